//! How deep an image's stack can get, bounded from what the compiler says of
//! each function's frame and from the calls in the machine code.
//!
//! Every direct branch out of a function counts as a call, a tail call too.
//! Calls through a register are not followed: whoever asks names what they may
//! reach, and a function that calls through a register and is not named is an
//! error, as is a recursion. What ends the image (panics, hard faults) is left
//! out: nothing returns from it.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use object::elf::{FileHeader32, STT_FUNC, Sym32};
use object::read::elf::{FileHeader, SectionHeader, Sym};
use object::{Endianness, SectionIndex};

/// A function of the image.
#[derive(Clone, Debug, Default)]
struct Function {
    names: Vec<String>,
    end: u32,
    frame: u32,
    calls: BTreeSet<u32>,
    indirect: bool,
}

impl Function {
    fn is(&self, part: &str) -> bool {
        self.names.iter().any(|name| name.contains(part))
    }
}

/// The functions of an image, by address.
#[derive(Clone, Debug)]
pub struct Calls {
    functions: BTreeMap<u32, Function>,
}

/// Sizes of an image, in bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sizes {
    /// Code and constants.
    pub text: u32,
    /// Initialised data.
    pub data: u32,
    /// Zeroed data.
    pub bss: u32,
}

/// Deepest way through the calls from one function.
#[derive(Clone, Debug, Default)]
pub struct Depth {
    /// Bytes.
    pub bytes: u32,
    /// The way: frame and name of each function.
    pub path: Vec<(u32, String)>,
}

