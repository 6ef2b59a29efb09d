//! Compares repeated couplings of one visit.
//!
//! They have the same joint angles, so the errors of the nominal model cancel. What is left is the
//! seat, the noise of the encoders and the drift of the arm. In simulation two couplings lie at most
//! 0.04 mm apart, with 1 to 2 N m of dry friction 0.06 mm. A nest that seats badly in 40 % of the
//! couplings (the plant `as_measured`) has 26 % of the pairs beyond 0.15 mm, so no single coupling
//! counts there:
//!
//! - The *place* of a visit is that of two couplings that agree, or of the first one.
//! - A later coupling at the place ends the comparison. Else the arm couples again. The sphere has
//!   moved if three couplings in a row are off and two of them agree, or if eight are off.
//! - An arm that warms up drifts, and the plate with it. Where two couplings agree within what the time
//!   since the place was found explains, the place has drifted with them.
//! - A first coupling that no other has confirmed may itself be the bad seat. Where the later ones
//!   are no further from it than a bad seat, nobody can tell: they become the place.

use nalgebra::Vector3;

use spherecal_plan::{Plan, Visit};
use spherecal_shared::protocol::host::Coupled;

use super::CampaignError;
use super::places::first_visit;

/// Largest distance between couplings that agree, in m.
pub(super) const AGREE_M: f64 = 0.000_15;
/// Largest distance of two couplings that agree from their place, in m, where nothing moved: a place is no
/// better known than one coupling.
const STAYED_M: f64 = 0.000_2;
/// Couplings in a row that are off their place, if two of them agree, for a moved sphere.
const OFF: usize = 3;
/// Couplings in a row after which there is a decision in any case.
const MOST: usize = 8;
/// Fastest drift of a warming arm and its plate, in m/s: 0.4 mm an hour. Arms that warm up drift by 0.1 to
/// 0.3 mm in their first hour, at first faster.
const DRIFT_M_S: f64 = 0.4e-3 / 3600.0;
/// Largest drift, in m, however long it takes.
const DRIFT_M: f64 = 0.4e-3;
/// Largest distance of a bad seat from the good one, in m. With [`AGREE_M`], by which good ones differ, it is the
/// largest distance of a first coupling that may be a bad one: of 270 on `as_measured`, four were 0.97 to 1.01 mm off.
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
    /// The first coupling of the visit, which no other confirmed, was this far off, in m. The later ones
    /// are the place now.
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
    /// Whether two couplings agreed on it.
    confirmed: bool,
    /// Couplings since the last that agreed.
    off: Vec<Vector3<f64>>,
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
                seat.confirmed = confirm;
                seat.off.clear();
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

    /// Takes a coupling.
    ///
    /// # Errors
    /// The sphere has moved, or its couplings scatter too much.
    pub(super) fn take(&mut self, visit: &Visit, coupled: &Coupled) -> Result<SeatVerdict, CampaignError> {
        let centre = Vector3::from(coupled.centre_m);
        let elsewhere = self
            .seats
            .iter()
            .any(|seat| (seat.sphere, seat.placement) == (visit.sphere_id, visit.place) && seat.place.is_some());
        // Another visit at a sphere whose place was confirmed has one coupling.
        let confirm = self.confirm && !elsewhere;
        let seat = self.of(visit);
        let agrees = |other: &Vector3<f64>| (other - centre).norm() <= AGREE_M;
        let sound = match &seat.place {
            Some(place) => agrees(place),
            None => !confirm || seat.off.iter().any(agrees),
        };
        if sound {
            seat.confirmed = seat.place.is_some() || !seat.off.is_empty();
            if seat.place.is_none() {
                seat.place = Some(centre);
                seat.time_us = coupled.time_us;
            }
            seat.off.clear();
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
        match closest {
            Some((middle, apart_m)) if (count >= OFF && apart_m <= AGREE_M) || count >= MOST => {
                let by_m = (middle - place).norm();
                let limit_m = STAYED_M + drift_m(seat.time_us, coupled.time_us);
                let agree = apart_m <= AGREE_M;
                let seating = if agree && by_m <= limit_m {
                    SeatVerdict::Drifted(by_m)
                } else if !seat.confirmed && by_m <= BAD_SEAT_M + AGREE_M {
                    SeatVerdict::Replaced(by_m)
                } else {
                    return Err(CampaignError::Shifted {
                        sphere: visit.sphere_id,
                        by_mm: by_m * 1e3,
                        limit_mm: limit_m * 1e3,
                        couplings: count,
                    });
                };
                seat.place = Some(middle);
                seat.time_us = coupled.time_us;
                seat.confirmed = agree;
                seat.off.clear();
                Ok(seating)
            }
            _ => Ok(SeatVerdict::Off((centre - place).norm())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use spherecal_plan::Waypoint;

    fn visit(joint: f64) -> Visit {
        Visit {
            sphere_id: 1,
            place: 0,
            position_m: [0.4, 0.0, 0.3],
            over_home: true,
            approach: Waypoint {
                joints: vec![joint; 7],
                ..Waypoint::default()
            },
            approach_direction: [0.0, 0.0, -1.0],
            poses: Vec::new(),
        }
    }

    fn seats(confirm: bool) -> Seats {
        Seats::recall(&Plan::default(), &[], confirm)
    }

    fn at(x_mm: f64) -> Coupled {
        at_s(x_mm, 0.0)
    }

    fn at_s(x_mm: f64, time_s: f64) -> Coupled {
        Coupled {
            sphere: 1,
            time_us: (time_s * 1e6) as u64,
            centre_m: [0.4 + x_mm * 1e-3, 0.0, 0.3],
            shift_m: 0.0,
            test_m: 0.0,
        }
    }

    // Fails if a sphere that moved by 0.3 mm is taken at its place, if one or two couplings that are off
    // count as a moved sphere, or if the stated distance is not that of the sphere.
    #[test]
    fn three_couplings_elsewhere_are_a_moved_sphere() {
        let mut seats = seats(false);
        assert_eq!(seats.take(&visit(0.1), &at(0.0)).expect("a place"), SeatVerdict::Sound);
        assert_eq!(seats.take(&visit(0.1), &at(0.1)).expect("noise"), SeatVerdict::Sound);
        for x_mm in [0.26, 0.32] {
            let said = seats.take(&visit(0.1), &at(x_mm)).expect("undecided");
            assert!(
                matches!(said, SeatVerdict::Off(m) if (m - x_mm * 1e-3).abs() < 1e-9),
                "{said:?}"
            );
        }
        let error = seats.take(&visit(0.1), &at(0.30)).expect_err("moved").to_string();
        assert!(
            error.contains("sphere 1 is 0.31 mm") && error.contains("limit 0.20 mm"),
            "{error}"
        );
        // Another visit has other errors of the model.
        assert_eq!(seats.take(&visit(0.2), &at(3.0)).expect("a place"), SeatVerdict::Sound);
    }

    // Fails if a bad seat, or two that disagree, counts as a moved sphere although a later coupling is
    // at the place, or if couplings that never come back to it do not.
    #[test]
    fn a_bad_seat_is_not_a_moved_sphere() {
        let mut seats = seats(false);
        seats.take(&visit(0.1), &at(0.0)).expect("a place");
        for x_mm in [0.5, -0.4, 0.9, -0.8] {
            assert!(matches!(seats.take(&visit(0.1), &at(x_mm)), Ok(SeatVerdict::Off(_))));
        }
        assert_eq!(seats.take(&visit(0.1), &at(0.03)).expect("there"), SeatVerdict::Sound);
        for x_mm in [0.5, -0.4, 0.9, -0.8, 1.3, -1.2, 1.7] {
            assert!(matches!(seats.take(&visit(0.1), &at(x_mm)), Ok(SeatVerdict::Off(_))));
        }
        assert!(matches!(
            seats.take(&visit(0.1), &at(-1.6)),
            Err(CampaignError::Shifted { couplings: MOST, .. })
        ));
    }

    // Fails if a first coupling that seated badly and that no other confirmed makes a sphere count as moved, if
    // the later ones do not become the place, or if a larger distance passes.
    #[test]
    fn an_unconfirmed_first_coupling_may_be_the_bad_one() {
        for (x_mm, passes) in [(0.35, true), (0.8, true), (1.09, true), (1.2, false)] {
            let mut seats = seats(false);
            seats.take(&visit(0.1), &at(0.0)).expect("a place");
            for off in [0.0, 0.05] {
                assert!(matches!(
                    seats.take(&visit(0.1), &at(x_mm + off)),
                    Ok(SeatVerdict::Off(_))
                ));
            }
            let third = seats.take(&visit(0.1), &at(x_mm + 0.02));
            assert_eq!(matches!(third, Ok(SeatVerdict::Replaced(_))), passes, "{third:?}");
            if passes {
                assert_eq!(
                    seats.take(&visit(0.1), &at(x_mm)).expect("the place"),
                    SeatVerdict::Sound
                );
                assert!(matches!(seats.take(&visit(0.1), &at(0.0)), Ok(SeatVerdict::Off(_))));
            }
        }
    }

    // Fails if a first coupling that no other confirms becomes the place, or if one that seated badly
    // makes a sphere count as moved.
    #[test]
    fn a_place_needs_two_couplings_that_agree() {
        let mut seats = seats(true);
        assert_eq!(
            seats.take(&visit(0.1), &at(0.6)).expect("first"),
            SeatVerdict::Unconfirmed
        );
        assert!(matches!(seats.take(&visit(0.1), &at(0.0)), Ok(SeatVerdict::Off(_))));
        assert!(!seats.knows(&visit(0.1)));
        assert_eq!(seats.take(&visit(0.1), &at(0.05)).expect("second"), SeatVerdict::Sound);
        assert!(seats.knows(&visit(0.1)));
        // The next visit of the sphere has one.
        assert_eq!(seats.take(&visit(0.2), &at(2.0)).expect("a place"), SeatVerdict::Sound);
        for x_mm in [0.6, 0.4] {
            assert!(matches!(seats.take(&visit(0.1), &at(x_mm)), Ok(SeatVerdict::Off(_))));
        }
        assert_eq!(seats.take(&visit(0.1), &at(0.01)).expect("there"), SeatVerdict::Sound);
    }

    // Fails if an arm that warms up counts as a sphere that moved, if a move that no drift explains passes
    // after a time, or if a clock that began again allows more than the largest drift.
    #[test]
    fn a_place_may_drift_with_time() {
        let after = |x_mm: f64, minutes: f64| {
            let mut seats = seats(true);
            for x_mm in [0.0, 0.01] {
                seats.take(&visit(0.1), &at_s(x_mm, 3600.0)).expect("a place");
            }
            let now_s = 3600.0 + 60.0 * minutes;
            for x_mm in [x_mm, x_mm + 0.01] {
                let said = seats.take(&visit(0.1), &at_s(x_mm, now_s)).expect("undecided");
                assert!(matches!(said, SeatVerdict::Off(_)), "{said:?}");
            }
            let said = seats.take(&visit(0.1), &at_s(x_mm, now_s));
            if said.is_ok() {
                // From now on the place is there.
                let next = seats.take(&visit(0.1), &at_s(x_mm + 0.1, now_s)).expect("the place");
                assert_eq!(next, SeatVerdict::Sound);
            }
            said
        };
        assert!(matches!(after(0.24, 10.0), Ok(SeatVerdict::Drifted(_))));
        assert!(matches!(after(0.30, 10.0), Err(CampaignError::Shifted { limit_mm, .. }) if limit_mm < 0.27));
        assert!(matches!(after(0.45, 55.0), Ok(SeatVerdict::Drifted(_))));
        assert!(matches!(after(0.65, 600.0), Err(CampaignError::Shifted { .. })));
        assert!(matches!(after(0.50, -30.0), Ok(SeatVerdict::Drifted(_))));
        assert!(matches!(after(0.65, -30.0), Err(CampaignError::Shifted { .. })));
    }

    // Fails if couplings of which no two agree give a place, or are tried without end.
    #[test]
    fn couplings_that_scatter_stop_the_run() {
        let mut seats = seats(true);
        for k in 0..7 {
            seats.take(&visit(0.1), &at(0.5 * f64::from(k))).expect("undecided");
        }
        let error = seats.take(&visit(0.1), &at(3.5)).expect_err("scatter").to_string();
        assert!(error.contains("no two of 8 couplings of sphere 1 agree"), "{error}");
        assert!(error.contains("0.50 mm apart") && error.contains("clean"), "{error}");
    }

    // Fails if a continued run forgets where an earlier session found a sphere, or takes a coupling
    // that was not confirmed for its place.
    #[test]
    fn earlier_sessions_count() {
        let plan = Plan {
            spheres: vec![visit(0.1), visit(0.2)],
            ..Plan::default()
        };
        let mut seats = Seats::recall(&plan, &[at(0.7), at(0.0), at(0.02), at(2.0)], true);
        assert!(seats.knows(&visit(0.1)) && !seats.knows(&visit(0.2)));
        assert_eq!(seats.take(&visit(0.1), &at(0.1)).expect("there"), SeatVerdict::Sound);
        assert!(matches!(seats.take(&visit(0.1), &at(0.7)), Ok(SeatVerdict::Off(_))));
        assert!(!Seats::recall(&plan, &[at(0.7)], true).knows(&visit(0.1)));
        assert!(Seats::recall(&plan, &[at(0.7)], false).knows(&visit(0.1)));
    }
}
