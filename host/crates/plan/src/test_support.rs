//! What the planner's tests share.

use spherecal_model::chain::{Chain, TcpPose, rotation_of};

use super::{Cell, Plan, Rules};

/// Follows every move of a visit on the nominal robot in steps half as long as the planner's. Fails
/// if a via is missing or the joints belong to another branch.
pub(super) fn assert_continuous(cell: &Cell, rules: &Rules, plan: &Plan) {
    let chain = Chain::new(&cell.robot, &cell.tool).expect("the cell's own robot");
    let finer = Rules {
        step_rad: 0.5 * rules.step_rad,
        limit_margin_rad: rules.limit_margin_rad - 1e-6,
        singular_rad: rules.singular_rad.map(|s| 0.8 * s),
        ..*rules
    };
    for visit in &plan.spheres {
        let pose_at = |position: [f64; 3], orientation: &[f64; 4], elbow| TcpPose {
            position: position.into(),
            rotation: rotation_of(orientation),
            elbow,
        };
        let approach = &visit.approach;
        let mut here = pose_at(approach.position_m, &approach.orientation, approach.elbow_rad);
        let mut q = approach.joints.clone();
        let reached = chain.pose(&q);
        assert!((reached.position - here.position).norm() < 1e-10);
        // Down to the sphere in the approach's orientation, then from pose to pose.
        let touch = TcpPose {
            position: visit.position_m.into(),
            ..here
        };
        q = finer.follow(&chain, &here, &q, &touch).expect("the descent is free");
        here = touch;
        for pose in &visit.poses {
            let next = pose_at(visit.position_m, &pose.orientation, pose.elbow_rad);
            q = finer
                .follow(&chain, &here, &q, &next)
                .unwrap_or_else(|e| panic!("pose {}: {e}", pose.id));
            let off = q
                .iter()
                .zip(&pose.joints)
                .map(|(a, b)| (a - b).abs())
                .fold(0.0, f64::max);
            assert!(off < 1e-6, "pose {} is {off} rad away from its joints", pose.id);
            here = next;
        }
    }
}
