//! The worlds W0 to W4 and how a robot is drawn from each (`identification.md`).

use nalgebra::{Rotation3, Vector3};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};
use spherecal_shared::robot::{Robot, iiwa7, iiwa7_tool};

use super::truth::{JointErrors, Truth, Wave};
use spherecal_model::{Chain, Pose, paper_plate};

/// A kind of world.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum World {
    /// Compliance, first and second encoder harmonics, white gear noise.
    W0,
    /// W0 with independently measured base and tool frames that are off.
    W1,
    /// All non-geometric effects three to four times larger.
    W2,
    /// W0 with harmonics 3 to 8, link bending and base tilt.
    W3,
    /// Out of any model's class: smooth random joint functions, cross-joint
    /// terms, ripple, nonlinear compliance, hysteresis, bending, tilt.
    W4,
    /// W4 with 5 % bad couplings of 3 to 6 mm.
    #[serde(rename = "W4 bad")]
    W4Bad,
}

impl World {
    /// All of them, in the order of tables.
    pub const ALL: [Self; 6] = [Self::W0, Self::W1, Self::W2, Self::W3, Self::W4, Self::W4Bad];

    /// Name in tables and on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::W0 => "W0",
            Self::W1 => "W1",
            Self::W2 => "W2",
            Self::W3 => "W3",
            Self::W4 => "W4",
            Self::W4Bad => "W4-bad",
        }
    }

    /// What it is, in a few words.
    pub const fn about(self) -> &'static str {
        match self {
            Self::W0 => "compliance, 1st and 2nd harmonics, white gear noise",
            Self::W1 => "the same, measured base and tool frames off",
            Self::W2 => "non-geometric effects three to four times larger",
            Self::W3 => "harmonics 3-8, link bending, base tilt",
            Self::W4 => "out of every model's class",
            Self::W4Bad => "the same, 5 % bad couplings of 3-6 mm",
        }
    }

    /// The numbers of this world.
    pub fn recipe(self) -> Recipe {
        let w0 = Recipe::default();
        match self {
            Self::W0 => w0,
            Self::W1 => Recipe {
                tool_off_m: 0.58e-3,
                base_off_m: 0.15e-3,
                ..w0
            },
            Self::W2 => Recipe {
                compliance: 8e-6,
                harmonics_rad: [7e-4, 4e-4],
                white_rad: 1.5e-4,
                ..w0
            },
            Self::W3 => Recipe {
                higher_harmonics_rad: 1e-4,
                bending: 1.5e-6,
                tilt: 1e-6,
                ..w0
            },
            Self::W4 | Self::W4Bad => Recipe {
                smooth_rad: 1.2e-4,
                cross_rad: 5e-5,
                ripple_rad: 5e-5,
                quadratic: 2e-8,
                hysteresis_rad: 3e-5,
                bending: 1.5e-6,
                tilt: 1e-6,
                bad_couplings: if self == Self::W4Bad { 0.05 } else { 0.0 },
                ..w0
            },
        }
    }
}

impl std::fmt::Display for World {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name())
    }
}

/// A name that no world has.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no world `{name}`: use one of {}", World::ALL.map(World::name).join(", "))]
pub struct UnknownWorld {
    /// As given.
    pub name: String,
}

impl std::str::FromStr for World {
    type Err = UnknownWorld;

    fn from_str(name: &str) -> Result<Self, UnknownWorld> {
        Self::ALL
            .into_iter()
            .find(|w| w.name().eq_ignore_ascii_case(name))
            .ok_or_else(|| UnknownWorld { name: name.to_owned() })
    }
}

