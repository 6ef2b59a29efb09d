//! The judge: a drive around the simulated arm that reads its truth.
//!
//! In every tick it stores on which sphere the nest truly sits and how fast the TCP truly moves,
//! and it keeps the largest kinetic energy and contact force. Recordings are compared with that
//! afterwards.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use nalgebra::Vector3;
use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState};
use spherecal_shared::protocol::host::Recording;
use spherecal_shared::robot::{Robot, Tool};

use spherecal_link::{Drive, LinkError};
use spherecal_sim::plant::{Disturbance, Plant, PlantConfig, PlantError};
use spherecal_sim::{Disturb, SimulatedArm};

/// Limit of the kinetic energy in every run, in J: 13 kg at 0.75 m/s have 3.7 J, the rotors have
/// the rest. See docs/recovery.md for this limit and the next two.
pub const KINETIC_J: f64 = 5.0;
/// Limit of the contact force in every run, in N, if it lasts 10 ms: ISO/TS 15066 allows it for
/// transient contact with a hand (table A.2: twice [`HELD_N`]). A shorter force is an impact, or
/// the magnet snapping the pads onto the sphere.
pub const CONTACT_N: f64 = 280.0;
/// Contact force that may last no longer than [`HELD_S`], in N: the same table allows it for
/// quasi-static contact with a hand.
pub const HELD_N: f64 = 140.0;
/// Duration from which a contact is quasi-static instead of transient, in s.
pub const HELD_S: f64 = 0.5;
/// Force with which the arm may press for 0.3 s, and for 10 ms, in N, after a fault. The
/// pull of the magnet does not count, nor what an injected push adds while it lasts.
pub const SUSTAINED_N: f64 = 20.0;
/// See [`SUSTAINED_N`].
pub const PEAK_N: f64 = 60.0;
/// Ticks for which a sustained force lasts: 0.3 s.
const SUSTAINED_TICKS: usize = 300;
/// How long a contact force must last to count, in ticks.
const LASTING: usize = 10;
/// Number of consecutive ticks for which a recording's nest may be off its sphere, because pads
/// chatter.
const CHATTER: usize = 5;
/// Largest motion of the nest during a recording, and distance from its seat, in m: a tenth of the target
/// accuracy.
const MOVED_M: f64 = 1e-4;
/// Number of consecutive ticks on the sphere at whose beginning the nest is in its seat: it leaves the seat
/// faster.
const SEATED: usize = 250;

/// What a tick truly was.
#[derive(Clone, Copy, Debug)]
struct TrueTick {
    seated: Option<u8>,
    tcp: Vector3<f32>,
}

/// What the judge has seen.
#[derive(Clone, Debug, Default)]
pub struct JudgeRecord {
    ticks: Vec<TrueTick>,
    /// The control period, from 1, in which the controller first moved the motors.
    pub ready_tick: Option<u64>,
    forces: [f64; LASTING],
    /// Largest kinetic energy, in J.
    pub kinetic_j: f64,
    /// The control period in which it was reached, from 1.
    pub kinetic_tick: usize,
    /// Largest contact force, in N, that lasted 10 ms.
    pub contact_n: f64,
    /// Largest contact force at any instant, in N.
    pub peak_n: f64,
    /// Ticks since the contact force was last below [`HELD_N`].
    held: u32,
    /// Longest time for which it was not, in s.
    pub held_s: f64,
    /// Whether an injected push acts on the arm.
    pushed: bool,
    /// The latest forces of the contacts less the magnet's, in N.
    pressing: std::collections::VecDeque<f64>,
    /// Largest of these forces, in N, that lasted 0.3 s without a push.
    pub sustained_n: f64,
    /// The control period in which it was reached, from 1.
    pub sustained_tick: usize,
    /// Largest of these forces, in N, that lasted 10 ms without a push.
    pub pressed_n: f64,
    /// The control period in which it was reached, from 1.
    pub pressed_tick: usize,
}

impl JudgeRecord {
    /// Why a recording should have been rejected; `None` for a good one.
    pub fn of(&self, recording: &Recording) -> Option<String> {
        // Device time and ticks differ by one period at most.
        let (from, to) = (
            (recording.start_us / 1000) as usize,
            (recording.end_us / 1000) as usize + 1,
        );
        let during = self.ticks.get(from..to.min(self.ticks.len())).unwrap_or_default();
        if during.is_empty() {
            return Some("recorded at no time".to_owned());
        }
        let sphere = u8::try_from(recording.sphere).ok();
        let (mut off, mut worst) = (0, 0);
        for tick in during {
            off = if tick.seated == sphere { 0 } else { off + 1 };
            worst = worst.max(off);
        }
        if worst > CHATTER {
            // Without the magnet a nest may rest on its pads: it is no longer pressed, but at its place.
            let away = self
                .seat_before(from, sphere)
                .map_or(f64::INFINITY, |seat| farthest(during, &seat));
            if away > MOVED_M {
                return Some(format!(
                    "the nest was off sphere {} for {worst} ms, {:.3} mm from its seat",
                    recording.sphere,
                    away * 1e3
                ));
            }
        }
        let moved = farthest(during, &during[0].tcp);
        (moved > MOVED_M).then(|| format!("the nest moved by {:.3} mm", moved * 1e3))
    }

