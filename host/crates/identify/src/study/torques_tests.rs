use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use spherecal_shared::robot::{iiwa7, iiwa7_tool};

use super::*;
use crate::{Target, halton_configurations};

const OFFSETS: [f64; 7] = [0.3, -0.5, 0.2, 0.4, -0.1, 0.05, 0.1];

/// Rows with torques of an arm with a load of `mass_kg`, in `direction`, with offsets and noise (N m).
fn rows(mass_kg: f64, direction: f64, noise: f64, seed: u64) -> Vec<Observation> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let real = Nominal::new(&iiwa7(), &tool_with(&iiwa7_tool(), mass_kg, [0.03, -0.01, 0.06]));
    let row = |q: Vec<f64>| {
        let tau = holding(&real, &q);
        let tau = tau.iter().zip(OFFSETS);
        let tau = tau.map(|(tau, offset)| direction * (tau + offset + noise * rng.random_range(-1.0..1.0)));
        Observation {
            seat: None,
            tau: Some(tau.collect()),
            q,
            target: Target::Point([0.0; 3]),
            set: Set::Calibrate,
        }
    };
    halton_configurations(&iiwa7(), 80).into_iter().map(row).collect()
}

// Fails if the sign is not told, if load or offsets are not those of the arm, if the stated sigma of the load is
// not that of its errors, or if the description's own load is taken for the truth.
#[test]
fn sign_load_and_offsets_are_told() {
    for (seed, direction, mass_kg) in [(1, 1.0, 2.4), (2, -1.0, 2.4), (3, 1.0, 0.0), (4, -1.0, 0.6)] {
        let mut observations = rows(mass_kg, direction, 0.3, seed);
        let found = torques(&iiwa7(), &iiwa7_tool(), &observations).expect("rows with torques");
        assert_eq!(found.sign, Some(direction));
        let load = found.load.expect("a load");
        assert!(load.sigma_kg < 0.1, "{load:?}");
        assert!(
            (load.mass_kg - mass_kg).abs() < 4.0 * load.sigma_kg,
            "{load:?} of {mass_kg}"
        );
        assert!(load.differs(mass_kg + 0.8) && !load.differs(mass_kg));
        if mass_kg > 1.0 {
            assert!((load.com_m - Vector3::new(0.03, -0.01, 0.06)).norm() < 0.02, "{load:?}");
        }
        for (found, offset) in found.offsets_nm.iter().zip(OFFSETS) {
            assert!((found - offset).abs() < 0.2, "{found} of {offset}");
        }
        found.turn(&mut observations);
        let turned = torques(&iiwa7(), &iiwa7_tool(), &observations).expect("rows with torques");
        assert_eq!(turned.sign, Some(1.0));
        assert!((turned.load.expect("a load").mass_kg - load.mass_kg).abs() < 1e-9);
    }
}

// Fails if columns that have nothing to do with gravity get a sign or a load, or if rows without torques get anything.
#[test]
fn what_does_not_follow_gravity_tells_nothing() {
    let mut observations = rows(1.0, 1.0, 0.1, 5);
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    for tau in observations.iter_mut().filter_map(|o| o.tau.as_mut()).flatten() {
        *tau = rng.random_range(-20.0..20.0);
    }
    let found = torques(&iiwa7(), &iiwa7_tool(), &observations).expect("rows with torques");
    assert_eq!((found.sign, found.load), (None, None));
    assert!(found.words().contains("cannot be told"));
    for observation in &mut observations {
        observation.tau = None;
    }
    assert_eq!(torques(&iiwa7(), &iiwa7_tool(), &observations), None);
}

// Fails if a load is told of a robot whose links have no masses: the torques are those of unknown links.
#[test]
fn a_robot_without_masses_has_no_load() {
    let mut robot = iiwa7();
    for joint in &mut robot.joints {
        joint.link = Inertia::default();
    }
    let found = torques(&robot, &iiwa7_tool(), &rows(2.0, -1.0, 0.1, 7)).expect("rows with torques");
    assert_eq!((found.sign, found.load), (Some(-1.0), None));
}

