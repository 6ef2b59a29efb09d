//! A hundred draws of each kind of mistake.

use super::*;

/// Draws of each kind.
const DRAWS: usize = 100;

/// What comes of one draw of a kind: whether the mistake is named.
fn is_named(arms: &[RobotModel], kind: &str, draw: usize) -> Result<(), String> {
    let model = &arms[draw % arms.len()];
    let poses = kind == "--invert-poses";
    let last = model.robot.dof() - 1;
    let of_kind: Vec<Adjustments> = mistakes(model.robot.dof(), poses)
        .into_iter()
        .map(|(_, adjust)| adjust)
        // A TCP near the last axis takes up the zero of the last joint.
        .filter(|a| a.options().starts_with(kind) && !a.zeros.iter().any(|z| z.0 == last))
        .collect();
    let adjust = &of_kind[draw / arms.len() % of_kind.len()];
    let rows = mistaken(&sound(model, 5_000 + draw as u64, 60, poses), adjust);
    let found = explained(model, &rows, TOOL);
    match named(&found, adjust) {
        Named::No => Err(format!(
            "{}, {}: {:?}",
            model.robot.name,
            adjust.options(),
            found.sentences()
        )),
        Named::Among | Named::Alone => Ok(()),
    }
}

// Fails if a kind of mistake in the data of four arms is not named in 95 of 100 draws.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_each_kind_of_mistake_is_named() {
    let arms = arms();
    let mut wrong = Vec::new();
    for kind in [
        "--flip",
        "--order",
        "--zero-deg",
        "--couple",
        "--joint-unit",
        "--point-factor",
        "--mirror-points",
        "--invert-poses",
        "--shift-rows",
    ] {
        let missed: Vec<String> = (0..DRAWS)
            .filter_map(|draw| is_named(&arms, kind, draw).err())
            .collect();
        println!("{kind}: {} of {DRAWS} named; missed: {missed:#?}", DRAWS - missed.len());
        if missed.len() > 5 {
            wrong.push(kind);
        }
    }
    assert!(wrong.is_empty(), "{wrong:?}");
}

// Fails if a tool that points the other way or is given in m, data of another robot, or a controller's readout is not named in 95
// of 100 draws.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_each_tool_robot_and_readout_is_named() {
    let arms = arms();
    let ur10e = built_in("ur10e").unwrap();
    let mut right = [0; 4];
    for draw in 0..DRAWS {
        let model = &arms[draw % arms.len()];
        let rows = sound(model, 9_000 + draw as u64, 60, false);
        let said = |model: &RobotModel, rows: &[Observation], tool| explained(model, rows, tool).sentences().join("; ");
        let readout: Vec<Observation> = {
            let path = model.joint_path().unwrap();
            let own = |row: &Observation| {
                let at = path.frames(&path.positions(&row.q)).tip.point(&Vector3::from(TOOL));
                Observation {
                    target: Target::Point(at.map(|v| (v * 1e6).round() / 1e6).into()),
                    ..row.clone()
                }
            };
            rows.iter().map(own).collect()
        };
        let other = sound(&ur10e, 9_000 + draw as u64, 60, false);
        let cases = [
            (said(model, &rows, TOOL.map(|v| -v)), "the tool points the other way"),
            (said(model, &rows, TOOL.map(|v| v * 1e-3)), "the tool is given in m"),
            (said(&arms[0], &other, TOOL), "--robot ur10e"),
            (said(model, &readout, TOOL), "those of the nominal model"),
        ];
        for (count, (said, words)) in right.iter_mut().zip(&cases) {
            *count += usize::from(said.contains(words));
        }
    }
    println!("of {DRAWS}: reversed tool, tool in m, another robot, readout: {right:?}");
    assert!(right.iter().all(|count| *count >= 95), "{right:?}");
}
