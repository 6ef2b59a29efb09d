use std::collections::VecDeque;
use std::sync::atomic::AtomicBool;

use spherecal_link::{JointReading, JournalError, LinkError, StateReader};
use spherecal_model::robots;
use spherecal_shared::robot::{Arm, Dynamics as _, Robot, Tool};

use super::*;
use crate::CampaignError;

/// A robot at rest with these torques.
struct Still {
    q: Vec<f64>,
    tau: Vec<f64>,
    unsigned: bool,
    commanded: bool,
    states: u32,
    /// Of so many states one is lost; 0: none.
    lossy: u32,
}

impl StateReader for Still {
    fn joints(&self) -> usize {
        self.q.len()
    }

    fn has_torques(&self) -> bool {
        !self.unsigned
    }

    fn read(&mut self, reading: &mut JointReading) -> Result<(), LinkError> {
        reading.time_s = f64::from(self.states) * 1e-3;
        self.states += 1;
        if self.lossy > 0 && self.states.is_multiple_of(self.lossy) {
            self.states += 1;
        }
        reading.q.clone_from(&self.q);
        let (signed, unsigned) = if self.unsigned {
            (Vec::new(), self.tau.clone())
        } else {
            (self.tau.clone(), Vec::new())
        };
        reading.tau = signed;
        reading.unsigned_tau = unsigned;
        reading.commanded = self.commanded.then(|| "somebody".to_owned());
        Ok(())
    }
}

/// Answers as it was told.
#[derive(Default)]
struct Script {
    answers: VecDeque<bool>,
    kept: Vec<StepReport>,
}

impl Attendant for Script {
    fn tell(&mut self, _: &str) {}
    fn ask(&mut self, _: &str) {}
    fn answer(&mut self) -> Option<bool> {
        Some(self.answers.pop_front().expect("no more questions than answers"))
    }
    fn done(&mut self, report: &StepReport) -> Result<(), JournalError> {
        self.kept.push(report.clone());
        Ok(())
    }
}

fn iiwa() -> (Robot, Tool) {
    let model = robots::load("iiwa7").expect("built in");
    (model.robot.clone(), model.tool_in_table())
}

const STRETCHED: [f64; 7] = [0.0, 1.0, 0.0, -0.6, 0.0, 0.7, 0.0];

fn still(tool: &Tool) -> Still {
    let (robot, _) = iiwa();
    Still {
        q: STRETCHED.to_vec(),
        tau: gravity_nm(&robot, &tool.body, &STRETCHED),
        unsigned: false,
        commanded: false,
        states: 0,
        lossy: 0,
    }
}

fn read(mut robot_side: Still, answers: &[bool]) -> (Result<StepReport, CampaignError>, Vec<StepReport>) {
    let (robot, tool) = iiwa();
    let mut script = Script {
        answers: answers.iter().copied().collect(),
        ..Script::default()
    };
    let limits = ReadOnlyLimits::default();
    let interrupt = AtomicBool::new(false);
    let report = commission_read_only(&mut robot_side, &robot, &tool, &limits, &mut script, &interrupt);
    (report, script.kept)
}

// Fails if gravity for any number of joints differs from the controller's own dynamics.
#[test]
fn gravity_is_that_of_the_controller() {
    let (robot, mut tool) = iiwa();
    tool.body.mass_kg = 2.0;
    tool.body.com_m = [0.02, -0.03, 0.1];
    let arm = Arm::<f64, 7>::new(&robot, &tool).expect("seven joints");
    for q in [STRETCHED, [0.3, -0.5, 1.2, 1.0, -2.0, 0.4, 2.2], [0.0; 7]] {
        let expected = arm.bodies(&arm.frames(&q)).gravity();
        for (own, of_controller) in gravity_nm(&robot, &tool.body, &q).iter().zip(expected.iter()) {
            assert!((own - of_controller).abs() < 1e-9, "{own} {of_controller}");
        }
    }
}

// Fails if a sound robot does not pass, or if its report is not kept.
#[test]
fn a_robot_as_described_passes_the_first_step() {
    let (report, kept) = read(still(&iiwa().1), &[true, true]);
    let report = report.expect("read");
    assert_eq!(report.verdict, StepEnd::Passed, "{report:?}");
    assert_eq!(kept, [report]);
}

// Fails if a load of 1.5 kg that nobody declared passes, or if its mass is not stated within 0.1 kg.
#[test]
fn a_load_that_was_not_declared_is_found() {
    let mut tool = iiwa().1;
    tool.body.mass_kg += 1.5;
    let report = read(still(&tool), &[true, true]).0.expect("read");
    assert_eq!(report.verdict, StepEnd::Failed);
    let load = report
        .figures
        .iter()
        .find(|f| f.name.starts_with("load"))
        .expect("told");
    assert!((load.value.expect("told") - 1.5).abs() < 0.1, "{load:?}");
    assert!(
        report.remarks.iter().any(|r| r.contains("correct the tool's mass")),
        "{report:?}"
    );
}