/// A table of points of an arm that yields, with 1.2 kg at the flange; torques in `direction`, or none.
fn table(direction: Option<f64>) -> String {
    // The torques' noise must not change the angles'.
    let (mut rng, mut sensor) = (ChaCha8Rng::seed_from_u64(8), ChaCha8Rng::seed_from_u64(9));
    let loaded = tool_with(&iiwa7_tool(), 1.2, [0.02, 0.0, 0.05]);
    let nominal = Nominal::new(&iiwa7(), &loaded);
    let mut real = iiwa7();
    for (k, joint) in real.joints.iter_mut().enumerate().skip(1) {
        joint.mdh.d += 2e-4 * (k as f64 - 3.0);
        joint.mdh.theta += 3e-4 * (k as f64 - 2.0);
    }
    let chain = spherecal_model::Chain::unchecked(&real, &loaded);
    let columns = |name: &str| (1..=7).map(|j| format!("{name}{j}")).collect::<Vec<_>>().join(",");
    let mut text = format!("{},x_m,y_m,z_m", columns("q"));
    if direction.is_some() {
        text += &format!(",{}", columns("tau"));
    }
    for q in halton_configurations(&iiwa7(), 120) {
        let tau = holding(&nominal, &q);
        let stands: Vec<f64> = q
            .iter()
            .zip(&tau)
            .map(|(q, tau)| q - 4e-5 * tau + 5e-5 * rng.random_range(-1.0..1.0))
            .collect();
        let p = chain.pose(&stands).position;
        let mut cells: Vec<f64> = q;
        cells.extend([p.x, p.y, p.z]);
        if let Some(direction) = direction {
            let sensed = tau.iter().zip(OFFSETS);
            cells.extend(sensed.map(|(t, o)| direction * (t + o + 0.2 * sensor.random_range(-1.0..1.0))));
        }
        let cells: Vec<String> = cells.iter().map(f64::to_string).collect();
        text += &format!("\n{}", cells.join(","));
    }
    text
}

// Fails if the result with torque columns of either sign, with the load stated or taken from them, differs by more than
// 3 % from that with the load stated and no torques, or if sign and load are not reported.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_torques_of_either_sign_give_one_result() {
    let folder = tempfile::tempdir().unwrap();
    let found = |name: &str, direction: Option<f64>, payload_kg: Option<f64>| {
        let data = folder.path().join(name);
        std::fs::write(&data, table(direction)).unwrap();
        let request = crate::study::StudyRequest {
            robot: "iiwa7".to_owned(),
            data,
            tool_mm: Some([50.0, 0.0, 100.0]),
            payload_kg,
            payload_com_mm: payload_kg.map(|_| [20.0, 0.0, 50.0]),
            ..Default::default()
        };
        let study = crate::study::study(&request, &mut |_| {}).unwrap();
        let judged = study.evaluation.judged.unwrap();
        let error = judged.model("calibrated").unwrap().errors().mean_mm;
        (error, study.notes.join("; "))
    };
    let (stated, _) = found("none.csv", None, Some(1.2));
    for (name, direction, payload_kg) in [
        ("holding.csv", 1.0, Some(1.2)),
        ("gravity.csv", -1.0, Some(1.2)),
        ("holding_untold.csv", 1.0, None),
        ("gravity_untold.csv", -1.0, None),
    ] {
        let (error, notes) = found(name, Some(direction), payload_kg);
        assert!((error / stated - 1.0).abs() < 0.03, "{name}: {error} of {stated} mm");
        assert_eq!(notes.contains("sign was turned"), direction < 0.0, "{notes}");
        assert_eq!(
            notes.contains("speak for a load of 1."),
            payload_kg.is_none(),
            "{notes}"
        );
    }
    let (_, notes) = found("wrong.csv", Some(1.0), Some(3.0));
    assert!(notes.contains("weigh the load"), "{notes}");
    let (_, notes) = found("untold.csv", None, None);
    assert!(notes.contains("nothing is taken to hang at the flange"), "{notes}");
}
