//! Whole bags: what is read, and what is refused in which words.

use std::path::Path;

use mcap::Compression;

use super::test_bag::{CdrMessage, TestBag, joint_state, point};
use super::{Poses, Wanted, read_bag};

#[path = "sqlite_tests.rs"]
mod sqlite;
#[path = "streamed_tests.rs"]
mod streamed;

const START_NS: u64 = 1_790_000_000_000_000_000;
const JOINT_STATE: &str = "sensor_msgs/msg/JointState";
const POINT: &str = "geometry_msgs/msg/PointStamped";

fn wanted() -> Wanted {
    Wanted::new(vec!["shoulder".to_owned(), "elbow".to_owned()])
}

fn read(path: &Path, wanted: &Wanted) -> Result<Poses, String> {
    read_bag(path, wanted, &mut |_| {}).map_err(|error| error.to_string())
}

/// The message refuses, and names each of these.
fn refused(path: &Path, wanted: &Wanted, words: &[&str]) {
    let error = read(path, wanted).expect_err("refused");
    for word in words {
        assert!(error.contains(word), "\"{word}\" is not in: {error}");
    }
}

/// Writes the joint states of a number of rests of 1 s, with 0.5 s of motion between, at 100 Hz. The elbow is named first,
/// and a gripper is there too. Calls `each` with the time in the middle of each rest.
fn joints(bag: &mut TestBag, rests: usize, mut each: impl FnMut(&mut TestBag, usize, u64)) {
    for k in 0..150 * rests {
        let time = START_NS + 10_000_000 * k as u64;
        let (rest, step) = (k / 150, k % 150);
        let q = rest as f64 * 0.2
            + if step < 100 {
                0.0
            } else {
                (step - 99) as f64 * 0.2 / 51.0
            };
        let data = joint_state(time, &["elbow", "finger", "shoulder"], &[-q, 0.04, q], &[2.0, 0.0, 1.0]);
        bag.put("/joint_states", JOINT_STATE, "cdr", time, &data);
        if step == 50 {
            each(bag, rest, time);
        }
    }
}

/// A bag with a measured point per rest.
fn points(folder: &Path, frame: &str, compression: Option<Compression>) -> std::path::PathBuf {
    let mut bag = TestBag::compressed(folder, compression);
    joints(&mut bag, 4, |bag, rest, time| {
        let at = [rest as f64, 0.25, -0.5];
        bag.put("/tracker/point", POINT, "cdr", time, &point(time, frame, at));
    });
    bag.finish()
}

// Fails if a joint is taken by its place in the message and not by its name, or a compression is not read.
#[test]
fn a_rest_with_a_point_is_a_row() {
    let folder = tempfile::tempdir().unwrap();
    for compression in [None, Some(Compression::Lz4), Some(Compression::Zstd)] {
        let poses = read(&points(folder.path(), "tracker", compression), &wanted()).unwrap();
        let csv = poses.to_csv();
        let rows: Vec<&str> = csv.lines().collect();
        assert_eq!(rows[0], "q1,q2,x_m,y_m,z_m");
        assert_eq!(rows[2], "0.2,-0.2,1,0.25,-0.5");
        assert_eq!(rows.len(), 5);
        assert!(poses.notes[0].starts_with("4 poses were formed"), "{:?}", poses.notes);
        assert!(poses.notes[1].contains("--effort-nm"), "{:?}", poses.notes);
    }
    let torques = Wanted {
        effort_nm: true,
        ..wanted()
    };
    let csv = read(&folder.path().join("bag.mcap"), &torques).unwrap().to_csv();
    assert!(csv.starts_with("q1,q2,tau1,tau2,x_m,y_m,z_m\n0,0,1,2,0,"), "{csv}");
}

