//! Continuous motion: follows the controller's motion between two poses step by step on the nominal
//! robot.
//!
//! The controller turns the orientation along the shortest arc and moves the elbow angle in
//! proportion. The TCP rests (or, in free space, moves on a straight line). A move is allowed if
//! the inverse kinematics follows it without a jump, inside the joint limits and away from
//! singularities.

use core::fmt;

use nalgebra::Rotation3;
use serde::{Deserialize, Serialize};

use spherecal_model::chain::{Chain, TcpPose, rotation_vector, turn_between, wrapped};

/// The obstacle to a pose or a move.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[serde(rename_all = "snake_case")]
pub enum Obstacle {
    /// No joint angles solve the pose.
    #[error("out of reach")]
    OutOfReach,
    /// A joint limit, margin included.
    #[error("joint {joint} would be at {angle_deg:.1} degrees, within its limit's margin or beyond")]
    JointLimit {
        /// Joint, from 1.
        joint: u32,
        /// Angle that it would need, in degrees.
        angle_deg: f64,
    },
    /// Too near to a singular place.
    #[error("singular: joint {joint} at {angle_deg:.1} degrees")]
    Singular {
        /// Joint whose axis aligns its neighbours; 0 if no single joint does.
        joint: u32,
        /// Its angle, in degrees (for joint 0: 0).
        angle_deg: f64,
    },
    /// The joints would have to jump on the way.
    #[error("no continuous motion: joint {joint} would jump by {jump_deg:.1} degrees")]
    Jump {
        /// Joint, from 1.
        joint: u32,
        /// Size of the jump over one step of the path, in degrees.
        jump_deg: f64,
    },
    /// Nest, tool or links would be within their margin of something.
    #[error("{part} would be {by_mm:.0} mm too near")]
    TooNear {
        /// To what.
        part: CollisionObject,
        /// How far within the margin, in mm.
        by_mm: f64,
    },
    /// The arm is folded or stretched: it would meet the sphere with too much mass.
    #[error(
        "the arm is folded or stretched there: it would meet the sphere with {kg:.0} kg, and may with {most_kg:.0} \
         (by procedure.limits.force_n, approach.speed_m_s and decouple.magnet_n)"
    )]
    Heavy {
        /// Mass along the approach, or in the worst direction, while the orientation is held, in kg.
        kg: f64,
        /// Largest mass that is accepted, in kg.
        most_kg: f64,
    },
    /// No clear motion leads there from home.
    #[error("no motion from home keeps nest, tool and links clear of spheres, plate and arm")]
    NoWay,
}

/// What an arm can come too near to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CollisionObject {
    /// A sphere or its post.
    Sphere(u32),
    /// The plate.
    Plate,
    /// The arm's own links up to the elbow.
    Arm,
}

impl fmt::Display for CollisionObject {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Sphere(id) => write!(f, "sphere {id} or its post"),
            Self::Plate => write!(f, "the plate"),
            Self::Arm => write!(f, "the arm itself"),
        }
    }
}

impl Obstacle {
    /// The kind in words, for counting.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::OutOfReach => "out of reach",
            Self::JointLimit { .. } => "joint limit",
            Self::Singular { .. } => "singular",
            Self::Jump { .. } => "no continuous motion",
            Self::TooNear { .. } => "too near to sphere, plate or arm",
            Self::Heavy { .. } => "folded or stretched",
            Self::NoWay => "no clear way",
        }
    }
}

/// What a configuration and a move must keep.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Rules {
    /// Distance to every joint limit, in rad.
    pub limit_margin_rad: f64,
    /// Smallest |q2|, |q4| and |q6| of a spherical-rotational-spherical arm, in
    /// rad: at zero two axes of shoulder, elbow or wrist align. Also for every other arm with seven joints: the smallest
    /// angle between the axes 1 and 3, half of that between upper arm and forearm, and the one between the axes 5 and 7.
    pub singular_rad: [f64; 3],
    /// For every arm without that structure: smallest singular value of the TCP Jacobian (m and rad). Arms with seven joints
    /// have one to spare and keep a third of it.
    pub singular_value: f64,
    /// Step of the followed path, in rad of rotation or elbow.
    pub step_rad: f64,
    /// How far from its planned place a sphere may seem to lie, in m: model errors and overshoot. Poses of a grid in which a
    /// joint would come to within 1 degree of its limit for that are left out, and the others are ordered by the joints'
    /// motion. At 0 only the planned place counts.
    pub stray_m: f64,
    /// Largest change of any joint over one step, in rad. Arms without a spherical shoulder and
    /// wrist keep a third of it.
    pub jump_rad: f64,
}

/// Distance to a joint's limit that a sphere elsewhere may leave, in rad: the controller stops a joint at 0.01.
const STRAY_MARGIN_RAD: f64 = 0.0175;

