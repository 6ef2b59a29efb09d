//! Contacts of an arm that a person guides by hand: no torque is commanded, and no contact is detected by force.
//!
//! ```text
//!   StateReader ─▶ StillWatch ─▶ plausible on this sphere? ─▶ ContactFile ─▶ identify
//! ```
//!
//! The person sets the tool on the spheres in a fixed order ([`Visits`]). Each pose at which the arm is still is averaged
//! and stored.

mod file;
mod still;

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use nalgebra::Vector3;
use spherecal_link::{JointReading, LinkError, StateReader};
use spherecal_model::chain::Chain;

pub use file::{ContactFile, ContactFileError, ContactRow};
pub use still::{StillPose, StillRules, StillWatch};

/// A TCP that is farther than this from the others on the same sphere is on another one, or in the air, in m. An arm
/// whose joint offsets are 20 mrad stays below it.
const ON_SPHERE_M: f64 = 0.1;
/// How far beyond a joint's limit an angle may be, in rad: joint offsets.
const BEYOND_RAD: f64 = 0.1;

/// Which contacts are wanted: the spheres of one placement after the other.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Visits {
    /// Ids of the spheres, in the order of the visits.
    pub spheres: Vec<u32>,
    /// Number of placements.
    pub places: u32,
    /// Number of poses in all.
    pub poses: u32,
}

impl Visits {
    /// The sphere that lacks poses, as placement (from 1) and id. `None`: all are there. Poses are spread evenly.
    pub fn next(&self, contacts: &[ContactRow]) -> Option<(u32, u32)> {
        let visits = (1..=self.places).flat_map(|place| self.spheres.iter().map(move |sphere| (place, *sphere)));
        let count = u64::from(self.places) * self.spheres.len() as u64;
        let share = |k: u64| u64::from(self.poses) * k / count.max(1);
        visits.zip(0_u64..).find_map(|(visit, k)| {
            let wanted = share(k + 1) - share(k);
            let found = contacts.iter().filter(|c| (c.place, c.sphere) == visit).count() as u64;
            (found < wanted).then_some(visit)
        })
    }
}

/// Why collecting ended before all contacts were there. Contacts that were kept are in the table.
#[derive(Debug, thiserror::Error)]
pub enum CollectError {
    /// The link failed.
    #[error("{source}; {kept} contacts are kept: give the same command again to go on")]
    Link {
        /// How.
        source: LinkError,
        /// Contacts in the table.
        kept: usize,
    },
    /// The table could not be extended.
    #[error(transparent)]
    File(#[from] ContactFileError),
    /// The robot is another one.
    #[error(
        "joint {joint} is at {angle_deg:.1} degrees, beyond its limits of {min_deg:.1} to {max_deg:.1} degrees: \
         name the robot that is connected with --robot"
    )]
    OtherRobot {
        /// Joint, from 1.
        joint: usize,
        /// Its angle, in degrees.
        angle_deg: f64,
        /// Its smallest angle, in degrees.
        min_deg: f64,
        /// Its largest angle, in degrees.
        max_deg: f64,
    },
    /// The arm has another number of joints.
    #[error(
        "the arm behind the link has {found} joints, but the robot has {expected}: name the right one with --robot"
    )]
    Joints {
        /// Joints of the arm.
        found: usize,
        /// Joints of the robot.
        expected: usize,
    },
    /// Somebody commands the arm.
    #[error("another program commands the arm ({what}): stop it, and start the robot's own hand guiding")]
    Commanded {
        /// What shows it.
        what: String,
    },
    /// No new still pose came.
    #[error(
        "no new still pose for {seconds:.0} s: hold the arm still for {needed:.1} s at each pose; {kept} contacts are \
         kept: give the same command again to go on"
    )]
    NotStill {
        /// How long, in s.
        seconds: f64,
        /// Time at rest that a pose needs, in s.
        needed: f64,
        /// Contacts in the table.
        kept: usize,
    },
}

/// What a person sees and says while contacts are collected.
pub trait CollectView {
    /// The next pose is wanted on this sphere, in this placement (from 1).
    fn wants(&mut self, place: u32, sphere: u32, contacts: &[ContactRow]);

