//! The targets of the host.

use std::path::PathBuf;

use spherecal_job::Config;
use spherecal_link::{HostEndpoint, Timing};
use spherecal_model::Target;
use spherecal_model::input::{Labels, TableFormat, read_csv, read_plate};
use spherecal_model::robots;
use spherecal_shared::protocol::host::{Command, Uplink};
use spherecal_store::{CalibrationStore as _, SqlStore, recover};

use crate::{framed, pieces};

/// Any messages of a controller to the host's end: each event once, in order.
pub fn events(data: &[u8]) {
    let mut endpoint = HostEndpoint::new(Timing::default());
    endpoint.send(Command::Hello);
    let mut down = Vec::new();
    let _ = endpoint.transmit(0, &mut down);
    let (mut arrived, mut last, mut now) = (Vec::new(), None, 0);
    for (body, k) in pieces(data).take(64).zip(1..) {
        now += 1000;
        let up = match postcard::from_bytes::<Uplink>(body) {
            Ok(mut message) => {
                if message.session[0] % 4 != 0 {
                    message.session = endpoint.session();
                }
                framed(&message, k)
            }
            Err(_) => body.to_vec(),
        };
        let stored: Result<(), ()> = endpoint.receive(&up, &mut arrived, |batch| {
            for arrival in batch {
                let next = last.map_or(arrival.event, |last: u32| last.wrapping_add(1).max(1));
                assert_eq!(arrival.event, next, "out of order");
                last = Some(arrival.event);
            }
            Ok(())
        });
        assert!(stored.is_ok());
        down.clear();
        let _ = endpoint.transmit(now, &mut down);
    }
}

/// Any table of poses, and any certificate of a plate.
pub fn csv(data: &[u8]) {
    let joints = data.first().map_or(7, |b| if b % 2 == 0 { 6 } else { 7 });
    let mut places = Labels::default();
    let format = TableFormat {
        joint_names: (1..=joints).map(|k| format!("arm_joint{k}")).collect(),
        ignore: vec!["time".to_owned()],
        label: Some("note".to_owned()),
        ..TableFormat::new(joints)
    };
    if let Ok(table) = read_csv("fuzz.csv", data, &format, &mut places) {
        for row in table.rows() {
            assert_eq!(row.q.len(), joints);
            assert!(row.q.iter().all(|q| q.is_finite()), "{row:?}");
            if let Target::Frame(pose) = row.target() {
                assert!((pose.rotation.determinant() - 1.0).abs() < 1e-6, "{row:?}");
            }
        }
    }
    if let Ok(text) = std::str::from_utf8(data)
        && let Ok(plate) = read_plate("fuzz.toml", text)
    {
        assert!(plate.spheres.iter().all(|s| s.sigma_m > 0.0), "{plate:?}");
    }
}

/// Topics of a made bag, and their types.
const TOPICS: [(&str, &str); 5] = [
    ("/joint_states", "sensor_msgs/msg/JointState"),
    ("/point", "geometry_msgs/msg/PointStamped"),
    ("/pose", "geometry_msgs/msg/PoseStamped"),
    ("/tip", "geometry_msgs/msg/TransformStamped"),
    ("/number", "std_msgs/msg/Int32"),
];

/// Names of the joints in a made bag.
pub const JOINTS: [&str; 6] = ["j1", "j2", "j3", "j4", "j5", "j6"];

/// Any bag: any bytes as a file, or a file whose messages are any bytes. What is read is finite.
/// Returns the number of poses.
pub fn bag(data: &[u8]) -> usize {
    let Some((kind, rest)) = data.split_first() else {
        return 0;
    };
    let folder = folder();
    std::fs::create_dir_all(&folder).expect("a folder");
    let file = folder.join("fuzz.mcap");
    let mut wanted = spherecal_bag::Wanted::new(JOINTS.map(str::to_owned).to_vec());
    let target = usize::from(kind / 8) % (TOPICS.len() - 1) + 1;
    if kind % 4 == 0 {
        std::fs::write(&file, rest).expect("written");
    } else {
        made_bag(&file, rest);
        wanted.topics = vec![TOPICS[0].0.to_owned(), TOPICS[target].0.to_owned()];
    }
    wanted.effort_nm = kind % 2 == 0;
    let Ok(poses) = spherecal_bag::read_bag(&file, &wanted, &mut |_| ()) else {
        return 0;
    };
    let text = poses.to_csv();
    let mut numbers = text
        .lines()
        .skip(1)
        .flat_map(|line| line.split(','))
        .filter_map(|cell| cell.parse::<f64>().ok());
    assert!(numbers.all(f64::is_finite), "{text}");
    poses.len()
}

