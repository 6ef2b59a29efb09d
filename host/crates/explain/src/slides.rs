//! Measured points of an arm with joints in front of it or in it that a table of hinges does not hold, as those of the same
//! arm with these joints at zero: joints that slide, and the *trunk* with which several chains of one tree begin.
//!
//! A joint that slides moves the TCP by `R u s`: the direction of its axis in the instrument's frame times its position. A
//! fit of the whole tree (base, tools, offsets and origins of all joints) gives that motion for each row, and that of the
//! trunk. Without it the points are those of an arm of hinges, which the identification knows. What remains of an error of
//! a slide or of the trunk is that of the fit: in first order its least-squares error.

use nalgebra::{Matrix3, Vector3};
use spherecal_model::input::{Table, TableRow};
use spherecal_model::robots::frames::compose;
use spherecal_model::robots::{JointKind, JointPath, PathFrames};
use spherecal_model::{Observation, Pose, Target};

use crate::TIE;
use crate::fit::{Effort, Fitted, Limb, State, fit_limbs};
use crate::rows::{Row, rows};

/// Fewest rows of a chain for its fit.
const FEWEST: usize = 10;
/// Standard deviation of the TCP, in m: also that of a tool that nobody gave.
const TOOL_M: f64 = 0.3;

/// Why the motion of slides and trunk cannot be taken out.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SlidesError {
    /// Too few rows.
    #[error("a chain with sliding joints or a shared trunk needs at least ten rows with a measured point")]
    TooFew,
    /// Contacts with spheres: their places are known, and cannot be moved.
    #[error("contacts with spheres cannot be used with sliding joints or a shared trunk: give measured points")]
    Contacts,
    /// Several chains that do not fit together.
    #[error(
        "the tables fit to {:.3} mm each and to {:.3} mm together: measure all tips in one frame of the instrument, and \
         give each tip its own table and tool",
        alone_m * 1e3,
        together_m * 1e3
    )]
    Apart {
        /// Median distance of the TCPs from their targets if each chain is fitted alone, in m: of the worst.
        alone_m: f64,
        /// The same in the fit of all, in m.
        together_m: f64,
    },
}

/// A chain from the base to a tip, and its rows.
#[derive(Clone, Debug)]
pub struct ChainRows {
    /// Its joints.
    pub path: JointPath,
    /// TCP in its flange frame, in m.
    pub tool: Vector3<f64>,
    /// Rows of joint columns of the path.
    pub observations: Vec<Observation>,
}

/// The fitted motion of what is taken out: joints that slide, and the trunk of several chains.
#[derive(Clone, Debug)]
pub struct Slides {
    state: State,
    /// How many joints all chains have in common, from the base.
    trunk: usize,
    /// Median distance of the TCPs from their targets in the fit of everything, in m.
    pub left_m: f64,
}

/// Fits chains that begin with the same `trunk` joints.
fn fitted(chains: &[ChainRows], trunk: usize) -> Result<Fitted, SlidesError> {
    let mut all: Vec<Row> = Vec::new();
    for (limb, chain) in chains.iter().enumerate() {
        let sphere = |o: &Observation| matches!(o.target, Target::Sphere { .. });
        if chain.observations.iter().any(sphere) {
            return Err(SlidesError::Contacts);
        }
        let own = rows(&chain.observations, &[]);
        if own.len() < FEWEST {
            return Err(SlidesError::TooFew);
        }
        all.extend(own.into_iter().map(|row| Row { limb, ..row }));
    }
    let effort = Effort {
        offsets: true,
        origins: true,
        tool_m: TOOL_M,
        iterations: 50,
    };
    let limbs: Vec<_> = chains.iter().map(|chain| (&chain.path, chain.tool)).collect();
    Ok(fit_limbs(&limbs, trunk, &all, effort))
}

impl Slides {
    /// Fits chains that begin with the same `trunk` joints to their rows, which have one frame of the instrument.
    ///
    /// # Errors
    /// Too few rows, contacts with spheres, or tables that do not fit together.
    pub fn fit(chains: &[ChainRows], trunk: usize) -> Result<Self, SlidesError> {
        let found = fitted(chains, trunk)?;
        let own = Self {
            left_m: found.median_m,
            state: found.state,
            trunk,
        };
        if chains.len() > 1 {
            let mut alone_m: f64 = 0.0;
            for chain in chains {
                alone_m = alone_m.max(fitted(std::slice::from_ref(chain), 0)?.median_m);
            }
            if own.left_m > TIE * alone_m {
                return Err(SlidesError::Apart {
                    alone_m,
                    together_m: own.left_m,
                });
            }
        }
        Ok(own)
    }

    /// Frames of a chain with all its columns at zero, in the base frame.
    fn at_zero(&self, limb: &Limb) -> PathFrames {
        limb.path.frames(&self.state.positions(limb, &[]))
    }

    /// The base of the chains in the instrument's frame.
    pub fn base(&self) -> Pose<f64> {
        self.state.bases.first().copied().unwrap_or_else(Pose::identity)
    }