// Fails if a contact is not told from a measured point, or a placement is lost.
#[test]
fn contacts_by_frame_and_by_number() {
    let folder = tempfile::tempdir().unwrap();
    let mut bag = TestBag::new(folder.path());
    joints(&mut bag, 4, |bag, rest, time| {
        let frame = format!("plate_{}/sphere_{}", rest / 2, rest % 2 + 1);
        bag.put("/contact", POINT, "cdr", time, &point(time, &frame, [0.0; 3]));
        let number = CdrMessage::new().u32(rest as u32 + 7).bytes();
        bag.put("/sphere", "std_msgs/msg/Int32", "cdr", time, &number);
    });
    let path = bag.finish();
    let csv = read(&path, &wanted()).unwrap().to_csv();
    let rows: Vec<&str> = csv.lines().collect();
    assert_eq!(rows[0], "q1,q2,sphere,place");
    assert_eq!(
        (rows[1], rows[4]),
        (
            "0,0,1,\"plate_0\"",
            "0.6000000000000001,-0.6000000000000001,2,\"plate_1\""
        )
    );
    // A number must be named, and its topic has no header: times are the recorder's.
    let named = Wanted {
        topics: vec!["/joint_states".to_owned(), "/sphere".to_owned()],
        ..wanted()
    };
    let poses = read(&path, &named).unwrap();
    assert!(
        poses.to_csv().starts_with("q1,q2,sphere\n0,0,7\n"),
        "{}",
        poses.to_csv()
    );
    assert!(
        poses.notes[0].ends_with("times are those of the recorder"),
        "{:?}",
        poses.notes
    );
}

// Fails if a bag that cannot be used is read, or its message lacks topic, type or remedy.
#[test]
fn topics_that_are_missing_or_not_clear_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = points(folder.path(), "tracker", None);
    let named = |topics: &[&str]| Wanted {
        topics: topics.iter().map(|t| (*t).to_owned()).collect(),
        ..wanted()
    };
    refused(
        &path,
        &named(&["/joint_states", "/no"]),
        &["no message on the topic \"/no\"", "/tracker/point"],
    );
    refused(
        &path,
        &named(&["/joint_states"]),
        &["no topic with measured points", POINT],
    );
    let other = Wanted::new(vec!["left_shoulder".to_owned(), "elbow".to_owned()]);
    refused(
        &path,
        &other,
        &["left_shoulder", "elbow, finger, shoulder", "--joint-columns"],
    );

    let mut bag = TestBag::new(folder.path());
    joints(&mut bag, 2, |bag, _, time| {
        bag.put("/a", POINT, "cdr", time, &point(time, "t", [0.0; 3]));
        bag.put("/b", POINT, "cdr", time, &point(time, "t", [0.0; 3]));
    });
    refused(
        &bag.finish(),
        &wanted(),
        &["several topics with measured points", "/a", "/b", "--topics"],
    );

    let mut bag = TestBag::new(folder.path());
    bag.put("/joint_states", "sensor_msgs/JointState", "json", START_NS, b"{}");
    bag.put("/p", POINT, "cdr", START_NS, &point(START_NS, "t", [0.0; 3]));
    refused(
        &bag.finish(),
        &wanted(),
        &["/joint_states", "\"json\"", "export --format ros2"],
    );

    refused(
        &TestBag::new(folder.path()).finish(),
        &wanted(),
        &["it has no messages", JOINT_STATE],
    );
}