/// The numbers from which a robot is drawn; all 1 sigma, SI units.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Recipe {
    /// Lengths a and d, in m, before the geometry is rescaled.
    pub length_m: f64,
    /// Twists alpha, in rad, before the geometry is rescaled.
    pub alpha_rad: f64,
    /// Offsets theta, in rad, before the geometry is rescaled.
    pub theta_rad: f64,
    /// Mean error of the nominal robot on the validation configurations that
    /// the geometry is rescaled to, in m.
    pub nominal_m: f64,
    /// Each coordinate of the tool, in m.
    pub tool_m: f64,
    /// Compliance in rad/(N m), times U(0.7, 1.3) for each joint.
    pub compliance: f64,
    /// Amplitudes of the first two encoder harmonics, in rad.
    pub harmonics_rad: [f64; 2],
    /// Root mean square of harmonics 3 to 8 together, in rad.
    pub higher_harmonics_rad: f64,
    /// White error of every joint at every pose, in rad.
    pub white_rad: f64,
    /// Link bending of each joint about x and y, in rad/(N m).
    pub bending: f64,
    /// Base tilt about x and y, in rad/(N m).
    pub tilt: f64,
    /// Smooth random joint functions (length scale 0.35 rad), rms in rad.
    pub smooth_rad: f64,
    /// Cross-joint functions, rms in rad.
    pub cross_rad: f64,
    /// Ripple of orders 20 to 60, rms in rad.
    pub ripple_rad: f64,
    /// Quadratic compliance, in rad/(N m)².
    pub quadratic: f64,
    /// Torque hysteresis, in rad.
    pub hysteresis_rad: f64,
    /// Seating of the nest, each axis, in m.
    pub seating_m: f64,
    /// Encoder after averaging, in rad.
    pub encoder_rad: f64,
    /// Laser tracker, each axis, in m.
    pub tracker_m: f64,
    /// Independently measured tool off sideways by this much, in m.
    pub tool_off_m: f64,
    /// Independently measured base off by this much, in m.
    pub base_off_m: f64,
    /// Share of contacts that are bad couplings, 3 to 6 mm off.
    pub bad_couplings: f64,
}

impl Default for Recipe {
    /// World W0.
    fn default() -> Self {
        Self {
            length_m: 0.20e-3,
            alpha_rad: 0.5e-3,
            theta_rad: 0.8e-3,
            nominal_m: 1.403e-3,
            tool_m: 1e-3,
            compliance: 3e-6,
            harmonics_rad: [2e-4, 1e-4],
            higher_harmonics_rad: 0.0,
            white_rad: 5e-5,
            bending: 0.0,
            tilt: 0.0,
            smooth_rad: 0.0,
            cross_rad: 0.0,
            ripple_rad: 0.0,
            quadratic: 0.0,
            hysteresis_rad: 0.0,
            seating_m: 3e-6,
            encoder_rad: 2e-6,
            tracker_m: 49e-6 / 1.96,
            tool_off_m: 0.0,
            base_off_m: 0.0,
            bad_couplings: 0.0,
        }
    }
}

/// Length scale of the smooth random functions of one joint, in rad.
const SMOOTH_SCALE_RAD: f64 = 0.35;
/// Length scale of the functions of two joints, in rad. `identification.md` gives
/// none; 1 rad leaves the residuals that the stored W4 worlds leave, on spheres
/// and under the laser, where 0.35 rad is rougher than they are.
const CROSS_SCALE_RAD: f64 = 1.0;
/// Waves that stand in for a Gaussian process (random Fourier features).
const FEATURES: usize = 64;

fn normal(rng: &mut impl Rng, sigma: f64) -> f64 {
    let unit: f64 = StandardNormal.sample(rng);
    unit * sigma
}

/// Draws a robot: errors of geometry as drawn, not yet rescaled.
fn drawn(recipe: &Recipe, plate: &Pose, rng: &mut ChaCha8Rng) -> Truth {
    let mut robot = iiwa7();
    let mut tool = iiwa7_tool();
    for joint in robot.joints.iter_mut().skip(1) {
        joint.mdh.alpha += normal(rng, recipe.alpha_rad);
        joint.mdh.a += normal(rng, recipe.length_m);
        joint.mdh.theta += normal(rng, recipe.theta_rad);
        joint.mdh.d += normal(rng, recipe.length_m);
    }
    for coordinate in &mut tool.tcp_m {
        *coordinate += normal(rng, recipe.tool_m);
    }
    let n = robot.dof();
    let joints = (0..n).map(|i| joint_errors(recipe, rng, i, n)).collect();
    let spheres = paper_plate();
    // The tracker stands somewhere in front of the cell.
    let base = Pose {
        rotation: *Rotation3::from_euler_angles(normal(rng, 0.01), normal(rng, 0.01), rng.random_range(-3.0..3.0))
            .matrix(),
        position: Vector3::new(
            rng.random_range(1.5..2.5),
            rng.random_range(-1.0..1.0),
            rng.random_range(-1.0..0.0),
        ),
    };
    let spheres_m = spheres
        .iter()
        .map(|s| s.position_m.map(|x| x + normal(rng, s.sigma_m)))
        .collect();
    Truth {
        robot,
        tool,
        base,
        plate: *plate,
        spheres_m,
        sphere_ids: spheres.iter().map(|s| s.id).collect(),
        joints,
        tilt: [(); 2].map(|()| normal(rng, recipe.tilt)),
        white_rad: recipe.white_rad,
        geometry_scale: 1.0,
    }
}

