//! Bad data are refused with row, field, value and remedy; sparse data are served.

use proptest::prelude::*;
use spherecal::identify::{
    DataError, Experiment, IdentifyError, Method, Model, Options, Override, Pose, Set, Split, Target, holdout, identify,
};
use spherecal_tests::worlds::World;

fn few(count: usize) -> Experiment {
    let mut e = World::load("world_W1_seed0").spheres();
    let step = e.observations.len() / count;
    e.observations = e.observations.into_iter().step_by(step).take(count).collect();
    e
}

fn refusal(e: &Experiment) -> IdentifyError {
    identify(e, &Options::default()).expect_err("bad data")
}

#[test]
fn bad_rows_are_named() {
    let mut e = few(30);
    e.observations[4].q[2] = f64::NAN;
    assert!(matches!(refusal(&e), IdentifyError::Data(DataError::NotFinite { row: 5, field, .. }) if field == "q3"));
    let mut e = few(30);
    e.observations[4].q[2] = 90.0;
    assert!(matches!(
        refusal(&e),
        IdentifyError::Data(DataError::OutOfRange { row: 5, .. })
    ));
    let mut e = few(30);
    e.observations[7].q.pop();
    assert!(matches!(
        refusal(&e),
        IdentifyError::Data(DataError::JointCount {
            row: 8,
            found: 6,
            expected: 7
        })
    ));
    let mut e = few(30);
    e.observations[0].target = Target::Sphere { sphere: 9, place: 0 };
    let text = refusal(&e).to_string();
    assert!(
        text.contains("row 1") && text.contains("sphere 9") && text.contains("0, 1, 2"),
        "{text}"
    );
    let mut e = few(30);
    e.spheres[1].sigma_m = -1.0;
    assert!(matches!(
        refusal(&e),
        IdentifyError::Data(DataError::Plate { sphere: 1, .. })
    ));
    assert!(matches!(
        refusal(&few(2)),
        IdentifyError::TooFewObservations { found: 2, .. }
    ));
    let mut e = few(30);
    let q = e.observations[0].q.clone();
    e.observations.iter_mut().for_each(|o| o.q.clone_from(&q));
    assert_eq!(refusal(&e), IdentifyError::NoVariety);
    let mut e = few(30);
    e.observations.iter_mut().for_each(|o| o.set = Set::Validate);
    assert!(matches!(
        refusal(&e),
        IdentifyError::TooFewObservations { found: 0, .. }
    ));
}

#[test]
fn bad_options_are_named() {
    let e = few(30);
    let mut options = Options::default();
    options.parameters.0.insert(
        "alpha9".into(),
        Override {
            free: Some(false),
            ..Override::default()
        },
    );
    assert!(matches!(identify(&e, &options), Err(IdentifyError::UnknownParameter { name, .. }) if name == "alpha9"));
    let mut options = Options::default();
    options.parameters.0.insert(
        "alpha".into(),
        Override {
            prior_sigma: Some(-1.0),
            ..Override::default()
        },
    );
    assert!(matches!(identify(&e, &options), Err(IdentifyError::Option { .. })));
    let mut options = Options::default();
    options.noise.joint_rad = 0.0;
    assert!(matches!(identify(&e, &options), Err(IdentifyError::Option { .. })));
    assert!(
        holdout(&few(30), &Options::default(), &Split::Place).is_err(),
        "one place cannot be left out"
    );
}

