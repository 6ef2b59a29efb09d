//! Files with several oddities at once, drawn from a seed: an arm on something, with something at its end, in a text as
//! people have it.

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use super::super::super::*;
use super::super::tips::tree;

/// How many files are drawn.
const FILES: u64 = 300;

/// A file, the SRDF beside it, and what is expected.
struct Drawn {
    text: Vec<u8>,
    srdf: Option<String>,
    /// Root, tip, and how many joints of the chain turn and slide; else what the refusal names.
    expected: Result<(String, String, usize, usize), Vec<String>>,
    /// What is said of it, once.
    said: Vec<&'static str>,
    /// What was drawn.
    words: String,
}

/// One of several, evenly.
fn one<'a, T>(random: &mut ChaCha8Rng, of: &'a [T]) -> &'a T {
    &of[random.random_range(0..of.len())]
}

/// An arm, joint by joint.
struct Arm {
    joints: String,
    last: String,
    turning: usize,
    sliding: usize,
}

fn arm(random: &mut ChaCha8Rng, prefix: &str, from: &str) -> Arm {
    let count = random.random_range(5..=7);
    let slide = (random.random_range(0..5) == 0).then(|| random.random_range(1..count));
    let follower = (random.random_range(0..6) == 0).then(|| random.random_range(2..count));
    let kind = *one(random, &["revolute", "continuous"]);
    let mut out = Arm {
        joints: String::new(),
        last: from.to_owned(),
        turning: 0,
        sliding: 0,
    };
    for k in 0..count {
        let link = format!("{prefix}link{}", k + 1);
        let (kind, leader) = match k {
            _ if Some(k) == slide => ("prismatic", String::new()),
            _ if Some(k) == follower && Some(k - 1) != slide => ("revolute", format!(" {prefix}joint{k}")),
            _ => (kind, String::new()),
        };
        out.joints += &format!("{prefix}joint{} {kind} {} {link}{leader};", k + 1, out.last);
        out.sliding += usize::from(kind == "prismatic");
        out.turning += usize::from(kind != "prismatic");
        out.last = link;
    }
    out
}

/// What an arm stands on: joints, the link that carries it, the root of the chain, and how many joints of it slide.
const STANDS: [(&str, &str, &str, usize); 6] = [
    ("", "base_link", "base_link", 0),
    ("fix fixed world base_link;", "base_link", "world", 0),
    ("rail prismatic world carriage;", "carriage", "world", 1),
    (
        "float floating world body; lidar_joint continuous body lidar;",
        "body",
        "body",
        0,
    ),
    (
        "left_wheel_joint continuous base_link left_wheel; right_wheel_joint continuous base_link right_wheel; lift prismatic base_link \
         torso; head_pan_joint revolute torso head_pan_link; head_tilt_joint revolute head_pan_link head_tilt_link; camera_joint \
         fixed head_tilt_link camera_link;",
        "torso",
        "base_link",
        1,
    ),
    (
        "door revolute frame panel; stand fixed table camera_stand;",
        "base_link",
        "base_link",
        0,
    ),
];

/// What an arm holds, on the link `@`: joints, and the tip; `@` where it is the arm's last link.
const ENDS: [(&str, &str, &str); 9] = [
    ("tool0", "f fixed @ #flange; t fixed #flange #tool0;", "#tool0"),
    (
        "tool0 and a gripper of two jaws",
        "t fixed @ #tool0; g fixed #tool0 #gripper_base; j1 prismatic #gripper_base #jaw_left; j2 prismatic #gripper_base #jaw_right j1;",
        "#tool0",
    ),
    (
        "two fingers, one of which follows",
        "h fixed @ #hand; f1 prismatic #hand #finger_left; f2 prismatic #hand #finger_right f1;",
        "@",
    ),
    ("one jaw", "jaw_joint revolute @ #moving_jaw;", "@"),
    (
        "a propeller and a bar",
        "e fixed @ #ee_arm_link; gripper continuous #ee_arm_link #gripper_prop_link; b fixed #ee_arm_link #gripper_bar_link; l prismatic \
         #gripper_bar_link #left_finger_link; r prismatic #gripper_bar_link #right_finger_link l;",
        "#ee_arm_link",
    ),
    (
        "a camera and a gripper without names",
        "cam fixed @ #wrist_camera_link; g1 prismatic @ #a; g2 prismatic @ #b g1;",
        "@",
    ),
    ("a suction cup", "s fixed @ #suction_cup;", "@"),
    (
        "a flange",
        "f fixed @ #flange; c fixed #flange #camera_mount;",
        "#flange",
    ),
    (
        "three fingers",
        "f1 revolute @ #finger1; f2 revolute @ #finger2; f3 revolute @ #finger3;",
        "@",
    ),
];

