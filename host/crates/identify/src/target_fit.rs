//! How well the fit explains each target of the tool, and the orientation of a measured body.

use nalgebra::Vector3;
use serde::Serialize;

use super::hierarchy::Fit;
use super::seen::RowPart;

/// One target's place, noise and residual.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TargetFit {
    /// Its number, from 1: the TCP.
    pub number: usize,
    /// Rows of the calibration set that saw it.
    pub rows: usize,
    /// Where it is in the last frame of the table, in m.
    pub place_m: [f64; 3],
    /// Its own noise along each axis (1 sigma), in mm: without that of the joints. Across the line of sight where rows have
    /// one.
    pub noise_mm: f64,
    /// The same along the line of sight, which goes from the origin of the instrument's frame to the target. `None` unless
    /// rows have an orientation, as those of cameras have.
    pub depth_noise_mm: Option<f64>,
    /// Root mean square distance between model and measurement, in mm.
    pub rms_mm: f64,
}

impl TargetFit {
    /// Its noise in words.
    pub fn noise_words(&self) -> String {
        match self.depth_noise_mm {
            Some(depth) => format!(
                "{:.3} mm across the line of sight, {depth:.3} mm along it",
                self.noise_mm
            ),
            None => format!("{:.3} mm", self.noise_mm),
        }
    }
}

/// Noise and residual of measured orientations.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct OrientationFit {
    /// Rows of the calibration set that have one.
    pub rows: usize,
    /// Its own noise about each axis (1 sigma), in mrad: without that of the joints.
    pub noise_mrad: f64,
    /// Root mean square angle between model and measurement, in mrad.
    pub rms_mrad: f64,
}

/// The targets of data that have more than one, and their orientation; none of other data.
pub(super) fn target_fits(fit: &Fit) -> (Vec<TargetFit>, Option<OrientationFit>) {
    let layout = &fit.layout;
    if layout.targets == 1 && !layout.body {
        return (Vec::new(), None);
    }
    let mut sums = vec![(0_usize, 0.0_f64); layout.targets + 1];
    for observation in &fit.prepared {
        for block in fit.state.blocks(layout.n, observation) {
            let slot = match block.part {
                RowPart::Target(number) => number,
                RowPart::Body => layout.targets,
            };
            sums[slot].0 += 1;
            sums[slot].1 += block.residual.norm_squared();
        }
    }
    let rms = |(rows, sum): (usize, f64)| (sum / rows.max(1) as f64).sqrt() * 1e3;
    let targets = (0..layout.targets).map(|number| {
        let own = fit.target_noise(number);
        TargetFit {
            number: number + 1,
            rows: sums[number].0,
            place_m: fit.state.place(number).into(),
            noise_mm: own.across.sqrt() * 1e3,
            depth_noise_mm: (own.sight != Vector3::zeros()).then(|| own.along.sqrt() * 1e3),
            rms_mm: rms(sums[number]),
        }
    });
    let body = sums[layout.targets];
    let orientation = layout.body.then(|| OrientationFit {
        rows: body.0,
        noise_mrad: fit.whitening.body.sqrt() * 1e3,
        rms_mrad: rms(body),
    });
    (targets.collect(), orientation)
}
