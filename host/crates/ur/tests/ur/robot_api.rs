//! The Robot API of PolyScope X: bytes of HTTP, our client against our robot side, and our client against hostile answers.

use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use spherecal_cyclic::testing::{LOCAL, World};
use spherecal_cyclic::{Listener, Process, Wire};
use spherecal_ur::client::{ClientConfig, ClientError, DashboardCommand, TorqueClient, ask_robot_api};
use spherecal_ur::robot::{ArmState, RobotConfig, RobotSide, start_robot};
use spherecal_ur::wire::{
    ControllerVersion, HTTP_CONFLICT, HTTP_FORBIDDEN, HttpAnswer, HttpRequest, Load, ROBOT_API, SafetyMode, Series,
    WireError,
};
use spherecal_ur::{DASHBOARD_BELOW_RTDE, RTDE_PORT, robot_api_port};

use crate::common::{calibration, config};

const UNLOCK: [DashboardCommand; 2] = [
    DashboardCommand::CloseSafetyPopup,
    DashboardCommand::UnlockProtectiveStop,
];
const REMOTE: [DashboardCommand; 1] = [DashboardCommand::IsInRemoteControl];
/// The first PolyScope X that closes messages.
const WITH_POPUPS: ControllerVersion = ControllerVersion {
    minor: 14,
    bugfix: 0,
    ..ControllerVersion::POLYSCOPE_X
};

/// What happens to a client's bytes.
struct Scripted {
    listener: Box<dyn Listener>,
    client: Option<Wire>,
    /// What is answered to anything.
    says: Vec<u8>,
    /// Whether the connection ends then.
    closes: bool,
    heard: Arc<Mutex<Vec<u8>>>,
}

impl Process for Scripted {
    fn turn(&mut self, now: Instant) -> Instant {
        if let Ok((stream, _)) = self.listener.accept() {
            self.client = Some(Wire::new(stream));
        }
        if let Some(wire) = &mut self.client {
            wire.poll();
            if !wire.received.is_empty() {
                self.heard.lock().expect("a lock").append(&mut wire.received);
                wire.send(&self.says);
                if self.closes {
                    wire.finish();
                }
            }
        }
        now + Duration::from_millis(2)
    }
}

/// What a client asks, and gets, of a Robot API that answers with these bytes; how long it took.
fn asked(
    version: ControllerVersion,
    commands: &[DashboardCommand],
    says: &[u8],
    closes: bool,
) -> (String, Result<String, ClientError>, Duration) {
    let world = World::new(0);
    let machine = world.machine();
    let listener = machine.listen(LOCAL).expect("a port");
    let port = listener.address().expect("an address").port() + DASHBOARD_BELOW_RTDE;
    let heard = Arc::default();
    let scripted = Scripted {
        listener,
        client: None,
        says: says.to_vec(),
        closes,
        heard: Arc::clone(&heard),
    };
    let _running = machine.run("robot", Box::new(scripted)).expect("a process");
    let settings = ClientConfig {
        machine: Arc::clone(&machine),
        port,
        ..ClientConfig::new("127.0.0.1")
    };
    let begun = machine.now();
    let answer = ask_robot_api(&settings, version, commands);
    let took = machine.now() - begun;
    let heard = heard.lock().expect("a lock");
    let heard = String::from_utf8_lossy(&heard).replace(&format!(":{}", port - DASHBOARD_BELOW_RTDE), ":80");
    (heard, answer, took)
}

