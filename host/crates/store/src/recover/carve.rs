//! Rows that SQLite does not find any more: the head of their page is damaged, and they are not.
//!
//! The bytes of a row say how long it is and which types its values have (SQLite's file format, sections 1.6 and 2.1). So
//! rows are looked for at every place of every page. Much else looks like a row; a digest tells those that were written.

use std::collections::{HashMap, HashSet};

use super::rows::StoredRow;
use super::seals::Seals;
use crate::seal::SealedValue;

/// The size of a page of this program's databases, in bytes: SQLite's default.
const PAGE: usize = 4096;
/// Rows of this table have a digest together, that of their recording. What does not fit it is left out later.
const JOINTS: &str = "recording_joints";

/// Most columns of a key: run, sphere, pose, joint.
const KEY: usize = 4;

/// A table: its name, and which of its columns are floating point. SQLite stores whole numbers of those as integers.
pub(super) type Shape = (&'static str, Vec<bool>);

/// The rows of these tables that stand in the bytes of a file, and that a digest proves.
pub(super) fn rows_in(bytes: &[u8], tables: &[Shape], seals: &Seals) -> HashMap<&'static str, Vec<StoredRow>> {
    let mut found: HashMap<&'static str, Vec<StoredRow>> = HashMap::new();
    for page in bytes.chunks(PAGE) {
        for at in 0..page.len() {
            let Some(row) = row_at(page, at) else { continue };
            for (table, real) in tables {
                if let Some(row) = shaped(&row, real)
                    && (*table == JOINTS || seals.prove(table, &row))
                {
                    found.entry(table).or_default().push(row);
                }
            }
        }
    }
    found
}

/// Those of the rows found whose keys none of the rows read has, each once.
pub(super) fn beyond(read: &[StoredRow], found: Vec<StoredRow>) -> Vec<StoredRow> {
    // Of every table, the key is in the whole numbers and texts before the first other value.
    let key = |row: &StoredRow| {
        let key = row
            .iter()
            .take_while(|value| !matches!(value, SealedValue::Real(_) | SealedValue::Nothing));
        key.take(KEY).map(ToString::to_string).collect::<Vec<_>>()
    };
    let mut known: HashSet<Vec<String>> = read.iter().map(key).collect();
    found.into_iter().filter(|row| known.insert(key(row))).collect()
}

/// The row with the types of the columns; `None` if it is none of this table.
fn shaped(row: &[SealedValue], real: &[bool]) -> Option<StoredRow> {
    if row.len() != real.len() {
        return None;
    }
    let typed = |(value, real): (&SealedValue, &bool)| match value {
        SealedValue::Whole(number) if *real => Some(SealedValue::Real(*number as f64)),
        SealedValue::Real(_) | SealedValue::Text(_) if *real != matches!(value, SealedValue::Real(_)) => None,
        other => Some(other.clone()),
    };
    row.iter().zip(real).map(typed).collect()
}

/// A number of one to nine bytes at a place, and where it ends.
fn varint(bytes: &[u8], at: usize) -> Option<(u64, usize)> {
    let mut value = 0u64;
    for k in 0..9 {
        let byte = *bytes.get(at + k)?;
        if k == 8 {
            return Some((value << 8 | u64::from(byte), at + 9));
        }
        value = value << 7 | u64::from(byte & 0x7f);
        if byte < 0x80 {
            return Some((value, at + k + 1));
        }
    }
    None
}

/// What looks like a row at a place of a page: the length of its bytes, its number, the types of its values, the values.
fn row_at(page: &[u8], at: usize) -> Option<StoredRow> {
    let (length, after) = varint(page, at)?;
    let (_number, begin) = varint(page, after)?;
    let length = usize::try_from(length).ok().filter(|length| *length <= PAGE)?;
    let body = page.get(begin..begin + length)?;
    let (head, mut type_at) = varint(body, 0)?;
    let head = usize::try_from(head).ok().filter(|head| *head > 2 && *head <= length)?;
    let (mut values, mut value_at) = (Vec::new(), head);
    while type_at < head {
        let (kind, next) = varint(body, type_at)?;
        type_at = next;
        let (value, size) = value_of(kind, body.get(value_at..)?)?;
        value_at += size;
        values.push(value);
    }
    (type_at == head && value_at == length).then_some(values)
}

/// A value of a type of SQLite at the begin of some bytes, and how many of them it has.
fn value_of(kind: u64, bytes: &[u8]) -> Option<(SealedValue, usize)> {
    let whole = |size: usize| {
        let bytes = bytes.get(..size)?;
        let sign = if bytes.first()? & 0x80 == 0 { 0i64 } else { -1 };
        let value = bytes.iter().fold(sign, |sum, byte| sum << 8 | i64::from(*byte));
        Some((SealedValue::Whole(value), size))
    };
    match kind {
        0 => Some((SealedValue::Nothing, 0)),
        1..=4 => whole(kind as usize),
        5 => whole(6),
        6 => whole(8),
        7 => {
            let bytes: [u8; 8] = bytes.get(..8)?.try_into().ok()?;
            Some((SealedValue::Real(f64::from_be_bytes(bytes)), 8))
        }
        8 | 9 => Some((SealedValue::Whole(kind as i64 - 8), 0)),
        text if text >= 13 && text % 2 == 1 => {
            let size = usize::try_from((text - 13) / 2).ok()?;
            let text = std::str::from_utf8(bytes.get(..size)?).ok()?;
            Some((SealedValue::Text(text.to_owned()), size))
        }
        _ => None,
    }
}
