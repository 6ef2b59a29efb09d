//! The questions of `spherecal init`. An answer is checked before the next question.

use std::io::{BufRead, Write};
use std::path::Path;

use super::exit::CliError;
use super::init_given::Given;
use spherecal_job::new_cell::{LARGEST_MM, check_mass, check_robot, check_serial, check_tcp};
use spherecal_model::input::triple;

/// Someone who answers, and where the questions are written.
pub(super) struct Questions<I, O> {
    answers: I,
    out: O,
}

impl<I: BufRead, O: Write> Questions<I, O> {
    pub(super) fn new(answers: I, out: O) -> Self {
        Self { answers, out }
    }

    /// Asks for what is not given.
    /// Errors: the answers end, or the terminal cannot be written to.
    pub(super) fn ask(&mut self, given: &mut Given) -> Result<(), CliError> {
        if given.robot.is_none() {
            let words = "Robot (a built-in name such as fr3, iiwa7, ur5e, or a .urdf or .toml file)";
            given.robot = self.question(words, None, |text| check_robot(text).map(|()| text.to_owned()))?;
        }
        let robot = given.robot.clone().unwrap_or_default();
        if given.serial.is_none() {
            let words = "Serial number of the arm";
            given.serial = self.question(words, None, |text| check_serial(text).map(|()| text.to_owned()))?;
        }
        if given.plate.is_none() {
            let words = "Plate: distances 1-2,1-3,2-3 of its centres in mm, or centres X,Y,Z;X,Y,Z;X,Y,Z, or its file, or paper";
            given.plate = self.question(words, None, str::parse)?;
        }
        if given.plate_u_mm.is_none() {
            let words = "Uncertainty U (k = 2) of the plate's certificate in mm; empty if it is in the plate's file";
            given.plate_u_mm = self.question(words, Some(""), number)?;
        }
        if given.plate_certificate.is_none() {
            let words = "Number of the plate's certificate; empty if there is none";
            given.plate_certificate = self.question(words, Some(""), |text| Ok::<_, String>(text.to_owned()))?;
        }
        if given.tool_mass_kg.is_none() {
            let words = "Mass of everything at the flange, in kg";
            given.tool_mass_kg = self.question(words, None, |text| {
                let mass = number(text).map_err(|e| e.to_string())?;
                check_mass(&robot, mass).map(|()| mass).map_err(|e| e.to_string())
            })?;
        }
        if given.tool_mm.is_none() {
            let words =
                "Tool offset: centre of a seated sphere in the flange frame, X,Y,Z in mm; empty for the default";
            let diameter = given.sphere_diameter_mm;
            given.tool_mm = self.question(words, Some(""), |text| {
                let tool = triple("the tool offset", text, LARGEST_MM).map_err(|e| e.to_string())?;
                check_tcp(tool, diameter).map(|()| tool).map_err(|e| e.to_string())
            })?;
        }
        if given.instrument.is_none() {
            let words = "Instrument: none (the plate alone), tracker, or points";
            given.instrument = self.question(words, Some("none"), str::parse)?;
        }
        Ok(())
    }

    /// Asks whether to write the files.
    /// Errors: the answers end, or the terminal cannot be written to.
    pub(super) fn confirm(&mut self, assumed: &[String], folder: &Path) -> Result<bool, CliError> {
        for words in assumed {
            self.say(&format!("Assumed: {words}\n"))?;
        }
        let words = format!(
            "Write cell.toml, plate.toml and poses.csv to {}? (yes, no)",
            folder.display()
        );
        let answer = self.question(&words, Some("yes"), |text| match text.to_lowercase().as_str() {
            "y" | "yes" => Ok(true),
            "n" | "no" => Ok(false),
            _ => Err("answer yes or no"),
        })?;
        Ok(answer.unwrap_or(false))
    }

    /// Asks until an answer is read by `read`. An empty answer is the default; `None` where that is
    /// empty, too.
    fn question<T, E: std::fmt::Display>(
        &mut self,
        words: &str,
        default: Option<&str>,
        read: impl Fn(&str) -> Result<T, E>,
    ) -> Result<Option<T>, CliError> {
        let shown = default
            .filter(|d| !d.is_empty())
            .map_or_else(String::new, |d| format!(" [{d}]"));
        loop {
            self.say(&format!("{words}{shown}: "))?;
            let mut line = String::new();
            let count = self.answers.read_line(&mut line).map_err(CliError::input)?;
            if count == 0 {
                return Err(CliError::input(
                    "the answers ended before every question was answered: nothing is written",
                ));
            }
            let answer = match (line.trim(), default) {
                ("", Some("")) => return Ok(None),
                ("", Some(default)) => default,
                ("", None) => {
                    self.say("  an answer is needed\n")?;
                    continue;
                }
                (answer, _) => answer,
            };
            match read(answer) {
                Ok(value) => return Ok(Some(value)),
                Err(error) => self.say(&format!("  {error}\n"))?,
            }
        }
    }

    fn say(&mut self, words: &str) -> Result<(), CliError> {
        self.out
            .write_all(words.as_bytes())
            .and_then(|()| self.out.flush())
            .map_err(CliError::job)
    }
}

#[derive(Debug, thiserror::Error)]
#[error("\"{0}\" is no number")]
struct NoNumber(String);

/// A finite number; a decimal comma is read, too.
fn number(text: &str) -> Result<f64, NoNumber> {
    let read: Option<f64> = text.replace(',', ".").parse().ok().filter(|x: &f64| x.is_finite());
    read.ok_or_else(|| NoNumber(spherecal_model::excerpt(text)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use spherecal_job::new_cell::{Instrument, StatedPlate};

    fn asked(answers: &str, given: &mut Given) -> (Result<(), CliError>, String) {
        let mut out = Vec::new();
        let result = Questions::new(answers.as_bytes(), &mut out).ask(given);
        (result, String::from_utf8(out).expect("text"))
    }

    // Fails if an answer is lost, a wrong one is taken, or what is given is asked for again.
    #[test]
    fn wrong_answers_are_asked_for_again() {
        let mut given = Given {
            sphere_diameter_mm: 50.8,
            serial: Some("A".to_owned()),
            ..Given::default()
        };
        let answers = "fr4\nfr3\n300,300\n300,300.2,300.1\nno\n0,0027\n\n9\n0.8\n0,0,1\n\nlaser\n\n";
        let (result, said) = asked(answers, &mut given);
        result.expect("answered");
        assert_eq!(
            (given.robot.as_deref(), given.serial.as_deref()),
            (Some("fr3"), Some("A"))
        );
        assert_eq!(given.plate, Some(StatedPlate::Distances([300.0, 300.2, 300.1])));
        assert_eq!(
            (given.plate_u_mm, given.tool_mass_kg, given.tool_mm),
            (Some(0.0027), Some(0.8), None)
        );
        assert_eq!(given.instrument, Some(Instrument::None));
        assert!(
            said.contains("did you mean fr3?") && said.contains("payload of 3 kg"),
            "{said}"
        );
        assert!(!said.contains("Serial"), "{said}");
    }

    // Fails if a closed terminal is asked for ever, or counts as an answer.
    #[test]
    fn answers_that_end_are_refused() {
        let (result, _) = asked("fr3\n\n", &mut Given::default());
        assert!(result.expect_err("refused").to_string().contains("nothing is written"));
        let mut out = Vec::new();
        let mut confirm = |answers: &str| Questions::new(answers.as_bytes(), &mut out).confirm(&[], Path::new("."));
        assert!(confirm("\n").expect("yes") && !confirm("maybe\nno\n").expect("no"));
        assert!(confirm("").is_err());
    }
}
