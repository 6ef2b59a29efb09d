//! The services of Figure 4: robot, tracker and database behind gRPC, as their
//! users and those who must not use them meet them.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

use crate::support::{PROGRAM, Server, text};

fn spherecal(folder: &Path, arguments: &[&str], environment: &[(&str, &str)]) -> Output {
    Command::new(PROGRAM)
        .args(arguments)
        .current_dir(folder)
        .env_remove("SPHERECAL_TOKEN")
        .env_remove("SPHERECAL_CA")
        .envs(environment.iter().copied())
        .output()
        .expect("the program starts")
}

fn summary(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {}", text(&output.stderr)))
}

// Fails if a run whose robot, tracker and database are services records another
// bit than one in a single process, if the tracker measures another, if the
// served database is not where it was stored, or if reading it back differs.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_run_over_services_is_the_run_in_one_process() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    // Whether the arm of a service is simulated is not known before the run: the error of teaching is for simulated arms.
    std::fs::write(
        folder.join("cell.toml"),
        "[campaign]\ntaught_error_m = 0.0\n[plan]\nchoice = \"grid\"\n",
    )
    .expect("written");
    let run = ["run", "--config", "cell.toml", "--poses", "4", "--seed", "5", "--json"];
    let here = summary(&spherecal(folder, &[&run[..], &["--out", "here"]].concat(), &[]));
    assert_eq!(here["poses"]["recorded"], 4);

    let server = Server::start_in(folder, &["serve", "--grpc", "0", "--seed", "5", "--out", "served"]);
    let peer = server.peer.as_str();
    let services = [
        "--link",
        peer,
        "--tracker",
        peer,
        "--store",
        peer,
        "--out",
        "there",
        "--arm",
        "A-17",
    ];
    let output = spherecal(folder, &[&run[..], &services].concat(), &[]);
    let there = summary(&output);
    assert_eq!(here["recordings_sha256"], there["recordings_sha256"]);
    for model in ["nominal", "sphere", "laser"] {
        assert_eq!(
            here["validation"]["models"][model], there["validation"]["models"][model],
            "{model}"
        );
    }
    assert!(!folder.join("there/calibration.db").exists());
    assert!(folder.join("there/report.html").exists());

    // The same stages on the stored run say the same, over the network and at the server.
    let again = summary(&spherecal(
        folder,
        &["report", "--store", peer, "--arm", "A-17", "--out", "again", "--json"],
        &[],
    ));
    assert_eq!(again["parameters"], there["parameters"]);
    drop(server);
    let again = summary(&spherecal(folder, &["report", "--out", "served", "--json"], &[]));
    assert_eq!(again["parameters"], there["parameters"]);
    let history = spherecal(folder, &["history", "--out", "served", "--arm", "A-17"], &[]);
    assert!(text(&history.stdout).contains("A-17"), "{}", text(&history.stdout));
    let none = spherecal(folder, &["history", "--out", "served", "--arm", "B", "--json"], &[]);
    assert_eq!(summary(&none)["runs"], serde_json::json!([]));
}

// Fails if a server closes the connection of a client that plans or waits for longer than the server's pings may stay
// without an answer (40 s), and the run then ends.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_client_that_plans_for_long_keeps_its_connection() {
    use spherecal::campaign::Tracker as _;
    use spherecal::model::TrackerSession;
    use spherecal::services::grpc::{RemoteStore, RemoteTracker};
    use spherecal::store::CalibrationStore as _;

    let folder = tempfile::tempdir().expect("a folder");
    let services = ["serve", "--grpc", "0", "--service", "store,tracker", "--out", "served"];
    let server = Server::start_in(folder.path(), &services);
    let peer = spherecal::store::Peer::parse(&server.peer).expect("an address");
    let mut store = RemoteStore::connect(&peer).expect("a store");
    let mut tracker = RemoteTracker::connect(&peer).expect("a tracker");
    let mut ask = || {
        assert_eq!(store.runs_of("").expect("it answers").len(), 0);
        tracker
            .shot(TrackerSession::Measurement, &[0.1; 7])
            .expect("it measures");
    };
    ask();
    std::thread::sleep(std::time::Duration::from_secs(50));
    ask();
}

