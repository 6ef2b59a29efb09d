//! What the image is to do: `arg=` of QEMU's semihosting.

/// A scenario.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub enum Scenario {
    /// Controller on the lock-step pipe.
    Pipe,
    /// The same with a thread-mode task that hogs the processor for 20 ms at a time.
    Hog,
    /// Controller on UART0 (drive) and UART1 (host), one tick for each drive state.
    Uart,
    /// What the stages of the control law cost.
    Stages,
    /// The timer across its 32-bit wrap.
    Wrap,
}

/// The arguments, taken apart.
#[derive(Clone, Copy)]
pub struct Arguments<'a> {
    /// The first word.
    pub scenario: Option<Scenario>,
    /// `log=`: path of the log file, its zero byte included.
    pub log: Option<&'a str>,
}

impl<'a> Arguments<'a> {
    /// Takes apart `length` bytes of text at the start of `buffer`.
    pub fn parse(buffer: &'a mut [u8], length: usize) -> Self {
        // Every word ends with a zero byte, as semihosting wants its paths.
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
