//! Whether a map of the residuals is kept: by rows that neither the fit nor the map has seen.
//!
//! The rows are cut into contiguous blocks in the order of measurement. Poses that follow each other
//! resemble each other, and so do their errors: a map that only knows its neighbours wins where single
//! rows are left out, and helps nobody. For each block the model and its maps are made from the other
//! blocks. A map is kept if the mean error of the blocks falls clearly ([`SIGMAS`], [`GAIN`]).

use rayon::prelude::*;
use serde::Serialize;

use super::fit::{ChosenFit, fit};
use super::folds::{FOLD_ROWS, predictor_with};
use super::thin::thinned;
use super::{EvaluateError, EvaluateOptions};
use crate::IdentifyError;
use crate::diagnosis::workspace;
use crate::judge::judge;
use crate::recordings::{Judge, Recordings};
use crate::residual_map::{MapInput, MapShare, ResidualMap, Samples, learn};

/// Blocks of rows that are left out in turn.
const BLOCKS: usize = 10;
/// Fewest rows: a block of fewer than six says little.
const FEWEST: usize = 60;
/// Standard errors of the mean gain that a map must win by.
const SIGMAS: f64 = 2.0;
/// Share of the error without a map that it must win by.
const GAIN: f64 = 0.02;

/// One map that was tried.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TriedMap {
    /// What it depends on.
    pub input: MapInput,
    /// Mean error of the blocks with the map, in mm.
    pub error_mm: f64,
    /// By how much it is lower than without, in mm: mean over the blocks.
    pub gain_mm: f64,
    /// Standard error of that mean, in mm.
    pub gain_sigma_mm: f64,
    /// Blocks in which the other rows spoke for a map at all.
    pub learnt: usize,
}

impl TriedMap {
    /// Whether it wins against no map.
    fn wins(&self, none_mm: f64) -> bool {
        self.gain_mm > SIGMAS * self.gain_sigma_mm && self.gain_mm > GAIN * none_mm
    }

    fn words(&self, none_mm: f64) -> String {
        if self.learnt == 0 {
            return format!("over {} the residuals speak for no map", self.input.words());
        }
        let share = 100.0 * self.gain_mm.abs() / none_mm.max(f64::MIN_POSITIVE);
        let size = if self.gain_sigma_mm > 0.0 {
            format!("{:.1} standard errors", self.gain_mm.abs() / self.gain_sigma_mm)
        } else {
            "in every block alike".to_owned()
        };
        format!(
            "over {} {:.3} mm ({share:.1} % {}, {size})",
            self.input.words(),
            self.error_mm,
            if self.gain_mm >= 0.0 { "better" } else { "worse" },
        )
    }
}

/// What was tried, and what was kept.
#[derive(Clone, Debug, Serialize)]
pub struct MapReport {
    /// Rows in the blocks.
    pub rows: usize,
    /// Blocks of rows that were left out in turn.
    pub blocks: usize,
    /// Mean error of the blocks without a map, in mm; none where no blocks could be left out.
    pub none_mm: Option<f64>,
    /// The maps that were tried.
    pub tried: Vec<TriedMap>,
    /// The map that was kept, learnt from all rows.
    pub map: Option<ResidualMap>,
    /// What the kept map does over the workspace, and its share in the error that is left.
    pub share: Option<MapShare>,
    /// All of it in words.
    pub words: String,
}

impl MapReport {
    /// Nothing could be tried.
    fn without(rows: usize, why: &str) -> Self {
        Self {
            rows,
            blocks: 0,
            none_mm: None,
            tried: Vec::new(),
            map: None,
            share: None,
            words: format!("residual map: none was kept: {why}"),
        }
    }

    /// What the kept map depends on.
    pub(super) fn input(&self) -> Option<MapInput> {
        self.map.as_ref().map(|map| map.data().input)
    }
}

/// Mean errors of one block, in mm: without a map, and with each; none where no map was learnt.
type BlockErrors = (f64, [Option<f64>; MapInput::ALL.len()]);