/// How near a configuration is to a singular place.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct NearSingular {
    /// What is left beyond the distance that the rules ask for: a difference of sines, or of the smallest singular value
    /// (m and rad). Negative within it.
    pub(super) room: f64,
    /// Joint whose axis aligns its neighbours; 0 if no single joint does.
    joint: u32,
    /// Its angle, in rad (for joint 0: 0).
    angle_rad: f64,
}

/// Angle between upper arm and forearm of an arm without the closed form, as a multiple of the second angle of
/// [`Rules::singular_rad`]. An FR3 whose pose was 12 degrees from the stretched posture swung through it.
const STRETCHED_FACTOR: f64 = 2.0;

/// How far the elbow of an arm without the closed form may stay behind on a move, in rad: dry friction holds it. A
/// Panda's joint 2 was planned to keep 11 degrees from zero, where the axes 1 and 3 align, and came within 4. KUKA's arms,
/// which have the closed form, finish on the same plants without it.
const ELBOW_LAG_RAD: f64 = 0.2;

impl Default for Rules {
    /// Keeps 15 degrees from the shoulder's singularity, where the elbow angle turns joint 1 fast,
    /// and 10 from those of elbow and wrist. Keeps 7 degrees from the limits, because the arm
    /// deviates while it turns, and more when static friction breaks. At a singular value of 0.027 the torques of a UR5e tell
    /// a force to 60 N, and its nest left the sphere on fast turns: a move passes at a third of 0.08 or more.
    fn default() -> Self {
        Self {
            limit_margin_rad: 7f64.to_radians(),
            singular_rad: [15f64.to_radians(), 10f64.to_radians(), 10f64.to_radians()],
            singular_value: 0.08,
            stray_m: 0.0,
            step_rad: 3f64.to_radians(),
            jump_rad: 30f64.to_radians(),
        }
    }
}

impl Rules {
    /// The filter of the paper's whole grid: 2 degrees to the limits, as in the reference worlds
    /// (1,843 of 1,875 poses), and no exact singularity.
    pub fn paper() -> Self {
        Self {
            limit_margin_rad: 2f64.to_radians(),
            singular_rad: [1f64.to_radians(); 3],
            ..Self::default()
        }
    }

    /// The same for an arm that carries it out (1,815 poses): its joints are not where the nominal ones are, and a stretched
    /// arm's are off by much. With the sphere 4 mm from its nominal place, joint 6 of an iiwa ran to its limit in poses that
    /// were planned 5 degrees from it: 2 degrees were the place, 3 the overshoot that friction makes.
    pub fn paper_on_an_arm() -> Self {
        Self {
            stray_m: 0.008,
            ..Self::paper()
        }
    }

    /// The rules for passing through: a third of the distance to singularities.
    pub fn passing(&self) -> Self {
        Self {
            singular_rad: self.singular_rad.map(|s| s / 3.0),
            singular_value: self.singular_value / 3.0,
            ..*self
        }
    }

    /// Checks one configuration for a recording.
    ///
    /// # Errors
    /// The limit or the singularity that is too close.
    pub fn configuration(&self, chain: &Chain, q: &[f64]) -> Result<(), Obstacle> {
        for ((joint, q), limit) in (1..).zip(q).zip(chain.limits()) {
            if *q < limit.min_rad + self.limit_margin_rad || *q > limit.max_rad - self.limit_margin_rad {
                return Err(Obstacle::JointLimit {
                    joint,
                    angle_deg: q.to_degrees(),
                });
            }
        }
        let near = self.nearest_singular(chain, q);
        if near.room < 0.0 {
            return Err(Obstacle::Singular {
                joint: near.joint,
                angle_deg: near.angle_rad.to_degrees(),
            });
        }
        Ok(())
    }

    /// Checks that the joints keep off their limits also if the sphere seems to lie [`stray_m`](Self::stray_m) elsewhere.
    /// Errors: the limit that is too close.
    pub(super) fn astray(&self, chain: &Chain, pose: &TcpPose, q: &[f64]) -> Result<(), Obstacle> {
        if self.stray_m == 0.0 {
            return Ok(());
        }
        let wide = Self {
            limit_margin_rad: STRAY_MARGIN_RAD,
            singular_rad: [0.0; 3],
            singular_value: 0.0,
            ..*self
        };
        for side in 0..6 {
            let mut moved = *pose;
            moved.position[side / 2] += if side % 2 == 0 { self.stray_m } else { -self.stray_m };
            let joints = chain.follow(&moved, q).ok_or(Obstacle::OutOfReach)?;
            wide.configuration(chain, &joints)?;
        }
        Ok(())
    }

