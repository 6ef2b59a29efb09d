//! Writes the first corpora: one good example of everything.
//!
//! `scripts/fuzz seed`; what the fuzzer finds beyond is not kept in the
//! repository, but for findings that were mended. It is a fuzz target in form,
//! for what is instrumented links with libFuzzer only.

#![no_main]

use std::path::Path;

use spherecal_fci::wire as fci;
use spherecal_fci::wire::{MAX_COMMAND_SIZE, MAX_STATE_SIZE, RobotCommand, RobotMode, RobotState, Version};
use spherecal_fri::wire as fri;
use spherecal_fuzz::joined;
#[cfg(feature = "host")]
use spherecal_job::Config;
#[cfg(feature = "host")]
use spherecal_model::robots;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::drive::{DriveState, DriveStatus};
use spherecal_shared::protocol::frame::{self, MAX_FRAME};
use spherecal_shared::protocol::host::{
    ApproachCommand, Banner, Command, Downlink, Event, Fault, FaultReport, ImpedanceCommand, Phase, PhaseChange,
    PoseCommand, Recording, Refusal, SignalStatistics, Uplink,
};
use spherecal_shared::protocol::{PROTOCOL_VERSION, SCHEMA};
use spherecal_shared::robot::{iiwa7, iiwa7_tool};
#[cfg(feature = "host")]
use spherecal_store::{CalibrationStore as _, NewRun, SqlStore, StoredPose};
use spherecal_ur::wire as ur;

/// Joint angles of an LBR, in rad.
const HOME: [f64; 7] = [0.0, 0.6, 0.0, -1.6, 0.0, 0.9, 0.0];

fn write(target: &str, name: &str, bytes: &[u8]) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(target);
    std::fs::create_dir_all(&folder).expect("a folder");
    std::fs::write(folder.join(name), bytes).expect("written");
}

fn body(message: &impl serde::Serialize) -> Vec<u8> {
    postcard::to_stdvec(message).expect("it fits")
}

libfuzzer_sys::fuzz_target!(
    init: {
        links();
        robots_wires();
        #[cfg(feature = "host")]
        host();
        // There is nothing to fuzz.
        if links_written() {
            std::process::exit(0)
        }
    },
    |_data: &[u8]| {}
);

/// Whether the corpora are there, as they always are by then.
fn links_written() -> bool {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus/frames").is_dir()
}