/// What a person's text has, and what is said of it.
const TEXTS: [(&str, fn(&str) -> String, Option<&str>); 9] = [
    (
        "infinite limits",
        |t| limit(t, "lower=\"-inf\" upper=\"inf\" velocity=\"2\""),
        Some("lower is -inf"),
    ),
    (
        "limits of 1e16",
        |t| limit(t, "lower=\"-1e16\" upper=\"1e16\" velocity=\"2\""),
        Some("lower is -1e16"),
    ),
    (
        "equal limits",
        |t| limit(t, "lower=\"0\" upper=\"0\""),
        Some("lower is 0 and upper is 0"),
    ),
    (
        "a fast joint",
        |t| limit(t, "lower=\"-2\" upper=\"2\" velocity=\"10000\""),
        Some("velocity is 10000"),
    ),
    (
        "no force",
        |t| limit(t, "lower=\"-2\" upper=\"2\" velocity=\"2\" effort=\"0\""),
        None,
    ),
    (
        "an undeclared prefix",
        |t| {
            t.replacen(
                "</robot>",
                "<gazebo><ignition:plugin name=\"a:b\"/></gazebo></robot>",
                1,
            )
        },
        Some("prefix ignition is not declared"),
    ),
    ("lines of Windows", |t| t.replace('\n', "\r\n"), None),
    (
        "hyphens in a comment",
        |t| t.replacen("<link", "<!-- -- arm -- --><link", 1),
        None,
    ),
    ("a byte order mark", |t| format!("\u{feff}{t}"), None),
];

/// Gives the first joint that turns limits.
fn limit(text: &str, limits: &str) -> String {
    let joint = text
        .find("type=\"revolute\"")
        .or_else(|| text.find("type=\"prismatic\""));
    let at = joint.and_then(|from| Some(from + text.get(from..)?.find("<axis")?));
    let Some(at) = at else { return text.to_owned() };
    format!("{}<limit {limits}/>{}", &text[..at], &text[at..])
}

