//! The limits of positions and speeds.

use spherecal_shared::procedure::Limits;
use spherecal_shared::protocol::host::Fault;
use spherecal_shared::robot::iiwa7;

use super::{JointState, OUTWARD_RAD_S, SafetyMonitor};

fn monitor() -> SafetyMonitor<7> {
    let mut monitor = SafetyMonitor::default();
    monitor.configure(&iiwa7(), None).expect("the built-in robot");
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

// Fails if a joint outside of its range may rest there, at either end; if one inside of the
// margin may go on outwards, or may not rest and come back; or if an arm that leaves a sphere
// has not half of the margin.
#[test]
fn a_joint_keeps_its_range() {
    let (monitor, limits) = (monitor(), Limits::default());
    let joint = iiwa7().joints[1].limits;
    let margin = limits.position_margin_rad;
    let check = |q, dq, leaves| monitor.joint_state(&state(q, dq), &limits, leaves);
    for (end, outwards) in [(joint.max_rad, 1.0), (joint.min_rad, -1.0)] {
        for dq in [0.0, -outwards * 0.5] {
            let found = check(end + outwards * 1e-3, dq, false).expect("out of the range");
            assert_eq!((found.fault, found.joint), (Fault::JointPosition, 2));
            assert!((found.limit - (end - outwards * margin)).abs() < 1e-12);
        }
        let within = end - outwards * 0.75 * margin;
        assert!(check(within, outwards * 2.0 * OUTWARD_RAD_S, false).is_some());
        assert!(check(within, outwards * 2.0 * OUTWARD_RAD_S, true).is_none());
        assert!(check(within, outwards * 0.5 * OUTWARD_RAD_S, false).is_none());
        assert!(check(within, -outwards * 0.5, false).is_none());
        assert!(check(end - outwards * 1.1 * margin, outwards * 0.5, false).is_none());
    }
    let fastest = joint.velocity_rad_s * limits.velocity_share;
    for direction in [1.0, -1.0] {
        assert!(check(0.0, direction * 0.999 * fastest, false).is_none());
        let found = check(0.0, direction * 1.001 * fastest, false).expect("too fast");
        assert_eq!(
            (found.fault, found.joint, found.limit),
            (Fault::JointVelocity, 2, fastest)
        );
    }
}
