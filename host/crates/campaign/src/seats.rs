//! Compares repeated couplings of one visit.
//!
//! They have the same joint angles, so the errors of the nominal model cancel. What is left is the
//! seat, the noise of the encoders and the drift of the arm. In simulation two couplings lie at most
//! 0.04 mm apart, with 1 to 2 N m of dry friction 0.06 mm. A nest that seats badly in 40 % of the
//! couplings (the plant `as_measured_socket`) has 26 % of the pairs beyond 0.15 mm, so no single coupling
//! counts there:
//!
//! - The *place* of a visit is that of two couplings that agree, or of the first one.
//! - A later coupling at the place ends the comparison. Else the arm couples again.
//! - Bad seats agree by chance, too: on `as_measured_socket` two of three within 0.15 mm in one case of two. Only good seats lie
//!   within 0.06 mm of each other. So a sphere has moved if three couplings in a row lie as near to each other and off
//!   the place, and two lay as near at the place; if they are farther off than a bad seat; or if eight are off and do
//!   not agree.
//! - An arm that warms up drifts, and the plate with it. Where two couplings agree within what the time
//!   since the place was found explains, the place has drifted with them.
//! - A nest that friction held beside its seat slips on in the first turn. Such a coupling is no place, unless something was
//!   recorded of it.
//! - Where the couplings scatter so much that they do not tell a moved sphere from bad seats, the later ones become the
//!   place. The residuals show what it was: the fit gives such recordings a seat of their own.

use nalgebra::Vector3;

use spherecal_plan::{Plan, Visit};
use spherecal_shared::protocol::host::Coupled;

use super::CampaignError;
use super::places::first_visit;

/// Largest distance between couplings that agree, in m.
pub(super) const AGREE_M: f64 = 0.000_15;
/// Largest distance between couplings that seated well, in m: 0.04 mm, with friction of 1 to 2 N m 0.06 mm in simulation.
const GOOD_M: f64 = 0.000_06;
/// Largest distance of two couplings that agree from their place, in m, where nothing moved: a place is no
/// better known than one coupling.
const STAYED_M: f64 = 0.000_2;
/// Couplings in a row that are off their place and agree, for a moved sphere.
const OFF: usize = 3;
/// Couplings in a row after which there is a decision in any case.
const MOST: usize = 8;
/// Fastest drift of a warming arm and its plate, in m/s: 0.4 mm an hour. Arms that warm up drift by 0.1 to
/// 0.3 mm in their first hour, at first faster.
const DRIFT_M_S: f64 = 0.4e-3 / 3600.0;
/// Largest drift, in m, however long it takes.
const DRIFT_M: f64 = 0.4e-3;
/// Largest distance of a bad seat from the good one, in m. With [`AGREE_M`], by which good ones differ, it is the
/// largest distance of a first coupling that may be a bad one: of 270 on `as_measured_socket`, four were 0.97 to 1.01 mm off.
const BAD_SEAT_M: f64 = 0.001;

/// What a coupling says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum SeatVerdict {
    /// The nest is where it should be.
    Sound,
    /// The first coupling of a visit: another one must confirm it.
    Unconfirmed,
    /// This far from the earlier couplings, in m: another one must decide.
    Off(f64),
    /// The couplings were this far off their place, in m, and tell no moved sphere from bad seats. They are the place now.
    Replaced(f64),
    /// The place drifted by this much, in m, as it may while arm and cell warm up.
    Drifted(f64),
}

/// The couplings of one visit.
struct Seat {
    sphere: u32,
    placement: u32,
    /// Joint angles of the approach, in rad.
    joints: Vec<f64>,
    /// Where the sphere was found, in F0, in m, once that is known.
    place: Option<Vector3<f64>>,
    /// Controller's time of the coupling that gave the place, in µs.
    time_us: u64,
    /// Whether two couplings there seated well.
    confirmed: bool,
    /// Whether something was recorded there.
    counts: bool,
    there: Vec<Vector3<f64>>,
    /// Couplings since the last that agreed.
    off: Vec<Vector3<f64>>,
}

