//! The primary interface: what a robot says of its own calibration.
//!
//! A package is `i32` length (header included), `u8` kind, payload. A robot state (kind 16) consists of parts: `u32` length
//! (header included), `u8` kind, payload. The part [`KinematicsInfo`] (kind 5) comes in the first state after a connection.
//! Source: the maker's client library, `src/primary/robot_state/kinematics_info.cpp`.

use super::WireError;
use super::bytes::Bytes;
use crate::JOINTS;
use spherecal_budget::robot::PACKAGE_BYTES;

/// Bytes of a header, of a package and of a part.
const HEADER: usize = 5;
/// Kind of a package: a robot state.
const ROBOT_STATE: u8 = 16;
/// Kind of a part: the calibrated kinematics.
const KINEMATICS_INFO: u8 = 5;

/// The Denavit-Hartenberg parameters that the robot computes with: nominal ones and the corrections of its factory
/// calibration, added up. Joint `i` turns about z by its angle and `theta[i]`, then `d[i]` along z, `a[i]` along x, and
/// `alpha[i]` about x.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct KinematicsInfo {
    /// The robot's checksums of the parameters of each joint.
    pub checksum: [u32; JOINTS],
    /// Joint offsets, rad.
    pub theta: [f64; JOINTS],
    /// Lengths along x, m.
    pub a: [f64; JOINTS],
    /// Lengths along z, m. Those of neighbouring parallel joints can be hundreds of metres that cancel.
    pub d: [f64; JOINTS],
    /// Twists, rad.
    pub alpha: [f64; JOINTS],
    /// What the robot says of its calibration: 0 is good.
    pub status: u32,
}

impl KinematicsInfo {
    /// A robot state that contains this and nothing else.
    pub fn encode(&self) -> Vec<u8> {
        let mut payload = Vec::new();
        payload.extend(self.checksum.iter().flat_map(|sum| sum.to_be_bytes()));
        for numbers in [&self.theta, &self.a, &self.d, &self.alpha] {
            payload.extend(numbers.iter().flat_map(|number| number.to_be_bytes()));
        }
        payload.extend(self.status.to_be_bytes());
        let framed = |kind, inner: &[u8]| {
            let mut out = ((inner.len() + HEADER) as u32).to_be_bytes().to_vec();
            out.push(kind);
            out.extend(inner);
            out
        };
        framed(ROBOT_STATE, &framed(KINEMATICS_INFO, &payload))
    }

    fn decode(payload: &[u8]) -> Result<Self, WireError> {
        let mut bytes = Bytes::new(payload, "KinematicsInfo");
        let mut info = Self::default();
        for sum in &mut info.checksum {
            *sum = bytes.u32("checksum")?;
        }
        for (field, numbers) in [
            ("dh_theta", &mut info.theta),
            ("dh_a", &mut info.a),
            ("dh_d", &mut info.d),
            ("dh_alpha", &mut info.alpha),
        ] {
            for number in numbers {
                *number = bytes.f64(field)?;
                if !number.is_finite() {
                    return Err(WireError::NotFinite { field });
                }
            }
        }
        info.status = bytes.u32("calibration_status")?;
        bytes.end()?;
        Ok(info)
    }

    /// The calibration in a package that [`take_primary`] took; `None` if the package does not contain it.
    ///
    /// # Errors
    /// A [`WireError`] if the package is broken.
    pub fn find(kind: u8, payload: &[u8]) -> Result<Option<Self>, WireError> {
        let mut bytes = Bytes::new(payload, "robot state");
        if kind != ROBOT_STATE {
            return Ok(None);
        }
        loop {
            let mut rest = bytes;
            if rest.rest().is_empty() {
                return Ok(None);
            }
            let size = bytes.u32("length of a part")? as usize;
            let kind = bytes.u8("kind of a part")?;
            let size = size.checked_sub(HEADER).ok_or(WireError::Size {
                size,
                least: HEADER,
                most: PACKAGE_BYTES,
            })?;
            let part = bytes.take(size, "part")?;
            if kind == KINEMATICS_INFO {
                return Self::decode(part).map(Some);
            }
        }
    }
}

/// Takes the first package from what has come: its kind and its payload. `None` while it is not whole.
///
/// # Errors
/// [`WireError::Size`] for a length below the header's or above [`PACKAGE_BYTES`].
pub fn take_primary(received: &mut Vec<u8>) -> Result<Option<(u8, Vec<u8>)>, WireError> {
    let Some(&[a, b, c, d, kind]) = received.first_chunk::<HEADER>() else {
        return Ok(None);
    };
    let size = u32::from_be_bytes([a, b, c, d]) as usize;
    if !(HEADER..=PACKAGE_BYTES).contains(&size) {
        return Err(WireError::Size {
            size,
            least: HEADER,
            most: PACKAGE_BYTES,
        });
    }
    if received.len() < size {
        return Ok(None);
    }
    let mut package: Vec<u8> = received.drain(..size).collect();
    package.drain(..HEADER);
    Ok(Some((kind, package)))
}
