//! What the tests of the program share: calling it, and servers that end with
//! their test.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

/// The program under test.
pub(crate) const PROGRAM: &str = env!("CARGO_BIN_EXE_spherecal");

/// Runs the program in `folder` to its end.
pub(crate) fn spherecal(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(PROGRAM)
        .args(arguments)
        .current_dir(folder)
        .output()
        .expect("the program starts")
}

/// What was printed.
pub(crate) fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Starts the program in `folder`; both its outputs wait to be read.
pub(crate) fn start(folder: &Path, arguments: &[&str]) -> Child {
    Command::new(PROGRAM)
        .args(arguments)
        .current_dir(folder)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts")
}

/// A pseudo-terminal: what a person types, and the side that the program reads.
#[cfg(target_os = "linux")]
pub(crate) fn terminal() -> (std::fs::File, std::os::fd::OwnedFd) {
    use rustix::fs::{Mode, OFlags};
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
    let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).expect("a pseudo-terminal");
    grantpt(&master).expect("a pseudo-terminal");
    unlockpt(&master).expect("a pseudo-terminal");
    let name = ptsname(&master, Vec::new()).expect("it has a name");
    let slave = rustix::fs::open(name, OFlags::RDWR | OFlags::NOCTTY, Mode::empty()).expect("it opens");
    (std::fs::File::from(master), slave)
}

/// A server that has said where it listens; it is ended with the test.
pub(crate) struct Server {
    child: Child,
    /// `HOST:PORT`
    pub(crate) address: String,
    /// `SCHEME:HOST:PORT`, as `--link` and `--store` take it.
    pub(crate) peer: String,
}

impl Server {
    /// Starts one in the folder of the tests.
    pub(crate) fn start(arguments: &[&str]) -> Self {
        Self::start_in(Path::new("."), arguments)
    }

    /// Starts one in `folder`.
    pub(crate) fn start_in(folder: &Path, arguments: &[&str]) -> Self {
        Self::start_with(folder, arguments, Stdio::null())
    }

    /// Starts one in `folder`; what it says on stderr goes into a file.
    #[cfg(target_os = "linux")]
    pub(crate) fn start_telling(folder: &Path, arguments: &[&str], file: &Path) -> Self {
        Self::start_with(folder, arguments, std::fs::File::create(file).expect("made").into())
    }

    fn start_with(folder: &Path, arguments: &[&str], told: Stdio) -> Self {
        let mut child = Command::new(PROGRAM)
            .args(arguments)
            .current_dir(folder)
            .stdout(Stdio::piped())
            .stderr(told)
            .spawn()
            .expect("the program starts");
        let mut line = String::new();
        let mut output = BufReader::new(child.stdout.take().expect("piped"));
        output.read_line(&mut line).expect("one line");
        let peer = line.split_whitespace().last().unwrap_or_default().to_owned();
        let (_, address) = peer.split_once(':').unwrap_or_default();
        assert!(address.contains(':'), "{arguments:?} said {line:?}");
        let address = address.to_owned();
        Self { child, address, peer }
    }

    /// Resident memory, MiB; Linux only.
    #[cfg(target_os = "linux")]
    pub(crate) fn memory_mib(&self) -> f64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).expect("it runs");
        let line = status.lines().find(|l| l.starts_with("VmRSS")).expect("memory is told");
        let kib: f64 = line
            .split_whitespace()
            .nth(1)
            .and_then(|n| n.parse().ok())
            .expect("a number");
        kib / 1024.0
    }

    pub(crate) fn ended_well(mut self) {
        assert!(self.child.wait().expect("it ends").success());
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
