//! `spherecal doctor`: what this machine has and lacks, with the remedies.
//!
//! A check has one of three results: *ok*; *missing*, if only some uses need it (QEMU, a serial
//! port, real-time scheduling); *fault*, if the main job cannot run without it. Only a fault fails
//! the command.

use std::path::{Path, PathBuf};
use std::process::Command;

use clap::Args;
use serde::Serialize;

use super::doctor_realtime::RealTimeCheck;
use super::exit::{CliError, Exit, existing_folder, try_writing};
use super::out::{out, outln};
use spherecal_link::qemu::find_image;

/// The Cortex-M7's Rust target.
const TARGET: &str = "thumbv7em-none-eabihf";
/// Free space below which a long run may not fit, in bytes: with every sample kept, the telemetry of a whole grid is more
/// than 1 GB.
const ROOM: u64 = 2 << 30;

/// Arguments of `doctor`.
#[derive(Args, Clone, Debug)]
pub struct DoctorArgs {
    /// Folder that results are to be written to.
    #[arg(long, value_name = "DIR", default_value = "spherecal-out")]
    pub out: PathBuf,
    /// Measure for some seconds, 10 by default, how late a real-time thread wakes up at 1 kHz, and
    /// say whether this machine can drive a robot over franka: or fri:.
    #[arg(long, value_name = "SECONDS", num_args = 0..=1, require_equals = true, default_missing_value = "10")]
    pub realtime: Option<f64>,
    /// Print one JSON document on stdout and nothing else.
    #[arg(long)]
    pub json: bool,
}

/// How a check came out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum CheckState {
    Ok,
    Missing,
    Fault,
}

/// One line of the answer.
#[derive(Clone, Debug, Serialize)]
struct DoctorCheck {
    name: &'static str,
    state: CheckState,
    found: String,
    needed_for: &'static str,
    /// What to do; empty where all is well.
    remedy: String,
}

pub(super) fn run(args: &DoctorArgs) -> Result<Exit, CliError> {
    let checks = [
        folder(&args.out),
        room(&args.out),
        processors(),
        tool(
            "toolchain",
            "cargo",
            "building from source, and the board images",
            "install Rust from https://rustup.rs",
        ),
        cross(),
        qemu(),
        image(),
        serial(),
        real_time(),
    ];
    let realtime = args.realtime.map(RealTimeCheck::measure).transpose()?;
    let healthy = checks.iter().all(|check| check.state != CheckState::Fault);
    if args.json {
        let document = serde_json::json!({
            "program": concat!("spherecal ", env!("CARGO_PKG_VERSION")),
            "healthy": healthy,
            "checks": checks,
            "realtime": realtime,
        });
        outln!("{document:#}");
    } else {
        out!("{}", text(&checks));
        if let Some(realtime) = &realtime {
            out!("{}", realtime.text());
        }
    }
    let fit = realtime.as_ref().is_none_or(|found| found.holds_1_khz);
    Ok(if healthy && fit { Exit::Done } else { Exit::Failed })
}

fn text(checks: &[DoctorCheck]) -> String {
    let mut out = format!("spherecal {}\n\n", env!("CARGO_PKG_VERSION"));
    for check in checks {
        let mark = match check.state {
            CheckState::Ok => "ok",
            CheckState::Missing => "missing",
            CheckState::Fault => "FAULT",
        };
        out.push_str(&format!("{mark:>8}  {}: {}\n", check.name, check.found));
        if check.state != CheckState::Ok {
            out.push_str(&format!(
                "          needed for {}; to do: {}\n",
                check.needed_for, check.remedy
            ));
        }
    }
    out
}

fn check(name: &'static str, needed_for: &'static str, good: bool, found: String, remedy: &str) -> DoctorCheck {
    DoctorCheck {
        name,
        state: if good { CheckState::Ok } else { CheckState::Missing },
        found,
        needed_for,
        remedy: if good { String::new() } else { remedy.to_owned() },
    }
}

/// The first line that a program prints, if it runs.
fn first_line(program: &str, arguments: &[&str]) -> Option<String> {
    let output = Command::new(program).args(arguments).output().ok()?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    output
        .status
        .success()
        .then(|| text.lines().next().unwrap_or_default().trim().to_owned())
}

fn tool(name: &'static str, program: &str, needed_for: &'static str, remedy: &str) -> DoctorCheck {
    let found = first_line(program, &["--version"]);
    let good = found.is_some();
    check(
        name,
        needed_for,
        good,
        found.unwrap_or_else(|| format!("no `{program}` in PATH")),
        remedy,
    )
}

fn cross() -> DoctorCheck {
    let library = first_line("rustc", &["--print", "sysroot"])
        .map(|sysroot| Path::new(&sysroot).join("lib/rustlib").join(TARGET).join("lib"));
    let sources = Path::new("/usr/lib/rustlib/src/rust/library/core");
    let (good, found) = match library {
        Some(library) if library.is_dir() => (true, format!("{TARGET} in {}", library.display())),
        _ if sources.is_dir() => (
            true,
            format!("core's sources in {} (Debian's route)", sources.display()),
        ),
        _ => (false, format!("no core library for {TARGET}")),
    };
    check(
        "cross target",
        "--link qemu and real boards",
        good,
        found,
        "run `rustup target add thumbv7em-none-eabihf`, or `scripts/cross.sh --install check` in the source",
    )
}