// Fails if a message that cannot be used is read, or its message lacks topic, number or remedy.
#[test]
fn messages_that_cannot_be_used_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let with = |each: &dyn Fn(usize, u64) -> Vec<u8>| {
        let mut bag = TestBag::new(folder.path());
        joints(&mut bag, 3, |bag, rest, time| {
            bag.put("/point", POINT, "cdr", time, &each(rest, time));
        });
        bag.finish()
    };
    let path = with(&|rest, time| point(time, if rest == 2 { "other" } else { "t" }, [0.0; 3]));
    refused(
        &path,
        &wanted(),
        &["/point", POINT, "message 3", "\"other\"", "one frame"],
    );
    let path = with(&|rest, time| point(time, "t", [0.0, if rest == 1 { f64::NAN } else { 0.0 }, 0.0]));
    refused(&path, &wanted(), &["message 2", "its y is NaN"]);
    let path = with(&|_, time| point(time, "sphere_1", [0.1, 0.0, 0.0]));
    refused(&path, &wanted(), &["message 1", "sphere_1", "(0, 0, 0)"]);
    let path = with(&|_, time| point(time, "t", [0.0; 3])[..30].to_vec());
    refused(&path, &wanted(), &["message 1", "ends before its last field"]);
    let path = with(&|_, _| vec![0, 3, 0, 0, 0, 0]);
    refused(&path, &wanted(), &["message 1", "0003"]);

    // Another clock: no time in common.
    let path = with(&|_, time| point(time - START_NS + 1, "t", [0.0; 3]));
    refused(&path, &wanted(), &["no time in common", "use_sim_time"]);
    // The arm moves at the times of the points.
    let path = with(&|_, time| point(time + 800_000_000, "t", [0.0; 3]));
    refused(&path, &wanted(), &["none of the 3 messages of /point"]);

    let mut bag = TestBag::new(folder.path());
    joints(&mut bag, 3, |bag, _, time| {
        bag.put("/point", POINT, "cdr", time, &point(time, "t", [0.0; 3]));
        bag.put("/point", POINT, "cdr", time, &point(time, "t", [0.02, 0.0, 0.0]));
    });
    refused(
        &bag.finish(),
        &wanted(),
        &["/point", "10.0 mm from their mean", "at most 2 mm"],
    );

    let mut bag = TestBag::new(folder.path());
    bag.put("/point", POINT, "cdr", START_NS, &point(START_NS, "t", [0.0; 3]));
    bag.put(
        "/joint_states",
        JOINT_STATE,
        "cdr",
        START_NS,
        &joint_state(START_NS, &["elbow", "shoulder"], &[0.1], &[]),
    );
    refused(
        &bag.finish(),
        &wanted(),
        &["/joint_states", "message 1", "\"shoulder\"", "1 positions"],
    );
}

// Fails if a file or folder of another kind is not told by name, with the remedy.
#[test]
fn other_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        path
    };
    refused(
        &write("a.db3", b"SQLite format 3\0"),
        &wanted(),
        &["is not a whole bag in SQLite"],
    );
    refused(
        &write("a.bag", b"#ROSBAG V2.0\n"),
        &wanted(),
        &["ROS 1", "rosbags-convert"],
    );
    refused(
        &write("a.mcap.zstd", b"\x28\xb5\x2f\xfd"),
        &wanted(),
        &["compressed", "zstd -d"],
    );
    refused(
        &write("a.mcap", b"q1,q2\n"),
        &wanted(),
        &["does not begin as an MCAP file"],
    );
    refused(folder.path().join("no.mcap").as_path(), &wanted(), &["no such file"]);
    refused(Path::new("/dev/zero"), &wanted(), &["is a device"]);
    let empty = folder.path().join("empty");
    std::fs::create_dir(&empty).unwrap();
    refused(&empty, &wanted(), &["folder without a file in MCAP or SQLite"]);
    std::fs::write(empty.join("x_0.db3"), "").unwrap();
    refused(&empty, &wanted(), &["SQLite"]);
}

// Fails if a file that unpacks to thousands of times its size is read to its end.
#[test]
fn a_bomb_is_refused_before_it_is_unpacked() {
    let folder = tempfile::tempdir().unwrap();
    let mut bag = TestBag::compressed(folder.path(), Some(mcap::Compression::Zstd));
    let zeros = vec![0; 1 << 20];
    for k in 0..100 {
        bag.put("/camera", "sensor_msgs/msg/Image", "cdr", START_NS + k, &zeros);
    }
    let path = bag.finish();
    assert!(std::fs::metadata(&path).unwrap().len() < 1 << 20);
    refused(&path, &wanted(), &["more than 200 times"]);
}

