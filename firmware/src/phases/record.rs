//! Recording at a pose: at 5 N/m, 1,000 consecutive ticks of a seated and still
//! arm, then a short pull along the axis of the nest.
//!
//! Friction can hold a nest still although its magnet has let go, and the samples
//! do not show it. Therefore the recording is sent only after the nest has stayed
//! seated under the pull.

use nalgebra::Vector3;
use spherecal_shared::protocol::host::Fault;

use super::pull::Pull;
use super::{Activity, CartesianState, Env, Next, STILL_S};
use crate::Report;
use crate::recorder::{Recorder, RecorderSample};

/// The recording starts anew when a joint is faster than this multiple of the
/// speed of a still arm.
const RESTART_FACTOR: f64 = 3.0;
/// Largest distance of the computed TCP from its place at the first sample, in m, also
/// of a recording that started anew. A seated TCP rests: the noise of the encoders
/// moves the computed one by up to 0.07 mm. Beyond it, nest or sphere has moved, and
/// the contact watch sees only what is faster or farther.
const MOVED_M: f64 = 0.2e-3;

/// Records a pose.
#[derive(Clone, Debug)]
pub(crate) struct RecordingPose<const N: usize> {
    pose: u32,
    recorder: Recorder<N>,
    still_s: f64,
    started_s: f64,
    /// Computed TCP at the very first sample, in m.
    place: Option<Vector3<f64>>,
    /// The pull and its start time (s), after all samples are taken.
    pull: Option<(Pull, f64)>,
}

impl<const N: usize> RecordingPose<N> {
    /// Reduces the stiffness for the recording.
    pub(crate) fn new(pose: u32, env: &Env<'_, N>, cartesian: &mut CartesianState<N>) -> Self {
        cartesian.soften(env, env.procedure.record.stiffness_n_m);
        cartesian.setpoint.velocity.fill(0.0);
        Self {
            pose,
            recorder: Recorder::default(),
            still_s: 0.0,
            started_s: 0.0,
            place: None,
            pull: None,
        }
    }

    /// Number of samples so far.
    #[cfg(test)]
    pub(crate) fn count(&self) -> u32 {
        self.recorder.count()
    }

    /// One tick.
    pub(crate) fn step(&mut self, env: &Env<'_, N>, cartesian: &mut CartesianState<N>) -> Next<N> {
        if let Some((pull, began_s)) = &mut self.pull {
            let seating = &env.procedure.seating;
            let moved = pull.push(&env.snapshot.tcp.position);
            if moved > seating.check_m {
                return Next::fail(Fault::ContactLost, moved, seating.check_m);
            }
            let elapsed_s = env.elapsed_s - *began_s;
            if elapsed_s < seating.check_s {
                // Along the axis of the nest only the magnet holds it.
                let axis = env.snapshot.tcp.z();
                let force = axis * -Pull::size(elapsed_s, seating.check_s, seating.check_n);
                cartesian.setpoint.feed_forward = cartesian.compensation(force);
                return Next::Stay;
            }
            cartesian.setpoint.feed_forward = cartesian.compensation(Vector3::zeros());
            return self.finish(cartesian);
        }
        let turn = &env.procedure.turn;
        let tcp = env.snapshot.tcp.position;
        if let Some(place) = self.place {
            let moved = (tcp - place).norm();
            if moved > MOVED_M {
                return Next::fail(Fault::ContactLost, moved, MOVED_M);
            }
        }
        if self.recorder.count() == 0 {
            let still = cartesian.impedance.settled() && env.joint_speed <= turn.still_rad_s;
            self.still_s = if still { self.still_s + env.period_s } else { 0.0 };
            if self.still_s < STILL_S {
                if env.elapsed_s - self.started_s > turn.settle_s {
                    return Next::fail(Fault::MotionTimeout, env.joint_speed, turn.still_rad_s);
                }
                return Next::Stay;
            }
            self.started_s = env.elapsed_s;
        } else if env.joint_speed > RESTART_FACTOR * turn.still_rad_s {
            self.recorder = Recorder::default();
            self.still_s = 0.0;
            if env.elapsed_s > turn.settle_s + 2.0 * f64::from(env.procedure.record.samples) * env.period_s {
                return Next::fail(Fault::MotionTimeout, env.joint_speed, RESTART_FACTOR * turn.still_rad_s);
            }
            return Next::Stay;
        }
        self.place.get_or_insert(tcp);
        let force = env.wrench.force - cartesian.tare.force;
        self.recorder.push(&RecorderSample {
            tick: env.tick,
            time_us: env.time_us,
            q: &env.snapshot.q,
            tau: env.tau,
            tcp: &env.snapshot.tcp.position,
            force: &force,
        });
        if self.recorder.count() < env.procedure.record.samples {
            return Next::Stay;
        }
        if env.procedure.seating.check_s > 0.0 {
            self.pull = Some((Pull::new(env.snapshot.tcp.position), env.elapsed_s));
            return Next::Stay;
        }
        self.finish(cartesian)
    }

    fn finish(&self, cartesian: &CartesianState<N>) -> Next<N> {
        let recording = self.recorder.finish(cartesian.sphere, self.pose);
        Next::Enter(Activity::Coupled, Some(Report::Recording(recording)))
    }
}
