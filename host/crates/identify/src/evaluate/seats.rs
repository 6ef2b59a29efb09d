//! The causes that the residuals name, and seats of their own for the rows in which the nest sat elsewhere.
//!
//! A nest that is not fully seated, or that finds another seat while it turns, displaces the sphere in the nest for
//! dozens of rows: too many for robust weights. Where the residuals name such a run of rows, it gets a seat of
//! its own, three parameters in the flange frame, and all is fitted again. So does the rest of that coupling:
//! what kept the nest from its seat once is still there. The rows still tell of the arm, but no longer of the
//! place of their sphere. A seat is a nuisance, so the result is qualified and not refused.

use std::borrow::Cow;

use nalgebra::Vector3;

use super::fit::{ChosenFit, fit};
use super::thin::thinned;
use super::{EvaluateOptions, Recordings};
use crate::course::Course;
use crate::diagnosis::{Alternative, Diagnosis, Finding, diagnose, workspace};

/// Most rows whose residuals are searched for causes: the search takes time and memory in
/// proportion to the rows.
const DIAGNOSED: usize = 600;
/// Largest displacement of a seat, in mm. Farther off, the sphere is hardly in the nest: its rim is a few
/// millimetres high.
const LARGEST_MM: f64 = 1.5;
/// Share of the rows that may have seats of their own: the others say what the usual seat is.
const MOST: f64 = 0.7;
/// Most fits with further seats.
const ROUNDS: usize = 8;
/// Fewest rows of a seat that nothing but its coupling speaks for.
const FEWEST: usize = 3;

/// Rows that have a seat of their own in the fit.
#[derive(Clone, Debug, PartialEq)]
pub struct OwnSeat {
    /// Its number, from 1; the parameters are `seat<number>_x`, `_y` and `_z`.
    pub number: u32,
    /// The rows of the recordings.
    pub rows: Vec<usize>,
    /// Sphere minus TCP in the flange frame, in mm.
    pub offset_mm: [f64; 3],
    /// Standard deviation of its length, in mm.
    pub sigma_mm: f64,
    /// As many standard deviations of one normal variable as the residuals named it by; none where its coupling
    /// speaks for it.
    pub sigmas: Option<f64>,
    /// Other causes that explain the same data.
    pub or: Vec<String>,
}

/// A fit with what its residuals tell.
pub(super) struct Seated<'a> {
    /// The recordings, where rows may have seats of their own.
    pub(super) recordings: Cow<'a, Recordings>,
    pub(super) fit: ChosenFit,
    pub(super) diagnosis: Option<Diagnosis>,
    pub(super) seats: Vec<OwnSeat>,
    pub(super) notes: Vec<String>,
}

/// A seat that was named: its number, and the finding.
type Named = (u32, Finding);

/// Searches the residuals of a fit for causes, gives rows that sat elsewhere a seat of their own and fits again,
/// until no further one is found.
pub(super) fn find<'a>(
    recordings: &'a Recordings,
    options: &EvaluateOptions,
    train: &[usize],
    first: ChosenFit,
) -> Seated<'a> {
    let mut found = Seated {
        recordings: Cow::Borrowed(recordings),
        fit: first,
        diagnosis: None,
        seats: Vec::new(),
        notes: Vec::new(),
    };
    if !options.diagnose {
        return found;
    }
    let mut named: Vec<Named> = Vec::new();
    for round in 0..=ROUNDS {
        found.notes.clear();
        found.diagnosis = diagnosed(&found.recordings, &found.fit, &mut found.notes);
        let Some(diagnosis) = found.diagnosis.as_ref().filter(|_| round < ROUNDS) else {
            break;
        };
        let Some((own, new)) = with_seats(&found.recordings, &found.fit, diagnosis) else {
            break;
        };
        let Ok(again) = fit(&own.experiment, options, &found.fit.options, train, false) else {
            break;
        };
        found.recordings = Cow::Owned(own);
        found.fit = again;
        named.extend(new);
    }
    found.seats = own_seats(&found.recordings, &found.fit, &named);
    found
}

