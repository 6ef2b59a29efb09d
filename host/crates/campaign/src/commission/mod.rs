//! The first run on a robot: five steps, each with what to expect, what was measured, and a yes of the
//! person before the next.
//!
//! ```text
//!   StateReader ─ states, no command ─▶ [read_only] ─▶ StepReport ─┐
//!   Session ─ hold, move, touch ──────▶ [moving] ────▶ StepReport ─┼─▶ stored after each step
//!   Attendant ─ yes or no ─────────────────────────────────────────┘
//! ```
//!
//! A step passes only if everything that it measures is within its limit. A step that does not pass, or a "no", ends
//! the procedure: nothing is commanded after it but to stop. What cannot be measured is said so; it is never a pass.

mod figure;
mod moving;
mod read_only;
#[cfg(test)]
mod tests;
mod watch;

use serde::{Deserialize, Serialize};

pub use figure::{Figure, Judgement};
pub use moving::commission_moving;
pub use read_only::{ReadOnlyLimits, commission_read_only, gravity_nm};
pub use watch::MovingLimits;

/// A step of the procedure, in its order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CommissioningStep {
    /// States are read; nothing is commanded.
    ReadOnly,
    /// The arm is held with zero stiffness: gravity compensation and damping alone.
    ZeroStiffness,
    /// The arm holds its place with soft springs.
    SoftHold,
    /// Each joint moves a little in free space, at a tenth of the speed.
    FreeMotion,
    /// The nest touches sphere 1, couples, and leaves it.
    Contact,
}

impl CommissioningStep {
    /// All steps, in order.
    pub const ALL: [Self; 5] = [
        Self::ReadOnly,
        Self::ZeroStiffness,
        Self::SoftHold,
        Self::FreeMotion,
        Self::Contact,
    ];

    /// Its name in words.
    pub fn name(self) -> &'static str {
        match self {
            Self::ReadOnly => "read only",
            Self::ZeroStiffness => "zero stiffness",
            Self::SoftHold => "soft hold",
            Self::FreeMotion => "free motion",
            Self::Contact => "one contact",
        }
    }

    /// What to do before it, and what to expect.
    pub fn expectation(self) -> &'static str {
        match self {
            Self::ReadOnly => {
                "Nothing is commanded. The arm stands still for 2 s. Its angles agree with the pendant, and its torques \
                 with the masses of arm and tool."
            }
            Self::ZeroStiffness => {
                "Put your hand on the emergency stop. The arm is held against gravity without springs for 5 s: it stays, or \
                 sinks slowly. Do not touch it."
            }
            Self::SoftHold => {
                "Keep your hand on the emergency stop. The arm holds its place with soft springs for 5 s. Do not touch it."
            }
            Self::FreeMotion => {
                "Keep your hand on the emergency stop, and 200 mm around the arm clear. Each joint turns by about 6 degrees and \
                 back, one after the other, at a tenth of the usual speed."
            }
            Self::Contact => {
                "Keep your hand on the emergency stop. The arm moves slowly over sphere 1, descends until it feels the \
                 contact, couples, and leaves the sphere."
            }
        }
    }
}

impl CommissioningStep {
    /// What to do if something that it measured is beyond its limit.
    pub fn remedy(self) -> &'static str {
        match self {
            Self::ReadOnly => {
                "Do not go on. See that nothing touches the arm, that the configuration describes this robot and its tool, \
                 and that the network loses nothing. Then begin again."
            }
            Self::ZeroStiffness => {
                "Do not go on. See that nothing touches or pulls the arm (hoses, cables), and that mass and centre of mass of \
                 the tool are right in the configuration and in the robot. Then begin again."
            }
            Self::SoftHold => {
                "Do not go on. See that nothing touches the arm. If it trembled, lower procedure.motion.natural_rad_s. Then \
                 begin again."
            }
            Self::FreeMotion => {
                "Do not go on. See that nothing touched the arm, and that the joints' limits are right in the robot's file. \
                 Then begin again."
            }
            Self::Contact => {
                "Do not run a calibration yet. See that the plate stands where the configuration says, that nest and sphere \
                 are clean, and that the tool's mass is right. Then begin again."
            }
        }
    }
}

/// How a step ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StepEnd {
    /// Everything that was judged is within its limit, and the person agreed.
    Passed,
    /// Something is beyond its limit, a fault came, or the person saw something else than expected.
    Failed,
    /// What the step is to show could not be measured: not a pass.
    CannotTell,
    /// The person did not want the step.
    Declined,
}

impl StepEnd {
    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Passed => "passed",
            Self::Failed => "FAILED",
            Self::CannotTell => "cannot tell",
            Self::Declined => "declined",
        }
    }
}

/// A step with what it measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StepReport {
    /// Which step.
    pub step: CommissioningStep,
    /// How it ended.
    pub verdict: StepEnd,
    /// What was measured.
    pub figures: Vec<Figure>,
    /// Why it did not pass, and what to do.
    pub remarks: Vec<String>,
    /// When it ended, UTC, RFC 3339; empty until the report is kept.
    #[serde(default)]
    pub ended_utc: String,
}

impl StepReport {
    /// A report of what was measured: passed if every figure could be measured and none is beyond its limit.
    pub(crate) fn of(step: CommissioningStep, figures: Vec<Figure>, mut remarks: Vec<String>) -> Self {
        let has = |judgement| figures.iter().any(|f| f.judgement() == judgement);
        let verdict = if has(Judgement::Beyond) {
            remarks.push(step.remedy().to_owned());
            StepEnd::Failed
        } else if has(Judgement::CannotTell) {
            StepEnd::CannotTell
        } else {
            StepEnd::Passed
        };
        Self {
            step,
            verdict,
            figures,
            remarks,
            ended_utc: String::new(),
        }
    }

    /// The same, failed for another reason.
    pub(crate) fn failed(mut self, why: String) -> Self {
        self.verdict = StepEnd::Failed;
        self.remarks.push(why);
        self
    }

    /// A step that the person did not want.
    pub(crate) fn declined(step: CommissioningStep) -> Self {
        Self {
            step,
            verdict: StepEnd::Declined,
            figures: Vec::new(),
            remarks: vec!["the person at the robot did not agree to begin".to_owned()],
            ended_utc: String::new(),
        }
    }
}

/// The person at the robot, and who keeps the reports.
pub trait Attendant {
    /// Shows a text.
    fn tell(&mut self, text: &str);

    /// Asks a question whose answer is yes or no. The answer to an earlier question does not count.
    fn ask(&mut self, question: &str);

    /// The answer, once there is one. The caller keeps the arm alive meanwhile.
    fn answer(&mut self) -> Option<bool>;

    /// The controller says that its drive moves a simulated arm.
    fn simulated(&mut self) {}

    /// A step has ended; its report is to be kept.
    ///
    /// # Errors
    /// It could not be kept: the procedure ends.
    fn done(&mut self, report: &StepReport) -> Result<(), spherecal_link::JournalError>;
}