// Fails if the parts of a split bag are read in the order of their names: 10 before 2.
#[test]
fn a_split_bag_is_read_in_its_order() {
    let folder = tempfile::tempdir().unwrap();
    let (parts, bag) = (folder.path().join("parts"), folder.path().join("bag"));
    std::fs::create_dir(&parts).unwrap();
    std::fs::create_dir(&bag).unwrap();
    for part in 0..11_u64 {
        let mut one = TestBag::new(&parts);
        for k in 0..100_u64 {
            let time = START_NS + (part * 100 + k) * 10_000_000;
            let q = part as f64 * 0.1;
            one.put(
                "/joint_states",
                JOINT_STATE,
                "cdr",
                time,
                &joint_state(time, &["elbow", "shoulder"], &[q, q], &[]),
            );
            if k == 50 {
                one.put("/point", POINT, "cdr", time, &point(time, "t", [q, 0.0, 0.0]));
            }
        }
        std::fs::rename(one.finish(), bag.join(format!("bag_{part}.mcap"))).unwrap();
    }
    let mut progress = Vec::new();
    let poses = read_bag(&bag, &wanted(), &mut |p| {
        progress.push((p.rows, p.bytes, p.total_bytes));
    })
    .unwrap();
    assert_eq!(poses.len(), 11);
    assert!(progress.is_sorted_by_key(|p| p.1), "{progress:?}");
    assert!(progress.iter().all(|p| p.1 <= p.2), "{progress:?}");
}

// Fails if a flipped bit or a missing end makes the reader panic, take all memory, or give other poses in silence.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_damage_is_an_error_and_no_panic() {
    let folder = tempfile::tempdir().unwrap();
    let path = points(folder.path(), "tracker", Some(Compression::Lz4));
    let bytes = std::fs::read(&path).unwrap();
    let whole = read(&path, &wanted()).unwrap().to_csv();
    let damaged = folder.path().join("damaged.mcap");
    let mut errors = 0;
    let bits = (0..64 * 8).chain((0..600).map(|k| bytes.len() * 8 / 600 * k + k % 8));
    for bit in bits {
        let mut flipped = bytes.clone();
        flipped[bit / 8] ^= 1 << (bit % 8);
        std::fs::write(&damaged, &flipped).unwrap();
        match read(&damaged, &wanted()) {
            // Bits of the index, the time of recording or the library's name change no pose.
            Ok(poses) if !poses.notes.iter().any(|n| n.contains("ends early")) => {
                assert_eq!(poses.to_csv(), whole, "bit {bit}");
            }
            Ok(_) => errors += 1,
            Err(_) => errors += 1,
        }
    }
    assert!(errors > 300, "{errors}");
    for cut in [9, bytes.len() / 2, bytes.len() - 8] {
        std::fs::write(&damaged, &bytes[..cut]).unwrap();
        match read(&damaged, &wanted()) {
            Ok(poses) => assert!(
                poses.notes.iter().any(|n| n.contains("ends early")),
                "{:?}",
                poses.notes
            ),
            Err(error) => assert!(error.contains("mcap recover"), "{error}"),
        }
    }
}

proptest::proptest! {
    // Fails if any bytes of a message panic.
    #[test]
    fn any_message_is_read_or_refused(data in proptest::collection::vec(proptest::prelude::any::<u8>(), 0..80)) {
        let mut data = data;
        // Mostly the encoding that is read.
        if data.len() > 4 && data[0] & 1 == 0 {
            data[..4].copy_from_slice(&[0, 1, 0, 0]);
        }
        let _ = super::messages::JointStateMessage::read(&data).map(|state| (state.names(), state.effort.get(3)));
        for (_, kind) in super::messages::TARGETS {
            let _ = super::messages::target(kind, &data, None);
        }
    }
}

