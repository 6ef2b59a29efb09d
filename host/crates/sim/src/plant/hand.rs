//! A simulated operator's hand: leads the nest over a sphere, as in Section 4.2
//! of the paper, with the strength, the speed and the eye of a person.
//!
//! The hand belongs to the world: it sees the true sphere and the true nest, as a person does, and
//! only pushes. It is a spring and damper between the tool and a point that moves over the plate,
//! with a limited force. Simplification: a person's hand does not follow straight lines.

use nalgebra::{Matrix3, Rotation3, Unit, UnitQuaternion, Vector3};
use rand_chacha::ChaCha8Rng;
use spherecal_shared::robot::Pose;

use super::config::PlantConfig;
use super::random::{Stream, normal, normal3, stream};
use super::simulation::Plant;

/// Speed of the hand, in m/s: hand-guiding keeps below 0.25.
const SPEED_M_S: f64 = 0.10;
/// Largest force, in N: an easy push.
const FORCE_N: f64 = 60.0;
/// Largest moment, in N m: a wrist's.
const MOMENT_NM: f64 = 10.0;
/// Spring and damper of the grip, in N/m and N s/m.
const GRIP: (f64, f64) = (3000.0, 200.0);
/// The same for its orientation, in N m/rad and N m s/rad.
const TWIST: (f64, f64) = (80.0, 0.8);
/// Standard deviation of the aim by eye, each axis, in m.
const AIM_SIGMA_M: f64 = 0.002;
/// Standard deviation of the tilt by eye, each axis, in rad: one degree.
const TILT_SIGMA_RAD: f64 = 0.017;
/// Height above the spheres' centres at which the hand crosses the plate, in m.
const CLEARANCE_M: f64 = 0.12;
/// The hand has arrived if the tool has been slower than this, in m/s, for this number of ticks.
const STILL: (f64, u32) = (0.003, 300);
/// How near the eye wants it, in m.
const NEAR_M: f64 = 0.012;

/// The hand.
#[derive(Clone, Debug)]
pub struct Hand {
    rng: ChaCha8Rng,
    legs: Vec<Vector3<f64>>,
    at: Vector3<f64>,
    facing: Matrix3<f64>,
    last: Option<Pose<f64>>,
    still: u32,
}

impl Hand {
    /// A hand that holds nothing; its aim is drawn from the plant's seed.
    pub fn new(config: &PlantConfig) -> Self {
        Self {
            rng: stream(config.seed, Stream::Hand),
            legs: Vec::new(),
            at: Vector3::zeros(),
            facing: Matrix3::identity(),
            last: None,
            still: 0,
        }
    }

    /// Takes the tool and begins to lead it to `height_m` above the centre of `sphere` (from 0).
    /// Does nothing if the sphere does not exist.
    pub fn lead<const N: usize>(&mut self, plant: &Plant<N>, sphere: usize, height_m: f64) {
        let truth = plant.truth();
        let world = plant.world();
        let Some(Some(centre)) = world.spheres.get(sphere) else {
            return;
        };
        let up = world.plate.z();
        let aim = normal3(&mut self.rng) * AIM_SIGMA_M;
        let goal = centre + up * height_m + aim;
        let over = |p: &Vector3<f64>| p + up * (CLEARANCE_M - up.dot(&(p - centre))).max(0.0);
        self.at = truth.tcp.position;
        self.legs = vec![goal, over(&goal), over(&truth.tcp.position)];
        // The shortest rotation that points the tool at the plate, with the error of the aim.
        let tool = truth.tcp.z();
        let across = tool.cross(&-up);
        let angle = across.norm().atan2(tool.dot(&-up));
        let turn = Unit::try_new(across, 1e-9).map_or_else(Rotation3::identity, |axis| {
            UnitQuaternion::from_axis_angle(&axis, angle).to_rotation_matrix()
        });
        let (a, b) = (normal(&mut self.rng), normal(&mut self.rng));
        let tilt = Rotation3::new(Vector3::new(a, b, 0.0) * TILT_SIGMA_RAD);
        self.facing = (tilt * turn).into_inner() * truth.tcp.rotation;
        self.last = Some(truth.tcp);
        self.still = 0;
    }

    /// Lets go.
    pub fn let_go<const N: usize>(&mut self, plant: &mut Plant<N>) {
        self.last = None;
        plant.set_hand_wrench([0.0; 3], [0.0; 3]);
    }

    /// Whether the tool is at its destination and at rest.
    pub fn is_there(&self) -> bool {
        self.still >= STILL.1
    }

    /// One tick, of `period_s`, of pushing.
    pub fn push<const N: usize>(&mut self, plant: &mut Plant<N>, period_s: f64) {
        let Some(last) = self.last else { return };
        let tcp = plant.truth().tcp;
        if let Some(goal) = self.legs.last() {
            let way = goal - self.at;
            let step = SPEED_M_S * period_s;
            if way.norm() > step {
                self.at += way * (step / way.norm());
            } else {
                self.at = *goal;
                // The last leg stays: it is where the hand waits.
                if self.legs.len() > 1 {
                    self.legs.pop();
                }
            }
        }
        let speed = (tcp.position - last.position) / period_s;
        let spin = turn(&(tcp.rotation * last.rotation.transpose())) / period_s;
        let pull = (self.at - tcp.position) * GRIP.0 - speed * GRIP.1;
        let twist = turn(&(self.facing * tcp.rotation.transpose())) * TWIST.0 - spin * TWIST.1;
        plant.set_hand_wrench(at_most(pull, FORCE_N).into(), at_most(twist, MOMENT_NM).into());
        self.last = Some(tcp);
        let arrived = self
            .legs
            .first()
            .is_some_and(|goal| *goal == self.at && (goal - tcp.position).norm() < NEAR_M && speed.norm() < STILL.0);
        self.still = if arrived { self.still.saturating_add(1) } else { 0 };
    }
}

/// Rotation vector of a rotation by less than half a turn; without the arc
/// cosine of the trace, which is no number for a trace that rounds past 3.
fn turn(r: &Matrix3<f64>) -> Vector3<f64> {
    let sine = Vector3::new(r[(2, 1)] - r[(1, 2)], r[(0, 2)] - r[(2, 0)], r[(1, 0)] - r[(0, 1)]) * 0.5;
    let s = sine.norm();
    if s < 1e-12 {
        return sine;
    }
    sine * (s.atan2((r.trace() - 1.0) * 0.5) / s)
}

fn at_most(vector: Vector3<f64>, most: f64) -> Vector3<f64> {
    let norm = vector.norm();
    if norm > most { vector * (most / norm) } else { vector }
}
