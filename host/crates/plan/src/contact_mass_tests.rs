use spherecal_shared::robot::{built_in, iiwa7_tool};

use super::*;
use crate::{Cell, Obstacle, PlanError, PlanRequest, PlatePose, Rules, plan, suggest};
use spherecal_model::chain::Chain;

/// Twice the kinetic energy of the arm as the tool moves along `direction` with 1 m/s and does not turn, in kg m²/s².
fn twice_the_energy(robot: &Robot, q: &[f64; 6], direction: &Vector3<f64>) -> f64 {
    let arm = Arm::<f64, 6>::new(robot, &iiwa7_tool()).expect("a built-in robot");
    let frames = arm.frames(q);
    let jacobian: SMatrix<f64, 6, 6> = arm.jacobian(&frames, &arm.tcp_frame(&frames).position);
    let mut velocity = nalgebra::Vector6::zeros();
    velocity.fixed_rows_mut::<3>(0).copy_from(direction);
    let speeds = jacobian.lu().solve(&velocity).expect("no singular place");
    let momentum: nalgebra::Vector6<f64> = arm.bodies(&frames).mass_matrix() * speeds;
    speeds.dot(&momentum)
}

// Fails if the mass is another than the one that has the arm's kinetic energy.
#[test]
fn the_mass_has_the_energy_of_the_arm() {
    let robot = built_in("ur20").expect("known");
    for q in [
        [-0.3, -1.3, 2.1, -5.5, 1.6, 1.2],
        [-2.27, -1.19, -2.72, -0.8, 1.57, -0.7],
    ] {
        for direction in [-Vector3::z(), Vector3::new(0.6, 0.0, 0.8)] {
            let masses = masses::<6>(&robot, &iiwa7_tool(), &q).expect("they are known");
            let mass = direction.dot(&(masses * direction));
            let energy = twice_the_energy(&robot, &q, &direction);
            assert!((mass - energy).abs() < 1e-6 * energy, "{mass} kg, not {energy}");
        }
    }
}

// Fails if the mass of a contact is another than the one whose momentum, after the magnet's work, the limit stops; if a stronger
// magnet allows more; or if the paper's magnet no longer allows what simulated arms showed.
#[test]
fn the_magnet_bounds_the_mass_of_a_contact() {
    let procedure = Procedure::default();
    let mut contact = Contact::from(&procedure);
    assert!(
        (contact.most_along_kg() - 24.7).abs() < 0.1,
        "{}",
        contact.most_along_kg()
    );
    assert!((contact.most_any_kg() - 33.3).abs() < 0.1, "{}", contact.most_any_kg());
    let mut last = f64::INFINITY;
    for magnet_n in [0.0, 13.0, 26.5, 79.0, 265.0] {
        contact.magnet_n = magnet_n;
        let kg = contact.most_along_kg();
        let energy = 0.5 * kg * contact.speed_m_s.powi(2) + magnet_n * 1e-3;
        let force = (2.0 * kg * energy).sqrt() / 0.013;
        assert!((force - contact.limit_n).abs() < 1e-9, "{force} N at {magnet_n} N");
        assert!(kg < last, "{kg} kg at {magnet_n} N");
        last = kg;
    }
}

// Fails if a folded arm goes to the sphere, or if no other place is found for the plate, or one where the arm is folded, too.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_folded_arm_is_refused_and_finds_another_place() {
    let mut cell = Cell {
        robot: built_in("ur20").expect("known"),
        tool_yaw_rad: None,
        ..Cell::iiwa7()
    };
    cell.plates = vec![PlatePose::level([0.450, 0.0, 0.100], 150f64.to_radians())];
    let request = PlanRequest::spread(12);
    let refused = plan(&cell, &request);
    assert!(
        matches!(
            refused,
            Err(PlanError::SphereOutOfReach {
                obstacle: Obstacle::Heavy { .. },
                ..
            })
        ),
        "{refused:?}"
    );
    let chain = Chain::new(&cell.robot, &cell.tool).expect("a built-in robot");
    cell.plates = vec![suggest(&cell, &chain, &Rules::default()).expect("a place")];
    let plan = plan(&cell, &request).expect("a plan at the place that was found");
    for visit in &plan.spheres {
        let masses = masses::<6>(&cell.robot, &cell.tool, &visit.approach.joints).expect("they are known");
        assert!(masses.symmetric_eigenvalues().max() < 40.0, "{masses}");
    }
}