// Fails if the plate of a simulated cell behind gRPC does not move between two
// placements, or moves elsewhere than in one process.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_the_plate_is_moved_over_services() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let place = spherecal::job::Config::default().cell.placements[0];
    let ([x, y, z], [roll, pitch, yaw]) = (place.origin_m, place.rpy_rad);
    let cell = format!(
        "[campaign]\ntaught_error_m = 0.0\n[plan]\nposes = 12\n[plan.range]\ncandidates = 700\n[[cell.placements]]\norigin_m = [{x}, {y}, {z}]\n\
         rpy_rad = [{roll}, {pitch}, {yaw}]\n[[cell.placements]]\norigin_m = [{x}, {}, {}]\n\
         rpy_rad = [{roll}, {pitch}, {}]\n",
        y + 0.12,
        z + 0.10,
        yaw + 0.3
    );
    std::fs::write(folder.join("cell.toml"), cell).expect("written");
    let run = ["run", "--config", "cell.toml", "--seed", "5", "--json"];
    let here = summary(&spherecal(folder, &[&run[..], &["--out", "here"]].concat(), &[]));
    assert_eq!(here["poses"]["recorded"], 12);
    let serve = [
        "serve",
        "--grpc",
        "0",
        "--seed",
        "5",
        "--config",
        "cell.toml",
        "--service",
        "robot",
    ];
    let server = Server::start_in(folder, &serve);
    let output = spherecal(
        folder,
        &[&run[..], &["--link", &server.peer, "--out", "there"]].concat(),
        &[],
    );
    let there = summary(&output);
    assert_eq!(here["recordings_sha256"], there["recordings_sha256"]);
    let plan: Value = serde_json::from_slice(
        &spherecal(folder, &["plan", "--config", "cell.toml", "--json", "--out", "p"], &[]).stdout,
    )
    .expect("JSON");
    assert!(plan.to_string().contains("\"place\":1"), "two placements are planned");
}

/// The services that a server describes, for programs without its files.
async fn reflected(address: &str) -> Vec<String> {
    use tonic_reflection::pb::v1::ServerReflectionRequest;
    use tonic_reflection::pb::v1::server_reflection_client::ServerReflectionClient;
    use tonic_reflection::pb::v1::server_reflection_request::MessageRequest;
    use tonic_reflection::pb::v1::server_reflection_response::MessageResponse;

    let endpoint = tonic::transport::Endpoint::from_shared(address.to_owned()).expect("an address");
    let mut client = ServerReflectionClient::new(endpoint.connect().await.expect("connects"));
    let request = ServerReflectionRequest {
        host: String::new(),
        message_request: Some(MessageRequest::ListServices(String::new())),
    };
    let answers = client.server_reflection_info(tokio_stream::iter([request])).await;
    match answers
        .expect("an answer")
        .into_inner()
        .message()
        .await
        .expect("a message")
        .and_then(|m| m.message_response)
    {
        Some(MessageResponse::ListServicesResponse(list)) => list.service.into_iter().map(|s| s.name).collect(),
        other => panic!("{other:?}"),
    }
}

// Fails if a server names a service that it does not offer as healthy, offers one that it was not asked to, or does not
// describe itself.
#[test]
fn health_says_what_is_served() {
    use tonic_health::pb::health_check_response::ServingStatus;
    use tonic_health::pb::{HealthCheckRequest, health_client::HealthClient};

    let folder = tempfile::tempdir().expect("a folder");
    let server = Server::start_in(folder.path(), &["serve", "--grpc", "0", "--service", "store"]);
    let address = format!("http://{}", server.peer.trim_start_matches("grpc:"));
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    let status = |service: &str| {
        let request = HealthCheckRequest {
            service: service.to_owned(),
        };
        runtime.block_on(async {
            let endpoint = tonic::transport::Endpoint::from_shared(address.clone()).expect("an address");
            let mut client = HealthClient::new(endpoint.connect().await.expect("connects"));
            client.check(request).await.map(|answer| answer.into_inner().status)
        })
    };
    assert_eq!(
        status("spherecal.v1.CalibrationStore").expect("known"),
        i32::from(ServingStatus::Serving)
    );
    let listed = runtime.block_on(reflected(&address));
    assert!(
        listed.iter().any(|name| name == "spherecal.v1.CalibrationStore"),
        "{listed:?}"
    );
    let missing = status("spherecal.v1.RobotController").expect_err("not offered");
    assert_eq!(missing.code(), tonic::Code::NotFound);
    // And the robot that is not there is refused with what to do.
    let output = spherecal(
        folder.path(),
        &["run", "--poses", "6", "--link", &server.peer, "--out", "o"],
        &[],
    );
    assert_eq!(output.status.code(), Some(1));
    assert!(
        text(&output.stderr).contains("start that server with this service"),
        "{}",
        text(&output.stderr)
    );
}

/// This machine's address as others see it; loopback where there is no network.
fn outside() -> std::net::IpAddr {
    let socket = std::net::UdpSocket::bind("0.0.0.0:0").expect("a socket");
    // Nothing is sent: the system only says from where it would be.
    let found = socket.connect("192.0.2.1:9").and_then(|()| socket.local_addr());
    match found {
        Ok(address) if !address.ip().is_unspecified() => address.ip(),
        _ => std::net::IpAddr::V4(std::net::Ipv4Addr::LOCALHOST),
    }
}

