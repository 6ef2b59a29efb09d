//! What was measured on one robot, as plain data: the input of
//! [`evaluate`](crate::evaluate()).

use spherecal_model::input::Labels;
use spherecal_model::{Experiment, Observation, Pose, Set, Target};

use crate::arcs::{LaserError, Measured, MeasuredArc, MeasuredFrames, frames_from_arcs};
use crate::course::Course;

/// By what people find a row again: the one name that it has in all messages, tables and files.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RowNames {
    /// Its number, from 1, as the checks of the data count: rows in the memory of a caller.
    #[default]
    Number,
    /// Its line in the file.
    Line,
    /// The pose of the plan at which a run recorded it.
    Pose,
}

/// Where one row of the data came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RowSource {
    /// Number of the row or line, from 1, or of the pose in the plan, as [`Recordings::named_by`] says.
    pub number: u64,
    /// Placement of the plate: also for points given in the plate's frame.
    pub place: u32,
    /// Value of the hold-out column: its number in [`Recordings::labels`].
    pub label: u32,
}

/// A row that judges.
#[derive(Clone, Copy, Debug)]
pub struct Judge<'a> {
    /// Its number in the result.
    pub index: usize,
    /// Joint angles and target.
    pub observation: &'a Observation,
    /// Placement of the plate: also for points given in the plate's frame.
    pub place: u32,
}

/// The rows of a table of validation points.
#[derive(Clone, Debug, Default)]
pub struct ValidationRows {
    /// File, for messages.
    pub file: String,
    /// Joint angles and targets.
    pub observations: Vec<Observation>,
    /// Where each came from.
    pub samples: Vec<RowSource>,
}

/// What an independent instrument, such as a laser tracker, measured on the same robot.
#[derive(Clone, Debug, Default)]
pub struct TrackerRecordings {
    /// Points for a calibration from the tracker alone.
    pub calibration: Vec<Measured>,
    /// Arcs of joints 1 and 2.
    pub base_arcs: Vec<MeasuredArc>,
    /// Arcs of the last three joints.
    pub tool_arcs: Vec<MeasuredArc>,
    /// Base and tool where they were measured otherwise; from the arcs if none.
    pub frames: Option<MeasuredFrames>,
    /// The plate in the tracker frame, where it was measured.
    pub plate: Option<Pose>,
    /// Points that judge the models.
    pub validation: Vec<Measured>,
}

impl TrackerRecordings {
    /// Base and tool as the instrument measured them.
    ///
    /// # Errors
    /// Arcs that do not give them.
    pub(crate) fn measured_frames(&self, experiment: &Experiment) -> Result<MeasuredFrames, LaserError> {
        match &self.frames {
            Some(frames) => Ok(frames.clone()),
            None => frames_from_arcs(&experiment.robot, &self.base_arcs, &self.tool_arcs),
        }
    }

    /// The calibration points as an experiment with the nominal robot and tool.
    pub(crate) fn experiment(&self, contacts: &Experiment) -> Experiment {
        let observation = |m: &Measured| Observation {
            seat: None,
            q: m.q.clone(),
            tau: None,
            target: Target::Point(m.point_m),
            set: Set::Calibrate,
        };
        Experiment {
            robot: contacts.robot.clone(),
            tool: contacts.tool,
            spheres: Vec::new(),
            observations: self.calibration.iter().map(observation).collect(),
        }
    }
}

/// What a campaign noted besides its recordings.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CampaignRecord {
    /// Poses that were to be recorded.
    pub planned: usize,
    /// Largest motion of a seated nest under the test pull, in m.
    pub worst_seat_m: f64,
    /// The sphere on which that was.
    pub worst_seat_sphere: Option<u32>,
    /// Poses that were given up: sphere, pose.
    pub given_up: Vec<(u32, u32)>,
    /// Faults, all recovered from.
    pub faults: usize,
    /// Whether the arm was a simulation.
    pub simulated: bool,
}

/// Everything that was measured on one robot. SI units.
#[derive(Clone, Debug)]
pub struct Recordings {
    /// Nominal robot, tool (in the last frame of the table) and plate, with every row.
    pub experiment: Experiment,
    /// The file of the rows, for messages; empty where there was none.
    pub file: String,
    /// By what messages name the rows.
    pub named_by: RowNames,
    /// Where each observation came from, in the same order.
    pub samples: Vec<RowSource>,
    /// Further rows that only judge the result.
    pub validation: ValidationRows,
    /// Names of the placements.
    pub places: Labels,
    /// Values of the hold-out column.
    pub labels: Labels,
    /// Name of the hold-out column; none where nothing is held out.
    pub holdout: Option<String>,
    /// The independent instrument's measurements, where there was one.
    pub tracker: Option<TrackerRecordings>,
    /// What the campaign noted, where there was one.
    pub campaign: Option<CampaignRecord>,
    /// When and in which coupling each observation was made; without it, rows on one
    /// sphere that follow each other count as one coupling.
    pub course: Option<Course>,
}

