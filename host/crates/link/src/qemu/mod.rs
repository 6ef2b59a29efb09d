//! Runs the controller's Cortex-M7 image in QEMU, in lock-step over its standard streams.
//!
//! Each control period is one exchange ([`spherecal_shared::protocol::lockstep`]): joint state and
//! host bytes down, torque and controller bytes up. QEMU counts instructions as time (`-icount`),
//! and its time stands still while the image waits for an exchange. So the same drive gives a
//! bit-identical run. The image logs with `defmt` into a file. When the run ends, [`log`] decodes
//! that file with the image's own ELF.
//!
//! A watchdog thread ends a QEMU that does not answer, so that no read waits for ever.

mod error;
mod image;
pub mod log;
mod watchdog;

use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::time::Duration;

use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState};
use spherecal_shared::protocol::frame::{self, MAX_FRAME, Message};
use spherecal_shared::protocol::lockstep::{Down, MAX_HOST, UP_HEADER, Up};

pub use error::{IMAGE_VARIABLE, PROGRAM, QemuError};
pub use image::{find_image, find_qemu};

use error::meaning;
use watchdog::Watchdog;

use super::{Controller, LinkError};

/// Name of the decoded log in the report's folder.
pub const LOG_FILE: &str = "controller.log";
/// Name of the log as the image wrote it.
const RAW_LOG_FILE: &str = "controller.defmt";
/// Name of the file with QEMU's own error output.
const STDERR_FILE: &str = "qemu.log";

/// How QEMU is started.
#[derive(Clone, Debug)]
pub struct QemuOptions {
    /// The image; `None` looks for it ([`find_image`]).
    pub image: Option<PathBuf>,
    /// Folder for the logs; it must exist.
    pub folder: PathBuf,
    /// Scenario of the image: `pipe`, `steps` for slow cores, or `hog`.
    pub scenario: String,
    /// The machine that the image is made for.
    pub machine: Machine,
    /// One instruction takes 2^shift ns.
    pub shift: u8,
    /// How long an answer may take.
    pub patience: Duration,
    /// File that stores every exchange sent to the image, so that the run can be repeated without
    /// the plant: `qemu-system-arm ... < FILE`.
    pub record: Option<PathBuf>,
}

impl QemuOptions {
    /// The usual way, with logs into `folder`.
    pub fn new(folder: &Path) -> Self {
        Self {
            image: None,
            folder: folder.to_path_buf(),
            scenario: "pipe".to_owned(),
            machine: Machine::default(),
            shift: 3,
            patience: Duration::from_secs(20),
            record: None,
        }
    }
}

/// A machine of QEMU that has an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Machine {
    /// MPS2 with AN500: Cortex-M7 with a double-precision FPU.
    #[default]
    CortexM7,
    /// MPS2 with AN386: Cortex-M4F, double precision by library.
    CortexM4F,
}

impl Machine {
    /// QEMU's names of machine and core.
    fn names(self) -> [&'static str; 2] {
        match self {
            Self::CortexM7 => ["mps2-an500", "cortex-m7"],
            Self::CortexM4F => ["mps2-an386", "cortex-m4"],
        }
    }
}

/// What a tick cost, in instructions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct TickCost {
    /// The host's commands, the control law and the phases.
    pub tick: u32,
    /// Frames of both links, parsed and built, below the control task.
    pub link: u32,
}

/// The arguments that start `image` on `machine` in QEMU with instruction counting:
/// `arguments` are the image's own (`arg=`).
pub fn qemu_arguments(image: &Path, machine: Machine, shift: u8, arguments: &[String]) -> Vec<String> {
    let mut semihosting = "enable=on,target=native".to_owned();
    for argument in arguments {
        semihosting.push_str(",arg=");
        semihosting.push_str(argument);
    }
    let [board, core] = machine.names();
    [
        "-M",
        board,
        "-cpu",
        core,
        "-display",
        "none",
        "-monitor",
        "none",
        "-serial",
        "null",
        "-serial",
        "null",
        "-icount",
        &format!("shift={shift},sleep=off"),
        "-semihosting-config",
        &semihosting,
        "-kernel",
        &image.display().to_string(),
    ]
    .map(str::to_owned)
    .to_vec()
}

/// A controller in QEMU.
pub struct Qemu {
    image: PathBuf,
    folder: PathBuf,
    shift: u8,
    patience: Duration,
    input: Option<ChildStdin>,
    output: BufReader<ChildStdout>,
    watchdog: Watchdog,
    hello: Vec<u8>,
    sequence: u32,
    turn: Vec<u8>,
    body: Vec<u8>,
    cost: TickCost,
    record: Option<BufWriter<File>>,
    finished: bool,
}

impl Qemu {
    /// Starts the image.
    ///
    /// # Errors
    /// When QEMU or the image is missing, or a file cannot be made.
    pub fn start(options: &QemuOptions) -> Result<Self, QemuError> {
        let program = find_qemu().ok_or(QemuError::NoQemu)?;
        let image = find_image(options.image.as_deref())?;
        let raw_log = options.folder.join(RAW_LOG_FILE);
        let text = raw_log.display().to_string();
        if text.contains([' ', ',']) || text.len() > 400 {
            return Err(QemuError::LogPath {
                path: options.folder.clone(),
            });
        }
        let record = options.record.as_ref().map(|path| {
            File::create(path).map_err(|source| QemuError::File {
                path: path.clone(),
                source,
            })
        });
        let record = record.transpose()?.map(BufWriter::new);
        let stderr_path = options.folder.join(STDERR_FILE);
        let stderr = File::create(&stderr_path).map_err(|source| QemuError::File {
            path: stderr_path,
            source,
        })?;
        let arguments = [options.scenario.clone(), format!("log={text}")];
        let mut child = Command::new(&program)
            .args(qemu_arguments(&image, options.machine, options.shift, &arguments))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(stderr)
            .spawn()
            .map_err(|source| QemuError::File { path: program, source })?;
        let (Some(input), Some(output)) = (child.stdin.take(), child.stdout.take()) else {
            return Err(QemuError::Garbled);
        };
        Ok(Self {
            image,
            folder: options.folder.clone(),
            shift: options.shift,
            patience: options.patience,
            input: Some(input),
            output: BufReader::with_capacity(1 << 16, output),
            watchdog: Watchdog::over(child, options.patience),
            hello: Vec::new(),
            sequence: 0,
            turn: Vec::new(),
            body: Vec::new(),
            cost: TickCost::default(),
            record,
            finished: false,
        })
    }