// Fails if a server listens beyond loopback without TLS and token, lets in a
// client without the token, with another, or without TLS, or keeps out one
// that has both.
#[test]
fn beyond_loopback_only_the_token_opens() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let refused = |arguments: &[&str]| {
        let output = spherecal(folder, &[&["serve", "--service", "store"], arguments].concat(), &[]);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        text(&output.stderr)
    };
    assert!(refused(&["--grpc", "0.0.0.0:0"]).contains("TLS is missing"));

    let outside = outside();
    let names = vec!["localhost".to_owned(), "127.0.0.1".to_owned(), outside.to_string()];
    let signed = rcgen::generate_simple_self_signed(names).expect("a certificate");
    let token = "7f".repeat(16);
    std::fs::write(folder.join("cert.pem"), signed.cert.pem()).expect("written");
    std::fs::write(folder.join("key.pem"), signed.signing_key.serialize_pem()).expect("written");
    std::fs::write(folder.join("token"), &token).expect("written");
    let tls = ["--tls-cert", "cert.pem", "--tls-key", "key.pem"];
    assert!(refused(&[&["--grpc", "0.0.0.0:0"], &tls[..]].concat()).contains("the token is missing"));

    let protected = [
        "serve",
        "--grpc",
        "0.0.0.0:0",
        "--token-file",
        "token",
        "--service",
        "store",
        "--out",
        "served",
    ];
    let server = Server::start_in(folder, &[&protected[..], &tls].concat());
    let port = server.peer.rsplit(':').next().expect("a port");
    assert!(server.peer.starts_with("grpcs:"), "{}", server.peer);
    let ask = |peer: &str, environment: &[(&str, &str)]| {
        spherecal(folder, &["history", "--json", "--store", peer], environment)
    };
    let peer = format!("grpcs:{outside}:{port}");
    let (ca, right) = (("SPHERECAL_CA", "cert.pem"), ("SPHERECAL_TOKEN", token.as_str()));
    let answer = ask(&peer, &[ca, right]);
    assert!(answer.status.success(), "{}", text(&answer.stderr));
    assert_eq!(summary(&answer)["runs"], serde_json::json!([]));
    for (environment, words) in [
        (vec![ca], "bearer token, and none was shown"),
        (
            vec![ca, ("SPHERECAL_TOKEN", "ffffffffffffffffffffffffffffffff")],
            "bearer token is not that of this server",
        ),
        (vec![right], "spherecal_ca names no file"),
    ] {
        let answer = ask(&peer, &environment);
        assert_eq!(answer.status.code(), Some(1), "{environment:?}");
        let said = text(&answer.stderr);
        assert!(said.to_lowercase().contains(words), "{environment:?}: {said}");
    }
    // What `openssl req -x509` makes: a certificate of an authority, which no server may use.
    let mut authority = rcgen::CertificateParams::new(vec!["localhost".to_owned()]).expect("names");
    authority.is_ca = rcgen::IsCa::Ca(rcgen::BasicConstraints::Unconstrained);
    let key = rcgen::KeyPair::generate().expect("a key");
    let signed = authority.self_signed(&key).expect("a certificate");
    std::fs::write(folder.join("ca.pem"), signed.pem()).expect("written");
    std::fs::write(folder.join("ca-key.pem"), key.serialize_pem()).expect("written");
    let arguments = [
        "serve",
        "--grpc",
        "0",
        "--tls-cert",
        "ca.pem",
        "--tls-key",
        "ca-key.pem",
        "--service",
        "store",
    ];
    let other = Server::start_in(folder, &[&arguments[..], &["--out", "other"]].concat());
    let other_port = other.peer.rsplit(':').next().expect("a port");
    let said = ask(&format!("grpcs:localhost:{other_port}"), &[("SPHERECAL_CA", "ca.pem")]);
    let said = text(&said.stderr);
    assert!(
        said.contains("CA:TRUE") && said.contains("basicConstraints") && said.contains("ca.pem"),
        "{said}"
    );
    // Key and certificate exchanged.
    let said = refused(&["--grpc", "0", "--tls-cert", "key.pem", "--tls-key", "cert.pem"]);
    assert!(said.contains("key.pem") && said.contains("BEGIN CERTIFICATE"), "{said}");
    let plain = ask(&peer.replace("grpcs", "grpc"), &[right]);
    assert_eq!(plain.status.code(), Some(1), "{}", text(&plain.stdout));
}
