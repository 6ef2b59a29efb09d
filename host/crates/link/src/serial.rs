//! The host's end of a controller board on a serial device.
//!
//! The board has its own clock and its own drive, so nothing waits for the host. Each
//! [`step`](Device::step) is one millisecond of this computer's clock: the host's bytes go out and
//! the board's bytes are read. The board states the times of its actions on its own clock.

use std::io::ErrorKind;
use std::time::{Duration, Instant};

use serial2::SerialPort;

use super::{Device, LinkError};
use spherecal_budget::link::SERIAL_WRITE;

/// Rate of the boards' host link, in bits per second.
pub(super) const BAUD: u32 = 921_600;
/// One step of the host, in µs.
const STEP_US: u64 = 1_000;

/// A controller board, reached over its host link.
pub struct Serial {
    port: SerialPort,
    name: String,
    begun: Instant,
    ticks: u64,
    buffer: Vec<u8>,
}

impl Serial {
    /// Opens `DEVICE` or `DEVICE@BAUD` (921,600 by default), 8N1, raw.
    ///
    /// # Errors
    /// The device does not exist or may not be opened, or the rate is not one that it supports.
    pub fn open(device: &str) -> Result<Self, LinkError> {
        Self::over(open_port(device, BAUD)?, &format!("serial:{device}"))
    }

    /// Refuses a rate that is none, and a device that is not there, without opening it: some boards restart
    /// when they are opened.
    ///
    /// # Errors
    /// Like [`open`](Self::open).
    pub fn check(device: &str) -> Result<(), LinkError> {
        let (path, rate) = device.rsplit_once('@').unwrap_or((device, "1"));
        if std::path::Path::new(path).exists() && rate.parse::<u32>().is_ok_and(|rate| rate > 0) {
            return Ok(());
        }
        Self::open(device).map(|_| ())
    }

    /// A board behind a port that is already open; `name` appears in messages.
    ///
    /// # Errors
    /// When the port cannot be set up.
    pub fn over(mut port: SerialPort, name: &str) -> Result<Self, LinkError> {
        let set = port
            .set_read_timeout(Duration::from_micros(STEP_US))
            .and_then(|()| port.set_write_timeout(SERIAL_WRITE))
            // Bytes that the board sent before anyone listened may begin in the middle of a frame.
            .and_then(|()| port.discard_input_buffer());
        let this = Self {
            port,
            name: name.to_owned(),
            begun: Instant::now(),
            ticks: 0,
            buffer: vec![0; 1 << 12],
        };
        set.map_err(|source| this.failed(source))?;
        Ok(this)
    }

    fn failed(&self, source: std::io::Error) -> LinkError {
        LinkError::Transport {
            link: self.name.clone(),
            source,
        }
    }
}

/// Opens `DEVICE` or `DEVICE@BAUD`, 8N1, raw.
pub(super) fn open_port(device: &str, baud: u32) -> Result<SerialPort, LinkError> {
    let link = format!("serial:{device}");
    let (path, baud) = match device.rsplit_once('@') {
        Some((path, rate)) => (path, rate.parse().ok().filter(|rate| *rate > 0)),
        None => (device, Some(baud)),
    };
    let Some(baud) = baud else {
        return Err(LinkError::Baud { link });
    };
    SerialPort::open(path, baud).map_err(|source| LinkError::Serial {
        link,
        source,
        found: present(),
    })
}

/// Serial devices of this computer, for a message.
fn present() -> String {
    let names: Vec<String> = SerialPort::available_ports()
        .unwrap_or_default()
        .iter()
        .map(|path| path.display().to_string())
        .collect();
    if names.is_empty() {
        "no serial device is there: plug the board in".to_owned()
    } else {
        format!("there are {}", names.join(", "))
    }
}

impl Device for Serial {
    fn waits(&self) -> bool {
        false
    }

    fn now_us(&self) -> u64 {
        self.ticks.saturating_mul(STEP_US)
    }

    fn ticks(&self) -> u64 {
        self.ticks
    }

    fn step(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        self.port.write_all(down).map_err(|e| self.failed(e))?;
        let mut ticks = u64::try_from(self.begun.elapsed().as_micros()).unwrap_or(u64::MAX) / STEP_US;
        // At least one step, and no faster than the clock.
        loop {
            match self.port.read(&mut self.buffer) {
                Ok(0) => return Err(self.failed(ErrorKind::UnexpectedEof.into())),
                Ok(count) => up.extend_from_slice(self.buffer.get(..count).unwrap_or_default()),
                Err(e)
                    if matches!(
                        e.kind(),
                        ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted
                    ) => {}
                Err(e) => return Err(self.failed(e)),
            }
            if ticks > self.ticks {
                break;
            }
            ticks = u64::try_from(self.begun.elapsed().as_micros()).unwrap_or(u64::MAX) / STEP_US;
        }
        self.ticks = ticks;
        Ok(())
    }
}