fn draw(seed: u64) -> Drawn {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let prefix = *one(&mut random, &["", "arm_", "robot1/", "left-", "ä_"]);
    let (stand, carrier, root, slides) = *one(&mut random, &STANDS);
    let (end, hand, tip) = *one(&mut random, &ENDS);
    let own = arm(&mut random, prefix, carrier);
    let named = |words: &str| words.replace('@', &own.last).replace('#', prefix);
    let mut joints = format!("{stand} {} {}", own.joints, named(hand));
    let mut tip = named(tip);
    let mut turning = own.turning;
    let mut sliding = own.sliding + slides;
    let mut srdf = None;
    let mut words = format!("{end}, prefix \"{prefix}\", on {carrier}");
    let mut refused = Vec::new();
    // A second arm: the SRDF says which is meant, or the question names both.
    if random.random_range(0..4) == 0 && !end.contains("tool0") {
        let second = arm(&mut random, "second_", carrier);
        joints += &second.joints;
        if random.random() {
            srdf = Some(if random.random() {
                format!(
                    "<robot name=\"small\"><group name=\"arm\"><chain base_link=\"{root}\" tip_link=\"{}\"/></group></robot>",
                    second.last
                )
            } else {
                format!(
                    "<robot name=\"small\"><end_effector name=\"e\" parent_link=\"{}\" group=\"hand\"/></robot>",
                    second.last
                )
            });
            (tip, turning, sliding) = (second.last, second.turning, second.sliding + slides);
            words += ", a second arm, which the SRDF names";
        } else {
            refused = vec!["several could be meant".to_owned(), tip.clone(), second.last];
            words += ", a second arm";
        }
    }
    let mut text = tree(&joints);
    let mut said = Vec::new();
    for (name, change, note) in TEXTS {
        if random.random_range(0..4) == 0 {
            let changed = change(&text);
            // Limits of one joint alone are given.
            let limits = ["limits", "joint", "force"].iter().any(|word| name.contains(word));
            if limits && (text.contains("<limit") || changed == text) {
                continue;
            }
            text = changed;
            said.extend(note);
            words += &format!(", {name}");
        }
    }
    let latin = random.random_range(0..5) == 0 && !text.starts_with('\u{feff}');
    let text = if latin {
        words += ", ISO-8859-1";
        let declared = format!("<?xml version=\"1.0\" encoding=\"ISO-8859-1\"?>\n<!-- Müller -->{text}");
        declared.chars().map(|c| c as u8).collect()
    } else {
        text.into_bytes()
    };
    let expected = if refused.is_empty() {
        Ok((root.to_owned(), tip, turning, sliding))
    } else {
        Err(refused)
    };
    Drawn {
        text,
        srdf,
        expected,
        said,
        words,
    }
}

// Fails if one of 300 files gets another root, tip or number of joints than a person would name, is refused without the names
// of the tips that could be meant or in more than one line, if an oddity is not said or said twice, or if the file is written
// back otherwise than it was.
#[test]
fn drawn_files_are_read_or_refused_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let mut wrong = Vec::new();
    let mut refusals = 0;
    for seed in 0..FILES {
        let drawn = draw(seed);
        let file = folder.path().join(format!("odd{seed}.urdf"));
        std::fs::write(&file, &drawn.text).unwrap();
        if let Some(srdf) = &drawn.srdf {
            std::fs::write(file.with_extension("srdf"), srdf).unwrap();
        }
        let found = load_path(&file.display().to_string());
        let right = match (&found, &drawn.expected) {
            (Ok(model), Ok((root, tip, turning, sliding))) => {
                let path = model.joint_path().unwrap();
                let slides = path
                    .joints
                    .iter()
                    .filter(|joint| joint.kind == JointKind::Slides)
                    .count();
                let said = |words: &&str| model.notes.iter().filter(|note| note.contains(words)).count() == 1;
                let text = crate::encoding::decode(&drawn.text).unwrap();
                (&model.frame_names.0, &model.frame_names.1) == (root, tip)
                    && (model.robot.dof(), slides) == (*turning, *sliding)
                    && model.notes.len() == drawn.said.len()
                    && drawn.said.iter().all(said)
                    && model.chain_words().is_some_and(|words| !words.contains('\n'))
                    && write_urdf(model, &model.rows(), &[]) == text
            }
            (Err(error), Err(words)) => {
                refusals += 1;
                let said = error.to_string();
                words.iter().all(|word| said.contains(word)) && !said.contains('\n') && said.len() < 700
            }
            _ => false,
        };
        if !right {
            let found = found.map(|m| (m.frame_names, m.robot.dof(), m.notes));
            wrong.push(format!(
                "{seed}: {}: {:?}, found {found:?}",
                drawn.words, drawn.expected
            ));
        }
    }
    assert!(wrong.is_empty(), "{} of {FILES}:\n{}", wrong.len(), wrong.join("\n"));
    assert!((10..FILES / 4).contains(&refusals), "{refusals} refusals");
}
