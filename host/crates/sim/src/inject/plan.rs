//! The file format of injected faults.
//!
//! ```toml
//! seed = 7
//!
//! [[fault]]
//! what = "state_frozen"                      # no parameters: a name
//! when = { phase = { name = "recording", entry = 2, after_s = 0.3 } }
//! for_s = 0.05
//!
//! [[fault]]
//! what = { human_push = { force_n = [50.0, 0.0, 0.0] } }
//! when = { rate = { per_s = 0.02, most = 3 } }
//! ```
//!
//! An unknown name is an error.

use serde::{Deserialize, Serialize};
use spherecal_shared::protocol::host::Phase;

use super::fault::InjectedFault;
use spherecal_link::{Lossy, LossyError};

/// When a fault begins.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum When {
    /// At a control period, from 1.
    Tick(u64),
    /// After the controller has entered a phase a number of times.
    Phase {
        /// The phase.
        name: Phase,
        /// Which entry, from 1.
        #[serde(default = "first")]
        entry: u32,
        /// Time since that entry, in s.
        #[serde(default)]
        after_s: f64,
    },
    /// By chance, at a rate.
    Rate {
        /// Mean number per s of device time.
        per_s: f64,
        /// How often at most.
        most: u32,
    },
    /// At random, each time the controller enters a phase.
    Entering {
        /// The phase.
        name: Phase,
        /// Probability, 0 to 1.
        probability: f64,
        /// Time since the entry, in s.
        #[serde(default)]
        after_s: f64,
        /// How often at most.
        most: u32,
    },
}

fn first() -> u32 {
    1
}

/// A fault, its beginning and its duration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlannedFault {
    /// What goes wrong.
    pub what: InjectedFault,
    /// When it begins.
    pub when: When,
    /// Duration, in s; by default [`InjectedFault::usual_s`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub for_s: Option<f64>,
}

/// Everything that goes wrong in a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FaultPlan {
    /// Seed of the random choices.
    #[serde(default)]
    pub seed: u64,
    /// Disturbances of the host link's frames in the whole run, as in the configuration's
    /// `[host_link]`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub host_link: Option<Lossy>,
    /// The faults.
    #[serde(default, rename = "fault")]
    pub faults: Vec<PlannedFault>,
}

/// Why a plan was refused.
#[derive(Debug, thiserror::Error)]
pub enum InjectError {
    /// Neither a preset nor a file.
    #[error("\"{name}\" is neither a preset nor a file that can be read ({source}). The presets: {presets}")]
    Unknown {
        /// As given.
        name: String,
        /// What the system said.
        source: std::io::Error,
        /// Names of the presets.
        presets: String,
    },
    /// The file is not TOML, or contains an unknown name.
    #[error("{path}: {message}\nremedy: `spherecal-lab faults --show NAME` prints a preset as a file")]
    Syntax {
        /// File.
        path: String,
        /// What is wrong, and where.
        message: String,
    },
    /// A number is out of range.
    #[error("fault {number}: {field} is {value}: give a value from {min} to {max}")]
    Range {
        /// Which fault of the file, from 1.
        number: usize,
        /// Field, as in the file.
        field: &'static str,
        /// Its value.
        value: f64,
        /// Smallest value accepted.
        min: f64,
        /// Largest value accepted.
        max: f64,
    },
    /// A disturbance of the host link is out of range.
    #[error("host_link: {0}")]
    HostLink(#[from] LossyError),
    /// The fault needs what is not there.
    #[error("fault {number}, {name}: {why}")]
    NotHere {
        /// Which fault of the file, from 1.
        number: usize,
        /// The fault.
        name: &'static str,
        /// What is missing, and the remedy.
        why: &'static str,
    },
}

impl PlannedFault {
    /// How long it lasts, in s.
    pub fn duration_s(&self) -> f64 {
        self.for_s.unwrap_or(self.what.usual_s())
    }

    fn ranges(&self) -> Vec<(&'static str, f64, f64, f64)> {
        let mut ranges = self.what.ranges();
        if let Some(for_s) = self.for_s {
            ranges.push(("for_s", for_s, 0.0, f64::INFINITY));
        }
        match self.when {
            When::Tick(tick) => ranges.push(("when.tick", tick as f64, 1.0, f64::INFINITY)),
            When::Phase { entry, after_s, .. } => {
                ranges.push(("when.phase.entry", f64::from(entry), 1.0, f64::INFINITY));
                ranges.push(("when.phase.after_s", after_s, 0.0, 3600.0));
            }
            When::Rate { per_s, .. } => ranges.push(("when.rate.per_s", per_s, 0.0, 1000.0)),
            When::Entering {
                probability, after_s, ..
            } => {
                ranges.push(("when.entering.probability", probability, 0.0, 1.0));
                ranges.push(("when.entering.after_s", after_s, 0.0, 3600.0));
            }
        }
        ranges
    }
}

impl FaultPlan {
    /// A plan of one fault.
    pub fn of(what: InjectedFault, when: When) -> Self {
        Self {
            seed: 0,
            host_link: None,
            faults: vec![PlannedFault {
                what,
                when,
                for_s: None,
            }],
        }
    }