impl Seat {
    /// Takes one or more couplings of its place. Two of them within `near_m` (m) confirm it.
    fn confirm(&mut self, at_the_place: &[Vector3<f64>], near_m: f64) {
        self.there.extend_from_slice(at_the_place);
        self.confirmed |= largest_cluster(&self.there, near_m) >= 2;
    }
}

/// How many of some points lie within `near_m` (m) of one of them, itself included.
fn largest_cluster(points: &[Vector3<f64>], near_m: f64) -> usize {
    let near = |a: &Vector3<f64>| points.iter().filter(|b| (a - *b).norm() <= near_m).count();
    points.iter().map(near).max().unwrap_or(0)
}

/// Where the couplings of this run's visits were.
pub(super) struct Seats {
    seats: Vec<Seat>,
    /// Whether the place of a sphere needs two couplings that agree.
    confirm: bool,
}

/// The two of some points that are nearest to each other: their middle and their distance, in m.
fn nearest(points: &[Vector3<f64>]) -> Option<(Vector3<f64>, f64)> {
    let pairs = points
        .iter()
        .enumerate()
        .flat_map(|(k, a)| points.iter().take(k).map(move |b| ((a + b) * 0.5, (a - b).norm())));
    pairs.min_by(|a, b| a.1.total_cmp(&b.1))
}

/// How far a place may drift between two times of the controller, in m. A clock that began again after the
/// first does not tell how long ago that was.
fn drift_m(since_us: u64, now_us: u64) -> f64 {
    let elapsed_s = now_us
        .checked_sub(since_us)
        .map_or(f64::INFINITY, |us| us as f64 * 1e-6);
    (DRIFT_M_S * elapsed_s).min(DRIFT_M)
}

impl Seats {
    /// Recalls what earlier sessions of the run found, in that order. Only the first visit of a sphere
    /// is recalled: which later visit a coupling belonged to is not stored.
    pub(super) fn recall(plan: &Plan, seated: &[Coupled], confirm: bool) -> Self {
        let mut seats = Self {
            seats: Vec::new(),
            confirm,
        };
        for coupled in seated {
            let Some(visit) = first_visit(plan, coupled) else {
                continue;
            };
            let seat = seats.of(visit);
            if seat.place.is_some() {
                continue;
            }
            let centre = Vector3::from(coupled.centre_m);
            if !confirm || seat.off.iter().any(|other| (other - centre).norm() <= AGREE_M) {
                seat.place = Some(centre);
                seat.time_us = coupled.time_us;
                // Whether something was recorded of it is not known here.
                seat.counts = true;
                let mut there = std::mem::take(&mut seat.off);
                there.push(centre);
                seat.confirm(&there, AGREE_M);
            } else {
                seat.off.push(centre);
            }
        }
        for seat in &mut seats.seats {
            seat.off.clear();
        }
        seats
    }

    fn of(&mut self, visit: &Visit) -> &mut Seat {
        let same = |seat: &Seat| {
            (seat.sphere, seat.placement) == (visit.sphere_id, visit.place) && seat.joints == visit.approach.joints
        };
        let index = self.seats.iter().position(same).unwrap_or(self.seats.len());
        if index == self.seats.len() {
            self.seats.push(Seat {
                sphere: visit.sphere_id,
                placement: visit.place,
                joints: visit.approach.joints.clone(),
                place: None,
                time_us: 0,
                confirmed: false,
                counts: false,
                there: Vec::new(),
                off: Vec::new(),
            });
        }
        &mut self.seats[index]
    }

    /// Whether the place of a visit is known.
    pub(super) fn knows(&self, visit: &Visit) -> bool {
        self.seats.iter().any(|seat| {
            (seat.sphere, seat.placement) == (visit.sphere_id, visit.place)
                && seat.joints == visit.approach.joints
                && seat.place.is_some()
        })
    }

