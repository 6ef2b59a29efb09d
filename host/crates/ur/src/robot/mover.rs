//! Setpoints of the robot's own position control: `servoj`, `speedj`, `movej` and `stopj`.

use super::controls::ArmCommand;
use crate::JOINTS;

type Six = [f64; JOINTS];

/// Times that `servoj` may look ahead, s: what the script manual permits.
const LOOKAHEAD_S: [f64; 2] = [0.03, 0.2];
/// Least speed and acceleration of a motion, rad/s and rad/s²: with less it would not end.
const SLOWEST: f64 = 1e-3;

/// What the setpoint does.
#[derive(Debug)]
enum Aim {
    /// Follows a target that moves, later by this time, s. The maker does not say how its robots smooth; this follows as a
    /// critically damped spring does.
    Servo { target: Six, lookahead_s: f64 },
    /// Takes on these velocities, rad/s, with this acceleration of the joint that changes most, rad/s².
    Speed { target: Six, acceleration: f64 },
    /// Goes straight to a target in joint space. Speed (rad/s) and acceleration (rad/s²) are those of the joint with the longest way.
    Move { target: Six, speed: f64, acceleration: f64 },
}

/// A setpoint of all joints that moves.
#[derive(Debug)]
pub(super) struct Mover {
    q: Six,
    qd: Six,
    aim: Aim,
}

fn largest(values: &Six) -> f64 {
    values.iter().fold(0.0, |most, value| most.max(value.abs()))
}

fn minus(a: &Six, b: &Six) -> Six {
    std::array::from_fn(|j| a[j] - b[j])
}

impl Mover {
    /// At rest at these angles, rad.
    pub(super) fn new(q: Six) -> Self {
        let (qd, target) = ([0.0; JOINTS], [0.0; JOINTS]);
        let acceleration = SLOWEST;
        Self {
            q,
            qd,
            aim: Aim::Speed { target, acceleration },
        }
    }

    /// `servoj`: follows these angles, rad, as they come.
    pub(super) fn servo(&mut self, target: Six, lookahead_s: f64) {
        let lookahead_s = lookahead_s.max(LOOKAHEAD_S[0]).min(LOOKAHEAD_S[1]);
        self.aim = Aim::Servo { target, lookahead_s };
    }

    /// `speedj`, or with no speed `stopj`.
    pub(super) fn speed(&mut self, target: Six, acceleration: f64) {
        let acceleration = acceleration.max(SLOWEST);
        self.aim = Aim::Speed { target, acceleration };
    }

    /// `movej`.
    pub(super) fn move_to(&mut self, target: Six, speed: f64, acceleration: f64) {
        self.aim = Aim::Move {
            target,
            speed: speed.max(SLOWEST),
            acceleration: acceleration.max(SLOWEST),
        };
    }

    /// Whether a motion has ended.
    pub(super) fn rests(&self) -> bool {
        match &self.aim {
            Aim::Servo { .. } => false,
            Aim::Speed { .. } => self.qd == [0.0; JOINTS],
            Aim::Move { target, .. } => self.q == *target,
        }
    }

