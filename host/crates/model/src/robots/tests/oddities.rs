//! Robots and files as people have them, generated: each is read with the tip that a person would name, or refused with one
//! clear line.

mod changes;
mod generated;
mod robots;

use super::super::*;
use super::tips::tree;
use changes::CHANGES;
use robots::robots;

/// What is expected of a file.
#[derive(Clone, Copy, Debug)]
enum Outcome {
    /// Its root, its tip, and the number of its joints that turn.
    Read(&'static str, &'static str, usize),
    /// What the refusal says.
    Refused(&'static str),
}
use Outcome::{Read, Refused};

/// Reads a file as `identify` does.
fn read(text: &str) -> Result<RobotModel, String> {
    let model = urdf_in::load_path("odd.urdf", text, None, None).map_err(|e| e.to_string())?;
    model.joint_path().map_err(|e| e.to_string())?;
    Ok(model)
}

/// Checks a file; what is wrong goes to `wrong`, so that one run shows all.
fn check(name: &str, text: &str, expected: Outcome, wrong: &mut Vec<String>) {
    let found = read(text);
    let right = match (&found, expected) {
        (Ok(model), Read(root, tip, joints)) => {
            (
                model.frame_names.0.as_str(),
                model.frame_names.1.as_str(),
                model.robot.dof(),
            ) == (root, tip, joints)
                && model.chain_words().is_some_and(|words| !words.contains('\n'))
        }
        (Err(message), Refused(words)) => {
            message.starts_with("odd.urdf: ")
                && message.contains(words)
                && !message.contains('\n')
                && message.len() < 700
        }
        _ => false,
    };
    if !right {
        let found = found.map(|m| (m.frame_names, m.robot.dof()));
        wrong.push(format!("{name}: {expected:?}, found {found:?}"));
    }
}

// Fails if a robot of the field gets another root, tip or number of joints than a person would name, or is refused without
// the reason.
#[test]
fn robots_of_the_field_are_read_or_refused_in_one_line() {
    let mut wrong = Vec::new();
    for (name, joints, expected) in robots() {
        check(name, &tree(&joints), expected, &mut wrong);
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

// Fails if a change of the text that says nothing about the joints moves the tip of an arm, if one that makes the file useless
// is read, or if the file is not written back as it was.
#[test]
fn odd_texts_are_read_or_refused_in_one_line() {
    let mut wrong = Vec::new();
    for (robot, joints, expected) in robots() {
        let Read(..) = expected else { continue };
        // The changes are of the first joint: it turns about z.
        if !joints.starts_with("joint1") {
            continue;
        }
        for (name, change, refusal) in CHANGES {
            let text = change(&tree(&joints));
            let expected = refusal.map_or(expected, Refused);
            check(&format!("{robot}, {name}"), &text, expected, &mut wrong);
            if let Ok(model) = read(&text)
                && write_urdf(&model, &model.rows(), &[]) != text
            {
                wrong.push(format!("{robot}, {name}: it is written back otherwise"));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