    /// Directions of the first chain's sliding joints with all joints at zero, base to tip, in the instrument's frame.
    pub fn directions(&self) -> Vec<Vector3<f64>> {
        let Some(limb) = self.state.limbs.first() else {
            return Vec::new();
        };
        let frames = self.at_zero(limb);
        let joints = limb.path.joints.iter().zip(&frames.before);
        let slides = joints.filter(|(joint, _)| joint.kind == JointKind::Slides);
        let base = self.base().rotation;
        slides
            .map(|(joint, frame)| base * (frame.rotation * joint.axis))
            .collect()
    }

    /// Origins of the trunk's joints, each in the frame of the joint before it, with the joints' offsets in them.
    pub fn trunk(&self) -> Vec<Pose<f64>> {
        let Some(limb) = self.state.limbs.first() else {
            return Vec::new();
        };
        let joints = limb.path.joints.iter().take(self.trunk).enumerate();
        joints
            .map(|(k, joint)| compose(&joint.origin, &joint.motion(self.state.offset(limb, k))))
            .collect()
    }

    /// The trunk's last frame with all columns at zero, in the instrument's frame.
    pub fn trunk_end(&self) -> Pose<f64> {
        let limb = self.state.limbs.first().filter(|_| self.trunk > 0);
        let end = limb.and_then(|limb| self.at_zero(limb).behind.get(self.trunk - 1).copied());
        end.map_or_else(|| self.base(), |end| compose(&self.base(), &end))
    }

    /// Takes a body that was measured at the tip of chain `limb` with these joint columns to where it is with slides and
    /// trunk at zero (m, instrument's frame).
    pub fn rest(&self, limb: usize, columns: &[f64]) -> Pose<f64> {
        let Some(limb) = self.state.limbs.get(limb) else {
            return Pose::identity();
        };
        let moved = self.state.positions(limb, columns);
        let zero = limb.path.positions(&[]);
        let mut rest = moved.clone();
        for (k, (q, joint)) in rest.iter_mut().zip(&limb.path.joints).enumerate() {
            if joint.kind == JointKind::Slides {
                *q = self.state.offset(limb, k);
            } else if k < self.trunk {
                *q = zero.get(k).copied().unwrap_or_default() + self.state.offset(limb, k);
            }
        }
        let (from, to) = (limb.path.frames(&moved), limb.path.frames(&rest));
        let base = self.base();
        let tcp = |tip: &Pose<f64>| base.point(&tip.point(&limb.tool));
        // A slide turns nothing, to the last bit.
        let rotation = match self.trunk {
            0 => Matrix3::identity(),
            _ => base.rotation * to.tip.rotation * (base.rotation * from.tip.rotation).transpose(),
        };
        Pose {
            position: tcp(&to.tip) - rotation * tcp(&from.tip),
            rotation,
        }
    }
}

/// The rows of a table of joint columns as a fit takes them.
pub fn observations(table: &Table) -> Vec<Observation> {
    let one = |row: TableRow<'_>| Observation {
        q: row.q.to_vec(),
        tau: None,
        target: row.target(),
        set: row.set.unwrap_or_default(),
        seat: None,
    };
    table.rows().map(one).collect()
}

/// Turns a table of the columns of a path into one of the hinges of its table, with the slides at zero. `tool` is the TCP in
/// the flange frame, in m. The first table gives the motion of the slides, also for a later one. Returns what was done.
///
/// # Errors
/// As [`Slides::fit`].
pub fn hinges(
    path: &JointPath,
    tool: &Vector3<f64>,
    table: &mut Table,
    motion: &mut Option<Slides>,
) -> Result<Vec<String>, SlidesError> {
    let mut notes = Vec::new();
    let slides = path.joints.iter().filter(|joint| joint.kind == JointKind::Slides);
    let names: Vec<&str> = slides.map(|joint| joint.name.as_str()).collect();
    if !names.is_empty() && motion.is_none() {
        let chain = ChainRows {
            path: path.clone(),
            tool: *tool,
            observations: observations(table),
        };
        let found = Slides::fit(&[chain], 0)?;
        notes.push(format!(
            "the motion of the sliding joints ({}) was fitted with the whole chain (to {:.3} mm) and taken out of the points: \
             the turning joints are calibrated, and calibrated.urdf has the directions of the slides",
            names.join(", "),
            found.left_m * 1e3
        ));
        *motion = Some(found);
    }
    if table.rows().any(|row| row.tau.is_some()) {
        notes.push("torques are of the table's columns and not of the hinges: they are not used".to_owned());
    }
    table.with_joints(|columns| {
        let rest = motion.as_ref().map_or_else(Pose::identity, |m| m.rest(0, columns));
        (path.table_angles(&path.positions(columns)), rest)
    });
    Ok(notes)
}

#[cfg(test)]
#[path = "slides_tests.rs"]
mod tests;