    /// A pose was stored as the last of `contacts`.
    fn kept(&mut self, pose: &StillPose, contacts: &[ContactRow]);

    /// A still pose was not stored: its TCP is this far from the others on the sphere, in m.
    fn refused(&mut self, place: u32, sphere: u32, distance_m: f64);

    /// Whether the arm is on the sphere; asked at each reading. Always true where still poses are taken without a key.
    fn ready(&mut self) -> bool;
}

/// How contacts are collected.
#[derive(Clone, Debug, PartialEq)]
pub struct CollectRequest {
    /// Which contacts.
    pub visits: Visits,
    /// What a still pose is.
    pub rules: StillRules,
    /// Time without a new still pose after which collecting ends.
    pub patience: Duration,
}

/// Collects until all contacts are in the table or `interrupt` is set. Returns whether all are there.
///
/// # Errors
/// The link or the table fails, the arm is not guided, or it is another robot.
pub fn collect(
    reader: &mut dyn StateReader,
    chain: &Chain,
    table: &mut ContactFile,
    request: &CollectRequest,
    view: &mut dyn CollectView,
    interrupt: &AtomicBool,
) -> Result<bool, CollectError> {
    let found = reader.joints();
    if found != chain.dof() {
        return Err(CollectError::Joints {
            found,
            expected: chain.dof(),
        });
    }
    let mut watch = StillWatch::new(request.rules);
    let mut reading = JointReading::default();
    let mut since = Instant::now();
    let mut wanted = None;
    let mut ready = false;
    loop {
        let Some((place, sphere)) = request.visits.next(table.contacts()) else {
            return Ok(true);
        };
        if interrupt.load(Ordering::Relaxed) {
            return Ok(false);
        }
        if wanted.replace((place, sphere)) != Some((place, sphere)) {
            view.wants(place, sphere, table.contacts());
        }
        reader.read(&mut reading).map_err(|source| CollectError::Link {
            source,
            kept: table.contacts().len(),
        })?;
        check(&reading, chain)?;
        if since.elapsed() > request.patience {
            return Err(CollectError::NotStill {
                seconds: request.patience.as_secs_f64(),
                needed: request.rules.settle_s + request.rules.average_s,
                kept: table.contacts().len(),
            });
        }
        ready = ready || view.ready();
        let Some(pose) = ready.then(|| watch.take(&reading)).flatten() else {
            continue;
        };
        since = Instant::now();
        ready = false;
        if let Some(distance_m) = off_sphere(chain, table.contacts(), place, sphere, &pose.q) {
            view.refused(place, sphere, distance_m);
        } else {
            table.append(place, sphere, &pose)?;
            view.kept(&pose, table.contacts());
        }
    }
}

fn check(reading: &JointReading, chain: &Chain) -> Result<(), CollectError> {
    if let Some(what) = &reading.commanded {
        return Err(CollectError::Commanded { what: what.clone() });
    }
    for (joint, (q, limit)) in (1..).zip(reading.q.iter().zip(chain.limits())) {
        if !(limit.min_rad - BEYOND_RAD..=limit.max_rad + BEYOND_RAD).contains(q) {
            return Err(CollectError::OtherRobot {
                joint,
                angle_deg: q.to_degrees(),
                min_deg: limit.min_rad.to_degrees(),
                max_deg: limit.max_rad.to_degrees(),
            });
        }
    }
    Ok(())
}

/// How far the TCP is from the mean of the others on the same sphere, in m, if it is not on that sphere.
fn off_sphere(chain: &Chain, contacts: &[ContactRow], place: u32, sphere: u32, q: &[f64]) -> Option<f64> {
    let others: Vec<Vector3<f64>> = contacts
        .iter()
        .filter(|c| (c.place, c.sphere) == (place, sphere))
        .map(|c| chain.pose(&c.q).position)
        .collect();
    let mean = others.iter().sum::<Vector3<f64>>() / others.len().max(1) as f64;
    let distance = (chain.pose(q).position - mean).norm();
    (!others.is_empty() && distance > ON_SPHERE_M).then_some(distance)
}

#[cfg(test)]
mod tests;
