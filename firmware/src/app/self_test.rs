//! What a board checks before it starts: memory, clock, and the image in flash.
//!
//! The checks are here and not on the board, so that they are tested against memory,
//! clocks and images that are bad.

/// Words of memory under test.
pub trait Memory {
    /// Number of words.
    fn words(&self) -> usize;
    /// Writes word `index`.
    fn write(&mut self, index: usize, value: u32);
    /// Reads word `index`.
    fn read(&self, index: usize) -> u32;
}

/// Tests memory by the march test C−: it finds bits that are stuck or cannot change,
/// addresses that share a cell, and most cells that change with another. The contents are
/// lost.
///
/// # Errors
/// Index of the first word that is wrong.
pub fn march(memory: &mut impl Memory) -> Result<(), usize> {
    const ZERO: u32 = 0;
    const ONE: u32 = u32::MAX;
    let words = memory.words();
    for index in 0..words {
        memory.write(index, ZERO);
    }
    let mut pass = |up: bool, expected: u32, then: u32| {
        for step in 0..words {
            let index = if up { step } else { words - 1 - step };
            if memory.read(index) != expected {
                return Err(index);
            }
            memory.write(index, then);
        }
        Ok(())
    };
    pass(true, ZERO, ONE)?;
    pass(true, ONE, ZERO)?;
    pass(false, ZERO, ONE)?;
    pass(false, ONE, ZERO)?;
    pass(true, ZERO, ZERO)
}

/// Whether `cycles` of a core at `core_hz` and `counts` of an independent oscillator at
/// `other_hz`, counted over the same time, agree within `percent`. The independent count
/// is known to one.
pub fn clocks_agree(cycles: u32, core_hz: u32, counts: u32, other_hz: u32, percent: u32) -> bool {
    // cycles / core_hz = counts / other_hz, without division.
    let (a, b) = (
        u64::from(cycles) * u64::from(other_hz),
        u64::from(counts) * u64::from(core_hz),
    );
    let allowed = b / 100 * u64::from(percent) + u64::from(core_hz);
    counts > 0 && a.abs_diff(b) <= allowed
}

/// Most parts of an image in flash.
pub const PARTS: usize = 8;
/// First word of a [`Seal`] that was written.
pub const SEALED: u32 = 0x5ea1_ed01;

/// What the image in flash must be: written into the image after it was linked
/// (`scripts/seal`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct Seal {
    /// [`SEALED`].
    pub magic: u32,
    /// Address, length in bytes and CRC-32 of each part; unused parts have length 0.
    pub parts: [[u32; 3]; PARTS],
}

/// What a check of the image found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Image {
    /// It is what was linked.
    Whole,
    /// It was not sealed, so this cannot be told.
    NotSealed,
    /// A part differs from what was linked, or the seal is damaged.
    Damaged {
        /// Address of the part.
        at: u32,
    },
}

impl Seal {
    /// A seal that was not written: flash after it was erased.
    pub const NONE: Self = Self {
        magic: u32::MAX,
        parts: [[u32::MAX; 3]; PARTS],
    };

    /// Compares the image with the seal. `read` gives the bytes of flash at an address and
    /// of a length, `None` outside of flash.
    pub fn check<'a>(&self, read: impl Fn(u32, u32) -> Option<&'a [u8]>) -> Image {
        if *self == Self::NONE {
            return Image::NotSealed;
        }
        let mut checked = 0;
        for [at, length, crc] in self.parts {
            if self.magic != SEALED {
                return Image::Damaged { at };
            }
            if length == 0 {
                continue;
            }
            let whole = read(at, length).is_some_and(|bytes| CRC.checksum(bytes) == crc);
            if !whole {
                return Image::Damaged { at };
            }
            checked += 1;
        }
        if checked > 0 {
            Image::Whole
        } else {
            Image::Damaged { at: 0 }
        }
    }
}

const CRC: crc::Crc<u32, crc::Table<1>> = crc::Crc::<u32, crc::Table<1>>::new(&crc::CRC_32_ISO_HDLC);

/// Configurable fault status: the address in MMFAR is valid; a load or store was not
/// allowed; stacking at an exception's entry was not allowed.
const MMARVALID: u32 = 1 << 7;
const DACCVIOL: u32 = 1 << 1;
const MSTKERR: u32 = 1 << 4;

