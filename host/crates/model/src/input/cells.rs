//! One line of a table as cells, and one cell as a number.
//!
//! A line is a row: a cell that holds a line break is refused, because a quote
//! that is never closed would otherwise swallow the rows below it.

/// Most columns of a table.
pub const MOST_COLUMNS: usize = 1000;

/// Why a line is not a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SplitError {
    /// A quote is opened and not closed on the line.
    OpenQuote,
    /// More than [`MOST_COLUMNS`] cells.
    TooMany,
}

/// Cells that stand for no value.
const NO_VALUE: [&str; 7] = ["", "nan", "-nan", "null", "none", "na", "n/a"];

/// Whether a cell says that there is no value.
pub(super) fn no_value(cell: &str) -> bool {
    NO_VALUE.iter().any(|word| cell.eq_ignore_ascii_case(word))
}

/// Cuts lines into cells.
pub(super) struct Splitter {
    reader: csv_core::Reader,
    text: Vec<u8>,
    ends: Vec<usize>,
    count: usize,
}

impl Splitter {
    pub(super) fn new(separator: u8) -> Self {
        Self {
            reader: csv_core::ReaderBuilder::new().delimiter(separator).build(),
            text: Vec::new(),
            ends: vec![0; MOST_COLUMNS],
            count: 0,
        }
    }

    /// Cuts a line; returns the number of its cells, 0 for an empty line.
    /// Errors: a quote without its partner; too many cells.
    pub(super) fn split(&mut self, line: &str) -> Result<usize, SplitError> {
        self.count = 0;
        let quotes = memchr::memchr_iter(b'"', line.as_bytes()).count();
        if quotes % 2 == 1 {
            return Err(SplitError::OpenQuote);
        }
        self.reader.reset();
        // A cell's text is never longer than what it was written as.
        self.text.resize(line.len() + 1, 0);
        let mut rest = line.as_bytes();
        let mut filled = 0;
        loop {
            let (found, read, written, ends) =
                self.reader
                    .read_record(rest, &mut self.text[filled..], &mut self.ends[self.count..]);
            rest = rest.get(read..).unwrap_or_default();
            filled += written;
            self.count += ends;
            match found {
                // The end of the line is the end of the input.
                csv_core::ReadRecordResult::InputEmpty => {}
                csv_core::ReadRecordResult::Record | csv_core::ReadRecordResult::End => return Ok(self.count),
                csv_core::ReadRecordResult::OutputFull | csv_core::ReadRecordResult::OutputEndsFull => {
                    self.count = 0;
                    return Err(SplitError::TooMany);
                }
            }
        }
    }

    /// A cell of the last line without the blanks around it; empty beyond the last.
    pub(super) fn cell(&self, k: usize) -> &str {
        if k >= self.count {
            return "";
        }
        let start = if k == 0 { 0 } else { self.ends[k - 1] };
        let bytes = self.text.get(start..self.ends[k]).unwrap_or_default();
        std::str::from_utf8(bytes).unwrap_or_default().trim()
    }
}

/// The separator of a header line: the one of comma, semicolon and tab that stands
/// most often outside quotes; the comma where there is none.
pub(super) fn separator(header: &str) -> u8 {
    let mut counts = [(b'\t', 0), (b';', 0), (b',', 0)];
    let mut quoted = false;
    for byte in header.bytes() {
        quoted ^= byte == b'"';
        if let Some(count) = counts.iter_mut().find(|c| !quoted && c.0 == byte) {
            count.1 += 1;
        }
    }
    counts.into_iter().max_by_key(|c| c.1).map_or(b',', |c| c.0)
}

/// Where a decimal sign was first seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct SeenSign {
    /// Row of data, from 1.
    pub(super) row: usize,
    /// Column, from 0.
    pub(super) column: usize,
}

/// How a table writes its decimals: with a point or with a comma, never both.
///
/// A table with both could mean 1,234 as a thousand in one cell and as 1.234 in
/// the next.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Decimals {
    point: Option<SeenSign>,
    comma: Option<SeenSign>,
}

/// Why a cell is not a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum NumberError {
    /// The cell is empty.
    Empty,
    /// NaN or infinite.
    NotFinite,
    /// A spreadsheet's mark for a formula that failed.
    Spreadsheet,
    /// Both decimal points and decimal commas; where the other one was seen.
    Mixed(SeenSign),
    /// A comma in a table that commas separate, or several in one number.
    Thousands,
    /// Anything else.
    NotANumber,
}

