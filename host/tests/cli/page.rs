//! The web page, as a browser and as those who must not look in meet it.

use std::io::{BufRead, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::path::Path;
use std::time::Duration;

use serde_json::{Value, json};

#[cfg(feature = "services")]
use crate::field::{check, python};
#[cfg(target_os = "linux")]
use crate::support::terminal;
use crate::support::{PROGRAM, Server, start};

fn spherecal(folder: &Path, arguments: &[&str]) -> Value {
    let output = start(folder, arguments).wait_with_output().expect("it ends");
    let said = String::from_utf8_lossy(&output.stderr);
    serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{arguments:?}: {e}: {said}"))
}

/// Sends a request, `HEADERS` each with its line's end; the answer's status, and all of it.
fn http(address: &str, line: &str, headers: &str) -> (u16, String) {
    let mut socket = TcpStream::connect(address).expect("connects");
    socket
        .set_read_timeout(Some(Duration::from_mins(1)))
        .expect("a time limit");
    let host = if headers.contains("Host:") {
        String::new()
    } else {
        format!("Host: {address}\r\n")
    };
    write!(socket, "{line} HTTP/1.1\r\n{host}{headers}Connection: close\r\n\r\n").expect("sent");
    let mut answer = Vec::new();
    let _ = socket.read_to_end(&mut answer);
    let answer = String::from_utf8_lossy(&answer).into_owned();
    let status = answer.get(9..12).and_then(|s| s.parse().ok()).unwrap_or_default();
    (status, answer)
}

// Fails if the page of a run lacks a file, if its stream is without the scene,
// frames, a contact or the end, if the arm stands still in it, if the run waits
// for a browser that takes nothing, or if it records another bit for being seen.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_run_serves_its_own_page() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut run = start(
        folder.path(),
        &["run", "--poses", "9", "--json", "--serve", "0", "--out", "o"],
    );
    let mut said = BufReader::new(run.stderr.take().expect("piped"));
    let mut line = String::new();
    said.read_line(&mut line).expect("a line");
    // The first line, before the poses are planned.
    assert!(line.contains("page on http://"), "{line}");
    let address = line
        .trim()
        .rsplit("//")
        .next()
        .expect("an address")
        .trim_end_matches('/')
        .to_owned();
    // One that asks for everything and takes nothing.
    let mut idle = TcpStream::connect(&address).expect("connects");
    write!(idle, "GET /api/live HTTP/1.1\r\nHost: {address}\r\n\r\n").expect("sent");
    let live = {
        let address = address.clone();
        std::thread::spawn(move || http(&address, "GET /api/live", "").1)
    };
    for (path, words) in [
        ("/", "<title>spherecal"),
        ("/page.js", "EventSource"),
        ("/page.js", "SIMULATED: "),
        ("/arm.js", "chain"),
        ("/plots.js", "plot"),
        ("/past.js", "history"),
        ("/page.css", "--ink"),
        ("/icon.svg", "<svg"),
        ("/api/history", "\"arms\""),
    ] {
        let (status, answer) = http(&address, &format!("GET {path}"), "");
        assert_eq!(status, 200, "{path}: {answer}");
        assert!(answer.contains(words), "{path}: {answer}");
        assert!(
            path.starts_with("/api") || answer.contains("default-src 'none'"),
            "{path}"
        );
        for elsewhere in ["http://", "https://"] {
            let text = answer.replace("http://www.w3.org/2000/svg", "");
            assert!(!text.contains(elsewhere), "{path} names {elsewhere}");
        }
    }
    assert_eq!(http(&address, "GET /report/99", "").0, 404);
    assert_eq!(http(&address, "GET /nothing", "").0, 404);
    let live = live.join().expect("no panic");
    let rest = std::thread::spawn(move || {
        let mut rest = String::new();
        let _ = said.read_to_string(&mut rest);
        rest
    });
    let output = run.wait_with_output().expect("it ends");
    let rest = rest.join().expect("no panic");
    assert!(matches!(output.status.code(), Some(0 | 3)), "{rest}");
    let summary: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    drop(idle);

    let messages: Vec<Value> = live
        .lines()
        .filter_map(|l| serde_json::from_str(l.strip_prefix("data: ")?).ok())
        .collect();
    let of = |kind: &str| {
        messages
            .iter()
            .filter_map(|m| m["message"].get(kind))
            .collect::<Vec<_>>()
    };
    let scene = of("scene");
    assert_eq!(scene[0]["robot"], "iiwa7", "{live}");
    assert_eq!(scene[0]["joints"].as_array().map(Vec::len), Some(7));
    assert!(
        scene[0]["sites"].as_array().is_some_and(|s| s.len() >= 3),
        "{}",
        scene[0]
    );
    let frames = of("frame");
    assert!(frames.len() > 5, "{}", frames.len());
    let angles: Vec<f64> = frames.iter().filter_map(|f| f["q"][0].as_f64()).collect();
    let (low, high) = angles
        .iter()
        .fold((9.0f64, -9.0f64), |(l, h), q| (l.min(*q), h.max(*q)));
    assert!(high - low > 0.05, "joint 1 went from {low} to {high}");
    let contacts = of("contact");
    assert!(!contacts.is_empty());
    let trace = &contacts[0]["trace"];
    assert!(trace["samples"].as_array().is_some_and(|s| s.len() > 100), "{trace}");
    let last = frames.last().expect("a frame");
    assert_eq!(last["done"], 9, "{last}");
    let alone = spherecal(folder.path(), &["run", "--poses", "9", "--json", "--out", "alone"]);
    assert_eq!(summary["recordings_sha256"], alone["recordings_sha256"]);
    assert_eq!(of("end").len(), 1);
    assert_eq!(of("end")[0]["trusted"], summary["verdict"]["may_be_used"]);
}