/// Whether a fault of a Cortex-M with these values of CFSR and MMFAR came from a stack that
/// has reached the `guard` below it: the addresses that the MPU closes.
pub fn stack_overflowed(cfsr: u32, mmfar: u32, guard: core::ops::Range<u32>) -> bool {
    cfsr & MSTKERR != 0 || (cfsr & MMARVALID != 0 && cfsr & DACCVIOL != 0 && guard.contains(&mmfar))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;
    use std::vec::Vec;

    /// Memory with a fault.
    struct Faulty {
        cells: Vec<u32>,
        fault: Fault,
    }

    #[derive(Clone, Copy, Debug)]
    enum Fault {
        None,
        Stuck {
            word: usize,
            bit: u32,
            at_one: bool,
        },
        /// A bit that never falls once it has risen.
        NeverFalls {
            word: usize,
            bit: u32,
        },
        /// An address line that does not count: two words are one.
        Aliased {
            line: usize,
        },
        /// A write to one word inverts a bit of another.
        Coupled {
            from: usize,
            to: usize,
        },
    }

    impl Faulty {
        fn cell(&self, index: usize) -> usize {
            match self.fault {
                Fault::Aliased { line } => index & !(1 << line),
                _ => index,
            }
        }
    }

    impl Memory for Faulty {
        fn words(&self) -> usize {
            self.cells.len()
        }

        fn write(&mut self, index: usize, value: u32) {
            let cell = self.cell(index);
            let before = self.cells[cell];
            self.cells[cell] = match self.fault {
                Fault::Stuck { word, bit, at_one } if word == index => {
                    if at_one {
                        value | 1 << bit
                    } else {
                        value & !(1 << bit)
                    }
                }
                Fault::NeverFalls { word, bit } if word == index => value | (before & 1 << bit),
                _ => value,
            };
            if let Fault::Coupled { from, to } = self.fault
                && from == index
                && before != value
            {
                self.cells[to] ^= 1 << 7;
            }
        }

        fn read(&self, index: usize) -> u32 {
            self.cells[self.cell(index)]
        }
    }

    // Fails if good memory is refused, or if a word that is stuck, aliased or coupled to
    // another passes, wherever it is.
    #[test]
    fn bad_memory_is_found() {
        let test = |fault| {
            march(&mut Faulty {
                cells: vec![0xdead_beef; 64],
                fault,
            })
        };
        assert_eq!(test(Fault::None), Ok(()));
        for word in [0, 31, 63] {
            for bit in [0, 31] {
                for at_one in [false, true] {
                    assert_eq!(test(Fault::Stuck { word, bit, at_one }), Err(word));
                }
                assert_eq!(test(Fault::NeverFalls { word, bit }), Err(word));
            }
        }
        for line in 0..6 {
            assert!(test(Fault::Aliased { line }).is_err(), "line {line}");
        }
        for (from, to) in [(0, 63), (63, 0), (7, 8), (8, 7)] {
            assert!(test(Fault::Coupled { from, to }).is_err(), "{from} to {to}");
        }
    }

    // Fails if a core that runs from another clock, at half or twice the speed, passes, or
    // if the tolerance of an RC oscillator does not.
    #[test]
    fn a_wrong_clock_is_found() {
        // 10 ms at 480 MHz against 32 kHz.
        let agree = |counts| clocks_agree(4_800_000, 480_000_000, counts, 32_000, 10);
        assert!(agree(320) && agree(300) && agree(345));
        assert!(!agree(160) && !agree(640) && !agree(280) && !agree(360));
        assert!(!agree(0), "an oscillator that stands still");
        assert!(!clocks_agree(0, 480_000_000, 320, 32_000, 10));
    }

    // Fails if one flipped bit of the image or of the seal passes, or if an image that
    // was not sealed is called whole or damaged.
    #[test]
    fn a_damaged_image_is_found() {
        let flash: Vec<u8> = (0..4000u32).map(|k| (k * 7) as u8).collect();
        let part = |at: usize, length: usize| {
            [
                0x0800_0000 + at as u32,
                length as u32,
                CRC.checksum(&flash[at..at + length]),
            ]
        };
        let mut parts = [[0; 3]; PARTS];
        parts[0] = part(0, 1000);
        parts[1] = part(2000, 1500);
        let seal = Seal { magic: SEALED, parts };
        let check = |seal: &Seal, flash: &[u8]| {
            seal.check(|at, length| {
                let at = at.checked_sub(0x0800_0000)? as usize;
                // The test's flash lives as long as the test.
                let bytes: &'static [u8] = Vec::leak(flash.to_vec());
                bytes.get(at..at.checked_add(length as usize)?)
            })
        };
        assert_eq!(check(&seal, &flash), Image::Whole);
        assert_eq!(check(&Seal::NONE, &flash), Image::NotSealed);
        for at in [0, 999, 2000, 3499] {
            let mut flash = flash.clone();
            flash[at] ^= 0x10;
            let begin = if at < 1000 { 0x0800_0000 } else { 0x0800_07d0 };
            assert_eq!(check(&seal, &flash), Image::Damaged { at: begin });
        }
        let mut outside = seal;
        outside.parts[1][1] = u32::MAX;
        assert!(matches!(check(&outside, &flash), Image::Damaged { .. }));
        let mut damaged = seal;
        damaged.magic ^= 1;
        assert!(matches!(check(&damaged, &flash), Image::Damaged { .. }));
        let empty = Seal {
            parts: [[0; 3]; PARTS],
            ..seal
        };
        assert!(matches!(check(&empty, &flash), Image::Damaged { .. }));
    }

    // Fails if a stack that reaches its guard is not named, or if another fault is.
    #[test]
    fn a_stack_overflow_is_told_from_other_faults() {
        let guard = 0x2000_0000..0x2000_0400;
        assert!(stack_overflowed(0x82, 0x2000_03fc, guard.clone()));
        assert!(stack_overflowed(0x10, 0, guard.clone()));
        assert!(!stack_overflowed(0x82, 0x2000_0400, guard.clone()));
        assert!(
            !stack_overflowed(0x02, 0x2000_03fc, guard.clone()),
            "the address is not valid"
        );
        assert!(!stack_overflowed(0x8200, 0x2000_03fc, guard), "a bus fault");
    }
}