    /// Moves on by this time, s.
    pub(super) fn step(&mut self, step_s: f64) -> ArmCommand {
        match &self.aim {
            Aim::Servo { target, lookahead_s } => {
                let rad_s = 2.0 / lookahead_s;
                for j in 0..JOINTS {
                    let pull = rad_s * (target[j] - self.q[j]) - 2.0 * self.qd[j];
                    self.qd[j] += rad_s * pull * step_s;
                }
            }
            Aim::Speed { target, acceleration } => {
                let missing = minus(target, &self.qd);
                let share = (acceleration * step_s / largest(&missing)).min(1.0);
                self.qd = std::array::from_fn(|j| {
                    if share < 1.0 {
                        self.qd[j] + share * missing[j]
                    } else {
                        target[j]
                    }
                });
            }
            Aim::Move {
                target,
                speed,
                acceleration,
            } => {
                let way = minus(target, &self.q);
                let left = largest(&way);
                let faster = largest(&self.qd) + acceleration * step_s;
                // What can still be braked, one step later.
                let brakes = acceleration * ((step_s * step_s / 4.0 + 2.0 * left / acceleration).sqrt() - step_s / 2.0);
                let now = faster.min(*speed).min(brakes);
                if left <= now * step_s || left == 0.0 {
                    (self.q, self.qd) = (*target, [0.0; JOINTS]);
                } else {
                    self.qd = way.map(|way| way * now / left);
                }
            }
        }
        self.q = std::array::from_fn(|j| self.q[j] + self.qd[j] * step_s);
        ArmCommand::Follow(self.q, self.qd)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP_S: f64 = 0.002;
    const AWAY: Six = [0.3, -0.1, 0.0, 0.05, 0.2, -0.3];

    /// Largest speed and acceleration of a joint in this many steps, and the steps until it rests.
    fn watch(mover: &mut Mover, steps: usize) -> (f64, f64, Option<usize>) {
        let (mut fastest, mut hardest, mut ended) = (0.0f64, 0.0f64, None);
        for k in 0..steps {
            let before = mover.qd;
            mover.step(STEP_S);
            fastest = fastest.max(largest(&mover.qd));
            hardest = hardest.max(largest(&minus(&mover.qd, &before)) / STEP_S);
            ended = ended.or(mover.rests().then_some(k + 1));
        }
        (fastest, hardest, ended)
    }

    // Fails if a motion leaves the straight line in joint space, does not end at its target, or exceeds its speed or
    // acceleration. 0.3 rad at 0.5 rad/s and 2 rad/s² take 0.85 s.
    #[test]
    fn a_motion_ends_at_its_target_in_the_time_of_its_speed() {
        let mut mover = Mover::new([0.1; JOINTS]);
        let target = std::array::from_fn(|j| 0.1 + AWAY[j]);
        mover.move_to(target, 0.5, 2.0);
        let (fastest, hardest, ended) = watch(&mut mover, 200);
        assert!((0.49..=0.5).contains(&fastest) && hardest < 2.01, "{fastest} {hardest}");
        let way = minus(&mover.q, &[0.1; JOINTS]);
        assert!(
            (0..JOINTS).all(|j| (way[j] * AWAY[0] - way[0] * AWAY[j]).abs() < 1e-12),
            "{way:?}"
        );
        assert_eq!(ended, None);
        let (_, hardest, ended) = watch(&mut mover, 400);
        assert!(
            hardest < 2.01 && ended.is_some_and(|end| (200 + end).abs_diff(425) < 8),
            "{hardest} {ended:?}"
        );
        assert_eq!((mover.q, mover.qd), (target, [0.0; JOINTS]));
    }

    // Fails if `servoj` lags a moving target by another time than its lookahead, or swings beyond one that stops.
    #[test]
    fn a_servo_follows_later_by_its_lookahead() {
        let mut mover = Mover::new([0.0; JOINTS]);
        let mut most = 0.0f64;
        for k in 0..1000 {
            let target = [0.4 * (f64::from(k.min(500)) * STEP_S); JOINTS];
            mover.servo(target, 0.1);
            mover.step(STEP_S);
            if k == 500 {
                assert!((target[0] - mover.q[0] - 0.4 * 0.1).abs() < 1e-3, "{}", mover.q[0]);
            }
            most = most.max(mover.q[0]);
        }
        assert!((mover.q[0] - 0.4).abs() < 1e-3 && most < 0.4 + 1e-9, "{most}");
    }

    // Fails if a speed is not taken on, is reached faster than its acceleration, or a stop never rests. An acceleration that
    // is none must not keep a client waiting for ever.
    #[test]
    fn a_speed_is_taken_on_and_stops() {
        let mut mover = Mover::new([0.0; JOINTS]);
        mover.speed(AWAY, 1.0);
        let (_, hardest, ended) = watch(&mut mover, 160);
        assert!(mover.qd == AWAY && hardest < 1.001 && ended.is_none(), "{hardest}");
        mover.speed([0.0; JOINTS], 2.0);
        assert_eq!(watch(&mut mover, 100).2, Some(75));
        mover.move_to(AWAY, f64::NAN, -1.0);
        mover.step(STEP_S);
        assert!(mover.q.iter().all(|q| q.is_finite()));
    }
}