impl Recordings {
    /// The recordings of an experiment without anything else.
    pub fn new(experiment: Experiment) -> Self {
        let place = |o: &Observation| match o.target {
            Target::Sphere { place, .. } => place,
            _ => 0,
        };
        let samples: Vec<RowSource> = (1..)
            .zip(&experiment.observations)
            .map(|(number, o)| RowSource {
                number,
                place: place(o),
                label: 0,
            })
            .collect();
        let mut places = Labels::default();
        match samples.iter().map(|s| s.place).max() {
            None | Some(0) => {
                places.number("");
            }
            // Numbers that were not given in turn have no names.
            Some(last) if last as usize >= samples.len() => {}
            Some(last) => {
                for place in 0..=last {
                    places.number(&place.to_string());
                }
            }
        }
        Self {
            experiment,
            file: String::new(),
            named_by: RowNames::default(),
            samples,
            validation: ValidationRows::default(),
            places,
            labels: Labels::default(),
            holdout: None,
            tracker: None,
            campaign: None,
            course: None,
        }
    }

    /// Whether the rows are contacts with spheres.
    pub fn closed_loop(&self) -> bool {
        let contact = |o: &Observation| matches!(o.target, Target::Sphere { .. });
        self.experiment.observations.iter().any(contact)
    }

    /// Name of row `i` for people: its line, pose or number, and place and sphere where it has them.
    pub fn describe(&self, i: usize) -> String {
        let (Some(observation), Some(sample)) = (self.experiment.observations.get(i), self.samples.get(i)) else {
            return String::new();
        };
        let row = match self.named_by {
            RowNames::Number => format!("row {}", i + 1),
            RowNames::Line => format!("{} line {}", self.file, sample.number),
            RowNames::Pose => format!("pose {}", sample.number),
        };
        let Target::Sphere { sphere, place } = observation.target else {
            return row;
        };
        match self.places.name(place) {
            "" => format!("{row} (sphere {sphere})"),
            place => format!("{row} (sphere {sphere}, place {place})"),
        }
    }

    /// Rows of the calibration set.
    pub(crate) fn training_rows(&self) -> Vec<usize> {
        let calibrates = |&i: &usize| self.experiment.observations[i].set == Set::Calibrate;
        (0..self.experiment.observations.len()).filter(calibrates).collect()
    }

    /// Row `i` as a judge that the result calls `index`.
    pub(crate) fn judge(&self, index: usize, i: usize) -> Judge<'_> {
        Judge {
            index,
            observation: &self.experiment.observations[i],
            place: self.samples.get(i).map_or(0, |s| s.place),
        }
    }

    /// The rows that no fit sees: those of the data that are set aside, then the
    /// validation file's.
    pub(crate) fn set_aside(&self) -> impl Iterator<Item = Judge<'_>> {
        let data = self
            .experiment
            .observations
            .iter()
            .zip(&self.samples)
            .filter(|(o, _)| o.set == Set::Validate);
        let file = self.validation.observations.iter().zip(&self.validation.samples);
        data.chain(file)
            .enumerate()
            .map(|(index, (observation, sample))| Judge {
                index,
                observation,
                place: sample.place,
            })
    }

    /// The rows that judge a result: all rows of the data in a cross-validation,
    /// else those that no fit sees.
    pub fn judges(&self, cross_validated: bool) -> Box<dyn Iterator<Item = Judge<'_>> + '_> {
        if cross_validated {
            Box::new((0..self.experiment.observations.len()).map(|i| self.judge(i, i)))
        } else {
            Box::new(self.set_aside())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use spherecal_model::robots;

    // Fails if a recording of a run, of a file and of a caller's arrays is not called by the pose, the line and
    // the number that its user can look up, with its sphere.
    #[test]
    fn a_row_has_the_name_by_which_its_user_finds_it() {
        let model = robots::load("iiwa7").expect("built in");
        let contact = |sphere| Observation {
            seat: None,
            q: vec![0.0; 7],
            tau: None,
            target: Target::Sphere { sphere, place: 0 },
            set: Set::Calibrate,
        };
        let mut recordings = Recordings::new(Experiment {
            robot: model.robot,
            tool: model.tool,
            spheres: Vec::new(),
            observations: vec![contact(2), contact(3)],
        });
        assert_eq!(recordings.describe(1), "row 2 (sphere 3)");
        recordings.samples[1].number = 86;
        recordings.named_by = RowNames::Pose;
        assert_eq!(recordings.describe(1), "pose 86 (sphere 3)");
        recordings.file = "poses.csv".to_owned();
        recordings.named_by = RowNames::Line;
        assert_eq!(recordings.describe(1), "poses.csv line 86 (sphere 3)");
    }
}
