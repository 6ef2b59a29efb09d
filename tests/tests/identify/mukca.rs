//! Real closed-loop data: a ball on the flange of an iiwa 14 in two sockets
//! 50 mm apart, at three places (`mukca_iiwa14.csv`, see `data/README.md`).

use spherecal::identify::{Experiment, Model, Observation, Options, Set, Sphere, Split, Target, holdout, identify};
use spherecal::model::input::{Labels, TableFormat, read_csv_file};
use spherecal::model::robots::load;
use spherecal_tests::data_path;

pub(crate) fn experiment() -> Experiment {
    let mut model = load(&data_path("iiwa14.urdf").display().to_string()).expect("a robot");
    model.tool.tcp_m = [0.0, 0.0, 0.04];
    let mut places = Labels::default();
    let format = TableFormat::new(7);
    let path = data_path("mukca_iiwa14.csv");
    let table = read_csv_file(&path, &format, &mut places, &mut |_| {}).expect("a table");
    let spheres = [(1, 0.0), (2, 0.05)].map(|(id, x)| Sphere {
        id,
        position_m: [x, 0.0, 0.0],
        sigma_m: 20e-6,
    });
    let observations = table.rows().map(|row| Observation {
        seat: None,
        q: row.q.to_vec(),
        tau: None,
        target: Target::Sphere {
            sphere: row.sphere.expect("contacts"),
            place: row.place,
        },
        set: Set::Calibrate,
    });
    Experiment {
        robot: model.robot.clone(),
        tool: model.tool_in_table(),
        spheres: spheres.to_vec(),
        observations: observations.collect(),
    }
}

/// Leave-one-place-out: no part of a place, and not its base, is seen by the fit
/// that predicts it. Nominal 0.487 mm (ball offset fitted), published method
/// about 0.2, yardstick of geometry with priors 0.231. Fails if noise shape,
/// gravity load of a robot without masses or priors no longer suit real data.
#[test]
fn a_place_left_out_is_predicted() {
    let e = experiment();
    let found = holdout(&e, &Options::default(), &Split::Place).expect("good data");
    let scatter = found.scatter_mm.expect("contacts");
    let distance = found.distance_mm.expect("two sockets");
    assert_eq!(found.parts.len(), 3);
    assert!(
        found.error_mm.is_none(),
        "the fit cannot know the base of a place that it never saw"
    );
    assert!(scatter <= 0.18, "scatter {scatter} mm");
    // Found: 0.082 mm; 0.075 mm with the constants that were tuned on this table.
    assert!(distance <= 0.085, "socket distance {distance} mm");
    // The load is what makes the difference to geometry alone.
    let geometry = Options {
        model: Model::Geometry,
        ..Options::default()
    };
    let plain = holdout(&e, &geometry, &Split::Place).expect("good data");
    assert!(plain.scatter_mm.expect("contacts") > scatter);
}

/// Fails if assumed masses are not owned up to, or a compliance found with them
/// is not of the sign of a spring.
#[test]
fn a_robot_without_masses_says_so() {
    let c = identify(&experiment(), &Options::default()).expect("good data");
    assert!(c.assumed_masses);
    assert!(c.compliance_rad_per_nm[1] > 0.0 && c.compliance_rad_per_nm[3] > 0.0);
    assert_eq!(c.frames.len(), 3);
}