// Fails if what is whole in a file that ends early is lost, or the loss is not said.
#[test]
fn a_file_that_ends_early_gives_its_whole_messages() {
    let folder = tempfile::tempdir().unwrap();
    // All messages of this bag are in one chunk. It is read as it comes, compressed too; of its head alone there is nothing.
    for (compression, words) in [
        (None, ["has no topic with measured points", "ends early"]),
        (Some(Compression::Lz4), ["it ends early", "mcap recover"]),
    ] {
        let path = points(folder.path(), "tracker", compression);
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        let part = read(&path, &wanted()).unwrap();
        assert!((1..4).contains(&part.len()), "{}", part.len());
        assert!(part.notes.iter().any(|n| n.contains("ends early")), "{:?}", part.notes);
        std::fs::write(&path, &bytes[..bytes.len() / 50]).unwrap();
        refused(&path, &wanted(), &words);
    }
    // In chunks of 4 KiB, most of it is whole.
    let mut bag = TestBag::in_chunks(folder.path(), 4096);
    joints(&mut bag, 4, |bag, rest, time| {
        bag.put("/p", POINT, "cdr", time, &point(time, "t", [rest as f64, 0.0, 0.0]));
    });
    let path = bag.finish();
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() * 6 / 10]).unwrap();
    let part = read(&path, &wanted()).unwrap();
    assert!((2..4).contains(&part.len()), "{}", part.len());
    assert!(
        part.notes
            .iter()
            .any(|n| n.contains("ends early") && n.contains("whole messages were read")),
        "{:?}",
        part.notes
    );
}

// Fails if a pose of another type is not the point that it holds, or the wrong transform of many is taken.
#[test]
fn poses_of_every_type_are_points() {
    let folder = tempfile::tempdir().unwrap();
    let pose = |message: CdrMessage, at: [f64; 3]| {
        [at[0], at[1], at[2], 0.0, 0.0, 0.0, 1.0]
            .iter()
            .fold(message, |m, x| m.f64(*x))
    };
    let at = |rest: usize| [rest as f64, 0.25, -0.5];
    let odometry = |time: u64, rest| pose(CdrMessage::new().header(time, "map").text("marker"), at(rest)).bytes();
    let array = |time: u64, rest| pose(CdrMessage::new().header(time, "camera").u32(1), at(rest)).bytes();
    let transforms = |time: u64, rest| {
        let other = pose(CdrMessage::new().u32(2).header(time, "base").text("marker"), [9.0; 3]);
        pose(other.header(time, "camera").text("marker"), at(rest)).bytes()
    };
    type Message<'a> = &'a dyn Fn(u64, usize) -> Vec<u8>;
    let cases: [(&str, Message<'_>, Option<(&str, &str)>); 3] = [
        ("nav_msgs/msg/Odometry", &odometry, None),
        ("geometry_msgs/msg/PoseArray", &array, None),
        ("tf2_msgs/msg/TFMessage", &transforms, Some(("camera", "marker"))),
    ];
    for (kind, message, pair) in cases {
        let mut bag = TestBag::new(folder.path());
        joints(&mut bag, 4, |bag, rest, time| {
            bag.put("/t", kind, "cdr", time, &message(time, rest));
        });
        let path = bag.finish();
        let mut named = Wanted {
            topics: vec!["/joint_states".to_owned(), "/t".to_owned()],
            ..wanted()
        };
        if pair.is_some() {
            refused(&path, &named, &["--tf PARENT:CHILD", "camera:marker"]);
        }
        named.transform = pair.map(|(parent, child)| (parent.to_owned(), child.to_owned()));
        let csv = read(&path, &named).unwrap().to_csv();
        assert_eq!(csv.lines().nth(2), Some("0.2,-0.2,1,0.25,-0.5"), "{kind}");
    }
}