impl Decimals {
    /// A finite number from a cell at `here`; `separator` is the table's.
    pub(super) fn number(&mut self, text: &str, separator: u8, here: SeenSign) -> Result<f64, NumberError> {
        let point = memchr::memchr(b'.', text.as_bytes()).is_some();
        if let Ok(value) = text.parse::<f64>() {
            if !value.is_finite() {
                return Err(NumberError::NotFinite);
            }
            if point {
                if let Some(seen) = self.comma {
                    return Err(NumberError::Mixed(seen));
                }
                self.point.get_or_insert(here);
            }
            return Ok(value);
        }
        if text.is_empty() {
            return Err(NumberError::Empty);
        }
        if text.starts_with('#') {
            return Err(NumberError::Spreadsheet);
        }
        if !text.contains(',') {
            return Err(NumberError::NotANumber);
        }
        let Ok(value) = text.replacen(',', ".", 1).parse::<f64>() else {
            let digits = |c: char| c.is_ascii_digit() || matches!(c, ',' | '.' | ' ' | '\u{a0}' | '+' | '-');
            return Err(if text.chars().all(digits) {
                NumberError::Thousands
            } else {
                NumberError::NotANumber
            });
        };
        if separator == b',' {
            return Err(NumberError::Thousands);
        }
        if let Some(seen) = self.point {
            return Err(NumberError::Mixed(seen));
        }
        self.comma.get_or_insert(here);
        if value.is_finite() {
            Ok(value)
        } else {
            Err(NumberError::NotFinite)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const HERE: SeenSign = SeenSign { row: 1, column: 0 };

    fn cells(line: &str, separator: u8) -> Vec<String> {
        let mut splitter = Splitter::new(separator);
        let count = splitter.split(line).unwrap();
        (0..count).map(|k| splitter.cell(k).to_owned()).collect()
    }

    #[test]
    fn quotes_hide_separators() {
        assert_eq!(cells("a,\"b,c\", \"d\"\"\" ,", b','), ["a", "b,c", "\"d\"\"\"", ""]);
        assert_eq!(cells("\"1,5\";2", b';'), ["1,5", "2"]);
        assert_eq!(cells("", b';'), [""; 0]);
        assert_eq!(cells(";;", b';'), ["", "", ""]);
        assert_eq!(Splitter::new(b',').split("a,\"b,c"), Err(SplitError::OpenQuote));
        assert_eq!(
            Splitter::new(b',').split(&",".repeat(MOST_COLUMNS)),
            Err(SplitError::TooMany)
        );
        assert_eq!(separator("a,\"b;c;d\",e"), b',');
        assert_eq!(separator("a;\"b,c,d\""), b';');
        assert_eq!(separator("a\tb"), b'\t');
        assert_eq!(separator("a b"), b',');
    }

    #[test]
    fn a_table_writes_decimals_one_way() {
        let mut d = Decimals::default();
        assert_eq!(d.number("-0,5", b';', HERE), Ok(-0.5));
        assert_eq!(d.number("1,5E-03", b';', HERE), Ok(1.5e-3));
        assert_eq!(d.number("7", b';', HERE), Ok(7.0));
        assert_eq!(d.number("0.5", b';', HERE), Err(NumberError::Mixed(HERE)));
        let mut d = Decimals::default();
        assert_eq!(d.number("1.5", b';', HERE), Ok(1.5));
        assert_eq!(d.number("1,5", b';', HERE), Err(NumberError::Mixed(HERE)));
        let mut d = Decimals::default();
        for (text, error) in [
            ("", NumberError::Empty),
            ("nan", NumberError::NotFinite),
            ("-inf", NumberError::NotFinite),
            ("1e999", NumberError::NotFinite),
            ("#DIV/0!", NumberError::Spreadsheet),
            ("1.234,5", NumberError::Thousands),
            ("1,234,567", NumberError::Thousands),
            ("1 234,5", NumberError::Thousands),
            ("twelve", NumberError::NotANumber),
            ("12,x", NumberError::NotANumber),
        ] {
            assert_eq!(d.number(text, b';', HERE), Err(error), "{text}");
        }
        // With commas between the cells it may be a thousand.
        assert_eq!(d.number("1,234", b',', HERE), Err(NumberError::Thousands));
    }

    proptest! {
        /// Fails if any line breaks the splitter, or cells are lost.
        #[test]
        fn plain_cells_are_kept(parts in proptest::collection::vec("[a-z0-9ü ]{0,4}", 1..8)) {
            let line = parts.join(";");
            let expected: Vec<&str> = parts.iter().map(|p| p.trim()).collect();
            let found = cells(&line, b';');
            prop_assert!(found == expected || (line.is_empty() && found.is_empty()));
        }

        #[test]
        fn any_line_is_split_or_refused(line in "[^\\r\\n]{0,60}", sep in proptest::sample::select(vec![b',', b';', b'\t'])) {
            let mut splitter = Splitter::new(sep);
            if let Ok(count) = splitter.split(&line) {
                for k in 0..=count {
                    let _ = Decimals::default().number(splitter.cell(k), sep, HERE);
                }
                prop_assert_eq!(splitter.cell(count), "");
            }
        }
    }
}