/// What a call through a register may reach: part of the caller's name, parts
/// of the callees'.
pub type Indirect<'a> = &'a [(&'a str, &'a [&'a str])];

/// Parts of the names of functions from which nothing returns.
const LAST: [&str; 5] = ["9panicking", "rust_begin_unwind", "HardFault", "6option13", "6result13"];

type Elf = FileHeader32<Endianness>;

/// Text, data and bss of `image`.
///
/// # Panics
/// When it is not a 32-bit ELF file.
pub fn sizes(image: &Path) -> Sizes {
    let bytes = std::fs::read(image).expect("an image");
    let elf = Elf::parse(&*bytes).expect("an ELF file");
    let endian = elf.endian().expect("an endianness");
    let sections = elf.sections(endian, &*bytes).expect("sections");
    let mut sizes = Sizes::default();
    for section in sections.iter() {
        let flags = section.sh_flags(endian);
        let size = section.sh_size(endian);
        if flags & object::elf::SHF_ALLOC == 0 {
            continue;
        }
        if section.sh_type(endian) == object::elf::SHT_NOBITS {
            let name = sections.section_name(endian, section).unwrap_or_default();
            if name != b".uninit" {
                sizes.bss += size;
            }
        } else if flags & object::elf::SHF_WRITE != 0 {
            sizes.data += size;
        } else {
            sizes.text += size;
        }
    }
    sizes
}

/// Bytes that the linker leaves for the stack of `image`: from its end down to
/// the end of static data, or of the memory that holds the stack alone.
///
/// # Panics
/// When it is not an ELF file of `cortex-m-rt`'s making.
pub fn room(image: &Path) -> u32 {
    let bytes = std::fs::read(image).expect("an image");
    let elf = Elf::parse(&*bytes).expect("an ELF file");
    let endian = elf.endian().expect("an endianness");
    let sections = elf.sections(endian, &*bytes).expect("sections");
    let symbols = sections
        .symbols(endian, &*bytes, object::elf::SHT_SYMTAB)
        .expect("symbols");
    let address = |wanted: &str| {
        let named = |symbol: &&Sym32<Endianness>| symbols.symbol_name(endian, symbol) == Ok(wanted.as_bytes());
        let symbol = symbols.iter().find(named);
        symbol.map_or_else(|| panic!("no symbol {wanted}"), |symbol| symbol.st_value(endian))
    };
    address("_stack_start") - address("_stack_end")
}

impl Calls {
    /// Reads `image`, which was built with stack sizes.
    ///
    /// # Panics
    /// When it is not an ELF file with code, symbols and stack sizes.
    pub fn read(image: &Path) -> Self {
        let bytes = std::fs::read(image).expect("an image");
        let elf = Elf::parse(&*bytes).expect("an ELF file");
        let endian = elf.endian().expect("an endianness");
        let sections = elf.sections(endian, &*bytes).expect("sections");
        let symbols = sections
            .symbols(endian, &*bytes, object::elf::SHT_SYMTAB)
            .expect("symbols");
        // Code lies in flash, and on some boards in a memory without wait states, too.
        let mut functions: BTreeMap<u32, Function> = BTreeMap::new();
        for name in [&b".text"[..], b".itcm"] {
            let Some((index, section)) = sections.section_by_name(endian, name) else {
                continue;
            };
            let code = section.data(endian, &*bytes).expect("code");
            let mut symbols = symbols.iter().map(|symbol| {
                let name = symbols.symbol_name(endian, symbol).unwrap_or_default();
                (symbol, String::from_utf8_lossy(name).into_owned())
            });
            read_section(
                &mut functions,
                &mut symbols,
                index,
                section.sh_addr(endian),
                code,
                endian,
            );
        }
        let (_, stack) = sections.section_by_name(endian, b".stack_sizes").expect("stack sizes");
        let mut rest = stack.data(endian, &*bytes).expect("stack sizes");
        while let Some((address, after)) = rest.split_first_chunk::<4>() {
            let (mut size, mut shift, mut used) = (0u32, 0, 0);
            for byte in after {
                size |= u32::from(byte & 0x7f) << shift;
                (shift, used) = (shift + 7, used + 1);
                if byte & 0x80 == 0 {
                    break;
                }
            }
            rest = &after[used..];
            if let Some(function) = functions.get_mut(&(u32::from_le_bytes(*address) & !1)) {
                function.frame = size;
            }
        }
        Self { functions }
    }

    /// Deepest way from the one function whose name contains `root`, functions
    /// whose names contain one of `without` left out.
    ///
    /// # Errors
    /// A recursion, a call through a register that `indirect` does not name, or
    /// a name that is none.
    pub fn depth(&self, root: &str, indirect: Indirect<'_>, without: &[&str]) -> Result<Depth, String> {
        let from = self.named(root)?;
        let [from] = from[..] else {
            return Err(format!("{} functions are named {root}", from.len()));
        };
        let mut open = Vec::new();
        self.below(from, indirect, without, &mut open, &mut BTreeMap::new())
    }

    fn named(&self, part: &str) -> Result<Vec<u32>, String> {
        let of = |fits: &dyn Fn(&String) -> bool| -> Vec<u32> {
            let fitting = self.functions.iter().filter(|(_, f)| f.names.iter().any(fits));
            fitting.map(|(address, _)| *address).collect()
        };
        let mut found = of(&|name| name == part);
        if found.is_empty() {
            found = of(&|name| name.contains(part));
        }
        if found.is_empty() {
            return Err(format!("no function is named {part}"));
        }
        Ok(found)
    }

    fn below(
        &self,
        address: u32,
        indirect: Indirect<'_>,
        without: &[&str],
        open: &mut Vec<u32>,
        known: &mut BTreeMap<u32, Depth>,
    ) -> Result<Depth, String> {
        if let Some(depth) = known.get(&address) {
            return Ok(depth.clone());
        }
        let function = &self.functions[&address];
        let name = function.names.first().cloned().unwrap_or_default();
        if open.contains(&address) {
            let names: Vec<_> = open.iter().map(|a| self.functions[a].names[0].clone()).collect();
            return Err(format!("{name} calls itself: {names:?}"));
        }
        let mut callees: Vec<u32> = function.calls.iter().copied().collect();
        if function.indirect {
            let Some((_, parts)) = indirect.iter().find(|(caller, _)| function.is(caller)) else {
                return Err(format!("{name} calls through a register, and nothing says whom"));
            };
            for part in *parts {
                callees.extend(self.named(part)?);
            }
        }
        open.push(address);
        let mut deepest = Depth::default();
        for callee in callees {
            let Some((&at, found)) = self.functions.range(..=callee).next_back() else {
                continue;
            };
            if LAST.iter().chain(without).any(|last| found.is(last)) {
                continue;
            }
            let depth = self.below(at, indirect, without, open, known)?;
            if depth.bytes > deepest.bytes || deepest.path.is_empty() {
                deepest = depth;
            }
        }
        open.pop();
        deepest.bytes += function.frame;
        deepest.path.insert(0, (function.frame, name));
        known.insert(address, deepest.clone());
        Ok(deepest)
    }
}

/// Adds the functions of a section of code, which lies at `start`.
fn read_section(
    functions: &mut BTreeMap<u32, Function>,
    symbols: &mut dyn Iterator<Item = (&Sym32<Endianness>, String)>,
    section: SectionIndex,
    start: u32,
    code: &[u8],
    endian: Endianness,
) {
    let mut kinds: BTreeMap<u32, bool> = BTreeMap::new();
    let mut found: BTreeMap<u32, Function> = BTreeMap::new();
    for (symbol, name) in symbols {
        if symbol.st_shndx(endian) as usize != section.0 {
            continue;
        }
        let address = symbol.st_value(endian);
        if name.starts_with("$t") || name.starts_with("$d") {
            kinds.insert(address, name.starts_with("$t"));
        } else if symbol.st_type() == STT_FUNC {
            let function = found.entry(address & !1).or_default();
            function.names.push(name);
            function.end = function.end.max((address & !1) + symbol.st_size(endian));
        }
    }
    let starts: Vec<u32> = found.keys().copied().collect();
    let end_of_code = start + code.len() as u32;
    for (k, address) in starts.iter().enumerate() {
        let next = starts.get(k + 1).copied().unwrap_or(end_of_code);
        let function = found.get_mut(address).expect("its own key");
        // Assembly does not say how long it is.
        if function.end == *address {
            function.end = next;
        }
        scan(function, *address, code, start, &kinds);
    }
    functions.append(&mut found);
}

/// The 16 bits that a `movw` or `movt` loads into r12.
fn immediate(first: u32, second: u32) -> u32 {
    (first & 0xf) << 12 | (first & 0x400) << 1 | (second & 0x7000) >> 4 | (second & 0xff)
}

/// Finds the calls of a function and, from its pushes, its frame.
fn scan(function: &mut Function, start: u32, code: &[u8], base: u32, kinds: &BTreeMap<u32, bool>) {
    let word = |at: u32| {
        let k = (at - base) as usize;
        code.get(k..k + 2)
            .map_or(0, |b| u32::from(u16::from_le_bytes([b[0], b[1]])))
    };
    let signed = |value: u32, bits: u32| ((value << (32 - bits)) as i32) >> (32 - bits);
    let end = function.end;
    let mut at = start;
    // What r12 holds: the linker's bridges to code that is far away load it and branch.
    let mut far = None;
    while at + 1 < end {
        let is_code = kinds.range(..=at).next_back().is_none_or(|(_, code)| *code);
        if !is_code {
            at += 2;
            continue;
        }
        let first = word(at);
        let wide = first >> 11 >= 0b11101;
        let second = if wide { word(at + 2) } else { 0 };
        let next = at + if wide { 4 } else { 2 };
        let target = |offset: i32| (at + 4).wrapping_add_signed(offset);
        let mut branch = None;
        if !wide {
            match first {
                // b<c>, b
                _ if first & 0xf000 == 0xd000 && first & 0x0f00 < 0x0e00 => {
                    branch = Some((target(signed(first & 0xff, 8) * 2), false));
                }
                _ if first & 0xf800 == 0xe000 => branch = Some((target(signed(first & 0x7ff, 11) * 2), false)),
                // blx, bx, mov pc; `bx lr` returns
                0x4760 if far.is_some() => branch = far.map(|target: u32| (target & !1, true)),
                _ if first & 0xff87 == 0x4780 => function.indirect = true,
                _ if first & 0xff87 == 0x4700 && first & 0x78 != 0x70 => function.indirect = true,
                _ if first & 0xff87 == 0x4687 => function.indirect = true,
                // push, sub sp
                _ if first & 0xfe00 == 0xb400 => function.frame += 4 * (first & 0x1ff).count_ones(),
                _ if first & 0xff80 == 0xb080 => function.frame += 4 * (first & 0x7f),
                _ => {}
            }
        } else if first & 0xf800 == 0xf000 && second & 0x8000 != 0 {
            let (s, j1, j2) = ((first >> 10) & 1, (second >> 13) & 1, (second >> 11) & 1);
            let call = second & 0xd000 == 0xd000;
            if call || second & 0xd000 == 0x9000 {
                let (i1, i2) = (1 ^ j1 ^ s, 1 ^ j2 ^ s);
                let high = s << 24 | i1 << 23 | i2 << 22;
                let offset = high | (first & 0x3ff) << 12 | (second & 0x7ff) << 1;
                branch = Some((target(signed(offset, 25)), call));
            } else if second & 0xd000 == 0x8000 && first & 0x0380 != 0x0380 {
                let offset = s << 20 | j2 << 19 | j1 << 18 | (first & 0x3f) << 12 | (second & 0x7ff) << 1;
                branch = Some((target(signed(offset, 21)), false));
            }
        } else if first & 0xfbf0 == 0xf240 && second & 0x8f00 == 0x0c00 {
            // movw r12
            far = Some(immediate(first, second));
        } else if first & 0xfbf0 == 0xf2c0 && second & 0x8f00 == 0x0c00 {
            // movt r12
            far = far.map(|low| low & 0xffff | immediate(first, second) << 16);
        } else if first == 0xe92d {
            // push.w
            function.frame += 4 * second.count_ones();
        } else if first & 0xffbf == 0xed2d && second & 0x0e00 == 0x0a00 {
            // vpush
            function.frame += 4 * (second & 0xff);
        } else if first & 0xff70 == 0xf850 && second >> 12 == 15 && first & 0xf != 13 {
            // ldr pc, but for the return `ldr pc, [sp], #4`
            function.indirect = true;
        }
        if let Some((target, call)) = branch
            && (call || target < start || target >= end)
        {
            function.calls.insert(target);
        }
        at = next;
    }
}