// Fails if the page does not answer before the poses are planned, if planning is not announced, if the page
// of a person at a terminal closes with the run, if it then says something else than the terminal, if it
// does not close at Enter, or if the exit code is another for it.
#[cfg(target_os = "linux")]
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_the_page_stays_after_the_run_until_it_is_closed() {
    let folder = tempfile::tempdir().expect("a folder");
    let (mut keyboard, slave) = terminal();
    let mut run = std::process::Command::new(PROGRAM)
        .args(["run", "--poses", "9", "--serve", "0", "--out", "o"])
        .current_dir(folder.path())
        .stdin(slave)
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .expect("the program starts");
    let mut said = BufReader::new(run.stderr.take().expect("piped")).lines();
    let mut next = || said.next().expect("a line").expect("readable");
    let first = next();
    let address = first
        .strip_prefix("page on http://")
        .unwrap_or_else(|| panic!("{first}"));
    let address = address.trim_end_matches('/').to_owned();
    assert_eq!(http(&address, "GET /", "").0, 200);
    assert_eq!(next(), "planning the poses");
    let mut line = next();
    while !line.contains("Press Enter") {
        line = next();
    }
    assert!(line.contains(&address), "{line}");
    // A browser that comes now, and reads for a moment.
    let mut late = TcpStream::connect(&address).expect("connects");
    write!(late, "GET /api/live HTTP/1.1\r\nHost: {address}\r\n\r\n").expect("sent");
    let mut late = BufReader::new(late).lines();
    let end = late.find_map(|l| {
        let message: Value = serde_json::from_str(l.expect("readable").strip_prefix("data: ")?).ok()?;
        message["message"].get("end").cloned()
    });
    let end = end.expect("the end of the run");
    let summary = std::fs::read(folder.path().join("o/summary.json")).expect("a summary");
    let summary: Value = serde_json::from_slice(&summary).expect("JSON");
    assert_eq!(end["trusted"], summary["verdict"]["may_be_used"]);
    assert!(run.try_wait().expect("its state").is_none(), "it has ended");
    keyboard.write_all(b"\n").expect("typed");
    let output = run.wait_with_output().expect("it ends");
    let result = String::from_utf8_lossy(&output.stdout).into_owned();
    // The words of the page are in the result, line by line.
    let words = end["text"].as_str().expect("words");
    assert!(words.lines().all(|l| result.contains(l.trim())), "{words}: {result}");
    let trusted = summary["verdict"]["may_be_used"] == true;
    assert_eq!(output.status.code(), Some(if trusted { 0 } else { 3 }));
    assert!(TcpStream::connect(&address).is_err(), "the page is still there");
}