// Fails if a request has other bytes than the Robot API takes, if the closing of a message is asked of software that cannot,
// or keeps the stop from being ended where it is refused.
#[test]
fn requests_have_the_bytes_of_the_robot_api() {
    let (unlock, remote, popup) = (
        "PUT /universal-robots/robot-api/robotstate/v1/state HTTP/1.1\r\nHost: 127.0.0.1:80\r\nAccept: application/json\r\n\
         Content-Type: application/json\r\nContent-Length: 35\r\nConnection: close\r\n\r\n{\"action\":\"UNLOCK_PROTECTIVE_STOP\"}",
        "GET /universal-robots/robot-api/system/v1/controlmode HTTP/1.1\r\nHost: 127.0.0.1:80\r\nAccept: application/json\r\n\
         Content-Length: 0\r\nConnection: close\r\n\r\n",
        "DELETE /universal-robots/robot-api/popup/v1/safety HTTP/1.1\r\nHost: 127.0.0.1:80\r\nAccept: application/json\r\n\
         Content-Length: 0\r\nConnection: close\r\n\r\n",
    );
    let mode = b"HTTP/1.1 200 OK\r\ncontent-length: 17\r\n\r\n{\"mode\":\"REMOTE\"}";
    let old = ControllerVersion::POLYSCOPE_X;
    for (version, commands, says, expected, answer) in [
        (old, &UNLOCK[..], &mode[..], unlock.to_owned(), true),
        (WITH_POPUPS, &UNLOCK, mode, format!("{popup}{unlock}"), true),
        (old, &REMOTE, mode, remote.to_owned(), true),
        (
            WITH_POPUPS,
            &UNLOCK,
            b"HTTP/1.1 404 \r\n\r\n",
            format!("{popup}{unlock}"),
            false,
        ),
    ] {
        let (heard, found, _) = asked(version, commands, says, true);
        assert_eq!((heard, found.is_ok()), (expected, answer), "{found:?}");
    }
}

// Fails if an answer is not read in each form that HTTP gives it, before it is whole, or with other bytes than came.
#[test]
fn answers_are_read_in_each_form() {
    let body = br#"{"mode":"LOCAL"}"#;
    let expected = HttpAnswer {
        status: 200,
        body: body.to_vec(),
    };
    let chunked =
        "HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\na;x=1\r\n{\"mode\":\"L\r\n6\r\nOCAL\"}\r\n0\r\n";
    for (bytes, closed) in [
        (expected.encode(), false),
        (chunked.as_bytes().to_vec(), false),
        ([b"HTTP/1.0 200 OK\r\nServer: x\r\n\r\n", &body[..]].concat(), true),
    ] {
        assert_eq!(HttpAnswer::decode(&bytes, closed), Ok(Some(expected.clone())));
        for cut in 0..bytes.len() {
            assert_eq!(HttpAnswer::decode(&bytes[..cut], false), Ok(None), "{cut}");
        }
    }
    let empty = HttpAnswer::decode(b"HTTP/1.1 204 No Content\r\n\r\n", false);
    assert_eq!(empty.expect("an answer").map(|answer| answer.body), Some(Vec::new()));
    let request = HttpRequest {
        method: "PUT".to_owned(),
        path: format!("{ROBOT_API}/x"),
        body: body.to_vec(),
    };
    let bytes = request.encode("robot");
    for cut in 0..bytes.len() {
        assert_eq!(HttpRequest::decode(&bytes[..cut]), Ok(None), "{cut}");
    }
    assert_eq!(HttpRequest::decode(&bytes), Ok(Some(request)));
}