/// The recordings with seats of their own for the rows of each finding that is one and for the rest of its
/// coupling, and these findings; none where there is none.
fn with_seats(recordings: &Recordings, fit: &ChosenFit, diagnosis: &Diagnosis) -> Option<(Recordings, Vec<Named>)> {
    let course = match &recordings.course {
        Some(course) => course.clone(),
        None => Course::without_moves(&recordings.experiment),
    };
    let coupling = |row: usize| course.coupling.get(row).copied();
    let mut own: Option<Recordings> = None;
    let mut named = Vec::new();
    for finding in &diagnosis.findings {
        if !matches!(finding.alternative, Alternative::Reseat { .. }) || finding.size > LARGEST_MM {
            continue;
        }
        let (Some(&first), Some(&last)) = (finding.rows.first(), finding.rows.last()) else {
            continue;
        };
        // Of thinned rows the finding names some; those between them sat there, too.
        let between = fit.used.get(first..=last).unwrap_or_default();
        let (Some(&from), Some(&to)) = (between.first(), between.last()) else {
            continue;
        };
        let own_coupling = |row: &&usize| coupling(**row) == coupling(from);
        let rows: Vec<usize> = between.iter().filter(own_coupling).copied().collect();
        let now = own.as_ref().unwrap_or(recordings);
        let seated = |row: &usize| now.experiment.observations.get(*row).is_some_and(|o| o.seat.is_some());
        let rest = |side: &dyn Fn(usize) -> bool| -> Vec<usize> {
            let free = |row: &&usize| side(**row) && own_coupling(row) && !seated(row);
            let part: Vec<usize> = fit.used.iter().filter(free).copied().collect();
            if part.len() < FEWEST { Vec::new() } else { part }
        };
        let (before, after) = (rest(&|row| row < from), rest(&|row| row > to));
        let parts = [rows, before, after];
        let taken = |row: &&usize| seated(row) || parts.iter().any(|part| part.contains(row));
        if fit.used.iter().filter(taken).count() as f64 > MOST * fit.used.len() as f64 {
            continue;
        }
        let observations = &mut own.get_or_insert_with(|| recordings.clone()).experiment.observations;
        let first = 1 + observations.iter().filter_map(|o| o.seat).max().unwrap_or(0);
        for (number, part) in (first..).zip(parts.iter().filter(|part| !part.is_empty())) {
            for &row in part {
                if let Some(observation) = observations.get_mut(row) {
                    observation.seat = Some(number);
                }
            }
        }
        named.push((first, finding.clone()));
    }
    own.filter(|_| !named.is_empty()).map(|own| (own, named))
}

/// The seats that rows have for themselves, as the fit found them.
fn own_seats(recordings: &Recordings, fit: &ChosenFit, named: &[Named]) -> Vec<OwnSeat> {
    let seat = |row: &usize| recordings.experiment.observations.get(*row).and_then(|o| o.seat);
    let numbers: std::collections::BTreeSet<u32> = fit.used.iter().filter_map(seat).collect();
    let own = |number: u32| {
        let of = |axis: &str| {
            let name = format!("seat{number}_{axis}");
            let parameter = fit.calibration.parameters.iter().find(|p| p.name == name);
            parameter.map_or((0.0, 0.0), |p| (p.estimate * 1e3, p.sigma * 1e3))
        };
        let (x, y, z) = (of("x"), of("y"), of("z"));
        let offset = Vector3::new(x.0, y.0, z.0);
        let along = offset.try_normalize(0.0).unwrap_or_default();
        let finding = named.iter().find(|(n, _)| *n == number).map(|(_, finding)| finding);
        OwnSeat {
            number,
            rows: fit
                .used
                .iter()
                .filter(|row| seat(row) == Some(number))
                .copied()
                .collect(),
            offset_mm: offset.into(),
            sigma_mm: along.component_mul(&Vector3::new(x.1, y.1, z.1)).norm(),
            sigmas: finding.map(|f| f.sigmas),
            or: finding.map(|f| f.or.clone()).unwrap_or_default(),
        }
    };
    let mut seats: Vec<OwnSeat> = numbers.into_iter().map(own).collect();
    seats.sort_by_key(|seat| seat.rows.first().copied());
    seats
}

/// What the residuals of the rows that the fit used tell, of at most [`DIAGNOSED`] of
/// them; none, with a note, where the equations have no solution.
fn diagnosed(recordings: &Recordings, fit: &ChosenFit, notes: &mut Vec<String>) -> Option<Diagnosis> {
    let rows = thinned(&recordings.experiment, &fit.used, DIAGNOSED);
    let experiment = fit.experiment(&recordings.experiment, &rows);
    let over = workspace(&experiment.robot, &experiment.tool);
    // Before rows were left out: the last move of a row is that from the row before it.
    let whole = match &recordings.course {
        Some(course) => course.clone(),
        None => Course::without_moves(&recordings.experiment),
    }
    .with_moves_of(&recordings.experiment.observations, &rows)
    .with_places(
        recordings.samples.iter().map(|sample| sample.place).collect(),
        recordings.places.names().map(str::to_owned).collect(),
    )
    .of_rows(&rows);
    let course = match &recordings.course {
        Some(_) => whole,
        None => Course {
            moves: whole.moves,
            place: whole.place,
            place_names: whole.place_names,
            ..Course::in_order(&experiment)
        },
    };
    match diagnose(&experiment, &fit.options, &course, &over) {
        Ok(mut diagnosis) => {
            if rows.len() < fit.used.len() {
                diagnosis.renumber(&fit.used, &rows);
                notes.push(format!(
                    "the causes in the residuals and the expected error are from {} of {} rows, spread evenly",
                    rows.len(),
                    fit.used.len()
                ));
            }
            Some(diagnosis)
        }
        Err(error) => {
            notes.push(format!("the residuals could not be tested: {error}"));
            None
        }
    }
}
