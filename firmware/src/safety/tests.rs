//! The limits of positions and speeds.

use nalgebra::{Vector3, Vector6};
use spherecal_shared::procedure::Limits;
use spherecal_shared::protocol::host::Fault;
use spherecal_shared::robot::{JointLimits, iiwa7};

use super::{BEYOND_RAD, Ends, JointState, OUTWARD_RAD_S, SafetyMonitor, Violation, workspace_clearance};
use crate::law::Shaped;

fn monitor() -> SafetyMonitor<7> {
    let mut monitor = SafetyMonitor::default();
    let robot = iiwa7().driven().expect("seven joints");
    monitor.configure(&robot, None).expect("the built-in robot");
    monitor
}

fn state(q: f64, dq: f64) -> JointState<7> {
    let mut state = JointState {
        q: [0.0, 0.0, 0.0, -1.0, 0.0, 0.5, 0.0],
        dq: [0.0; 7],
        tau: [0.0; 7],
    };
    (state.q[1], state.dq[1]) = (q, dq);
    state
}

// Fails if a joint outside of its range may rest there at a sphere, at either end, or may not come back in free
// space; if one inside of the margin may go on outwards, or may not rest and come back; or if an arm that leaves
// a sphere has not half of the margin.
#[test]
fn a_joint_keeps_its_range() {
    let (monitor, limits) = (monitor(), Limits::default());
    let joint = iiwa7().joints[1].limits;
    let margin = limits.position_margin_rad;
    let check = |q, dq, ends| monitor.joint_state(&state(q, dq), &limits, ends);
    for (end, outwards) in [(joint.max_rad, 1.0), (joint.min_rad, -1.0)] {
        for dq in [0.0, -outwards * 0.5] {
            let found = check(end + outwards * 1e-3, dq, Ends::Keep).expect("out of the range");
            assert_eq!((found.fault, found.joint), (Fault::JointPosition, 2));
            assert!((found.limit - (end - outwards * margin)).abs() < 1e-12);
            for ends in [Ends::Return, Ends::Leave] {
                let pushed = end + outwards * 0.999 * BEYOND_RAD;
                assert!(check(pushed, dq, ends).is_none(), "{ends:?} at {dq} rad/s");
                assert!(check(pushed, outwards * 2.0 * OUTWARD_RAD_S, ends).is_some());
                assert!(
                    check(end + outwards * 1.001 * BEYOND_RAD, dq, ends).is_some(),
                    "no such angle"
                );
            }
        }
        let within = end - outwards * 0.75 * margin;
        for ends in [Ends::Keep, Ends::Return] {
            assert!(check(within, outwards * 2.0 * OUTWARD_RAD_S, ends).is_some());
            assert!(check(within, outwards * 0.5 * OUTWARD_RAD_S, ends).is_none());
            assert!(check(within, -outwards * 0.5, ends).is_none());
            assert!(check(end - outwards * 1.1 * margin, outwards * 0.5, ends).is_none());
        }
        assert!(check(within, outwards * 2.0 * OUTWARD_RAD_S, Ends::Leave).is_none());
    }
    let fastest = joint.velocity_rad_s * limits.velocity_share;
    for direction in [1.0, -1.0] {
        assert!(check(0.0, direction * 0.999 * fastest, Ends::Keep).is_none());
        let found = check(0.0, direction * 1.001 * fastest, Ends::Keep).expect("too fast");
        assert_eq!(
            (found.fault, found.joint, found.limit),
            (Fault::JointVelocity, 2, fastest)
        );
    }
}