// Fails if an answer that is none, that is too large, cut, silent or senseless is taken for one, keeps the drive for more than
// the second of its budget, or is not told as what it is.
#[test]
fn hostile_answers_are_typed_errors_in_time() {
    type Right = fn(&ClientError) -> bool;
    let http: Right = |error| matches!(error, ClientError::Wire(WireError::Http { .. }));
    let size: Right = |error| matches!(error, ClientError::Wire(WireError::Size { .. }));
    let cut: Right = |error| matches!(error, ClientError::Wire(WireError::Cut { .. }));
    let silent: Right = |error| matches!(error, ClientError::NoAnswer { interface, .. } if *interface == "Robot API");
    let refused: Right = |error| matches!(error, ClientError::RobotApi { status: 500, .. });
    let large = [b"HTTP/1.1 200 OK\r\n".to_vec(), vec![b'a'; 1 << 16]].concat();
    let cases: &[(&[u8], bool, Right)] = &[
        (b"", false, silent),
        (b"HTTP/1.1 200 OK\r\n\r\n{\"mode\":\"REMOTE\"}", false, silent),
        (
            b"HTTP/1.1 200 OK\r\nContent-Length: 18\r\n\r\n{\"mode\":\"REMOTE\"}",
            false,
            silent,
        ),
        (
            b"HTTP/1.1 200 OK\r\nContent-Length: 18\r\n\r\n{\"mode\":\"REMOTE\"}",
            true,
            cut,
        ),
        (b"HTTP/1.1 200 OK\r\n", true, cut),
        (
            b"HTTP/1.1 200 OK\r\nContent-Length: 99999999999999\r\n\r\n",
            false,
            size,
        ),
        (
            b"HTTP/1.1 200 OK\r\nContent-Length: 999999999999999999999\r\n\r\n",
            false,
            http,
        ),
        (b"HTTP/1.1 200 OK\r\nContent-Length: -1\r\n\r\n", false, http),
        (
            b"HTTP/1.1 200 OK\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\n{}",
            false,
            http,
        ),
        (b"HTTP/1.1 200 OK\r\nTransfer-Encoding: gzip\r\n\r\n", false, http),
        (
            b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nffffffffffffffff\r\n",
            false,
            size,
        ),
        (
            b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nno\r\n",
            false,
            http,
        ),
        (
            b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n1\r\n{}\r\n",
            false,
            http,
        ),
        (b"HTTP/1.1 OK\r\n\r\n", false, http),
        (b"HTTP/1.1 99 \r\n\r\n", false, http),
        (b"Connected: Universal Robots Dashboard Server\r\n\r\n", false, http),
        (b"HTTP/1.1 200 OK\r\nno colon\r\n\r\n", false, http),
        (b"HTTP/1.1 200 \xff\r\n\r\n", false, silent),
        (b"HTTP/1.1 200 \x01\r\n\r\n", false, http),
        (&large, false, size),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 4\r\n\r\ntrue", false, http),
        (
            b"HTTP/1.1 200 OK\r\nContent-Length: 13\r\n\r\n{\"mode\":true}",
            false,
            http,
        ),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 7\r\n\r\n{\"mode\"", false, http),
        (b"HTTP/1.1 500 \r\nContent-Length: 0\r\n\r\n", false, refused),
    ];
    for (says, closes, right) in cases {
        let (_, answer, took) = asked(ControllerVersion::POLYSCOPE_X, &REMOTE, says, *closes);
        let says = String::from_utf8_lossy(&says[..says.len().min(80)]);
        let error = answer.expect_err(&says);
        assert!(right(&error), "{says}: {error:?}");
        assert!(took <= Duration::from_millis(1010), "{says}: {took:?}");
    }
    // The robot's words come to a terminal.
    let says = HttpAnswer {
        status: HTTP_CONFLICT,
        body: br#"{"message": "no \u001b[2J", "details": "stopped"}"#.to_vec(),
    };
    let (_, answer, _) = asked(ControllerVersion::POLYSCOPE_X, &UNLOCK, &says.encode(), false);
    let error = answer.expect_err("refused").to_string();
    assert!(error.contains("HTTP status 409: no [2J stopped)"), "{error}");
}

/// A PolyScope X of this world, and how it is reached.
fn robot(world: &World, version: ControllerVersion) -> (RobotSide, ClientConfig) {
    let settings = RobotConfig {
        machine: world.machine(),
        address: LOCAL,
        version,
        ..RobotConfig::new(Series::ESeries, calibration())
    };
    let arm = Arc::new(Mutex::new(ArmState::default()));
    let side = start_robot(settings, Box::new(arm)).expect("a robot");
    let config = config(world, &side);
    (side, config)
}

// Fails if the client of a PolyScope X does not ask its Robot API, if a protective stop can be ended within its first five
// seconds, without one, in local control, or not after them; if remote control is not told; or if the errors do not say what a
// person has to do.
#[test]
fn the_robot_api_ends_a_protective_stop_after_five_seconds() {
    for version in [ControllerVersion::POLYSCOPE_X, WITH_POPUPS] {
        let world = World::new(0);
        let (side, config) = robot(&world, version);
        let client = TorqueClient::connect(&config, Load::default()).expect("a connection");
        assert_eq!(client.version(), version);
        let controls = side.controls();
        let unlock = |remedy: &str| {
            let error = client.ask(&UNLOCK).expect_err("refused");
            assert!(error.to_string().contains(remedy), "{error}");
            match error {
                ClientError::RobotApi { status, .. } => status,
                _ => panic!("{error}"),
            }
        };
        assert_eq!(unlock("do it at the teach pendant"), HTTP_CONFLICT);
        let stop = SafetyMode::ProtectiveStop.number();
        controls.safety_mode.store(stop, Ordering::Relaxed);
        world.machine().sleep(Duration::from_secs(4));
        assert_eq!(unlock("do it at the teach pendant"), HTTP_CONFLICT);
        world.machine().sleep(Duration::from_secs(2));
        controls.remote.store(false, Ordering::Relaxed);
        assert_eq!(unlock("choose automatic mode and remote control"), HTTP_FORBIDDEN);
        assert_eq!(client.ask(&REMOTE).expect("an answer"), "false");
        assert_eq!(controls.safety_mode.load(Ordering::Relaxed), stop);
        controls.remote.store(true, Ordering::Relaxed);
        client.ask(&UNLOCK).expect("unlocked");
        assert_eq!(
            controls.safety_mode.load(Ordering::Relaxed),
            SafetyMode::Normal.number()
        );
        assert_eq!(client.ask(&REMOTE).expect("an answer"), "true");
    }
}

