//! What was found, in words.

use nalgebra::Vector3;

use crate::{Explanation, READOUT_M};

/// Share by which a TCP may differ from a reversed or rescaled one.
const NEAR: f64 = 0.25;

/// What is wrong with a TCP that was given (m) where another one fits, and the option for it.
pub(crate) fn tool(given: &Vector3<f64>, fitted: &Vector3<f64>) -> (String, String) {
    let near = |other: Vector3<f64>| (fitted - other).norm() < NEAR * other.norm();
    let words = if near(-given) {
        "the tool points the other way"
    } else if near(given * 1e3) {
        "the tool is given in m, not in mm"
    } else if near(given * 1e-3) {
        "the tool is given in um, not in mm"
    } else {
        "the TCP is elsewhere on the flange"
    };
    let mm = (fitted * 1e3).map(|v| (v * 10.0).round() / 10.0 + 0.0);
    (words.to_owned(), format!("--tool-mm {},{},{}", mm.x, mm.y, mm.z))
}

impl Explanation {
    /// One sentence each: what was found, and joints that hardly move; empty for a table that fits and moves.
    pub fn sentences(&self) -> Vec<String> {
        let mm = |m: f64| format!("{:.*}", if m < 1e-3 { 3 } else { 1 }, m * 1e3);
        let mut out = Vec::new();
        if self.readout {
            out.push(format!(
                "the measured points are those of the nominal model, to {:.0} um: the controller computed them, nothing \
                 measured them; a calibration needs points of another instrument",
                READOUT_M * 1e6
            ));
        }
        match self.found.as_slice() {
            [] => {}
            [one] => out.push(format!(
                "{}: then the rows fit to {} mm ({} mm without): use `{}`",
                one.words,
                mm(one.score_m),
                mm(self.own_m),
                one.options
            )),
            several => {
                let each = several
                    .iter()
                    .take(4)
                    .map(|f| format!("{} (to {} mm: `{}`)", f.words, mm(f.score_m), f.options));
                let each: Vec<String> = each.collect();
                let more = several.len().saturating_sub(each.len());
                let more = if more > 0 {
                    format!("; and {more} more")
                } else {
                    String::new()
                };
                out.push(format!(
                    "the rows do not tell these apart ({} mm without): {}{more}",
                    mm(self.own_m),
                    each.join("; or ")
                ));
            }
        }
        for (joint, range) in &self.still {
            out.push(format!(
                "joint {} moves by {:.1} degrees alone: its own errors and those of its neighbours cannot be told apart; \
                 measure poses in which it moves",
                joint + 1,
                range.to_degrees()
            ));
        }
        out
    }

    /// What to say where nothing was found.
    pub fn none_of_these(&self) -> String {
        format!(
            "none of {} usual mistakes (signs, order, zeros, couplings and units of joints; units, handedness and order \
             of points; tool; other built-in robots; pairs of these) makes the rows fit",
            self.tried
        )
    }
}