// Fails if a run waits for a server that is not there to show it, does not say
// so, or ends otherwise; or if one that comes later is not told of the run.
#[cfg(feature = "services")]
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_page_that_is_not_there_holds_nothing_up() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let free = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = free.local_addr().expect("an address").to_string();
    drop(free);
    let peer = format!("grpc:{address}");
    let mut run = start(
        folder,
        &["run", "--poses", "45", "--json", "--publish", &peer, "--out", "o"],
    );
    let mut said = BufReader::new(run.stderr.take().expect("piped")).lines();
    let missing = |line: &std::io::Result<String>| line.as_ref().is_ok_and(|l| l.contains("not shown for now"));
    assert!(
        said.any(|line| missing(&line)),
        "it is not said that nobody shows the run"
    );
    let server = Server::start_in(folder, &["serve", "--grpc", &address, "--service", "page"]);
    let rest = std::thread::spawn(move || said.map_while(Result::ok).collect::<Vec<_>>());
    let output = run.wait_with_output().expect("it ends");
    assert_eq!(output.status.code(), Some(0), "{:?}", rest.join());
    // What the page has kept of it: the stream goes on, so it is read until its end is told.
    let mut socket = TcpStream::connect(&server.address).expect("connects");
    write!(socket, "GET /api/live HTTP/1.1\r\nHost: {address}\r\n\r\n").expect("sent");
    let lines = BufReader::new(socket).lines().map_while(Result::ok);
    let told: Vec<String> = lines
        .take_while(|line| !line.contains("{\"end\":"))
        .filter(|line| line.contains("{\"scene\":"))
        .collect();
    assert_eq!(told.len(), 1);
    assert!(told[0].contains("iiwa7"), "{}", told[0]);
}

// Fails if the page is opened without the token where there is one, by a name
// that another site can point here where there is none, or if a service answers
// what a browser can send.
#[cfg(feature = "services")]
#[test]
fn the_page_is_guarded() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let refused = start(folder, &["run", "--poses", "6", "--serve", "0.0.0.0:0", "--out", "o"]);
    let output = refused.wait_with_output().expect("it ends");
    assert_eq!(output.status.code(), Some(2));
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(said.contains("TLS is missing"), "{said}");

    let open = Server::start_in(folder, &["serve", "--grpc", "0", "--service", "store,page"]);
    assert_eq!(http(&open.address, "GET /api/history", "").0, 200);
    let port = open.address.rsplit(':').next().expect("a port");
    for name in ["evil.example", "10.1.2.3", ""] {
        let header = format!("Host: {name}:{port}\r\n");
        for path in ["/", "/api/history", "/page.js"] {
            assert_eq!(
                http(&open.address, &format!("GET {path}"), &header).0,
                421,
                "{name}{path}"
            );
        }
    }
    let service = "POST /spherecal.v1.CalibrationStore/ListRuns";
    assert_eq!(http(&open.address, service, "Content-Length: 0\r\n").0, 404);

    let token = "5c".repeat(16);
    std::fs::write(folder.join("token"), &token).expect("written");
    let closed = Server::start_in(
        folder,
        &[
            "serve",
            "--grpc",
            "0",
            "--service",
            "store,page",
            "--token-file",
            "token",
        ],
    );
    let ask = |line: &str, headers: &str| http(&closed.address, line, headers);
    for path in ["/", "/api/history", "/api/live", "/report/1"] {
        let (status, answer) = ask(&format!("GET {path}"), "");
        assert_eq!(status, 401, "{path}: {answer}");
        assert!(!answer.contains("\"arms\""), "{path}: {answer}");
    }
    let bearer = |token: &str| format!("Authorization: Bearer {token}\r\n");
    assert_eq!(ask("GET /api/history", &bearer(&token)).0, 200);
    assert_eq!(ask("GET /api/history", &bearer(&"0".repeat(32))).0, 401);
    assert_eq!(ask("POST /login", &bearer(&"0".repeat(32))).0, 401);
    assert_eq!(ask("POST /login", "").0, 401);
    let (status, answer) = ask("POST /login", &bearer(&token));
    assert_eq!(status, 204, "{answer}");
    let cookie = answer
        .lines()
        .find_map(|l| l.strip_prefix("set-cookie: "))
        .expect("a cookie");
    assert!(
        cookie.contains("HttpOnly") && cookie.contains("SameSite=Strict"),
        "{cookie}"
    );
    assert!(!cookie.contains(&token));
    let pass = cookie.split(';').next().expect("a value");
    assert_eq!(ask("GET /api/history", &format!("Cookie: a=b; {pass}\r\n")).0, 200);
    assert_eq!(ask("GET /api/history", "Cookie: spherecal_pass=\r\n").0, 401);
}