/// Messages of the robots' own interfaces: behind the two bytes that choose version and decoder, and plain.
fn robots_wires() {
    for (version, choice) in Version::ALL.into_iter().zip(0..) {
        let name = |what: &str| format!("{what}-{version}");
        let chosen = |decoder: u8, bytes: &[u8]| [&[choice, decoder], bytes].concat();
        let state = RobotState {
            message_id: 7,
            robot_mode: RobotMode::Move,
            ..RobotState::default()
        };
        let mut bytes = [0; MAX_STATE_SIZE];
        let size = state.encode(version, &mut bytes);
        write("fci", &name("state"), &chosen(0, &bytes[..size]));
        let mut bytes = [0; MAX_COMMAND_SIZE];
        let size = RobotCommand::torque(7, [0.5; 7]).encode(version, &mut bytes);
        write("fci", &name("command"), &chosen(1, &bytes[..size]));
        let load = fci::FlangeLoad {
            mass: 1.5,
            centre_of_mass: [0.0, 0.0, 0.05],
            inertia: [0.0; 9],
        };
        for (what, request) in [
            (
                "connect",
                fci::Request::Connect {
                    version: version.number(),
                    udp_port: 50_000,
                },
            ),
            ("move", fci::Request::Move(fci::MoveRequest::torque(version))),
            ("load", fci::Request::SetLoad(load)),
        ] {
            let mut bytes = Vec::new();
            request.encode(version, 1, &mut bytes).expect("it fits");
            write("fci", &name(what), &chosen(2, &bytes));
        }
        let mut bytes = Vec::new();
        let response = fci::Response {
            command: fci::CommandKind::Move,
            id: 1,
            status: fci::Status::MotionStarted,
            body: &[],
        };
        response.encode(version, &mut bytes).expect("it fits");
        write("fci", &name("response"), &chosen(3, &bytes));
    }
    let mut bytes = [0; fri::MAX_MESSAGE_SIZE];
    let monitoring = fri::MonitoringMessage {
        sequence: 1,
        reflected_sequence: 0,
        robot: fri::RobotInfo {
            number_of_joints: Some(7),
            safety: Some(fri::SafetyState::NormalOperation),
            ..fri::RobotInfo::default()
        },
        measured_position: HOME,
        measured_torque: [1.0; 7],
        commanded_position: Some(HOME),
        commanded_torque: None,
        external_torque: Some([0.0; 7]),
        time: Some(fri::Timestamp::default()),
        connection: fri::ConnectionInfo {
            session: fri::SessionState::CommandingActive,
            quality: fri::Quality::Excellent,
            send_period_ms: Some(1),
            receive_multiplier: Some(1),
        },
        ipo: Some(fri::IpoData {
            joint_position: Some(HOME),
            command_mode: Some(fri::ClientCommandMode::Torque),
            ..fri::IpoData::default()
        }),
        end: None,
    };
    let size = monitoring.encode(&mut bytes, true).expect("it fits");
    write("fri", "monitoring", &bytes[..size]);
    let command = fri::CommandMessage {
        sequence: 1,
        reflected_sequence: 1,
        joint_position: Some(HOME),
        joint_torque: Some([0.5; 7]),
        ..fri::CommandMessage::default()
    };
    let size = command.encode(&mut bytes, true).expect("it fits");
    write("fri", "command", &bytes[..size]);
    let names = vec!["timestamp".to_owned(), "actual_q".to_owned()];
    let requests = [
        ur::Request::ProtocolVersion(ur::PROTOCOL),
        ur::Request::SetupOutputs { rate_hz: 500.0, names },
    ];
    write("ur", "requests", &requests.map(|request| request.encode()).concat());
    let setup = ur::Setup {
        recipe: 1,
        types: vec!["DOUBLE".to_owned(), "VECTOR6D".to_owned()],
    };
    let answers = [
        ur::Answer::ProtocolVersion(true),
        ur::Answer::SetupOutputs(setup),
        ur::Answer::Data(1, vec![0; 56]),
    ];
    write("ur", "answers", &answers.map(|answer| answer.encode()).concat());
    write("ur", "calibration", &ur::KinematicsInfo::default().encode());
    let request = ur::HttpRequest {
        method: "PUT".to_owned(),
        path: "/state".to_owned(),
        body: b"{}".to_vec(),
    };
    write("ur", "http_request", &request.encode("robot"));
    write("ur", "http_answer", b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n2\r\n{}\r\n0\r\n");
}

/// Messages of both links.
fn links() {
    let commands = [
        ("robot", Command::Robot(iiwa7().driven().expect("seven joints"))),
        (
            "configure",
            Command::Configure {
                tool: iiwa7_tool(),
                procedure: Procedure::default(),
            },
        ),
        (
            "move",
            Command::Move {
                target: [0.1, 0.6, 0.0, -1.1, 0.0, 1.2, 0.1].into_iter().collect(),
            },
        ),
        (
            "approach",
            Command::Approach(ApproachCommand {
                sphere: 2,
                direction: [0.0, 0.0, -1.0],
            }),
        ),
        (
            "pose",
            Command::Pose(PoseCommand {
                pose: 5,
                orientation: [0.0, 1.0, 0.0, 0.0],
                elbow_rad: Some(0.1),
                posture: [0.1, 0.6, 0.0, -1.1, 0.0, 1.2, 0.1].into_iter().collect(),
                record: true,
            }),
        ),
        ("decouple", Command::Decouple),
        ("stop", Command::Stop),
        ("clear", Command::ClearFault),
        ("guide", Command::HandGuide { on: true }),
        (
            "impedance",
            Command::Impedance(ImpedanceCommand {
                stiffness_n_m: [400.0, 400.0, 200.0],
                rotation_nm_rad: 50.0,
                offset_m: [0.0, 0.0, 0.01],
                turn_rad: [0.0, 0.0, 0.1],
            }),
        ),
        ("hello", Command::Hello),
    ];
    let mut all = Vec::new();
    for (name, command) in commands {
        let mut message = Downlink::at_once(1, command);
        message.start_us = 5000;
        let mut piece = vec![3];
        piece.extend(body(&message));
        write("frames", &format!("down-{name}"), &body(&message));
        write("commands", name, &joined(std::slice::from_ref(&piece)));
        all.push(piece);
    }
    write("commands", "all", &joined(&all));
    let joints = |x: f64| [x; 7].into_iter().collect::<spherecal_shared::Joints>();
    let states: Vec<Vec<u8>> = (0..6u64)
        .map(|k| {
            let state = DriveState {
                session: 1,
                tick: k + 3,
                q: joints(0.01 * k as f64),
                dq: joints(0.0),
                tau: joints(if k == 4 { f64::NAN } else { 1.0 }),
                status: DriveStatus::Ready,
            };
            [vec![1], body(&state)].concat()
        })
        .collect();
    write("drive", "six", &joined(&states));
    let signal = SignalStatistics {
        mean: 0.1,
        std: 1e-6,
        min: 0.09,
        max: 0.11,
    };
    let happened = [
        Event::Banner(Banner {
            protocol: PROTOCOL_VERSION,
            schema: SCHEMA,
            version: "0.1.0".try_into().expect("short"),
            build: "fuzz".try_into().expect("short"),
            joints: 7,
            period_us: 1000,
            first_event: 1,
        }),
        Event::Held { sequence: 1 },
        Event::Reply {
            sequence: 1,
            result: Err(Refusal::Phase),
        },
        Event::Phase(PhaseChange {
            phase: Phase::Moving,
            from: Phase::Idle,
            time_us: 5,
            tick: 6,
        }),
        Event::Recording(Recording {
            sphere: 1,
            pose: 2,
            start_us: 1,
            end_us: 2,
            count: 1000,
            gaps: 0,
            q: [signal; 7].into_iter().collect(),
            tau: [signal; 7].into_iter().collect(),
            tcp_spread_m: 1e-5,
            force_n: [0.1; 3],
        }),
        Event::Fault(FaultReport {
            fault: Fault::Force,
            phase: Phase::Turning,
            time_us: 9,
            tick: 9,
            joint: 0,
            value: 70.0,
            limit: 60.0,
        }),
    ];
    let messages: Vec<Vec<u8>> = happened
        .into_iter()
        .zip(0..)
        .map(|(event, k): (Event, u32)| {
            body(&Uplink {
                session: [1; 4],
                event: k.saturating_sub(2),
                body: event,
            })
        })
        .collect();
    for (message, k) in messages.iter().zip(0..) {
        write("frames", &format!("up-{k}"), message);
    }
    write("events", "six", &joined(&messages));
    let mut out = [0; MAX_FRAME];
    let length = frame::encode(&Downlink::at_once(1, Command::Stop), 1, 2, &mut out).expect("it fits");
    write("frames", "framed", &out[..length]);
}

/// Files that users bring.
/// Rests of an arm, with points and numbers of spheres: one message a piece, its topic first.
#[cfg(feature = "host")]
fn bags() {
    use spherecal_fuzz::JOINTS;
    let cdr = |topic: u8, time_ms: u32| {
        let mut message = vec![topic, 0, 1, 0, 0];
        message.extend((time_ms / 1000 + 1).to_le_bytes());
        message.extend((time_ms % 1000 * 1_000_000).to_le_bytes());
        // The frame: an empty text, then the gap to a multiple of four.
        message.extend([1, 0, 0, 0, 0, 0, 0, 0]);
        message
    };
    let joints = |time_ms: u32| {
        let mut message = cdr(0, time_ms);
        message.extend(6_u32.to_le_bytes());
        for name in JOINTS {
            message.extend(3_u32.to_le_bytes());
            message.extend([name.as_bytes(), &[0, 0]].concat());
        }
        message.extend([6, 0, 0, 0]);
        while (message.len() - 5) % 8 != 0 {
            message.push(0);
        }
        (1..=6).for_each(|k| message.extend((0.1 * f64::from(k)).to_le_bytes()));
        message.extend([0; 8]);
        message
    };
    let point = |time_ms: u32| {
        let mut message = cdr(1, time_ms);
        while (message.len() - 5) % 8 != 0 {
            message.push(0);
        }
        [0.5_f64, 0.0, 0.3].iter().for_each(|x| message.extend(x.to_le_bytes()));
        message
    };
    let number = |_: u32| vec![4, 0, 1, 0, 0, 2, 0, 0, 0];
    // The first byte asks for made bags, and for the topic of the targets.
    for (name, kind, target) in [
        ("points", 1, &point as &dyn Fn(u32) -> Vec<u8>),
        ("numbers", 1 + 8 * 3, &number),
    ] {
        let messages: Vec<Vec<u8>> = (0..40).flat_map(|k| [joints(16 * k), target(16 * k)]).collect();
        let mut data = vec![kind];
        for message in &messages {
            data.extend((message.len() as u16).to_le_bytes());
            data.extend(message);
        }
        assert_eq!(spherecal_fuzz::bag(&data), 1, "{name}: a rest with a target is a pose");
        write("bag", name, &data);
    }
}

#[cfg(feature = "host")]
fn host() {
    write(
        "csv",
        "absolute",
        b"q1,q2,q3,q4,q5,q6,q7,x_mm,y_mm,z_mm\n0.1,0.2,0.3,-1,0.5,0.6,0.7,500,0,300\n",
    );
    write(
        "csv",
        "spheres",
        b"q1_deg;q2_deg;q3_deg;q4_deg;q5_deg;q6_deg;sphere;place;set\n1;2;3;4;5;6;2;a;validate\n",
    );
    write(
        "csv",
        "frames",
        b"arm_joint1,q2,q3,q4,q5,q6,x_m,y_m,z_m,qw,qx,qy,qz,time\n0.1,0.2,0.3,-1,0.5,0.6,0.5,0,0.3,1,0,0,0,7\n",
    );
    write(
        "csv",
        "points",
        b"sep=;\nq1;q2;q3;q4;q5;q6;x1_mm;y1_mm;z1_mm;x2_mm;y2_mm;z2_mm\n0,1;0,2;0,3;-1;0,5;0,6;500;0;300;;;\n",
    );
    write(
        "csv",
        "utf16",
        &[
            0xff, 0xfe, b'q', 0, b'1', 0, b'\t', 0, b's', 0, b'p', 0, b'h', 0, b'e', 0, b'r', 0, b'e', 0, b'\n', 0,
        ],
    );
    write(
        "csv",
        "plate",
        b"[[sphere]]\nid = 1\nx_mm = 0.0\ny_mm = 1.0\nz_mm = 2.0\nsigma_mm = 0.001\n",
    );

    bags();
    let config = Config::default();
    write("config", "all", config.to_toml().expect("it can be written").as_bytes());
    write("config", "cell", b"seed = 7\n[plan]\nposes = 30\nchoice = \"grid\"\n[plant]\npreset = \"typical\"\n[plant.plate]\nplacement_sigma_m = 0.0015\n[cell.tool]\ntcp_mm = [50.0, 0.0, 100.0]\n[host_link]\nloss = 0.2\n");

    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/data");
    for name in ["ur5e.urdf", "irb120.urdf"] {
        let text = std::fs::read(data.join(name)).expect("the reference data are there");
        write("robots", name, &text);
    }
    let model = robots::load("ur5e").expect("built in");
    write("robots", "ur5e.toml", robots::toml_file::write(&model, &[]).as_bytes());
    write(
        "robots",
        "ur5e.yaml",
        robots::write_kinematics_yaml(&model, &model.rows(), &[]).as_bytes(),
    );
    let panda = robots::load("panda").expect("built in");
    write(
        "robots",
        "panda.yaml",
        robots::write_kinematics_yaml(&panda, &panda.rows(), &[]).as_bytes(),
    );

    let folder = std::env::temp_dir().join(format!("spherecal-seed-{}", std::process::id()));
    let path = folder.join("seed.db");
    let mut store = SqlStore::create_or_open(&path).expect("made");
    let run = store
        .create_run(&NewRun {
            created_utc: "2026-01-01T00:00:00Z".to_owned(),
            seed: 1,
            link: "sim".to_owned(),
            robot: iiwa7(),
            tool: iiwa7_tool(),
            config_toml: "seed = 1\n".to_owned(),
            plan_json: "{}".to_owned(),
            program: "seed".to_owned(),
            spheres: spherecal_model::paper_plate(),
            poses: vec![StoredPose {
                sphere: 1,
                pose: 1,
                orientation: [1.0, 0.0, 0.0, 0.0],
                elbow_rad: None,
            }],
            arm: String::new(),
        })
        .expect("a run");
    store.begin_session(run, "now").expect("a session");
    drop(store);
    write("database", "empty-run", &std::fs::read(&path).expect("read"));
    std::fs::remove_dir_all(&folder).expect("removed");
}