// Fails if torques of the opposite sign pass where the drive declares their sign, or if the sign is not stated where it
// does not.
#[test]
fn the_sign_of_the_torques_is_told() {
    let mut reversed = still(&iiwa().1);
    reversed.tau.iter_mut().for_each(|tau| *tau = -*tau);
    let report = read(reversed, &[true, true]).0.expect("read");
    assert_eq!(report.verdict, StepEnd::Failed);
    assert!(report.remarks.iter().any(|r| r.contains("torque_sign")), "{report:?}");
    for (factor, words) in [(1.0, "actuators on the links"), (-1.0, "links on the actuators")] {
        let mut silent = still(&iiwa().1);
        silent.unsigned = true;
        silent.tau.iter_mut().for_each(|tau| *tau *= factor);
        let report = read(silent, &[true, true]).0.expect("read");
        assert_eq!(report.verdict, StepEnd::Passed, "{report:?}");
        assert!(report.remarks.iter().any(|r| r.contains(words)), "{report:?}");
    }
}

// Fails if torques that say nothing (an arm that stands upright, a link without torques) are a pass.
#[test]
fn what_cannot_be_told_is_no_pass() {
    let mut upright = still(&iiwa().1);
    upright.q = vec![0.0; 7];
    upright.tau = vec![0.1; 7];
    let mut silent = still(&iiwa().1);
    silent.tau.clear();
    for (side, words) in [(upright, "stretch the arm"), (silent, "gives 0 torques")] {
        let report = read(side, &[true, true]).0.expect("read");
        assert_eq!(report.verdict, StepEnd::CannotTell);
        let unknown = report
            .figures
            .iter()
            .filter(|f| f.judgement() == Judgement::CannotTell)
            .count();
        assert_eq!(unknown, 2, "{report:?}");
        assert!(report.remarks.iter().any(|r| r.contains(words)), "{report:?}");
    }
}

// Fails if torques that agree with the heavy arm under no sign pass, or are excused as "cannot tell": dead sensors,
// joints in another order, a joint that is pressed while the arm stands upright.
#[test]
fn torques_of_another_arm_fail() {
    let (zeros, mut order, mut pressed) = (still(&iiwa().1), still(&iiwa().1), still(&iiwa().1));
    order.tau.rotate_right(1);
    pressed.q = vec![0.0; 7];
    pressed.tau = vec![0.0; 7];
    pressed.tau[0] = 12.0;
    for unsigned in [false, true] {
        for (side, tau) in [
            (&zeros, vec![0.0; 7]),
            (&order, order.tau.clone()),
            (&pressed, pressed.tau.clone()),
        ] {
            let side = Still {
                q: side.q.clone(),
                tau,
                unsigned,
                ..still(&iiwa().1)
            };
            let report = read(side, &[true, true]).0.expect("read");
            assert_eq!(report.verdict, StepEnd::Failed, "{report:?}");
            assert!(report.remarks.iter().any(|r| r.contains("neither sign")), "{report:?}");
        }
    }
}

// Fails if states that are lost on the way are not counted, or if one in fifty-one is too many.
#[test]
fn lost_states_are_counted() {
    for (lossy, expected, verdict) in [
        (0, 0.0, StepEnd::Passed),
        (51, 1.96, StepEnd::Passed),
        (10, 10.0, StepEnd::Failed),
    ] {
        let side = Still {
            lossy,
            ..still(&iiwa().1)
        };
        let report = read(side, &[true, true]).0.expect("read");
        assert_eq!(report.verdict, verdict, "{report:?}");
        let lost = report
            .figures
            .iter()
            .find(|f| f.name == "states that did not arrive")
            .expect("told");
        assert!((lost.value.expect("told") - expected).abs() < 0.2, "{lost:?}");
    }
}

// Fails if a figure beyond its limit comes without a word on what to do.
#[test]
fn what_fails_says_what_to_do() {
    for step in CommissioningStep::ALL {
        let beyond = vec![Figure::judged("x", 2.0, "N", 1.0)];
        let report = StepReport::of(step, beyond, Vec::new());
        assert_eq!(report.verdict, StepEnd::Failed);
        assert_eq!(report.remarks, [step.remedy()]);
    }
}

// Fails if the step goes on without a yes, or passes although the pendant shows other angles.
#[test]
fn a_no_ends_the_step() {
    let declined = read(still(&iiwa().1), &[false]).0.expect("asked");
    assert_eq!(declined.verdict, StepEnd::Declined);
    assert!(declined.figures.is_empty(), "nothing was measured");
    let other_angles = read(still(&iiwa().1), &[true, false]).0.expect("read");
    assert_eq!(other_angles.verdict, StepEnd::Failed);
    let mut moved = still(&iiwa().1);
    moved.commanded = true;
    assert!(matches!(read(moved, &[true]).0, Err(CampaignError::Commanded { .. })));
}

// Fails if a value beyond its limit, or a NaN, counts as within.
#[test]
fn figures_are_judged_by_magnitude() {
    let judged = |value| Figure::judged("x", value, "N", 2.0).judgement();
    assert_eq!(judged(-1.9), Judgement::Within);
    assert_eq!(judged(-2.1), Judgement::Beyond);
    assert_eq!(judged(f64::NAN), Judgement::Beyond);
    assert_eq!(Figure::shown("x", 9.0, "N").judgement(), Judgement::Shown);
}
