//! The arm without dynamics: it goes from pose to pose and rests there.
//!
//! Recordings of a run never come from here; they come from the controller's samples while the nest
//! is seated. This module serves the static worlds, where an hour of simulated motion per robot is
//! too expensive, and the shots of the tracker. Static errors, and those that depend on time and
//! path, are the plant's.

use nalgebra::{SMatrix, SVector, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use spherecal_shared::linalg::Cholesky;
use spherecal_shared::robot::{Arm, Dynamics, Pose};

use super::config::{PlantConfig, ReadingConfig};
use super::coupling::SeatScatter;
use super::joint::SlowState;
use super::random::{Stream, normal, stream};
use super::world::TrueCell;

/// The readings of an arm at rest.
#[derive(Clone, Copy, Debug)]
pub struct Rest<const N: usize> {
    /// Encoder angles as read, in rad: early, with averaged noise.
    pub q: [f64; N],
    /// Measured joint torques, in N m.
    pub tau: [f64; N],
    /// True TCP in F0. For tests and figures only.
    pub tcp: Pose<f64>,
}

/// An arm at rest and the state that depends on its path.
#[derive(Clone, Debug)]
pub(super) struct Standing<const N: usize> {
    /// Geometry of the moment.
    arm: Arm<f64, N>,
    slow: SlowState<N>,
    rng: ChaCha8Rng,
    /// Encoder angles of its position, in rad; none before the first pose.
    at: Option<[f64; N]>,
    time_s: f64,
}

impl<const N: usize> Standing<N> {
    pub(super) fn new(cell: &TrueCell<N>, seed: u64) -> Self {
        Self {
            arm: cell.arm.clone(),
            slow: cell.slow(seed, Stream::Still),
            rng: stream(seed, Stream::Reading),
            at: None,
            time_s: 0.0,
        }
    }

    /// Time passes; the links drift.
    pub(super) fn wait(&mut self, cell: &TrueCell<N>, for_s: f64) {
        self.time_s += for_s;
        if cell.warming.is_on() {
            let robot = cell.warming.robot(&cell.robot, self.time_s);
            // The arm grows by micrometres only, so it stays valid.
            if let Ok(arm) = Arm::new(&robot, &cell.tool) {
                self.arm = arm;
            }
        }
    }

    /// Moves the joints to `q` and updates their path-dependent state; returns the move.
    pub(super) fn move_to(&mut self, cell: &TrueCell<N>, q: &[f64; N]) -> [f64; N] {
        let by = self.at.map_or([0.0; N], |at| core::array::from_fn(|i| q[i] - at[i]));
        self.slow.moved(&cell.memory, &by);
        self.at = Some(*q);
        by
    }

    /// True link angles and TCP where the encoders stand at `q`.
    pub(super) fn tcp(&self, cell: &TrueCell<N>, q: &[f64; N]) -> ([f64; N], Pose<f64>) {
        let link = cell.link_angles(&self.arm, q, Some(&self.slow));
        (link, cell.tcp_of(&self.arm, &link))
    }

    /// Torques that hold the arm at link angles, as the sensors read them, in N m.
    pub(super) fn torques(&self, cell: &TrueCell<N>, link: &[f64; N]) -> [f64; N] {
        let gravity = self.arm.bodies(&self.arm.frames(link)).gravity();
        core::array::from_fn(|i| gravity[i] + cell.torque_bias[i])
    }

    /// The reading at encoder angles `q` after the move `by`: early in some rows.
    pub(super) fn read(&mut self, config: &ReadingConfig, q: &[f64; N], by: &[f64; N]) -> [f64; N] {
        let mut read = *q;
        if config.early_share > 0.0 && self.rng.random::<f64>() < config.early_share {
            let farthest = by.iter().fold(0.0_f64, |most, b| most.max(b.abs()));
            // A short move does not reach the full deceleration, so the rest never exceeds the
            // move.
            let to_go = (0.5 * config.deceleration_rad_s2 * config.early_s * config.early_s).min(farthest);
            for (angle, by) in read.iter_mut().zip(by) {
                *angle -= if farthest > 0.0 { to_go * by / farthest } else { 0.0 };
            }
        }
        read
    }
}

/// An arm that stands still at every reading.
#[derive(Clone, Debug)]
pub struct StillArm<'a, const N: usize> {
    cell: &'a TrueCell<N>,
    config: &'a PlantConfig,
    standing: Standing<N>,
    coupling: SeatScatter,
    rng: ChaCha8Rng,
}

