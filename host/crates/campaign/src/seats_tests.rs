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
    assert_eq!(seats.take(&visit(0.1), &at(0.05)).expect("noise"), SeatVerdict::Sound);
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

// Fails if a coupling whose nest slips on before anything is recorded is compared with the next ones, or if one is forgotten
// of which something was recorded, or with which a second one agrees.
#[test]
fn a_nest_that_slips_on_in_the_first_turn_had_no_place() {
    let here = visit(0.1);
    let first_after = |spoil: fn(&mut Seats)| {
        let mut seats = seats(false);
        seats.take(&visit(0.1), &at(2.33)).expect("a place");
        spoil(&mut seats);
        seats.lost(&visit(0.1));
        seats
    };
    let mut slipped = first_after(|_| {});
    assert!(!slipped.knows(&here));
    for x_mm in [0.0, 0.03, 0.01] {
        assert_eq!(slipped.take(&here, &at(x_mm)).expect("a place"), SeatVerdict::Sound);
    }
    let of_worth: [fn(&mut Seats); 2] = [
        |seats| seats.recorded(&visit(0.1)),
        |seats| {
            assert_eq!(
                seats.take(&visit(0.1), &at(2.31)).expect("the place"),
                SeatVerdict::Sound
            );
        },
    ];
    for spoil in of_worth {
        let said = first_after(spoil).take(&here, &at(0.0)).expect("undecided");
        assert!(matches!(said, SeatVerdict::Off(_)), "{said:?}");
    }
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

// Fails if bad seats that agree by chance count as a moved sphere, at either place. The couplings are those of a run of
// the paper's grid on `as_measured_socket`, where nothing moved.
#[test]
fn bad_seats_that_agree_by_chance_are_no_moved_sphere() {
    let at_mm = |x: f64, y: f64, z: f64| Coupled {
        centre_m: [x, y, z].map(|mm| 0.4 + mm * 1e-3),
        ..at(0.0)
    };
    let mut seats = seats(false);
    seats.take(&visit(0.1), &at_mm(0.0, 0.0, 0.0)).expect("a place");
    let couplings = [
        (-0.039, 0.104, 0.092),
        (-0.265, 0.030, 0.029),
        (-0.204, 0.046, 0.105),
        (-0.125, 0.214, 0.110),
    ];
    for (x, y, z) in couplings {
        seats.take(&visit(0.1), &at_mm(x, y, z)).expect("nothing moved");
    }
    // Where a place was found well, bad seats that agree by chance do not end the run either.
    let mut seats = Seats::recall(&Plan::default(), &[], false);
    for x_mm in [0.0, 0.02] {
        seats.take(&visit(0.1), &at(x_mm)).expect("a place");
    }
    for x_mm in [0.4, 0.53, -0.3, 0.7] {
        assert!(matches!(seats.take(&visit(0.1), &at(x_mm)), Ok(SeatVerdict::Off(_))));
    }
    assert_eq!(seats.take(&visit(0.1), &at(0.01)).expect("there"), SeatVerdict::Sound);
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