    /// Where the TCP was when the nest was last in its seat on a sphere before a tick; `None` if it
    /// never was.
    fn seat_before(&self, tick: usize, sphere: Option<u8>) -> Option<Vector3<f32>> {
        let before = self.ticks.get(..tick)?;
        let seat = before
            .windows(SEATED)
            .rev()
            .find(|run| run.iter().all(|t| t.seated == sphere))?;
        seat.first().map(|t| t.tcp)
    }

    fn take<const N: usize>(&mut self, plant: &Plant<N>) {
        let truth = plant.truth();
        if truth.kinetic_j > self.kinetic_j {
            self.kinetic_j = truth.kinetic_j;
            self.kinetic_tick = self.ticks.len() + 1;
        }
        let force = truth.contact_n.norm();
        self.peak_n = self.peak_n.max(force);
        self.held = if force > HELD_N { self.held.saturating_add(1) } else { 0 };
        self.held_s = self.held_s.max(f64::from(self.held) * 1e-3);
        let pressing = if self.pushed {
            0.0
        } else {
            (truth.contact_n + truth.magnet_n).norm()
        };
        self.pressing.push_front(pressing);
        self.pressing.truncate(SUSTAINED_TICKS);
        let least = |ticks: usize| {
            let enough = self.pressing.len() >= ticks;
            let least = self.pressing.iter().take(ticks).copied().fold(f64::INFINITY, f64::min);
            if enough { least } else { 0.0 }
        };
        let (sustained, pressed) = if pressing > 1.0 {
            (least(SUSTAINED_TICKS), least(LASTING))
        } else {
            (0.0, 0.0)
        };
        let tick = self.ticks.len() + 1;
        if sustained > self.sustained_n {
            (self.sustained_n, self.sustained_tick) = (sustained, tick);
        }
        if pressed > self.pressed_n {
            (self.pressed_n, self.pressed_tick) = (pressed, tick);
        }
        let slot = self.ticks.len() % LASTING;
        self.forces[slot] = force;
        let lasting = self.forces.iter().copied().fold(f64::INFINITY, f64::min);
        self.contact_n = self.contact_n.max(lasting);
        self.ticks.push(TrueTick {
            // Spheres count from 1 on the wire.
            seated: truth.seated.and_then(|s| u8::try_from(s + 1).ok()),
            tcp: truth.tcp.position.map(|x| x as f32),
        });
    }
}

/// Largest distance of the TCP from a place, in m.
fn farthest(ticks: &[TrueTick], place: &Vector3<f32>) -> f64 {
    f64::from(ticks.iter().map(|t| (t.tcp - place).norm()).fold(0.0, f32::max))
}

/// The simulated arm with a judge beside it.
pub struct JudgedArm<const N: usize> {
    arm: SimulatedArm<N>,
    judgement: Arc<Mutex<JudgeRecord>>,
}

impl<const N: usize> JudgedArm<N> {
    /// An arm at rest at `q` (rad), and a handle to the observations.
    ///
    /// # Errors
    /// The plant cannot be created.
    pub fn new(
        robot: &Robot,
        tool: &Tool,
        config: &PlantConfig,
        q: &[f64; N],
    ) -> Result<(Self, Arc<Mutex<JudgeRecord>>), PlantError> {
        let judgement = Arc::new(Mutex::new(JudgeRecord::default()));
        let arm = SimulatedArm::new(Plant::new(robot, tool, config, q)?, robot);
        Ok((
            Self {
                arm,
                judgement: Arc::clone(&judgement),
            },
            judgement,
        ))
    }
}

/// The locked value, even if a holder of the lock has panicked.
pub(super) fn look<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<const N: usize> Drive for JudgedArm<N> {
    fn hello(&self) -> &DriveHello {
        self.arm.hello()
    }

    fn exchange(&mut self, command: Option<&DriveCommand>, state: &mut DriveState) -> Result<(), LinkError> {
        self.arm.exchange(command, state)?;
        let mut judgement = look(&self.judgement);
        judgement.take(self.arm.plant());
        if judgement.ready_tick.is_none() && command.is_some_and(|c| c.enable) {
            judgement.ready_tick = Some(judgement.ticks.len() as u64);
        }
        Ok(())
    }

    fn move_plate(&mut self, place: u32) -> bool {
        self.arm.move_plate(place)
    }
}

impl<const N: usize> Disturb for JudgedArm<N> {
    fn disturb(&mut self, what: &Disturbance) {
        if let Disturbance::Push(force_n) = what {
            look(&self.judgement).pushed = force_n.iter().any(|f| *f != 0.0);
        }
        self.arm.disturb(what);
    }
}
