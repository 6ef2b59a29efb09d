//! The shares of the sources against the estimator written out.

use super::*;

/// Numbers without a pattern, the same in every run.
fn numbers(rows: usize, columns: usize, seed: usize) -> DMatrix<f64> {
    DMatrix::from_fn(rows, columns, |r, c| {
        (((r * 131 + c * 71 + seed * 37) % 101) as f64 / 101.0 - 0.5) * 2.0
    })
}

// Fails if a source is charged with anything but what it adds to the error of the estimate
// (written out here with the gain of the estimator), or if the squares of the sources are
// not the square of the whole.
#[test]
fn every_source_adds_what_the_estimator_makes_of_it() {
    let (rows, all, m, s2, factor) = (30, 8, 6, 0.7, 1.3);
    let w = numbers(rows, all, 1);
    let d = DVector::from_fn(all, |c, _| 0.3 + 0.2 * c as f64);
    let discrepancy = Discrepancy {
        components: Vec::new(),
        groups: Vec::new(),
        n: w.tr_mul(&w),
        wy: DVector::zeros(all),
        w: w.clone(),
        m,
        s2,
        pose_s2: s2,
        freedom: 20.0,
        noise_m: 1e-5,
        named: 0,
        absent: None,
    };
    // A part of the noise of each row: between nothing and everything.
    let joint_shares: Vec<Matrix3<f64>> = (0..rows / 3)
        .map(|k| Matrix3::from_diagonal(&Vector3::new(0.1, 0.5, 0.9)) * (1.0 - 0.05 * k as f64))
        .collect();
    let mut share = DMatrix::zeros(rows, rows);
    for (k, own) in joint_shares.iter().enumerate() {
        share.view_mut((3 * k, 3 * k), (3, 3)).copy_from(own);
    }
    let g = numbers(12, all, 2);
    let mean = numbers(all, 1, 3).column(0) * 0.1;
    let estimate = numbers(12, 1, 5).column(0) * 0.1;
    let bias = (&g * &mean - &estimate) * factor;
    let accounts = Accounts {
        discrepancy,
        plate: vec![4, 5],
        joint_shares,
        contacts: rows / 3,
        g: g.clone(),
        rest: Vec::new(),
        estimate,
        joints: 0.1,
        sets: vec![SizeSet {
            sigmas: d.clone(),
            amplitudes: Vec::new(),
            s2,
            joint_variance: 0.4,
            mean,
        }],
        factor,
    };
    let shift = numbers(12, 1, 4) * 0.05;
    let budget = accounts.budget(&shift).unwrap();

    let square = DMatrix::from_diagonal(&d.component_mul(&d));
    let data = &w * &square * w.transpose() + DMatrix::identity(rows, rows) * s2;
    let gain = &square * w.transpose() * data.try_inverse().unwrap();
    let left = DMatrix::identity(all, all) - &gain * &w;
    let mean_square = |covariance: DMatrix<f64>| (&g * covariance * g.transpose()).trace() / 4.0;
    let of_columns = |columns: std::ops::Range<usize>| {
        let mut own = DMatrix::zeros(all, all);
        columns.for_each(|c| own[(c, c)] = square[(c, c)]);
        mean_square(&left * own * left.transpose())
    };
    let rest = DMatrix::identity(rows, rows) - &share;
    let posterior = square.clone() - &gain * &w * &square;
    let known = mean_square(posterior) + 0.04;
    let bias = (&bias - shift.column(0)).norm_squared() / 4.0;
    let expected = [
        (Source::Plate, of_columns(4..6)),
        (Source::Seating, mean_square(&gain * &rest * gain.transpose() * s2)),
        (
            Source::EncoderNoise,
            mean_square(&gain * &share * gain.transpose() * s2) + 0.04,
        ),
        (Source::OpenParameters, of_columns(0..4)),
        (
            Source::ModelDiscrepancy,
            of_columns(6..8) + known * (factor * factor - 1.0) + bias,
        ),
    ];
    assert_eq!(budget.terms.len(), expected.len(), "{budget:?}");
    for (term, (source, square)) in budget.terms.iter().zip(expected) {
        assert_eq!(term.source, source);
        assert!(
            (term.rms_mm - square.sqrt() * 1e3).abs() < 1e-9 * 1e3,
            "{term:?} {square}"
        );
    }
    let whole = known * factor * factor + bias;
    assert!(
        (budget.total_mm - whole.sqrt() * 1e3).abs() < 1e-6,
        "{budget:?} {whole}"
    );
    let squares: f64 = budget.terms.iter().map(|t| t.rms_mm.powi(2)).sum();
    assert!((squares.sqrt() / budget.total_mm - 1.0).abs() < 1e-12);
}

// Fails if points that an instrument measured have a seat, or contacts an instrument, or a
// certificate without uncertainty a term.
#[test]
fn only_sources_that_the_data_have_are_named() {
    let sources = |contacts: usize, points: usize| {
        let accounts = Accounts {
            discrepancy: Discrepancy {
                components: Vec::new(),
                groups: Vec::new(),
                n: DMatrix::zeros(0, 0),
                wy: DVector::zeros(0),
                w: DMatrix::zeros(0, 0),
                m: 0,
                s2: 1.0,
                pose_s2: 1.0,
                freedom: 1.0,
                noise_m: 1e-5,
                named: 0,
                absent: None,
            },
            plate: Vec::new(),
            joint_shares: vec![Matrix3::zeros(); contacts + points],
            contacts,
            g: DMatrix::zeros(3, 0),
            rest: Vec::new(),
            estimate: DVector::zeros(3),
            joints: 0.0,
            sets: Vec::new(),
            factor: 1.0,
        };
        let budget = accounts.stated(Squares::default(), 1.0);
        budget.terms.iter().map(|t| t.source).collect::<Vec<_>>()
    };
    assert_eq!(
        sources(0, 9)[..],
        [
            Source::Instrument,
            Source::EncoderNoise,
            Source::OpenParameters,
            Source::ModelDiscrepancy
        ]
    );
    assert!(sources(9, 0).contains(&Source::Seating) && !sources(9, 0).contains(&Source::Plate));
}