/// A bag with the pieces as messages, 10 ms apart; the first byte of each names its topic.
fn made_bag(file: &std::path::Path, data: &[u8]) {
    let out = std::io::BufWriter::new(std::fs::File::create(file).expect("a file"));
    let options = mcap::WriteOptions::new().compression(None).profile("ros2");
    let mut writer = options.create(out).expect("a bag");
    let channels = TOPICS.map(|(topic, kind)| {
        let schema = writer.add_schema(kind, "ros2msg", b"").expect("a schema");
        let none = std::collections::BTreeMap::new();
        writer.add_channel(schema, topic, "cdr", &none).expect("a channel")
    });
    for (piece, k) in pieces(data).take(512).zip(0_u64..) {
        let Some((topic, body)) = piece.split_first() else {
            continue;
        };
        let header = mcap::records::MessageHeader {
            channel_id: channels[usize::from(*topic) % channels.len()],
            sequence: 0,
            log_time: 10_000_000 * k,
            publish_time: 10_000_000 * k,
        };
        writer.write_to_known_channel(&header, body).expect("written");
    }
    writer.finish().expect("finished");
}

/// Any configuration: refused, or one that can be written and read again.
pub fn config(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let Ok(config) = Config::parse("fuzz.toml", text) else {
        return;
    };
    if config.check().is_ok() {
        let again = config.to_toml().expect("what was read can be written");
        let read = Config::parse("again.toml", &again).expect("what was written can be read");
        assert!(read.check().is_ok());
    }
}

/// Any robot description, URDF, TOML or YAML: refused, or a robot that passes its check.
pub fn robots(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    for model in [
        robots::load_urdf_text("fuzz.urdf", text, None),
        robots::toml_file::load("fuzz.toml", text),
        robots::kinematics_yaml::load("fuzz.yaml", text),
    ]
    .into_iter()
    .flatten()
    {
        assert!(model.robot.check().is_ok());
    }
}

/// A folder that the process has to itself.
fn folder() -> PathBuf {
    // In memory where there is such a place: the fuzzer writes thousands of files a second.
    let base = PathBuf::from("/dev/shm");
    let base = if base.is_dir() { base } else { std::env::temp_dir() };
    base.join(format!("spherecal-fuzz-{}", std::process::id()))
}

/// Any file as a database: refused, or read to its end; and what can be
/// recovered of it is a database.
pub fn database(data: &[u8]) {
    let folder = folder();
    std::fs::create_dir_all(&folder).expect("a folder");
    let (file, saved) = (folder.join("fuzz.db"), folder.join("saved.db"));
    for old in [&file, &saved] {
        for end in ["", "-wal", "-shm", "-journal"] {
            let mut name = old.clone().into_os_string();
            name.push(end);
            let _ = std::fs::remove_file(name);
        }
    }
    std::fs::write(&file, data).expect("written");
    if let Ok(mut store) = SqlStore::open(&file) {
        read_all(&mut store);
    }
    // Dearer: only now and then.
    if data.last().is_some_and(|byte| byte % 8 == 1) && recover(&file, &saved).is_ok() {
        read_all(&mut SqlStore::open(&saved).expect("what was recovered can be opened"));
    }
}

fn read_all(store: &mut SqlStore) {
    for info in store.runs().unwrap_or_default() {
        let _ = spherecal_job::read(store, &info);
        let _ = store.read_run(info.run);
        let _ = store.result(info.run, "summary");
    }
}