// Fails if, in a browser, the arm does not move while the run does, or stands
// elsewhere than the controller computes; if force, contact, progress or the
// end are not shown; if past runs are not listed or their report does not open;
// if there is an error, a request to another host, a part wider than the page,
// an element without a name, or text that is hard to read.
#[cfg(feature = "services")]
#[test]
fn a_run_is_watched_in_a_browser() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    for _ in 0..2 {
        let arguments = [
            "run", "--poses", "12", "--seed", "5", "--arm", "A-17", "--json", "--out", "cell",
        ];
        assert_eq!(spherecal(folder, &arguments)["poses"]["recorded"], 12);
    }
    let server = Server::start_in(
        folder,
        &["serve", "--grpc", "0", "--service", "store,page", "--out", "cell"],
    );
    let (url, peer) = (
        format!("http://{}/", server.address),
        format!("grpc:{}", server.address),
    );
    // The second time on a telephone.
    for (round, width) in ["1400", "390"].into_iter().enumerate() {
        let shots = std::env::var_os("SPHERECAL_SHOTS").map_or_else(|| folder.to_owned(), Into::into);
        let (shots, out) = (shots.join(width), folder.join(width));
        let command = [
            "run", "--poses", "30", "--seed", "6", "--arm", "A-17", "--store", &peer, "--out",
        ];
        let arguments: Vec<&Path> = [Path::new(&url), &shots, Path::new(width), Path::new(PROGRAM)]
            .into_iter()
            .chain(command.iter().map(Path::new))
            .chain([out.as_path()])
            .collect();
        let found = check(&python, "tests/python/check_live.py", &arguments);
        let number = |name: &str| found[name].as_f64().unwrap_or_else(|| panic!("{name}: {found}"));
        assert_eq!(found["requests"], json!([]), "{found}");
        assert_eq!(found["errors"], json!([]), "{found}");
        assert!(matches!(found["exit"].as_i64(), Some(0 | 3)), "{found}");
        assert!(number("frames") > 20.0, "{found}");
        assert!(number("moved_rad") > 0.3 && number("shown_rad") > 0.3, "{found}");
        // The controller tells its own in single precision.
        assert!(number("tcp_off_mm") < 2e-3, "{found}");
        assert!(number("points") > 100.0 && number("contact") > 100.0, "{found}");
        assert!(number("residual") > 0.05, "{found}");
        for list in ["done", "words", "phases"] {
            assert!(found[list].as_array().is_some_and(|l| l.len() >= 4), "{list}: {found}");
        }
        for canvas in ["arm", "curve", "contact"] {
            assert!(found["painted"][canvas].as_f64().is_some_and(|n| n > 10.0), "{found}");
        }
        assert!(
            found["end"]
                .as_str()
                .is_some_and(|t| t.starts_with("SIMULATED iiwa7: ")),
            "{found}"
        );
        assert_eq!(
            (number("arms_before"), number("rows_before")),
            (1.0, 2.0 + round as f64),
            "{found}"
        );
        assert_eq!(number("rows_after"), 3.0 + round as f64, "{found}");
        assert!(
            found["arm_words"]
                .as_str()
                .is_some_and(|t| t.contains("iiwa7 A-17") && t.contains("Next calibration due")),
            "{found}"
        );
        assert!(found["report"].to_string().contains("Accuracy"), "{found}");
        assert_eq!(found["too_wide"], 0, "{width}: {found}");
        assert_eq!(found["nameless"], json!([]), "{found}");
        for scheme in ["contrast_light", "contrast_dark"] {
            assert!(number(scheme) > 4.5, "{scheme}: {found}");
        }
    }
}

// Fails if a browser beyond loopback looks in without the token, or cannot with it.
#[cfg(feature = "services")]
#[test]
fn a_browser_is_let_in_by_the_token() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let names = vec!["localhost".to_owned(), "127.0.0.1".to_owned()];
    let signed = rcgen::generate_simple_self_signed(names).expect("a certificate");
    let token = "7f".repeat(16);
    std::fs::write(folder.join("cert.pem"), signed.cert.pem()).expect("written");
    std::fs::write(folder.join("key.pem"), signed.signing_key.serialize_pem()).expect("written");
    std::fs::write(folder.join("token"), &token).expect("written");
    let server = Server::start_in(
        folder,
        &[
            "serve",
            "--grpc",
            "0.0.0.0:0",
            "--service",
            "store,page",
            "--tls-cert",
            "cert.pem",
            "--tls-key",
            "key.pem",
            "--token-file",
            "token",
        ],
    );
    let port = server.address.rsplit(':').next().expect("a port");
    let url = format!("https://127.0.0.1:{port}/");
    let found = check(
        &python,
        "tests/python/check_live.py",
        &[Path::new("--login"), Path::new(&url), Path::new(&token)],
    );
    assert_eq!(found["first"], 401, "{found}");
    assert_eq!(found["history"], 401, "{found}");
    assert_eq!(found["wrong"], "spherecal: token", "{found}");
    assert!(
        found["right"]
            .as_str()
            .is_some_and(|t| t.starts_with("spherecal") && !t.contains("token")),
        "{found}"
    );
    assert_eq!(found["inside"], 200, "{found}");
    assert_eq!(found["secrets"], "", "{found}");
}