    /// The singular place that `q` (rad) is nearest to, measured by what these rules ask for.
    pub(super) fn nearest_singular(&self, chain: &Chain, q: &[f64]) -> NearSingular {
        let nearest = |places: &mut dyn Iterator<Item = NearSingular>| {
            places.min_by(|a, b| a.room.total_cmp(&b.room)).unwrap_or_default()
        };
        if chain.closed_form() {
            return nearest(&mut self.singular_rad.iter().enumerate().map(|(k, least)| {
                let joint = 2 * k + 1;
                let angle_rad = q[joint] + chain.rows()[joint].theta;
                NearSingular {
                    room: wrapped(angle_rad).sin().abs() - least.sin(),
                    joint: joint as u32 + 1,
                    angle_rad,
                }
            }));
        }
        let rank = |least: f64| NearSingular {
            room: chain.smallest_singular_value(q) - least,
            joint: 0,
            angle_rad: 0.0,
        };
        if q.len() != 7 {
            return rank(self.singular_value);
        }
        let spare = rank(self.singular_value / 3.0);
        if spare.room < 0.0 {
            return spare;
        }
        nearest(&mut self.seven_joints(chain, q).into_iter().chain([spare]))
    }

    /// The singular places of an arm with seven joints and without the closed form.
    ///
    /// Seven joints keep the rank of the TCP Jacobian where two axes of shoulder or wrist align: the two joints turn
    /// against each other, and nothing else moves. The elbow angle does not see that motion, and friction lets it run: a
    /// Franka's joint 1 turned by a radian, and the force estimate reached 190 N where nothing pressed. Where shoulder,
    /// elbow and wrist are in line (a Franka's joint 4 at -27 degrees), the arm is stretched.
    fn seven_joints(&self, chain: &Chain, q: &[f64]) -> [NearSingular; 3] {
        let frames = chain.frames(q);
        let upper = frames[3].position - frames[1].position;
        let lower = frames[5].position - frames[3].position;
        let directions = [
            (1, frames[0].z(), frames[2].z(), self.singular_rad[0]),
            (3, upper, lower, STRETCHED_FACTOR * self.singular_rad[1]),
            (5, frames[4].z(), frames[6].z(), self.singular_rad[2]),
        ];
        directions.map(|(joint, before, after, least)| NearSingular {
            room: before.cross(&after).norm() / (before.norm() * after.norm()) - least.sin(),
            joint: joint as u32 + 1,
            angle_rad: q[joint],
        })
    }

    /// Follows the move from `from`, where the joints are at `q`, to `to`, by the rules for
    /// [`passing`](Self::passing). Returns the joint angles at the end, in rad.
    ///
    /// # Errors
    /// The first obstacle.
    pub fn follow(&self, chain: &Chain, from: &TcpPose, q: &[f64], to: &TcpPose) -> Result<Vec<f64>, Obstacle> {
        let count = (move_angle(from, to) / self.step_rad)
            .max((to.position - from.position).norm() / 0.010)
            .ceil()
            .max(1.0) as usize;
        let passing = self.passing();
        // Seven joints keep the rank of the TCP Jacobian where two wrist axes align, so the smallest
        // singular value does not see that joints 5 and 7 then turn fast against each other. (FR3:
        // 127 degrees of joint 5 over 30 of rotation ran beyond its limit.)
        let jump_rad = if chain.closed_form() {
            self.jump_rad
        } else {
            self.jump_rad / 3.0
        };
        let step = |pose: &TcpPose, current: &[f64]| {
            let next = chain.follow(pose, current).ok_or(Obstacle::OutOfReach)?;
            for ((joint, a), b) in (1..).zip(current).zip(&next) {
                if (a - b).abs() > jump_rad {
                    return Err(Obstacle::Jump {
                        joint,
                        jump_deg: (a - b).abs().to_degrees(),
                    });
                }
            }
            passing.configuration(chain, &next)?;
            Ok(next)
        };
        let mut current = q.to_vec();
        let mut behind = q.to_vec();
        for k in 1..=count {
            let pose = between(from, to, k as f64 / count as f64);
            current = step(&pose, &current)?;
            if let (false, Some(was), Some(elbow)) = (chain.closed_form(), from.elbow, pose.elbow) {
                let late = TcpPose {
                    elbow: Some(elbow + (was - elbow).clamp(-ELBOW_LAG_RAD, ELBOW_LAG_RAD)),
                    ..pose
                };
                behind = step(&late, &behind)?;
            }
        }
        Ok(current)
    }
}

/// Larger of the rotation angle and the elbow's change between two poses, in rad.
pub(super) fn move_angle(a: &TcpPose, b: &TcpPose) -> f64 {
    let elbow = match (a.elbow, b.elbow) {
        (Some(a), Some(b)) => (b - a).abs(),
        _ => 0.0,
    };
    turn_between(&a.rotation, &b.rotation).max(elbow)
}

/// The pose at fraction `t` of the move.
pub(super) fn between(a: &TcpPose, b: &TcpPose, t: f64) -> TcpPose {
    let turn = rotation_vector(&(b.rotation * a.rotation.inverse()));
    TcpPose {
        position: a.position + (b.position - a.position) * t,
        rotation: Rotation3::new(turn * t) * a.rotation,
        elbow: match (a.elbow, b.elbow) {
            (Some(a), Some(b)) => Some(a + (b - a) * t),
            (_, b) => b,
        },
    }
}