// Fails if a value that equals its limit is a fault, or the smallest one beyond it is none. All numbers
// are binary fractions, so that sums and norms are exact.
#[test]
fn what_equals_its_limit_is_allowed() {
    let beyond = |limit: f64| limit * (1.0 + f64::EPSILON);
    let limits = Limits {
        position_margin_rad: 0.0625,
        velocity_share: 0.5,
        force_n: 80.0,
        speed_m_s: 1.25,
        torque_error_share: 0.25,
        jump_rad: 0.25,
        ..Limits::default()
    };
    let mut robot = iiwa7();
    for joint in &mut robot.joints {
        joint.limits = JointLimits {
            min_rad: -2.0,
            max_rad: 2.0,
            velocity_rad_s: 2.0,
            torque_nm: 128.0,
        };
    }
    let mut monitor = SafetyMonitor::<7>::default();
    let robot = robot.driven().expect("seven joints");
    monitor.configure(&robot, None).expect("a robot");

    // The end of a range, its margin, the speed out of it, and the speed of a joint.
    let found = |monitor: &SafetyMonitor<7>, q, dq| monitor.joint_state(&state(q, dq), &limits, Ends::Keep).is_some();
    for side in [1.0, -1.0] {
        assert!(!found(&monitor, side * 2.0, 0.0));
        assert!(found(&monitor, side * beyond(2.0), 0.0));
        assert!(!found(&monitor, side * 1.9375, side * 0.5));
        assert!(found(&monitor, side * beyond(1.9375), side * 0.5));
        assert!(!found(&monitor, side * 2.0, side * OUTWARD_RAD_S));
        assert!(found(&monitor, side * 2.0, side * beyond(OUTWARD_RAD_S)));
        assert!(!found(&monitor, 0.0, side * 1.0));
        assert!(found(&monitor, 0.0, side * beyond(1.0)));
        let mut q = [0.0; 7];
        q[1] = side * 1.9375;
        assert!(monitor.reachable(&q, 0.0625));
        q[1] = side * beyond(1.9375);
        assert!(!monitor.reachable(&q, 0.0625));
    }

    // The force, the speed of the TCP, and the error of a torque, each for as long as it takes.
    let first = |look: &mut dyn FnMut() -> Option<Violation>| (1..100).find(|_| look().is_some());
    let mut watch = |newton: f64| {
        let force = Vector3::new(0.0, newton, 0.0);
        first(&mut || monitor.watch(&force, &Shaped::default(), &limits, 1.0 / 1024.0))
    };
    assert_eq!(watch(80.0), None);
    assert_eq!(watch(beyond(80.0)), Some(11), "10 ms");
    let mut tcp = |speed: f64| {
        let mut velocity = Vector6::zeros();
        (velocity[1], velocity[4]) = (speed, 9.0);
        let place = Vector3::zeros();
        first(&mut || monitor.parts().1.tcp(&place, &velocity, &limits, 1.0 / 1024.0))
    };
    assert_eq!(tcp(1.25), None);
    assert_eq!(tcp(beyond(1.25)), Some(6), "5 ms");
    let mut torque = |error: f64| {
        let mut delivered = [4.0; 7];
        delivered[2] += error;
        first(&mut || {
            let (joints, envelope) = monitor.parts();
            envelope.torque(&[4.0; 7], &delivered, joints, &limits, 1.0 / 1024.0)
        })
    };
    for side in [1.0, -1.0] {
        assert_eq!(torque(side * 32.0), None);
        assert_eq!(torque(side * 32.0 * (1.0 + 1e-12)), Some(21), "20 ms");
    }
}

// Fails if a bound of the workspace is another side of the box or of the plate than it is, or counts
// where the TCP is on it.
#[test]
fn the_workspace_has_seven_sides() {
    let limits = Limits {
        workspace_min_m: [-1.0, -2.0, -3.0],
        workspace_max_m: [1.5, 2.5, 3.5],
        plate_normal: [0.0, 0.0, 1.0],
        plate_offset_m: -2.75,
        ..Limits::default()
    };
    for (at, outwards) in [
        ([-1.25, 0.0, 0.0], [-1.0, 0.0, 0.0]),
        ([1.75, 0.0, 0.0], [1.0, 0.0, 0.0]),
        ([0.0, -2.25, 0.0], [0.0, -1.0, 0.0]),
        ([0.0, 2.75, 0.0], [0.0, 1.0, 0.0]),
        ([0.0, 0.0, 3.75], [0.0, 0.0, 1.0]),
        ([0.0, 0.0, -3.0], [0.0, 0.0, -1.0]),
    ] {
        let (left, out) = workspace_clearance(&at.into(), &limits);
        assert_eq!((left, out), (-0.25, outwards.into()), "{at:?}");
        let mut monitor = monitor();
        let mut leaves = |metres: f64, speed: f64| {
            let place = Vector3::from(at) - out * (0.25 - metres);
            let v = out * speed;
            let velocity = Vector6::new(v.x, v.y, v.z, 0.0, 0.0, 0.0);
            (0..20).find_map(|_| monitor.parts().1.tcp(&place, &velocity, &limits, 1e-3))
        };
        assert_eq!(leaves(0.0, 0.5), None, "on the bound");
        assert_eq!(leaves(0.125, 0.005), None, "slowly");
        let found = leaves(0.125, 0.0051).expect("outwards");
        assert_eq!((found.fault, found.value, found.limit), (Fault::Workspace, 0.125, 0.0));
    }
    // Where two bounds are as near, the first one counts: plate, then lower, then upper bounds.
    let corner = Vector3::new(-1.25, -2.25, -3.0);
    assert_eq!(workspace_clearance(&corner, &limits).1, -Vector3::z());
    let corner = Vector3::new(-1.25, 2.75, 0.0);
    assert_eq!(workspace_clearance(&corner, &limits).1, -Vector3::x());
}