    /// What the last tick cost.
    pub fn cost(&self) -> TickCost {
        self.cost
    }

    /// Ends the image and decodes its log; returns how QEMU exited, if it did
    /// so by itself.
    ///
    /// # Errors
    /// When the log cannot be read or written.
    pub fn finish(&mut self) -> Result<Option<ExitStatus>, QemuError> {
        if self.finished {
            return Ok(None);
        }
        self.finished = true;
        if let Some(mut input) = self.input.take() {
            // The process may have ended already; then nothing needs to be told.
            let _ = input.write_all(&Down::default().to_bytes());
        }
        let status = self.watchdog.end();
        self.decode_log()?;
        Ok(status)
    }

    fn decode_log(&self) -> Result<(), QemuError> {
        let raw = self.folder.join(RAW_LOG_FILE);
        log::decode_file(&self.image, &raw, &self.folder.join(LOG_FILE))
    }

    fn turn(&mut self) -> Result<Up, std::io::Error> {
        let Some(input) = self.input.as_mut() else {
            return Err(std::io::ErrorKind::BrokenPipe.into());
        };
        input.write_all(&self.turn)?;
        if let Some(record) = self.record.as_mut() {
            record.write_all(&self.turn)?;
        }
        let mut header = [0; UP_HEADER];
        self.output.read_exact(&mut header)?;
        let up = Up::from_bytes(header);
        let length = up.body().ok_or(std::io::Error::from(std::io::ErrorKind::InvalidData))?;
        self.body.resize(length, 0);
        self.output.read_exact(&mut self.body)?;
        self.watchdog.answered();
        Ok(up)
    }

    /// Why a turn failed.
    fn failure(&mut self, error: &std::io::Error) -> QemuError {
        let silent = self.watchdog.expired();
        let garbled = error.kind() == std::io::ErrorKind::InvalidData;
        self.input = None;
        let status = self.finish().ok().flatten();
        let log = self.folder.join(LOG_FILE);
        if silent {
            let seconds = self.patience.as_secs();
            return QemuError::Silent { seconds, log };
        }
        if garbled {
            return QemuError::Garbled;
        }
        let code = status.and_then(|status| status.code());
        if code == Some(4) {
            return QemuError::Refused;
        }
        let said = std::fs::read_to_string(self.folder.join(STDERR_FILE)).unwrap_or_default();
        let said = said.lines().last().map(|line| format!("; QEMU said: {line}"));
        QemuError::Ended {
            status: status.map_or_else(|| "killed".to_owned(), |status| status.to_string()),
            meaning: meaning(code),
            log,
            said: said.unwrap_or_default(),
        }
    }

    fn append<M: Message>(&mut self, message: &M, now_us: u64, to_hello: bool) -> Result<(), LinkError> {
        let mut out = [0; MAX_FRAME];
        let length = frame::encode(message, self.sequence, now_us, &mut out)?;
        self.sequence = self.sequence.wrapping_add(1);
        let target = if to_hello { &mut self.hello } else { &mut self.turn };
        target.extend_from_slice(out.get(..length).unwrap_or_default());
        Ok(())
    }
}

impl Controller for Qemu {
    fn connect(&mut self, hello: &DriveHello) -> Result<(), LinkError> {
        self.hello.clear();
        self.append(hello, 0, true)
    }

    fn exchange(
        &mut self,
        now_us: u64,
        state: &DriveState,
        down: &[u8],
        up: &mut Vec<u8>,
    ) -> Result<DriveCommand, LinkError> {
        if down.len() > MAX_HOST {
            return Err(QemuError::TooMuch { bytes: down.len() }.into());
        }
        self.turn.clear();
        self.turn.extend_from_slice(&Down::default().to_bytes());
        self.turn.append(&mut self.hello);
        self.append(state, now_us, false)?;
        let header = Down {
            drive: (self.turn.len() - Down::default().to_bytes().len()) as u16,
            host: down.len() as u16,
        };
        if let Some(start) = self.turn.first_chunk_mut() {
            *start = header.to_bytes();
        }
        self.turn.extend_from_slice(down);
        let header = match self.turn() {
            Ok(header) => header,
            Err(error) => return Err(self.failure(&error).into()),
        };
        // 25 MHz: 40 ns a count, 2^shift ns an instruction.
        let instructions = |counts: u32| ((u64::from(counts) * 40) >> self.shift) as u32;
        self.cost = TickCost {
            tick: instructions(header.tick),
            link: instructions(header.link),
        };
        let (drive, host) = self
            .body
            .split_at_mut_checked(usize::from(header.drive))
            .ok_or(QemuError::Garbled)?;
        up.extend_from_slice(host);
        let (_, drive) = drive.split_last_mut().ok_or(QemuError::Refused)?;
        let (_, command) = frame::decode::<DriveCommand>(drive)?;
        Ok(command)
    }
}

impl Drop for Qemu {
    fn drop(&mut self) {
        // There is nobody left to notify.
        let _ = self.finish();
    }
}
