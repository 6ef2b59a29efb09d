//! The limits of a joint. Files write infinities, 1e16 or `lower = upper` for "no limit":
//! these are read as such and named once, because an identification needs no limits.

use std::f64::consts::{PI, TAU};

use super::value_error;
use crate::robots::error::RobotFileError;

/// Largest angle (rad) or position (m) that is a limit; beyond it the joint has none.
const LARGEST_POSITION: f64 = 1e4;
/// Largest speed, in rad/s or m/s: the fastest joints of the field turn with 20 rad/s.
const LARGEST_SPEED: f64 = 1e3;
/// Largest torque (N m) or force (N).
const LARGEST_EFFORT: f64 = 1e5;
/// Range (m) of a sliding joint whose file gives none.
const SLIDE_M: f64 = 10.0;
/// Most joints that a note names.
const NAMED: usize = 3;

pub(super) struct Limits {
    /// Smallest and largest position, in rad or m.
    pub(super) range: (f64, f64),
    /// Largest speed, in rad/s or m/s; 0 where there is none.
    pub(super) velocity: f64,
    /// Largest torque (N m) or force (N); 0 where there is none.
    pub(super) effort: f64,
    /// What cannot be meant.
    pub(super) odd: Vec<String>,
}

/// Reads the limits of a joint of type `kind`.
/// Errors: text that is no number.
pub(super) fn read(
    path: &str,
    owner: &str,
    kind: &str,
    node: Option<roxmltree::Node<'_, '_>>,
) -> Result<Limits, RobotFileError> {
    let slides = kind == "prismatic";
    let mut limits = Limits {
        range: if slides { (-SLIDE_M, SLIDE_M) } else { (-TAU, TAU) },
        velocity: 0.0,
        effort: 0.0,
        odd: Vec::new(),
    };
    if !slides && !matches!(kind, "revolute" | "continuous") {
        return Ok(limits);
    }
    // The value; `None` where there is none, or none within `range` that could be meant.
    let number = |what: &'static str, range: std::ops::RangeInclusive<f64>, odd: &mut Vec<String>| {
        let Some(text) = node.and_then(|n| n.attribute(what)) else {
            return Ok(None);
        };
        let value: f64 = text.trim().parse().map_err(|_| {
            let remedy = "write a number (a xacro file must be expanded first: xacro FILE.xacro > FILE.urdf)";
            value_error(path, format!("{owner}: limit {what}"), text, remedy)
        })?;
        if range.contains(&value) {
            return Ok(Some(value));
        }
        odd.push(format!("{what} is {}", crate::excerpt(text.trim())));
        Ok::<_, RobotFileError>(None)
    };
    let odd = &mut limits.odd;
    if kind != "continuous" {
        let given = |what| node.is_some_and(|n| n.has_attribute(what));
        let possible = || -LARGEST_POSITION..=LARGEST_POSITION;
        let (lower, upper) = (number("lower", possible(), odd)?, number("upper", possible(), odd)?);
        let half = if slides { SLIDE_M } else { PI };
        let (least, most) = limits.range;
        // A limit that is not given is half a turn; one that cannot be meant is a whole one.
        let range = (
            lower.unwrap_or(if given("lower") { least } else { -half }),
            upper.unwrap_or(if given("upper") { most } else { half }),
        );
        limits.range = if range.0 < range.1 {
            range
        } else {
            odd.push(format!("lower is {} and upper is {}", range.0, range.1));
            (-half, half)
        };
    }
    limits.velocity = number("velocity", 0.0..=LARGEST_SPEED, odd)?.unwrap_or(0.0);
    limits.effort = number("effort", 0.0..=LARGEST_EFFORT, odd)?.unwrap_or(0.0);
    Ok(limits)
}

/// One sentence on all limits that cannot be meant; nothing without any.
pub(super) fn said(odd: &[String]) -> Option<String> {
    let more = odd.len().saturating_sub(NAMED);
    let named: Vec<&str> = odd.iter().take(NAMED).map(String::as_str).collect();
    let more = if more > 0 {
        format!(" and {more} more")
    } else {
        String::new()
    };
    (!odd.is_empty()).then(|| {
        format!(
            "limits that cannot be meant are taken as none: {}{more}",
            named.join("; ")
        )
    })
}
