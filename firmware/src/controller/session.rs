//! The session with a drive: what its handshake says, and when it begins anew.
//!
//! A drive gives itself a number at each start and states it in its handshake and
//! in every state. The controller gives no torque outside of a session: before the
//! handshake, and for a state with another number, its command has the number 0.
//! That asks the drive for its handshake. Period, limits, sign and gravity
//! compensation stay the same within one session.

use spherecal_shared::protocol::PROTOCOL_VERSION;
use spherecal_shared::protocol::drive::{
    DriveHello, DriveStatus, MOST_LATENCY_US, MOST_MOTOR_KG_M2, NO_SESSION, PERIODS_US, TorqueSign,
};
use spherecal_shared::protocol::host::{Fault, Refusal};
use spherecal_shared::robot::{Arm, JointLimits};

use super::Controller;
use crate::law::Actuation;
use crate::phases::Activity;
use crate::safety::{AnswerWatch, Violation};

/// A session with a drive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct DriveSession<const N: usize> {
    pub(super) number: u32,
    pub(super) period_us: u32,
    pub(super) gravity_by_drive: bool,
    pub(super) torque_reversed: bool,
    pub(super) limits: [JointLimits; N],
    pub(super) actuation: Actuation<N>,
    pub(super) latency_us: u32,
    pub(super) follows: bool,
    pub(super) simulated: bool,
}

impl<const N: usize> DriveSession<N> {
    /// The session that a handshake announces, if this controller can work with it.
    fn new(hello: &DriveHello) -> Option<Self> {
        let limits: [JointLimits; N] = hello.limits.as_slice().try_into().ok()?;
        // NaN fails each comparison.
        let possible = |l: &JointLimits| {
            l.min_rad < l.max_rad
                && [l.min_rad, l.max_rad, l.velocity_rad_s, l.torque_nm]
                    .iter()
                    .all(|x| x.is_finite())
                && l.velocity_rad_s > 0.0
                && l.torque_nm > 0.0
        };
        let fits = hello.protocol == PROTOCOL_VERSION
            && hello.session != NO_SESSION
            && PERIODS_US.contains(&hello.period_us)
            && limits.iter().all(possible)
            && hello.latency_us <= MOST_LATENCY_US
            && (hello.motor_kg_m2.is_empty() || hello.motor_kg_m2.len() == N)
            && hello
                .motor_kg_m2
                .iter()
                .all(|inertia| (0.0..=MOST_MOTOR_KG_M2).contains(inertia));
        let motors = core::array::from_fn(|i| hello.motor_kg_m2.get(i).copied().unwrap_or(0.0));
        let (period_s, latency_s) = (f64::from(hello.period_us) * 1e-6, f64::from(hello.latency_us) * 1e-6);
        fits.then_some(Self {
            number: hello.session,
            period_us: hello.period_us,
            gravity_by_drive: hello.compensates_gravity,
            torque_reversed: hello.torque_sign == TorqueSign::OfLink,
            limits,
            actuation: Actuation::new(motors, period_s, latency_s),
            latency_us: hello.latency_us,
            follows: hello.follows,
            simulated: hello.simulated,
        })
    }

    /// Checks that a spring that is safe on this drive holds the arm.
    pub(super) fn holds(&self, arm: &Arm<f64, N>) -> Result<(), Refusal> {
        if self.actuation.holds(arm) {
            return Ok(());
        }
        let latest_s = self.actuation.latest_s(arm, f64::from(self.period_us) * 1e-6);
        Err(Refusal::TooLate {
            latency_us: self.latency_us,
            most_us: (latest_s * 1e6) as u32,
        })
    }

    /// Delay that the drive declares, in whole periods.
    fn known(&self) -> usize {
        self.latency_us.div_ceil(self.period_us.max(1)) as usize
    }

    /// Whether the torque that it measures is the one that it was sent: no motor is in between.
    fn hides_motors(&self) -> bool {
        self.actuation.motors.iter().all(|inertia| *inertia == 0.0)
    }
}

