//! Chains with joints that slide or follow others: what a table says of them, and the calibrated robot.

use spherecal_explain::{Slides, hinges};
use spherecal_identify::study::Study;
use spherecal_model::input::{Labels, TableFormat, read_csv};
use spherecal_model::robots::{JointPath, RobotModel, load_urdf_text_path};
use spherecal_results::{CalibratedTexts, take_slides};

use crate::error::Failure;
use crate::robot::NativeRobot;

/// Motion of the slides of one chain, over all tables of an identification.
#[derive(Default)]
pub(crate) struct SlidesOfPath(Option<Slides>);

impl SlidesOfPath {
    /// Turns the table `csv`, named `name`, into one of hinges alone. Returns what is to be noted.
    /// Errors: a table that cannot be read, or rows that the chain cannot have.
    pub(crate) fn take(
        &mut self,
        path: &JointPath,
        nominal: &RobotModel,
        name: &str,
        csv: &mut String,
        label: Option<&str>,
    ) -> Result<Vec<String>, Failure> {
        let format = TableFormat {
            joints: path.columns.len(),
            label: label.map(str::to_owned),
            ..TableFormat::default()
        };
        let mut places = Labels::default();
        let mut table = read_csv(name, csv.as_bytes(), &format, &mut places)?;
        let notes = hinges(path, &nominal.tool.tcp(), &mut table, &mut self.0)
            .map_err(|e| Failure::input(name, &nominal.robot.name, &e.to_string()))?;
        *csv = table.to_csv(&places, label.filter(|_| !table.labels.is_empty()));
        Ok(notes)
    }

    /// Tells a study the directions of the slides.
    pub(crate) fn tell(&self, study: &mut Study) {
        if let Some(slides) = &self.0 {
            take_slides(study, &slides.directions());
        }
    }
}

/// The calibrated robot; with `path`, what slides or follows is in the file, not in the table.
/// Errors: a file that cannot be read back.
pub(crate) fn robot_of(texts: &CalibratedTexts, path: bool) -> Result<NativeRobot, Failure> {
    if !path {
        return Ok(NativeRobot {
            model: texts.model.clone(),
            path: None,
        });
    }
    let (base, tip) = &texts.model.frame_names;
    let chain = format!("{base}:{tip}");
    let mut robot = NativeRobot::of(load_urdf_text_path("calibrated.urdf", &texts.urdf, Some(&chain))?)?;
    robot.model.tool = texts.model.tool;
    Ok(robot)
}
