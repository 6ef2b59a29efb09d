//! A YAML file of nested mappings as its numbers, each with the keys that lead to it.

use granit_parser::{Event, Parser};
use spherecal_shared::MAX_CHAIN;

use super::error::RobotFileError;

/// Most joints (the flange and the tip included) of a file.
pub(super) const MOST_JOINTS: usize = MAX_CHAIN + 2;
/// The six numbers of an origin.
pub(super) const NUMBERS: [&str; 6] = ["x", "y", "z", "roll", "pitch", "yaw"];
pub(super) const AXIS: [&str; 3] = ["axis_x", "axis_y", "axis_z"];
/// Deepest nesting of a file that is read.
const MOST_DEPTH: usize = 4;

/// One scalar of a file with the keys that lead to it.
pub(super) struct ScalarEntry {
    pub(super) keys: Vec<String>,
    pub(super) value: String,
    /// The value is tagged `!degrees`.
    degrees: bool,
    pub(super) line: usize,
}

impl ScalarEntry {
    pub(super) fn number(&self) -> Option<f64> {
        let value: f64 = self.value.parse().ok()?;
        Some(if self.degrees { value.to_radians() } else { value })
    }
}

/// All scalars of a file of nested mappings.
pub(super) fn entries(path: &str, text: &str) -> Result<Vec<ScalarEntry>, RobotFileError> {
    let syntax = |line: usize, what: &str| RobotFileError::Syntax {
        path: path.to_owned(),
        message: format!("line {line}: {what}"),
    };
    let mut out: Vec<ScalarEntry> = Vec::new();
    // The keys of the mappings that are open; `None` where a key comes next.
    let mut open: Vec<Option<String>> = Vec::new();
    for event in Parser::new_from_str(text) {
        let (event, span) = event.map_err(|e| syntax(e.marker().line(), &format!("is not YAML: {}", e.info())))?;
        let line = span.start.line();
        match event {
            Event::MappingStart(..) if open.len() < MOST_DEPTH => {
                if matches!(open.last(), Some(None)) {
                    return Err(syntax(line, "a key must be a plain name"));
                }
                open.push(None);
            }
            Event::MappingEnd => {
                open.pop();
                if let Some(key) = open.last_mut() {
                    *key = None;
                }
            }
            Event::Scalar(value, _, _, tag) => {
                let degrees = match tag.as_ref().map(|tag| tag.suffix()) {
                    None | Some("radians" | "float" | "int" | "str") => false,
                    Some("degrees") => true,
                    Some(_) => {
                        return Err(syntax(
                            line,
                            "holds a tag (!..) that is not read: write numbers in m and rad",
                        ));
                    }
                };
                match open.last_mut() {
                    Some(key @ None) => *key = Some(value.into_owned()),
                    Some(Some(_)) if out.len() < MOST_JOINTS * (NUMBERS.len() + AXIS.len()) + 1 => {
                        out.push(ScalarEntry {
                            keys: open.iter().flatten().cloned().collect(),
                            value: value.into_owned(),
                            degrees,
                            line,
                        });
                        if let Some(key) = open.last_mut() {
                            *key = None;
                        }
                    }
                    Some(Some(_)) => return Err(syntax(line, "holds more numbers than a robot's joint origins")),
                    None => return Err(syntax(line, "is not a list of joint origins: begin with kinematics:")),
                }
            }
            Event::MappingStart(..) => return Err(syntax(line, "is nested deeper than joint origins are")),
            Event::SequenceStart(..) => {
                return Err(syntax(line, "holds a list: give x, y, z, roll, pitch and yaw by name"));
            }
            Event::Alias(_) => {
                return Err(syntax(
                    line,
                    "holds an alias (*..), which is not read: write the numbers out",
                ));
            }
            _ => {}
        }
    }
    Ok(out)
}