fn joint_errors(recipe: &Recipe, rng: &mut ChaCha8Rng, i: usize, n: usize) -> JointErrors {
    let mut waves = Vec::new();
    let mut cosine_and_sine = |rng: &mut ChaCha8Rng, order: f64, sigma: f64| {
        for phase in [0.0, -std::f64::consts::FRAC_PI_2] {
            waves.push(Wave {
                amplitude: normal(rng, sigma),
                order,
                other_order: 0.0,
                phase,
            });
        }
    };
    for (order, h) in (1u32..).zip(recipe.harmonics_rad) {
        cosine_and_sine(rng, f64::from(order), h / 2f64.sqrt());
    }
    if recipe.higher_harmonics_rad > 0.0 {
        // Six orders share the variance; a wave's mean square is half its square.
        for order in 3u32..=8 {
            cosine_and_sine(rng, f64::from(order), recipe.higher_harmonics_rad / 6f64.sqrt());
        }
    }
    if recipe.ripple_rad > 0.0 {
        for _ in 0..6 {
            let order = f64::from(rng.random_range(20u32..=60));
            cosine_and_sine(rng, order, recipe.ripple_rad / 6f64.sqrt());
        }
    }
    let features = |rng: &mut ChaCha8Rng, rms: f64, scale: f64, both: bool| -> Vec<Wave> {
        (0..FEATURES)
            .map(|_| Wave {
                amplitude: rms * (2.0 / FEATURES as f64).sqrt(),
                order: normal(rng, 1.0 / scale),
                other_order: if both { normal(rng, 1.0 / scale) } else { 0.0 },
                phase: rng.random_range(0.0..std::f64::consts::TAU),
            })
            .collect()
    };
    if recipe.smooth_rad > 0.0 {
        waves.extend(features(rng, recipe.smooth_rad, SMOOTH_SCALE_RAD, false));
    }
    let cross = if recipe.cross_rad > 0.0 {
        features(rng, recipe.cross_rad, CROSS_SCALE_RAD, true)
    } else {
        Vec::new()
    };
    JointErrors {
        compliance: recipe.compliance * rng.random_range(0.7..1.3),
        quadratic: recipe.quadratic,
        hysteresis: recipe.hysteresis_rad,
        waves,
        cross,
        other: (i + rng.random_range(1..n)) % n,
        bending: [(); 2].map(|()| normal(rng, recipe.bending)),
    }
}

/// The robot of `seed` in a world with this recipe. Its geometric errors are
/// rescaled so that the nominal robot, in the true base and with the true tool,
/// errs by [`Recipe::nominal_m`] in the mean on `configurations` (rad).
///
/// `plate` is where the plate stands in F0.
///
/// The same seed gives the same draws of geometry in every world.
pub fn draw(recipe: &Recipe, seed: u64, configurations: &[Vec<f64>], plate: &Pose) -> Truth {
    let mut rng = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0x776f_726c_6473);
    let unscaled = drawn(recipe, plate, &mut rng);
    let nominal = iiwa7();
    let error_at = |scale: f64| {
        let truth = Truth {
            robot: scaled(&nominal, &unscaled.robot, scale),
            ..unscaled.clone()
        };
        let ideal = Chain::unchecked(&nominal, &truth.tool);
        let evaluator = truth.evaluator();
        let errors = configurations
            .iter()
            .map(|q| (evaluator.tcp(q, &[]) - ideal.tcp_of(&ideal.frames(q))).norm());
        errors.sum::<f64>() / configurations.len().max(1) as f64
    };
    // The mean error grows with the scale: bisection, to a nanometre or so.
    let (mut low, mut high) = (0.0, 8.0);
    for _ in 0..30 {
        let middle = f64::midpoint(low, high);
        if error_at(middle) < recipe.nominal_m {
            low = middle;
        } else {
            high = middle;
        }
    }
    let geometry_scale = f64::midpoint(low, high);
    Truth {
        robot: scaled(&nominal, &unscaled.robot, geometry_scale),
        geometry_scale,
        ..unscaled
    }
}

/// `nominal` plus `scale` times the deviations of `drawn`.
fn scaled(nominal: &Robot, drawn: &Robot, scale: f64) -> Robot {
    let mut robot = nominal.clone();
    for (joint, other) in robot.joints.iter_mut().zip(&drawn.joints) {
        let (m, d) = (&mut joint.mdh, &other.mdh);
        m.alpha += scale * (d.alpha - m.alpha);
        m.a += scale * (d.a - m.a);
        m.theta += scale * (d.theta - m.theta);
        m.d += scale * (d.d - m.d);
    }
    robot
}