    /// Notes that something was recorded at the place of a visit.
    pub(super) fn recorded(&mut self, visit: &Visit) {
        self.of(visit).counts = true;
    }

    /// The nest left its sphere in a turn, before anything was recorded of its coupling. If that gave the place, it had not
    /// seated, and nothing depends on it.
    pub(super) fn lost(&mut self, visit: &Visit) {
        let seat = self.of(visit);
        if !seat.counts && seat.there.len() == 1 {
            seat.place = None;
            seat.there.clear();
        }
    }

    /// Takes a coupling.
    /// Errors: the sphere has moved, or its couplings scatter too much.
    pub(super) fn take(&mut self, visit: &Visit, coupled: &Coupled) -> Result<SeatVerdict, CampaignError> {
        let centre = Vector3::from(coupled.centre_m);
        let elsewhere = self
            .seats
            .iter()
            .any(|seat| (seat.sphere, seat.placement) == (visit.sphere_id, visit.place) && seat.place.is_some());
        // Another visit at a sphere whose place was confirmed has one coupling.
        let confirm = self.confirm && !elsewhere;
        // Where the operator asks for confirmed places, two that agree are one, and a doubt stops the run.
        let strict = self.confirm;
        let near_m = if strict { AGREE_M } else { GOOD_M };
        let seat = self.of(visit);
        let agrees = |other: &Vector3<f64>| (other - centre).norm() <= AGREE_M;
        let sound = match &seat.place {
            Some(place) => agrees(place),
            None => !confirm || seat.off.iter().any(agrees),
        };
        if sound {
            if seat.place.is_none() {
                seat.place = Some(centre);
                seat.time_us = coupled.time_us;
                let others = std::mem::take(&mut seat.off);
                seat.confirm(&others, near_m);
            }
            seat.off.clear();
            seat.confirm(&[centre], near_m);
            return Ok(SeatVerdict::Sound);
        }
        seat.off.push(centre);
        let (count, closest) = (seat.off.len(), nearest(&seat.off));
        let Some(place) = seat.place else {
            return match closest {
                Some((_, apart_m)) if count >= MOST => Err(CampaignError::Scattered {
                    sphere: visit.sphere_id,
                    couplings: count,
                    apart_mm: apart_m * 1e3,
                    limit_mm: AGREE_M * 1e3,
                }),
                Some((_, apart_m)) => Ok(SeatVerdict::Off(apart_m)),
                None => Ok(SeatVerdict::Unconfirmed),
            };
        };
        let Some((middle, apart_m)) = closest.filter(|_| count >= OFF) else {
            return Ok(SeatVerdict::Off((centre - place).norm()));
        };
        let by_m = (middle - place).norm();
        let limit_m = STAYED_M + drift_m(seat.time_us, coupled.time_us);
        let agree = apart_m <= AGREE_M;
        let far = by_m > BAD_SEAT_M + AGREE_M;
        let surely = seat.confirmed && largest_cluster(&seat.off, GOOD_M) >= OFF;
        let seating = if agree && by_m <= limit_m {
            SeatVerdict::Drifted(by_m)
        } else if agree && !far && (!seat.confirmed || (count >= MOST && !surely && !strict)) {
            SeatVerdict::Replaced(by_m)
        } else if (agree && (far || surely)) || count >= MOST {
            return Err(CampaignError::Shifted {
                sphere: visit.sphere_id,
                by_mm: by_m * 1e3,
                limit_mm: limit_m * 1e3,
                couplings: count,
            });
        } else {
            return Ok(SeatVerdict::Off((centre - place).norm()));
        };
        seat.place = Some(middle);
        seat.time_us = coupled.time_us;
        seat.confirmed = false;
        seat.there.clear();
        let there = std::mem::take(&mut seat.off);
        seat.confirm(&there, near_m);
        Ok(seating)
    }
}

#[cfg(test)]
#[path = "seats_tests.rs"]
mod tests;