    /// From the text of a file called `path`.
    ///
    /// # Errors
    /// The text is not TOML or contains an unknown name.
    pub fn parse(path: &str, text: &str) -> Result<Self, InjectError> {
        toml::from_str(text).map_err(|e| InjectError::Syntax {
            path: path.to_owned(),
            message: e.to_string().trim_end().to_owned(),
        })
    }

    /// Checks every number, for an arm of `joints` joints.
    ///
    /// # Errors
    /// The first number that is out of its range.
    pub fn check(&self, joints: usize) -> Result<(), InjectError> {
        if let Some(lossy) = &self.host_link {
            lossy.check()?;
        }
        for (entry, number) in self.faults.iter().zip(1..) {
            let mut ranges = entry.ranges();
            if let Some(joint) = entry.what.joint() {
                ranges.push(("joint", joint as f64, 1.0, joints as f64));
            }
            for (field, value, min, max) in ranges {
                if !(value >= min && value <= max) {
                    return Err(InjectError::Range {
                        number,
                        field,
                        value,
                        min,
                        max,
                    });
                }
            }
        }
        Ok(())
    }

    /// Checks that no fault affects a file, for a store without one.
    ///
    /// # Errors
    /// The first fault that affects a file.
    pub fn check_without_file(&self) -> Result<(), InjectError> {
        let wants_file =
            |what: &InjectedFault| matches!(what, InjectedFault::DiskFull | InjectedFault::DatabaseLocked { .. });
        match self.faults.iter().zip(1..).find(|(f, _)| wants_file(&f.what)) {
            Some((entry, number)) => Err(InjectError::NotHere {
                number,
                name: entry.what.name(),
                why: "this fault needs a database in a file of this computer: leave out --store",
            }),
            None => Ok(()),
        }
    }

    /// The same without the moments at which the host is killed.
    pub fn without_kills(&self) -> Self {
        let mut plan = self.clone();
        plan.faults
            .retain(|f| !matches!(f.what, InjectedFault::HostKilled { .. }));
        plan
    }

    /// As the text of a file.
    pub fn to_toml(&self) -> String {
        // Nothing here that TOML cannot say.
        toml::to_string(self).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inject::PRESETS;

    // Fails if a preset changes when it is written and read, or is refused.
    #[test]
    fn presets_are_files() {
        for preset in PRESETS {
            let plan = preset.plan();
            let text = plan.to_toml();
            assert_eq!(FaultPlan::parse(preset.name, &text).expect(&text), plan, "{text}");
            plan.check(7).expect(preset.name);
            assert_eq!(plan.faults[0].what.name(), preset.name);
        }
    }

    // Fails if a misspelt name or a number out of range is accepted, or if the message does not
    // name it.
    #[test]
    fn what_is_not_known_is_refused() {
        for text in [
            "sed = 1",
            "[[fault]]\nwhat = \"state_frozn\"\nwhen = { tick = 5 }",
            "[[fault]]\nwhat = \"state_frozen\"\nwhen = { tick = 5 }\nfor_ms = 3",
            "[[fault]]\nwhat = { human_push = { force = [1.0, 0.0, 0.0] } }\nwhen = { tick = 5 }",
            "[[fault]]\nwhat = \"state_frozen\"\nwhen = { phase = { name = \"recordin\" } }",
        ] {
            assert!(FaultPlan::parse("a.toml", text).is_err(), "{text}");
        }
        let text = "[[fault]]\nwhat = { state_nan = { joint = 8 } }\nwhen = { tick = 5 }\n";
        let error = FaultPlan::parse("a.toml", text)
            .expect("TOML")
            .check(7)
            .expect_err("joint 8");
        assert_eq!(error.to_string(), "fault 1: joint is 8: give a value from 1 to 7");
        assert!(matches!(FaultPlan::load("no such"), Err(InjectError::Unknown { .. })));
        let full = FaultPlan::load("disk_full").expect("a preset");
        let error = full.check_without_file().expect_err("no file").to_string();
        assert!(error.contains("disk_full") && error.contains("--store"), "{error}");
        let killed = FaultPlan::load("host_killed").expect("a preset");
        killed.check_without_file().expect("nothing of a file");
    }
}
