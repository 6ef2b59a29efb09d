//! The accepted range of every number of a procedure. Host and controller use
//! the same check.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::{Decouple, MAX_STIFFNESS_N_M, MAX_STIFFNESS_NM_RAD, Procedure};

/// How many times as far as a magnet stretches the spring its rest must go: friction may take half of the force.
const FRICTION: f64 = 2.0;

/// A number of the procedure is out of its range.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("procedure.{field} is {value}: give a value from {min} to {max}")]
pub struct ProcedureError {
    /// The field, as in the file.
    pub field: &'static str,
    /// Its value.
    pub value: f64,
    /// Smallest value accepted.
    pub min: f64,
    /// Largest value accepted.
    pub max: f64,
}

impl Procedure {
    /// Checks every number against its range. NaN is out of every range.
    ///
    /// # Errors
    /// The first field that is out of its range.
    pub fn check(&self) -> Result<(), ProcedureError> {
        let k = MAX_STIFFNESS_N_M;
        let a = &self.approach;
        let (l, u) = (&self.limits, UNBOUNDED_M);
        // Of a magnet that is no stronger than the paper's, both are the user's own matter.
        let decouple = &self.decouple;
        let (least_n, least_m) = if decouple.magnet_n > Decouple::default().magnet_n {
            (
                decouple.unexplained_n(),
                FRICTION * decouple.magnet_n / decouple.pull_n_m(),
            )
        } else {
            (0.0, 0.0)
        };
        let normal2 = l.plate_normal.iter().map(|x| x * x).sum::<f64>();
        let ranges: &[(&'static str, f64, f64, f64)] = &[
            ("law.damping_ratio", self.law.damping_ratio, 0.1, 1.0),
            (
                "law.rotation_nm_rad",
                self.law.rotation_nm_rad,
                50.0,
                MAX_STIFFNESS_NM_RAD,
            ),
            ("law.elbow_nm_rad", self.law.elbow_nm_rad, 0.0, 500.0),
            ("law.elbow_damping_ratio", self.law.elbow_damping_ratio, 0.1, 1.0),
            ("law.stiffness_ramp_s", self.law.stiffness_ramp_s, 0.0, 5.0),
            ("law.torque_rate_nm_s", self.law.torque_rate_nm_s, 50.0, 1e5),
            ("law.observer_rad_s", self.law.observer_rad_s, 1.0, 500.0),
            ("law.torque_loop_gain", self.law.torque_loop_gain, 0.0, 10.0),
            ("law.torque_loop_rad_s", self.law.torque_loop_rad_s, 0.0, 80.0),
            ("law.torque_loop_nm", self.law.torque_loop_nm, 0.0, 50.0),
            ("motion.speed_rad_s", self.motion.speed_rad_s, 0.01, 3.0),
            (
                "motion.acceleration_rad_s2",
                self.motion.acceleration_rad_s2,
                0.01,
                20.0,
            ),
            ("motion.natural_rad_s", self.motion.natural_rad_s, 2.0, 60.0),
            ("motion.tolerance_rad", self.motion.tolerance_rad, 1e-4, 0.2),
            ("motion.settle_s", self.motion.settle_s, 0.1, 60.0),
            ("approach.stiffness_n_m[0]", a.stiffness_n_m[0], 0.0, k),
            ("approach.stiffness_n_m[1]", a.stiffness_n_m[1], 0.0, k),
            ("approach.stiffness_n_m[2]", a.stiffness_n_m[2], 1.0, k),
            ("approach.speed_m_s", a.speed_m_s, 1e-4, 0.25),
            ("approach.acceleration_m_s2", a.acceleration_m_s2, 1e-3, 5.0),
            ("approach.trigger_n", a.trigger_n, 0.5, 100.0),
            ("approach.dwell_s", a.dwell_s, 0.001, 1.0),
            ("approach.tare_s", a.tare_s, 0.05, 10.0),
            ("approach.tare_limit_n", a.tare_limit_n, 0.0, 100.0),
            ("approach.contact_speed_m_s", a.contact_speed_m_s, 1e-4, 0.25),
            ("approach.travel_m", a.travel_m, 0.001, 0.5),
            ("approach.line_n_m_s", a.line_n_m_s, 0.0, 250.0),
            ("couple.stiffness_n_m", self.couple.stiffness_n_m, 0.0, k),
            ("couple.hold_s", self.couple.hold_s, 0.0, 60.0),
            ("couple.searches", f64::from(self.couple.searches), 0.0, 10.0),
            ("couple.search_n", self.couple.search_n, 0.0, 25.0),
            ("couple.search_across_n", self.couple.search_across_n, 0.0, 15.0),
            ("couple.search_s", self.couple.search_s, 0.1, 60.0),
            ("turn.stiffness_n_m", self.turn.stiffness_n_m, 0.0, k),
            ("turn.speed_rad_s", self.turn.speed_rad_s, 0.01, 2.0),
            ("turn.acceleration_rad_s2", self.turn.acceleration_rad_s2, 0.01, 20.0),
            ("turn.tolerance_rad", self.turn.tolerance_rad, 1e-4, 0.2),
            ("turn.elbow_tolerance_rad", self.turn.elbow_tolerance_rad, 1e-4, 3.2),
            ("turn.still_rad_s", self.turn.still_rad_s, 1e-5, 0.1),
            ("turn.settle_s", self.turn.settle_s, 0.1, 60.0),
            ("record.stiffness_n_m", self.record.stiffness_n_m, 0.0, k),
            ("record.samples", f64::from(self.record.samples), 1.0, 120_000.0),
            ("seating.window_m", self.seating.window_m, 1e-4, 0.1),
            ("seating.speed_m_s", self.seating.speed_m_s, 1e-3, 1.0),
            ("seating.dwell_s", self.seating.dwell_s, 0.001, 1.0),
            ("seating.test_n", self.seating.test_n, 0.0, 20.0),
            ("seating.test_s", self.seating.test_s, 0.0, 10.0),
            ("seating.test_m", self.seating.test_m, 1e-5, 0.1),
            ("seating.check_n", self.seating.check_n, 0.0, 20.0),
            ("seating.check_s", self.seating.check_s, 0.0, 10.0),
            ("seating.check_m", self.seating.check_m, 1e-5, 0.1),
            ("decouple.magnet_n", self.decouple.magnet_n, 0.0, 300.0),
            ("decouple.stiffness_n_m", self.decouple.stiffness_n_m, 200.0, k),
            ("decouple.speed_m_s", self.decouple.speed_m_s, 1e-3, 0.25),
            ("decouple.retreat_m", self.decouple.retreat_m, 0.015, 0.3),
            ("decouple.free_m", self.decouple.free_m, 0.005, 0.3),
            ("decouple.settle_s", self.decouple.settle_s, 0.1, 60.0),
            ("limits.position_margin_rad", self.limits.position_margin_rad, 0.0, 0.5),
            ("limits.velocity_share", self.limits.velocity_share, 0.05, 1.0),
            ("limits.force_n", self.limits.force_n, 1.0, 500.0),
            (
                "limits.force_n (with this decouple.magnet_n)",
                self.limits.force_n,
                least_n,
                500.0,
            ),
            (
                "decouple.retreat_m (with this decouple.magnet_n)",
                self.decouple.retreat_m,
                least_m,
                0.3,
            ),
            ("limits.path_m", self.limits.path_m, 0.001, 1.0),
            ("limits.path_rad", self.limits.path_rad, 0.001, 3.0),
            ("limits.host_silence_s", self.limits.host_silence_s, 0.05, 3600.0),
            ("limits.missed_ticks", f64::from(self.limits.missed_ticks), 0.0, 100.0),
            ("limits.frozen_ticks", f64::from(self.limits.frozen_ticks), 0.0, 1000.0),
            ("limits.jump_rad", self.limits.jump_rad, 0.0, 10.0),
            ("limits.torque_error_share", self.limits.torque_error_share, 0.01, 10.0),
            ("limits.speed_m_s", self.limits.speed_m_s, 0.01, 5.0),
            ("limits.soft_speed_m_s", self.limits.soft_speed_m_s, 0.01, 5.0),
            ("limits.soft_force_n", self.limits.soft_force_n, 1.0, 500.0),
            ("limits.turn_rad", self.limits.turn_rad, 0.01, 3.2),
            (
                "limits.workspace_min_m[0]",
                l.workspace_min_m[0],
                -u,
                l.workspace_max_m[0],
            ),
            (
                "limits.workspace_min_m[1]",
                l.workspace_min_m[1],
                -u,
                l.workspace_max_m[1],
            ),
            (
                "limits.workspace_min_m[2]",
                l.workspace_min_m[2],
                -u,
                l.workspace_max_m[2],
            ),
            ("limits.workspace_max_m[0]", l.workspace_max_m[0], -u, u),
            ("limits.workspace_max_m[1]", l.workspace_max_m[1], -u, u),
            ("limits.workspace_max_m[2]", l.workspace_max_m[2], -u, u),
            ("|limits.plate_normal|²", normal2, 1.0 - 1e-6, 1.0 + 1e-6),
            ("limits.plate_offset_m", l.plate_offset_m, -u, u),
            (
                "telemetry.contact_ticks",
                f64::from(self.telemetry.contact_ticks),
                0.0,
                1e6,
            ),
            ("telemetry.other_ticks", f64::from(self.telemetry.other_ticks), 0.0, 1e6),
        ];
        for &(field, value, min, max) in ranges {
            if !(value >= min && value <= max) {
                return Err(ProcedureError { field, value, min, max });
            }
        }
        Ok(())
    }
}

/// Limits whose violation is a fault.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// Margin to the joints' position limits, in rad.
    pub position_margin_rad: f64,
    /// Share of the joints' speed limits that may be used, from 0 to 1.
    pub velocity_share: f64,
    /// Largest contact force at the TCP by the steady estimate, in N, for 10 ms or longer. The estimate is a low-pass of
    /// `law.observer_rad_s`: of an impact of 10 ms it shows a third to a half.
    pub force_n: f64,
    /// Largest distance between TCP and setpoint in the approach, in m. It
    /// includes the lag that builds the contact force.
    pub path_m: f64,
    /// Largest joint error in joint motions, in rad.
    pub path_rad: f64,
    /// Longest time without a frame from the host while one is needed, in s.
    pub host_silence_s: f64,
    /// Number of missing or unusable drive states in a row that are bridged by the
    /// last torque.
    pub missed_ticks: u32,
    /// Number of identical drive states in a row after which the drive counts as
    /// frozen, if the commanded torque has changed meanwhile or the states show a
    /// joint speed. 0 turns the check off.
    pub frozen_ticks: u32,
    /// Change of a joint angle between two states that is accepted in addition to
    /// 1.5 times the joint's speed limit, in rad: noise and resolution.
    pub jump_rad: f64,
    /// Largest difference between commanded and measured torque for longer than
    /// 20 ms, as a share of the joint's torque limit. Gear friction causes some.
    pub torque_error_share: f64,
    /// Speed of the TCP that stops the arm, in m/s.
    pub speed_m_s: f64,
    /// Speed of the TCP above which a free motion slows down, in m/s.
    pub soft_speed_m_s: f64,
    /// Force at the TCP by the steady estimate above which a free motion slows down, in N.
    pub soft_force_n: f64,
    /// Orientation error while turning that stops the arm, in rad.
    pub turn_rad: f64,
    /// Smallest coordinates of the TCP, F0, in m.
    pub workspace_min_m: [f64; 3],
    /// Largest coordinates of the TCP, F0, in m.
    pub workspace_max_m: [f64; 3],
    /// Normal of the plate: a unit vector in F0 that points away from the plate.
    pub plate_normal: [f64; 3],
    /// Smallest coordinate of the TCP along the plate's normal, in m.
    pub plate_offset_m: f64,
}

