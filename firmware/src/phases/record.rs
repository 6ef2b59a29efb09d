//! Recording at a pose: at 5 N/m, consecutive ticks of a seated and still
//! arm, then a short pull along the axis of the nest.
//!
//! Friction can hold a nest still although its magnet has let go, and the samples
//! do not show it. Therefore the recording is sent only after the nest has stayed
//! seated under the pull.

use nalgebra::Vector3;
use spherecal_shared::protocol::host::Fault;

use super::pull::Pull;
use super::{Activity, CartesianState, Env, Next, PATIENT_SHARE, STILL_S};
use crate::Report;
use crate::recorder::{Recorder, RecorderSample};

/// The recording starts anew when a joint is faster than this multiple of the
/// speed of a still arm.
pub(super) const RESTART_FACTOR: f64 = 3.0;
/// Largest distance of the computed TCP from its place at the first sample, in m, also
/// of a recording that started anew. A seated TCP rests: the noise of the encoders
/// moves the computed one by up to 0.07 mm. Beyond it, nest or sphere has moved, and
/// the contact watch sees only what is faster or farther.
const MOVED_M: f64 = 0.2e-3;

/// An arm with elastic joints gives way under the pull: stretched out, one with 7,000 N m/rad at each
/// joint by 1.3 mm. So a displacement up to this multiple of `seating.check_m` is no fault if the TCP
/// comes back. A nest that has left its sphere does not.
const ELASTIC_SHARE: f64 = 3.0;
/// How much of `seating.check_m` may remain after the pull. A plate of 10 N/mm under a nest that joints with a
/// friction of F (N, at the TCP) hold goes from -F to F: 0.7 mm where F is a third of the pull.
const KEPT_SHARE: f64 = 0.75;
/// Time that the TCP has for that after the pull, in s: a plate of 10 kg on 10 N/mm, damped by 5 %, swings with 5 Hz and
/// comes to rest within 0.1 of its amplitude in 1.5 s.
const RETURN_S: f64 = 1.5;

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

    /// Whether the nest is pulled. Elastic joints then move the TCP faster than a seated nest may move.
    pub(crate) fn is_pulling(&self) -> bool {
        self.pull.is_some()
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
            let most = ELASTIC_SHARE * seating.check_m;
            if moved > most {
                return Next::fail(Fault::ContactLost, moved, most);
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
            let left = pull.left(&env.snapshot.tcp.position);
            let rests = env.joint_speed <= RESTART_FACTOR * env.procedure.turn.still_rad_s;
            // A magnet that has come back pulls a nest that had left past this place.
            let most = KEPT_SHARE * seating.check_m;
            return match (left <= most, elapsed_s > seating.check_s + RETURN_S) {
                (true, late) if late || rests => self.finish(cartesian),
                (false, true) => Next::fail(Fault::ContactLost, left, most),
                _ => Next::Stay,
            };
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
                if env.elapsed_s - self.started_s > PATIENT_SHARE * turn.settle_s {
                    cartesian.hold_posture(env.snapshot);
                }
                if env.elapsed_s - self.started_s > turn.most_s(env.joint_speed) {
                    return Next::fail(Fault::MotionTimeout, env.joint_speed, turn.still_rad_s);
                }
                return Next::Stay;
            }
            self.started_s = env.elapsed_s;
        } else if env.joint_speed > RESTART_FACTOR * turn.still_rad_s {
            self.recorder = Recorder::default();
            self.still_s = 0.0;
            let samples_s = f64::from(env.procedure.record.samples) * env.period_s;
            if env.elapsed_s > turn.most_s(env.joint_speed) + 2.0 * samples_s {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::phases::scene::Scene;

    /// Records ten samples and pulls; the TCP moves along x by `away` (m) at a time after the start of
    /// the pull (s). Returns when it ended after that start, in ticks, and the fault.
    fn pulled(away: fn(f64) -> f64) -> (u32, Option<(Fault, f64)>) {
        let mut scene = Scene::new();
        scene.procedure.record.samples = 10;
        let mut cartesian = scene.engaged(-Vector3::z());
        let mut phase = RecordingPose::new(1, &scene.env(), &mut cartesian);
        let place = scene.snapshot.tcp.position;
        let mut ticks = 0;
        for tick in 1..9_000 {
            scene.elapsed_s = f64::from(tick) * 1e-3;
            ticks += u32::from(phase.is_pulling());
            if ticks > 0 {
                let before = scene.snapshot.tcp.position.x;
                scene.snapshot.tcp.position.x = place.x + away(f64::from(ticks) * 1e-3);
                // At an arm of 1 m.
                scene.joint_speed = (scene.snapshot.tcp.position.x - before).abs() / 1e-3;
            }
            let _ = cartesian.impedance.force(&scene.snapshot, &cartesian.setpoint, 0.7);
            match phase.step(&scene.env(), &mut cartesian) {
                Next::Stay => {}
                Next::Enter(Activity::Coupled, Some(Report::Recording(_))) => return (ticks, None),
                Next::Fail(found) => return (ticks, Some((found.fault, found.limit))),
                other @ Next::Enter(..) => panic!("{other:?}"),
            }
        }
        panic!("it never ends");
    }

    // Fails if an elastic arm that gives way under the pull and comes back counts as a lost nest, or if a
    // nest that does not come back, goes too far, or only passes its place, does not.
    #[test]
    fn an_elastic_arm_comes_back() {
        let lost = |limit: f64| Some((Fault::ContactLost, limit));
        let kept = KEPT_SHARE * Scene::new().procedure.seating.check_m;
        assert_eq!(pulled(|_| 0.000_7), (150, None), "a soft plate");
        assert_eq!(pulled(|_| 0.000_8), (1651, lost(kept)), "it slips a little");
        assert_eq!(pulled(|t| if t < 0.149 { 0.002 } else { 0.0 }), (150, None));
        assert_eq!(pulled(|t| if t < 0.250 { 0.002 } else { 0.000_1 }), (251, None));
        let pulled_past = |t: f64| (0.02 * (t - 0.145)).clamp(0.0, 0.001);
        assert_eq!(pulled(pulled_past), (1651, lost(kept)), "the magnet comes back");
        assert_eq!(pulled(|_| 0.002), (1651, lost(kept)));
        let most = ELASTIC_SHARE * Scene::new().procedure.seating.check_m;
        assert_eq!(pulled(|t| 0.031 * t), (97, lost(most)));
    }
}