impl<const N: usize> Controller<N> {
    /// Takes the drive's handshake. A new session number begins a new session: all
    /// that was known of the drive is forgotten. If the drive was under torque, that
    /// is a fault: it has started again. The same handshake once more has no effect.
    ///
    /// # Errors
    /// [`Refusal::Drive`] if the controller does not support the drive's number of
    /// joints, period, limits, motors, delay or protocol, if drive and robot have no common range of
    /// a joint, or if the handshake changes a running session. [`Refusal::TooLate`] if no spring that is
    /// safe on this drive holds the arm. The present session then goes on.
    pub fn connect(&mut self, hello: &DriveHello) -> Result<(), Refusal> {
        let session = DriveSession::<N>::new(hello).ok_or(Refusal::Drive)?;
        if let Some(present) = self.session.as_ref().filter(|present| present.number == session.number) {
            return if *present == session {
                Ok(())
            } else {
                Err(Refusal::Drive)
            };
        }
        if let Some(configured) = &self.configured {
            session.holds(&configured.arm)?;
        }
        if let Some(robot) = self.robot.as_ref().filter(|_| self.configured.is_some()) {
            self.safety
                .configure(robot, Some(&session.limits))
                .map_err(|()| Refusal::Drive)?;
        }
        self.session_lost();
        self.session = Some(session);
        self.answer = AnswerWatch::default();
        self.shown = 0;
        self.take_drive();
        self.safety.restart();
        self.set_motion_limits();
        self.snapshot = None;
        self.blind_ticks = 0;
        self.period_s = f64::from(session.period_us) * 1e-6;
        Ok(())
    }

    /// Whether the controller has taken the handshake of a drive.
    pub fn has_session(&self) -> bool {
        self.session.is_some()
    }

    /// The control period, in µs: that of the session, 1000 before the first one.
    pub fn period_us(&self) -> u32 {
        self.session.as_ref().map_or(1000, |session| session.period_us)
    }

    /// Number of the session; [`NO_SESSION`] without one.
    pub(super) fn number(&self) -> u32 {
        self.session.as_ref().map_or(NO_SESSION, |session| session.number)
    }

    /// What the law of the present phase may ask of the drive.
    pub(super) fn actuation(&self) -> Actuation<N> {
        match self.activity {
            Activity::Approaching(_) => self.drive.in_approach(self.period_s),
            _ => self.drive,
        }
    }

    /// Takes the drive of the session for the law: as it declares itself, or as much later as it has shown, as far as
    /// springs that are safe then still hold the arm.
    pub(super) fn take_drive(&mut self) {
        let Some(session) = &self.session else { return };
        self.drive = session.actuation;
        let known = session.known();
        for periods in known + 1..=self.shown {
            let latency_s = periods as f64 * f64::from(session.period_us) * 1e-6;
            let later = Actuation::new(session.actuation.motors, f64::from(session.period_us) * 1e-6, latency_s);
            if self
                .configured
                .as_ref()
                .is_none_or(|configured| later.holds(&configured.arm))
            {
                self.drive = later;
            }
        }
    }

    /// Compares the torque that the drive has `delivered` (N m) with what was sent: a drive that answers later than it declares
    /// gets springs for that delay for the rest of its session.
    ///
    /// Not inlined: the fast memory of a board has no room for it beside the law.
    #[inline(never)]
    pub(super) fn watch_answer(&mut self, delivered: &[f64; N]) {
        let Some(session) = self.session.as_ref().filter(|session| session.hides_motors()) else {
            return;
        };
        let sent = self.last.as_ref().map_or(&[][..], |last| &last.tau);
        let known = session.known().max(self.shown);
        if let Some(periods) = self.answer.push(sent, delivered, known, self.period_s) {
            self.shown = periods;
            self.take_drive();
        }
    }

    /// Checks that the drive has not shown a delay for which no springs are safe: nothing may move then.
    pub(super) fn answers_in_time(&self) -> Result<(), Refusal> {
        let latency_us = self.period_us().saturating_mul(self.shown as u32);
        if latency_us > MOST_LATENCY_US {
            let most_us = MOST_LATENCY_US;
            return Err(Refusal::TooLate { latency_us, most_us });
        }
        Ok(())
    }

    /// Whether the drive moves the arm by the angles of the setpoint, not by torques: in a motion through free space, if it can,
    /// and if a motion or a release before has shown that the nest is on no sphere.
    pub(super) fn follows(&self) -> bool {
        let can = self.session.as_ref().is_some_and(|session| session.follows);
        can && matches!(self.activity, Activity::Moving(_)) && !self.may_be_on_sphere && self.disturbance.is_free()
    }

    /// Whether the drive adds the gravity torque itself.
    pub(super) fn gravity_by_drive(&self) -> bool {
        self.session.as_ref().is_some_and(|session| session.gravity_by_drive)
    }

    /// The drive is no longer the one that carries out the torques: a fault if there
    /// were any.
    pub(super) fn session_lost(&mut self) {
        if self.last.is_some() {
            let status = f64::from(DriveStatus::Disabled as u8);
            self.fail(Violation::new(Fault::Drive, status, 0.0));
        }
        self.last = None;
    }
}