/// Stands for "no limit" in the workspace, in m: farther than any arm reaches.
pub(super) const UNBOUNDED_M: f64 = 10.0;

impl Limits {
    /// Share of [`Self::velocity_share`] that a motion uses. The rest is for what deviates from it.
    pub const MOTION_SHARE: f64 = 0.8;
    /// Share of a motion's speed limit above which a turn about a sphere slows down.
    pub const SLOW_TURN_SHARE: f64 = 0.6;
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            position_margin_rad: 0.01,
            velocity_share: 0.9,
            force_n: 100.0,
            path_m: 0.150,
            path_rad: 0.1,
            host_silence_s: 2.0,
            missed_ticks: 3,
            frozen_ticks: 20,
            jump_rad: 0.002,
            torque_error_share: 0.15,
            speed_m_s: 1.3,
            soft_speed_m_s: 0.75,
            soft_force_n: 40.0,
            turn_rad: 0.3,
            workspace_min_m: [-UNBOUNDED_M; 3],
            workspace_max_m: [UNBOUNDED_M; 3],
            plate_normal: [0.0, 0.0, 1.0],
            plate_offset_m: -UNBOUNDED_M,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::procedure::Turn;

    #[test]
    fn the_defaults_are_the_papers_numbers() {
        let p = Procedure::default().paper();
        p.check().expect("the defaults must pass their own check");
        assert_eq!(p.approach.stiffness_n_m, [50.0, 50.0, 100.0]);
        assert_eq!((p.approach.trigger_n, p.approach.speed_m_s), (7.5, 0.025));
        assert_eq!((p.couple.stiffness_n_m, p.couple.hold_s), (5.0, 5.0));
        assert_eq!(
            (p.turn.stiffness_n_m, p.record.stiffness_n_m, p.record.samples),
            (20.0, 5.0, 1000)
        );
        assert_eq!(p.law.damping_ratio, 0.7);
        let mut own = Procedure::default();
        (own.couple.hold_s, own.record.samples) = (2.0, 300);
        assert_eq!((own.paper().couple.hold_s, own.paper().record.samples), (2.0, 300));
        assert_eq!(own.paper().turn, p.turn);
        // Nothing else is the paper's: the rest is as by default.
        let (mut rest, default) = (p, Procedure::default());
        (rest.couple, rest.record, rest.turn, rest.law) = (default.couple, default.record, default.turn, default.law);
        (rest.motion, rest.approach) = (default.motion, default.approach);
        assert_eq!(rest, default);
    }