/// Tries the maps and keeps the best that wins.
pub(super) fn choose(
    recordings: &Recordings,
    asked: &EvaluateOptions,
    all: &ChosenFit,
) -> Result<MapReport, EvaluateError> {
    let rows = thinned(&recordings.experiment, &all.used, FOLD_ROWS);
    if rows.len() < FEWEST {
        return Ok(MapReport::without(
            rows.len(),
            &format!("{} rows cannot tell, at least {FEWEST} are needed", rows.len()),
        ));
    }
    let bounds: Vec<(usize, usize)> = (0..BLOCKS)
        .map(|b| (b * rows.len() / BLOCKS, (b + 1) * rows.len() / BLOCKS))
        .collect();
    let blocks: Result<Vec<BlockErrors>, EvaluateError> = bounds
        .par_iter()
        .map(|&(first, end)| block(recordings, asked, all, &rows, first, end))
        .collect();
    let blocks = match blocks {
        Ok(blocks) => blocks,
        Err(EvaluateError::Identify(
            error @ (IdentifyError::TooFewObservations { .. }
            | IdentifyError::NoVariety
            | IdentifyError::Singular { .. }),
        )) => {
            return Ok(MapReport::without(
                rows.len(),
                &format!("with a block left out, {error}"),
            ));
        }
        Err(error) => return Err(error),
    };
    let count = blocks.len() as f64;
    let none_mm = blocks.iter().map(|b| b.0).sum::<f64>() / count;
    let tried: Vec<TriedMap> = MapInput::ALL
        .into_iter()
        .enumerate()
        .map(|(k, input)| {
            let gains: Vec<f64> = blocks.iter().map(|b| b.0 - b.1[k].unwrap_or(b.0)).collect();
            let gain_mm = gains.iter().sum::<f64>() / count;
            let spread = gains.iter().map(|g| (g - gain_mm).powi(2)).sum::<f64>() / (count - 1.0);
            TriedMap {
                input,
                error_mm: none_mm - gain_mm,
                gain_mm,
                gain_sigma_mm: (spread / count).sqrt(),
                learnt: blocks.iter().filter(|b| b.1[k].is_some()).count(),
            }
        })
        .collect();
    let best = tried.iter().filter(|t| t.wins(none_mm));
    let best = best.max_by(|a, b| a.gain_mm.total_cmp(&b.gain_mm)).copied();
    let map = best.and_then(|best| of_fit(recordings, all, best.input));
    let over = workspace(&recordings.experiment.robot, &recordings.experiment.tool);
    let share = map.as_ref().and_then(|map| MapShare::of(map, &all.calibration, &over));
    let mut report = MapReport {
        rows: rows.len(),
        blocks: blocks.len(),
        none_mm: Some(none_mm),
        tried,
        map,
        share,
        words: String::new(),
    };
    report.words = words(&report, none_mm, recordings.closed_loop());
    Ok(report)
}

/// The map of a fit's own rows over an input.
pub(super) fn of_fit(recordings: &Recordings, fit: &ChosenFit, input: MapInput) -> Option<ResidualMap> {
    let own = fit.experiment(&recordings.experiment, &fit.used);
    learn(input, &Samples::of(&fit.calibration, &own))
}

/// Judges rows `first..end` by a fit, and by its maps, of the others.
fn block(
    recordings: &Recordings,
    asked: &EvaluateOptions,
    all: &ChosenFit,
    rows: &[usize],
    first: usize,
    end: usize,
) -> Result<BlockErrors, EvaluateError> {
    let rest: Vec<usize> = rows[..first].iter().chain(&rows[end..]).copied().collect();
    let fit = fit(&recordings.experiment, asked, &all.options, &rest, false)?;
    let own = fit.experiment(&recordings.experiment, &fit.used);
    let samples = Samples::of(&fit.calibration, &own);
    let maps = MapInput::ALL.map(|input| learn(input, &samples));
    let judges: Vec<Judge<'_>> = rows[first..end].iter().map(|&i| recordings.judge(i, i)).collect();
    let error_mm = |map: Option<&ResidualMap>| {
        let judged = judge(
            &[predictor_with(&fit, map)],
            &judges,
            &recordings.experiment.spheres,
            recordings.closed_loop(),
            "",
        );
        judged.models.first().map_or(0.0, |m| m.errors().mean_mm)
    };
    Ok((error_mm(None), maps.map(|map| map.map(|map| error_mm(Some(&map))))))
}

/// The report in words.
fn words(report: &MapReport, none_mm: f64, closed_loop: bool) -> String {
    let tried: Vec<String> = report.tried.iter().map(|t| t.words(none_mm)).collect();
    let tried = format!(
        "{} contiguous blocks of rows, each predicted by a fit and a map of the others: {none_mm:.3} mm without a map, {}",
        report.blocks,
        tried.join(", ")
    );
    let Some(map) = &report.map else {
        let why = if report.tried.iter().any(|t| t.wins(none_mm)) {
            "All rows together speak for none".to_owned()
        } else {
            format!(
                "A map must lower the error by {:.0} % and by {SIGMAS:.0} standard errors",
                100.0 * GAIN
            )
        };
        return format!("residual map: none was kept ({tried}). {why}");
    };
    let data = map.data();
    let mut text = format!(
        "residual map: one over {} was kept ({tried}). It has {} centres and corrects by at most {:.3} mm; far from its \
         centres it corrects nothing",
        data.input.words(),
        data.centres.len(),
        data.bound_m * 1e3
    );
    if let Some(share) = &report.share {
        text += &format!(
            ". Over the workspace it moves the TCP by {:.3} mm in the mean, with an uncertainty of its own of {:.3} mm \
             (1 sigma), and knows {:.0} % of it. If it describes what the model leaves out, the expected error with it is \
             {:.3} mm (95 % interval {:.3} to {:.3} mm), and {:.0} % of its square is the map's own uncertainty",
            share.correction_mm,
            share.sigma_mm,
            100.0 * share.known,
            share.expected_error_mm.mean,
            share.expected_error_mm.interval[0],
            share.expected_error_mm.interval[1],
            100.0 * share.of_map
        );
    }
    if closed_loop {
        text += ". The frames of the plate take up a part of such a displacement before the map sees it";
    }
    text += ". Only summary.json holds the map: calibrated.urdf, calibrated.toml and the compensator are without it, and so \
             are the expected error and the verdict";
    text
}