/// Fails if the user's table does not reach the estimator: a fixed parameter
/// must stay, a free one with a tiny prior too.
#[test]
fn the_user_s_table_rules() {
    let e = few(60);
    let text = r#"
        [parameters.alpha3]
        free = false
        [parameters.tool]
        prior_sigma = 1e-9
        [parameters.harmonic]
        prior_sigma = 1e-12
    "#;
    #[derive(serde::Deserialize)]
    struct File {
        parameters: spherecal::identify::Overrides,
    }
    let file: File = toml::from_str(text).expect("TOML");
    let options = Options {
        parameters: file.parameters,
        ..Options::default()
    };
    let c = identify(&e, &options).expect("good data");
    let of = |name: &str| {
        c.parameters
            .iter()
            .find(|p| p.name == name)
            .expect("a parameter")
            .clone()
    };
    assert!(!of("alpha3").free && of("alpha3").estimate == of("alpha3").nominal && of("alpha3").sigma == 0.0);
    assert!((of("tool_x").estimate - 0.05).abs() < 1e-7 && !of("tool_x").moved);
    assert!(c.harmonics_rad.iter().flatten().flatten().all(|h| h.abs() < 1e-9));
    assert!(of("alpha2").moved);
}

/// Few poses, one sphere, no spheres: the priors carry what the data do not.
#[test]
fn sparse_data_are_served() {
    for count in [3, 6, 12, 30] {
        for model in Model::ALL {
            let c = identify(
                &few(count),
                &Options {
                    model,
                    ..Options::default()
                },
            )
            .expect("few data");
            assert!(c.residual.rms_mm.is_finite() && c.noise.joint_rad.is_finite());
            let p = c.tcp_covariance(&[0.1; 7]);
            assert!(p.symmetric_eigenvalues().min() > 0.0);
        }
    }
    let world = World::load("world_W1_seed0");
    let laser = identify(&world.laser(), &Options::default()).expect("points");
    let [_, v2] = world.validate(|q| laser.tcp_m(q, None));
    assert!(v2.mean < 0.1, "structured laser {}", v2.mean);
}

/// A robot that starts in another frame is the same robot: fails if a result
/// depends on where the plate or the tracker stands.
#[test]
fn results_do_not_depend_on_the_reference_frame() {
    let world = World::load("world_W1_seed0");
    let options = Options {
        method: Method::Geometry,
        ..Options::default()
    };
    let here = identify(&world.laser(), &options).expect("points");
    let mut moved = world.laser();
    let turn = Pose {
        rotation: nalgebra::Rotation3::new(nalgebra::Vector3::new(0.3, -1.0, 2.0)).into_inner(),
        position: nalgebra::Vector3::new(3.0, -2.0, 0.5),
    };
    for o in &mut moved.observations {
        if let Target::Point(p) = &mut o.target {
            *p = turn.point(&nalgebra::Vector3::from(*p)).into();
        }
    }
    let there = identify(&moved, &options).expect("points");
    for q in &world.valid_q {
        let difference = turn.point(&here.tcp_world_m(q, None)) - there.tcp_world_m(q, None);
        assert!(difference.norm() < 1e-7, "{}", difference.norm());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    /// Any finite numbers give a result or a typed refusal, never a panic.
    #[test]
    fn nothing_panics(
        seed in prop::collection::vec(prop::array::uniform7(-3.0f64..3.0), 3..12),
        tool in prop::array::uniform3(-0.3f64..0.3),
        spheres in 0u32..3,
    ) {
        let mut e = few(12);
        e.tool.tcp_m = tool;
        e.observations.truncate(seed.len());
        for (o, q) in e.observations.iter_mut().zip(&seed) {
            o.q = q.to_vec();
            if let Target::Sphere { sphere, .. } = &mut o.target {
                *sphere = (*sphere).min(spheres);
            }
        }
        for method in [Method::Full, Method::Geometry, Method::GaussNewton, Method::Lm] {
            let _ = identify(&e, &Options { method, ..Options::default() });
        }
    }
}

/// Fails if a sphere that the fit never touched is judged where two others cannot
/// say it is: the plate may turn about the line through them.
#[test]
fn a_sphere_that_was_never_touched_is_judged_by_its_scatter() {
    let found = holdout(&few(30), &Options::default(), &Split::Sphere).expect("good data");
    assert!(found.error_mm.is_none(), "{found:?}");
    assert!(found.figure_mm().is_some_and(|mm| mm > 0.0 && mm < 2.0), "{found:?}");
}
