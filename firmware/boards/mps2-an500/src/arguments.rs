//! The scenario and the log file, from `arg=` of QEMU's semihosting.

/// A scenario.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub enum Scenario {
    /// Controller on the lock-step pipe.
    Pipe,
    /// As `Pipe`, while a thread-mode task occupies the processor for 20 ms at a time.
    Hog,
    /// As `Pipe`, with one tick per exchange, however long a tick takes.
    Steps,
    /// Controller on UART0 (drive) and UART1 (host), one tick per drive state.
    Uart,
    /// Measures the cost of the stages of the control law.
    Stages,
    /// Runs the timer across its 32-bit wrap.
    Wrap,
}

/// The image's arguments.
#[derive(Clone, Copy)]
pub struct Arguments<'a> {
    /// The first word, if it is a scenario.
    pub scenario: Option<Scenario>,
    /// Path of the log file from `log=`, with its zero byte.
    pub log: Option<&'a str>,
}

impl<'a> Arguments<'a> {
    /// Parses `length` bytes of text at the start of `buffer`.
    pub fn parse(buffer: &'a mut [u8], length: usize) -> Self {
        // Every word gets a zero byte at its end, as semihosting wants for paths.
        for byte in buffer.iter_mut() {
            if *byte == b' ' {
                *byte = 0;
            }
        }
        if let Some(end) = buffer.get_mut(length) {
            *end = 0;
        }
        let mut arguments = Self {
            scenario: None,
            log: None,
        };
        let text = core::str::from_utf8(buffer).unwrap_or_default();
        for (index, word) in text.split_inclusive('\0').enumerate() {
            if word.len() < 2 {
                break;
            }
            if index == 0 {
                arguments.scenario = match word.trim_end_matches('\0') {
                    "pipe" => Some(Scenario::Pipe),
                    "steps" => Some(Scenario::Steps),
                    "hog" => Some(Scenario::Hog),
                    "uart" => Some(Scenario::Uart),
                    "stages" => Some(Scenario::Stages),
                    "wrap" => Some(Scenario::Wrap),
                    _ => None,
                };
            } else if let Some(path) = word.strip_prefix("log=") {
                arguments.log = Some(path);
            }
        }
        arguments
    }
}