impl<'a, const N: usize> StillArm<'a, N> {
    /// An arm at the start of a run.
    pub fn new(cell: &'a TrueCell<N>, config: &'a PlantConfig) -> Self {
        Self {
            cell,
            config,
            standing: Standing::new(cell, config.seed),
            coupling: SeatScatter::new(config),
            rng: stream(config.seed, Stream::Noise),
        }
    }

    /// Time passes; links and plate drift.
    pub fn wait(&mut self, for_s: f64) {
        self.standing.wait(self.cell, for_s);
    }

    /// Goes to the encoder angles `q` (rad) in free space and rests.
    pub fn go_to(&mut self, q: &[f64; N]) -> Rest<N> {
        let by = self.standing.move_to(self.cell, q);
        self.read(q, &by)
    }

    /// Leaves the sphere: the next contact is a new coupling.
    pub fn decouple(&mut self) {
        self.coupling.near = false;
    }

    /// Goes to the contact with a ball centred at `centre` (m, F0, at the start of the run), near
    /// the encoder angles `guess` (rad), and rests. `None` if it is out of reach.
    pub fn go_to_contact(&mut self, guess: &[f64; N], centre: &Vector3<f64>) -> Option<Rest<N>> {
        let by = self.standing.move_to(self.cell, guess);
        let nest = &self.config.nest;
        if nest.seating_error {
            let orientation = self.standing.tcp(self.cell, guess).1.rotation;
            if !self.coupling.near {
                self.coupling.couple(nest, &orientation);
                self.coupling.near = true;
            }
            self.coupling.turn(nest, &orientation);
        }
        let centre = centre + self.cell.warming.plate(self.standing.time_s);
        let q = self.encoder_angles_at(guess, &centre)?;
        Some(self.read(&q, &by))
    }

    /// Encoder angles (rad) nearest to `guess` at which the ball sits centred at `centre` (m, F0).
    ///
    /// `None` if Newton's method does not converge to 0.1 µm: out of reach or singular.
    fn encoder_angles_at(&self, guess: &[f64; N], centre: &Vector3<f64>) -> Option<[f64; N]> {
        let nest = &self.config.nest;
        let plate = self.cell.plate.rotation;
        let target = |tcp: &Pose<f64>| {
            if !nest.seating_error {
                return *centre;
            }
            let seat = self.coupling.seated(nest, &tcp.rotation, &plate);
            // The nest is on the tool: a seat's error turns with it.
            centre - tcp.rotation * seat
        };
        let arm = &self.standing.arm;
        let mut q = *guess;
        for _ in 0..20 {
            let (link, tcp) = self.standing.tcp(self.cell, &q);
            let wrong = target(&tcp) - tcp.position;
            if wrong.norm() < 1e-9 {
                break;
            }
            let full = arm.jacobian(&arm.frames(&link), &tcp.position);
            let j: SMatrix<f64, 3, N> = full.fixed_rows::<3>(0).into();
            let square = j * j.transpose() + SMatrix::<f64, 3, 3>::identity() * 1e-9;
            let step: SVector<f64, N> = j.transpose() * Cholesky::new(&square)?.solve(&wrong);
            for i in 0..N {
                q[i] += step[i].clamp(-0.1, 0.1);
            }
        }
        let (_, reached) = self.standing.tcp(self.cell, &q);
        ((reached.position - target(&reached)).norm() < 1e-7).then_some(q)
    }

    /// Reads the arm at encoder angles `q` after the move `by`.
    fn read(&mut self, q: &[f64; N], by: &[f64; N]) -> Rest<N> {
        let (link, tcp) = self.standing.tcp(self.cell, q);
        let mut read = self.standing.read(&self.config.reading, q, by);
        let tracker = &self.config.tracker;
        if tracker.noise {
            for angle in &mut read {
                *angle += tracker.encoder_rad * normal(&mut self.rng);
            }
        }
        Rest {
            q: read,
            tau: self.standing.torques(self.cell, &link),
            tcp,
        }
    }
}
