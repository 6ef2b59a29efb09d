//! Several calibrated chains in one file.

use nalgebra::Vector3;
use proptest::prelude::*;

use super::super::frames::{compose, distance, from_rpy, inverse};
use super::super::*;
use super::tips::{row, tree};

/// Two arms on a lift and a torso that turns, each on a mount that is fixed; and a head.
fn text() -> String {
    tree(&format!(
        "lift prismatic base column; c fixed column shelf; torso revolute shelf body; head_pan revolute body head; \
         lm fixed body left_mount; {} lt fixed left_link4 left_tool; rm fixed body right_mount; {} rt fixed right_link5 right_tool",
        row("left_", "left_mount", 4),
        row("right_", "right_mount", 5)
    ))
}

fn chain(text: &str, ends: &str) -> RobotModel {
    load_urdf_text_path("r.urdf", text, Some(ends)).expect("a chain")
}

/// A frame of six numbers.
fn frame(v: &[f64]) -> Pose<f64> {
    Pose {
        position: Vector3::new(v[0], v[1], v[2]),
        rotation: from_rpy([v[3], v[4], v[5]]),
    }
}

proptest! {
    // Fails if the chains of the written file are not the trunk, the mounts and the tables that were given: a fixed link that is
    // forgotten, an origin in another frame, the tool centre point of the other arm, or a joint beside the chains that moved.
    #[test]
    fn all_chains_are_in_the_written_file(
        off in proptest::collection::vec(-0.02..0.02_f64, 24), changes in proptest::collection::vec(-0.02..0.02_f64, 9 * 4),
        q in proptest::collection::vec(-1.5..1.5_f64, 7),
    ) {
        let text = text();
        let tips = ["left_tool", "right_tool"];
        let wholes = tips.map(|tip| chain(&text, &format!("base:{tip}")));
        let trunk = Trunk::of(&wholes).expect("a trunk");
        prop_assert_eq!(&trunk.joints, &["lift", "torso"]);
        prop_assert_eq!(&trunk.end, "body");
        let path = wholes[0].joint_path().expect("a path");
        let origins: Vec<_> = (0..2).map(|k| compose(&path.joints[k].origin, &frame(&off[6 * k..]))).collect();
        let own = tips.map(|tip| chain(&text, &format!("{}:{tip}", trunk.end)));
        let mounts = [frame(&off[12..]), frame(&off[18..])];
        let mut more = changes.chunks_exact(4);
        let rows = [0, 1].map(|limb: usize| {
            let mut rows = own[limb].rows();
            for row in &mut rows {
                let by = more.next().expect("a change");
                row.a += by[0];
                row.alpha += by[1];
                row.d += by[2];
                row.theta += by[3];
            }
            rows
        });
        let tcps = [[0.01, 0.02, 0.03], [0.04, 0.05, 0.06]];
        let limb = |k: usize| Limb { model: &own[k], rows: rows[k].clone(), mount: mounts[k], tcp_m: tcps[k] };
        let written = write_urdf_of_limbs(&wholes[0], &origins, &[limb(0), limb(1)], &["a note".to_owned()]);
        let mut body = Pose::identity();
        for (k, (joint, origin)) in path.joints.iter().zip(&origins).enumerate() {
            body = compose(&compose(&body, origin), &joint.motion(q[k]));
        }
        for k in 0..2 {
            let count = rows[k].len();
            let angles = &q[2..2 + count];
            let flange = compose(&body, &compose(&mounts[k], &own[k].flange_with(&rows[k], angles)));
            let again = chain(&written, &format!("base:{}_tcp", tips[k])).joint_path().expect("a path");
            let found = again.frames(&again.positions(&q[..2 + count])).tip;
            let tcp = Pose { position: tcps[k].into(), ..flange };
            let tcp = Pose { position: flange.point(&tcp.position), ..tcp };
            prop_assert!(distance(&found, &tcp) < 1e-9, "{} {found:?} {tcp:?}", tips[k]);
        }
        let head = |text: &str| {
            let path = chain(text, "body:head").joint_path().expect("a path");
            path.frames(&path.positions(&[0.3])).tip
        };
        prop_assert!(distance(&compose(&inverse(&head(&text)), &head(&written)), &Pose::identity()) < 1e-15);
        // A later calibration moves the tool centre points in place of adding others.
        let wholes = tips.map(|tip| chain(&written, &format!("base:{tip}")));
        let own = tips.map(|tip| chain(&written, &format!("body:{tip}")));
        let limb = |k: usize| Limb { model: &own[k], rows: own[k].rows(), mount: Pose::identity(), tcp_m: tcps[1 - k] };
        let origins: Vec<_> = wholes[0].joint_path().expect("a path").joints[..2].iter().map(|j| j.origin).collect();
        let again = write_urdf_of_limbs(&wholes[0], &origins, &[limb(0), limb(1)], &[]);
        prop_assert_eq!(again.matches("_tcp\"/>").count(), written.matches("_tcp\"/>").count());
    }
}

// Fails if chains that have no common base, nothing of their own, or a slide behind the trunk are taken.
#[test]
fn chains_that_cannot_be_meant_are_refused() {
    let text = text();
    let refused = |ends: [&str; 2], words: &str| {
        let error = Trunk::of(&ends.map(|ends| chain(&text, ends))).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    };
    refused(
        ["base:left_tool", "body:right_tool"],
        "one base link that carries them all",
    );
    refused(["left_tool:right_tool", "base:left_tool"], "one base link");
    refused(["base:left_tool", "base:body"], "another tip is behind it");
    let slides = tree(&format!(
        "{} {}",
        row("a_", "base", 3),
        row("b_", "base", 3).replacen("revolute", "prismatic", 1)
    ));
    let two = ["base:a_link3", "base:b_link3"].map(|ends| chain(&slides, ends));
    let error = Trunk::of(&two).unwrap_err().to_string();
    assert!(error.contains("a joint slides behind"), "{error}");
    let built_in = built_in("ur5e").expect("built in");
    assert!(
        Trunk::of(&[built_in.clone(), built_in])
            .unwrap_err()
            .to_string()
            .contains("one URDF")
    );
}
