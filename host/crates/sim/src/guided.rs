//! An arm that a simulated hand guides from pose to pose, behind a robot's own interface. It follows no command.

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, Normal};
use spherecal_fci::robot as fci;
use spherecal_fri::robot as fri;
use spherecal_model::robots::RobotModel;
use spherecal_shared::robot::{Arm, Dynamics as _, RobotError};
use spherecal_ur::robot as ur;

/// Time from one pose to the next, in s.
const MOVE_S: f64 = 0.5;
/// Time at the first pose, in s: a client connects meanwhile.
const FIRST_S: f64 = 5.0;
/// Noise of an encoder (1 sigma), in rad.
const NOISE_RAD: f64 = 1e-5;

/// The guided arm, with `N` joints.
pub struct GuidedArm<const N: usize> {
    poses: Vec<[f64; N]>,
    rest_s: f64,
    known: Arm<f64, N>,
    time_s: f64,
    noise: Normal<f64>,
    random: ChaCha8Rng,
    q: [f64; N],
    dq: [f64; N],
}

impl<const N: usize> GuidedArm<N> {
    /// A hand that guides the arm to these readings of the encoders (rad), and rests at each for `rest_s`. It rests at
    /// the first pose for 5 s, and stays at the last one. `None` without a pose.
    ///
    /// # Errors
    /// The robot has another number of joints.
    pub fn new(model: &RobotModel, poses: &[[f64; N]], rest_s: f64, seed: u64) -> Result<Option<Self>, RobotError> {
        let known = Arm::new(&model.robot, &model.tool_in_table())?;
        let (Some(first), Ok(noise)) = (poses.first(), Normal::new(0.0, NOISE_RAD)) else {
            return Ok(None);
        };
        Ok(Some(Self {
            q: *first,
            poses: poses.to_vec(),
            rest_s,
            known,
            time_s: 0.0,
            noise,
            random: ChaCha8Rng::seed_from_u64(seed),
            dq: [0.0; N],
        }))
    }

    fn advance(&mut self, step_s: f64) {
        self.time_s += step_s;
        let after = (self.time_s - FIRST_S).max(0.0);
        let cycle = MOVE_S + self.rest_s;
        let last = self.poses.len() - 1;
        let from = ((after / cycle) as usize).min(last);
        let to = (from + 1).min(last);
        // A smooth step: speed zero at both ends.
        let s = ((after - from as f64 * cycle) / MOVE_S).clamp(0.0, 1.0);
        let (part, rate) = (s * s * (3.0 - 2.0 * s), 6.0 * s * (1.0 - s) / MOVE_S);
        for j in 0..N {
            let way = self.poses[to][j] - self.poses[from][j];
            self.q[j] = self.poses[from][j] + part * way + self.noise.sample(&mut self.random);
            self.dq[j] = rate * way;
        }
    }

    fn gravity(&self) -> [f64; N] {
        self.known.bodies(&self.known.frames(&self.q)).gravity().into()
    }
}

impl fci::ArmHardware for GuidedArm<7> {
    fn state(&self) -> fci::ArmState {
        fci::ArmState {
            q: self.q,
            dq: self.dq,
            tau: self.gravity(),
            tau_external: [0.0; 7],
            wrench_external: [0.0; 6],
        }
    }

    fn step(&mut self, _: fci::ArmCommand) -> fci::ArmState {
        self.advance(1e-3);
        fci::ArmHardware::state(self)
    }
}

impl fri::ArmHardware for GuidedArm<7> {
    fn state(&self) -> fri::ArmState {
        fri::ArmState {
            q: self.q,
            tau: self.gravity(),
            tau_external: [0.0; 7],
        }
    }

    fn step(&mut self, _: fri::ArmCommand, step_s: f64) -> fri::ArmState {
        self.advance(step_s);
        fri::ArmHardware::state(self)
    }
}

impl ur::ArmHardware for GuidedArm<6> {
    fn state(&self) -> ur::ArmState {
        ur::ArmState {
            q: self.q,
            qd: self.dq,
            moment: self.gravity(),
            motor_torque: [0.0; 6],
        }
    }

    fn step(&mut self, _: ur::ArmCommand, step_s: f64) -> ur::ArmState {
        self.advance(step_s);
        ur::ArmHardware::state(self)
    }
}