/// What the Robot API of this robot answers: status and body.
fn answered(world: &World, config: &ClientConfig, bytes: &[u8]) -> (u16, String) {
    use std::io::{Read as _, Write as _};
    let to = ([127, 0, 0, 1], robot_api_port(config.port)).into();
    let wait = Duration::from_secs(1);
    let mut stream = world.machine().connect(to, wait).expect("a connection");
    stream.write_all(bytes).expect("sent");
    stream.set_wait(Some(wait)).expect("a wait");
    let mut said = Vec::new();
    stream.read_to_end(&mut said).expect("the robot ends the connection");
    let answer = HttpAnswer::decode(&said, true).expect("HTTP").expect("an answer");
    (answer.status, String::from_utf8_lossy(&answer.body).into_owned())
}

// Fails if a mode is not told as the robot has it, a program is not stopped, something that is not simulated seems to be done,
// or bytes that are no request are not refused; or if the robot loses a period by any of them.
#[test]
fn the_robot_side_answers_each_request() {
    let world = World::new(0);
    let (side, config) = robot(&world, ControllerVersion::POLYSCOPE_X);
    let ask = |method: &str, path: &str, body: &str| {
        let request = HttpRequest {
            method: method.to_owned(),
            path: format!("{ROBOT_API}{path}"),
            body: body.as_bytes().to_vec(),
        };
        answered(&world, &config, &request.encode("robot"))
    };
    for (path, words) in [
        ("/openapi.json", r#""version":"3.1.4""#),
        ("/robotstate/v1/robotmode", r#""mode":"RUNNING""#),
        ("/robotstate/v1/safetymode", r#""mode":"NORMAL""#),
        ("/system/v1/controlmode", r#""mode":"REMOTE""#),
        ("/system/v1/operationalmode", r#""mode":"AUTOMATIC""#),
        ("/program/v1/state", r#""state":"STOPPED""#),
    ] {
        let (status, said) = ask("GET", path, "");
        assert!(status == 200 && said.contains(words), "{path}: {status} {said}");
    }
    for (method, path, body, status) in [
        ("PUT", "/program/v1/state", r#"{"action":"stop"}"#, 200),
        ("PUT", "/program/v1/state", r#"{"action":"play"}"#, 501),
        ("PUT", "/robotstate/v1/state", r#"{"action":"POWER_ON"}"#, 501),
        ("PUT", "/robotstate/v1/state", r#"{"action":1}"#, 422),
        ("PUT", "/robotstate/v1/state", "action", 422),
        ("DELETE", "/popup/v1/safety", "", 404),
        ("GET", "/robotstate/v1/state", "", 404),
        ("GET", "", "", 404),
    ] {
        assert_eq!(ask(method, path, body).0, status, "{method} {path} {body}");
    }
    for bytes in [&b"robotmode\r\n\r\n"[..], b"GET / HTTP/2\r\n\r\n", &[b'a'; 1 << 15]] {
        assert_eq!(answered(&world, &config, bytes).0, 400);
    }
    let statistics = side.shut_down();
    assert_eq!((statistics.slipped, statistics.broken), (0, 0));
}

// Fails if the Robot API of a robot with the usual ports is not sought at port 80.
#[test]
fn a_real_robot_has_its_robot_api_at_port_80() {
    assert_eq!(robot_api_port(RTDE_PORT), 80);
    assert_eq!(robot_api_port(30_104), 30_099);
}