fn qemu() -> DoctorCheck {
    let machines = Command::new("qemu-system-arm").args(["-machine", "help"]).output();
    let version = first_line("qemu-system-arm", &["--version"]);
    let (good, found) = match (version, machines) {
        (Some(version), Ok(machines)) if String::from_utf8_lossy(&machines.stdout).contains("mps2-an500") => {
            (true, version)
        }
        (Some(version), _) => (false, format!("{version}, without the machine mps2-an500")),
        (None, _) => (false, "no `qemu-system-arm` in PATH".to_owned()),
    };
    check(
        "QEMU",
        "--link qemu, the controller on an emulated Cortex-M7",
        good,
        found,
        "install it: `apt install qemu-system-arm`, or your system's package",
    )
}

fn image() -> DoctorCheck {
    let found = find_image(None);
    let good = found.is_ok();
    let found = found.map_or_else(|_| "not built".to_owned(), |path| path.display().to_string());
    check(
        "controller image",
        "--link qemu",
        good,
        found,
        "run `scripts/cross.sh build mps2-an500` in the source, or name one in SPHERECAL_QEMU_IMAGE",
    )
}

/// Serial devices that a board appears as.
fn serial_devices() -> Vec<PathBuf> {
    let mut devices: Vec<PathBuf> = std::fs::read_dir("/dev")
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| {
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            ["ttyACM", "ttyUSB", "cu.usb"].iter().any(|kind| name.starts_with(kind))
        })
        .collect();
    devices.sort();
    devices
}

fn serial() -> DoctorCheck {
    let needed_for = "--link serial:DEVICE, a controller board";
    let devices = serial_devices();
    let names = |devices: &[&PathBuf]| {
        let names: Vec<String> = devices.iter().map(|d| d.display().to_string()).collect();
        names.join(", ")
    };
    let closed: Vec<&PathBuf> = devices.iter().filter(|device| !may_use(device)).collect();
    if devices.is_empty() {
        return check(
            "serial ports",
            needed_for,
            false,
            "none".to_owned(),
            "plug the board in",
        );
    }
    if closed.is_empty() {
        return check(
            "serial ports",
            needed_for,
            true,
            names(&devices.iter().collect::<Vec<_>>()),
            "",
        );
    }
    check(
        "serial ports",
        needed_for,
        false,
        format!("{} may not be opened by this user", names(&closed)),
        "run `sudo usermod -aG dialout $USER`, then log in again",
    )
}

fn processors() -> DoctorCheck {
    let count = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    check("processors", "speed alone", true, format!("{count} usable"), "")
}

fn folder(out: &Path) -> DoctorCheck {
    let folder = existing_folder(out);
    let good = try_writing(&folder).is_ok();
    let found = if good {
        format!("{} can be written", folder.display())
    } else {
        format!("{} is no folder that can be written", folder.display())
    };
    let mut answer = check("output folder", "every run", good, found, "choose another with --out");
    if !good {
        answer.state = CheckState::Fault;
    }
    answer
}

fn room(out: &Path) -> DoctorCheck {
    let needed_for = "databases and 1 kHz telemetry";
    match free_bytes(&existing_folder(out)) {
        Some(free) => check(
            "disk space",
            needed_for,
            free >= ROOM,
            format!("{:.1} GB free", free as f64 * 1e-9),
            "free 2 GB, or choose another --out",
        ),
        None => check("disk space", needed_for, true, "unknown on this system".to_owned(), ""),
    }
}

#[cfg(unix)]
fn may_use(path: &Path) -> bool {
    use rustix::fs::{Access, access};
    access(path, Access::READ_OK | Access::WRITE_OK).is_ok()
}

#[cfg(not(unix))]
fn may_use(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|m| !m.permissions().readonly())
}

#[cfg(unix)]
fn free_bytes(path: &Path) -> Option<u64> {
    let system = rustix::fs::statvfs(path).ok()?;
    Some(system.f_bavail.saturating_mul(system.f_frsize))
}

#[cfg(not(unix))]
fn free_bytes(_path: &Path) -> Option<u64> {
    None
}

/// A drive in real time wants the controller's thread on time: a kernel that
/// can be preempted, and the right to ask for it.
#[cfg(target_os = "linux")]
fn real_time() -> DoctorCheck {
    use rustix::process::{Resource, geteuid, getrlimit};
    let preemptive = std::fs::read_to_string("/sys/kernel/realtime").is_ok_and(|text| text.trim() == "1")
        || std::fs::read_to_string("/proc/version").is_ok_and(|text| text.contains("PREEMPT_RT"));
    let allowed = geteuid().is_root() || getrlimit(Resource::Rtprio).current.is_none_or(|limit| limit > 0);
    let found = format!(
        "{}; {}",
        if preemptive {
            "a PREEMPT_RT kernel"
        } else {
            "an ordinary kernel"
        },
        if allowed {
            "real-time priority is allowed"
        } else {
            "no right to real-time priority"
        }
    );
    let remedy = if allowed {
        "boot a kernel with PREEMPT_RT (`apt install linux-image-rt-amd64`), or use a controller board"
    } else {
        "add `@realtime - rtprio 99` to /etc/security/limits.conf and join that group; a PREEMPT_RT kernel besides, \
         or a controller board; `spherecal doctor --realtime` measures"
    };
    check(
        "real-time scheduling",
        "a drive in real time (--link franka:, fri:, or tcp: to a robot's gateway)",
        preemptive && allowed,
        found,
        remedy,
    )
}

#[cfg(not(target_os = "linux"))]
fn real_time() -> DoctorCheck {
    check(
        "real-time scheduling",
        "a drive in real time (--link franka:, fri:, or tcp: to a robot's gateway)",
        false,
        "unknown on this system".to_owned(),
        "use Linux with PREEMPT_RT, or a controller board",
    )
}