    #[test]
    fn bad_numbers_are_refused_by_name() {
        let mut p = Procedure::default();
        p.approach.stiffness_n_m[1] = -50.0;
        let error = p.check().expect_err("negative stiffness");
        assert_eq!(error.field, "approach.stiffness_n_m[1]");
        assert_eq!(
            std::format!("{error}"),
            "procedure.approach.stiffness_n_m[1] is -50: give a value from 0 to 5000"
        );
        let mut p = Procedure::default();
        p.couple.hold_s = f64::NAN;
        assert_eq!(p.check().expect_err("NaN").field, "couple.hold_s");
    }

    // Fails if a magnet stronger than the paper's is accepted with limits by which no arm leaves it, or if the refusal does not
    // name it.
    #[test]
    fn a_strong_magnet_needs_its_limits() {
        let mut p = Procedure::default();
        p.decouple.magnet_n = 79.0;
        assert_eq!(p.check(), Ok(()));
        p.decouple.magnet_n = 265.0;
        let refused = |p: &Procedure| std::format!("{}", p.check().expect_err("out of range"));
        let text = refused(&p);
        assert!(
            text.contains("limits.force_n (with this decouple.magnet_n) is 100: give a value from 272.5"),
            "{text}"
        );
        p.limits.force_n = 280.0;
        let text = refused(&p);
        assert!(
            text.contains("decouple.retreat_m (with this decouple.magnet_n) is 0.05: give a value from 0.106"),
            "{text}"
        );
        p.decouple.retreat_m = 0.11;
        assert_eq!(p.check(), Ok(()));
        p.decouple.magnet_n = 301.0;
        assert_eq!(p.check().expect_err("too strong").field, "decouple.magnet_n");
    }

    #[test]
    fn a_file_may_name_only_what_it_changes() {
        let p: Procedure = toml::from_str("[approach]\ntrigger_n = 5.0\n").expect("a partial file");
        assert_eq!(p.approach.trigger_n, 5.0);
        assert_eq!(p.turn, Turn::default());
        assert!(
            toml::from_str::<Procedure>("[approach]\ntriger_n = 5.0\n").is_err(),
            "a misspelt field must not pass"
        );
    }
}
