//! Reads the rows of a damaged table, and writes them into the new file.

use std::collections::{BTreeMap, HashSet};

use sqlx::sqlite::SqliteRow;
use sqlx::{AnyConnection, AssertSqlSafe, Connection as _, Row as _, SqliteConnection, TypeInfo as _, ValueRef as _};

use super::Saved;
use crate::seal::SealedValue;

/// The search for rows of a table ends after so many numbers in a row without a row.
const GAP: i64 = 20_000;

/// A row, in the order of the new file's columns.
pub(super) type StoredRow = Vec<SealedValue>;

/// The run of a row. It is the first column of every table.
pub(super) fn run_of(row: &StoredRow) -> Option<i64> {
    match row.first() {
        Some(SealedValue::Whole(run)) => Some(*run),
        _ => None,
    }
}

/// A copy that rows are read from.
pub(super) struct Source {
    pub(super) connection: SqliteConnection,
    /// Whether its list of tables was replaced by that of a fresh database.
    pub(super) replaced: bool,
    /// Whether it is a file of an older schema, whose tables lack columns.
    pub(super) older: bool,
}

/// A column of the new file: its name, and its value where an older schema lacks it, as SQL.
pub(super) type Column = (String, Option<String>);

/// The columns of a table of the new file.
pub(super) async fn columns_of(table: &str, target: &mut AnyConnection) -> Result<Vec<Column>, sqlx::Error> {
    sqlx::query_as(AssertSqlSafe(format!(
        "SELECT name, dflt_value FROM pragma_table_info('{table}') ORDER BY cid"
    )))
    .fetch_all(target)
    .await
}

/// All rows of a table that can be read from any of the sources, and the number of those that cannot. Of equal rows
/// one is taken.
pub(super) async fn read_rows(table: &str, columns: &[Column], sources: &mut [Source]) -> (Vec<StoredRow>, u64) {
    let (mut all, mut lost) = (Vec::new(), 0u64);
    for (source, number) in sources.iter_mut().zip(0..) {
        let (rows, of_source, _) = read_table(table, columns, source).await;
        if number == 0 {
            (all, lost) = (rows, of_source);
            continue;
        }
        let known: HashSet<String> = all.iter().map(|row| format!("{row:?}")).collect();
        all.extend(rows.into_iter().filter(|row| !known.contains(&format!("{row:?}"))));
    }
    (all, lost)
}

/// All rows of a table that can be read, the number of those that cannot, and whether the table was
/// read to its end without an error.
///
/// The table is read as a whole. If that fails, it is read forwards and backwards, each to the first
/// damage, and then number by number.
pub(super) async fn read_table(table: &str, columns: &[Column], source: &mut Source) -> (Vec<StoredRow>, u64, bool) {
    let lacking = if source.older {
        lacking(table, columns, &mut source.connection).await
    } else {
        Vec::new()
    };
    let source = &mut source.connection;
    // An expression has no declared type; a declared type that is not text would hang the driver.
    let value = |(name, default): &Column| match default {
        Some(default) if lacking.contains(name) => format!("{default} AS {name}"),
        _ => format!("+{name} AS {name}"),
    };
    let values: Vec<String> = columns.iter().map(value).collect();
    let select = format!(
        "SELECT +rowid AS number, {} FROM {table} NOT INDEXED",
        values.join(", ")
    );
    // The whole table in the order of its pages: a damaged number does not matter to that.
    if let Ok(all) = sqlx::query(AssertSqlSafe(select.clone())).fetch_all(&mut *source).await {
        let rows: Vec<StoredRow> = all.iter().filter_map(|row| values_of(row, columns.len())).collect();
        let lost = (all.len() - rows.len()) as u64;
        return (rows, lost, lost == 0);
    }
    let mut rows: BTreeMap<i64, StoredRow> = BTreeMap::new();
    let mut lost = 0;
    for order in ["ASC", "DESC"] {
        let mut from: Option<i64> = None;
        // In steps, because an error in the middle of a step loses what the step had read.
        loop {
            let bound = match from {
                None => String::new(),
                Some(last) if order == "ASC" => format!(" WHERE rowid > {last}"),
                Some(last) => format!(" WHERE rowid < {last}"),
            };
            let statement = format!("{select}{bound} ORDER BY rowid {order} LIMIT 1");
            match sqlx::query(AssertSqlSafe(statement)).fetch_optional(&mut *source).await {
                Ok(None) => break,
                Ok(Some(row)) => {
                    let Ok(number) = row.try_get_unchecked::<i64, _>(0) else {
                        break;
                    };
                    // A damaged number must not lead to a circle.
                    if from.is_some_and(|last| (order == "ASC") != (number > last) || number == last) {
                        break;
                    }
                    from = Some(number);
                    if let Some(values) = values_of(&row, columns.len()) {
                        rows.insert(number, values);
                    }
                }
                Err(_) => break,
            }
        }
    }
    let highest: Option<i64> = sqlx::query_scalar(AssertSqlSafe(format!("SELECT MAX(rowid) FROM {table}")))
        .fetch_one(&mut *source)
        .await
        .ok()
        .flatten();
    let select = format!(
        "SELECT 0 AS number, {} FROM {table} WHERE rowid = $1",
        values.join(", ")
    );
    let (mut rowid, mut missing) = (0, 0);
    while highest.map_or(missing < GAP, |highest| rowid < highest) && rowid < i64::MAX {
        rowid += 1;
        if rows.contains_key(&rowid) {
            missing = 0;
            continue;
        }
        match sqlx::query(AssertSqlSafe(select.clone()))
            .bind(rowid)
            .fetch_optional(&mut *source)
            .await
        {
            Ok(None) => missing += 1,
            // The table, or a column that an older schema lacks, is missing: nothing of it can be
            // read.
            Err(_) if rowid == 1 && !has_table(table, source).await => break,
            Err(_) => {
                missing += 1;
                lost += 1;
            }
            Ok(Some(row)) => {
                missing = 0;
                match values_of(&row, columns.len()) {
                    Some(values) => {
                        rows.insert(rowid, values);
                    }
                    None => lost += 1,
                }
            }
        }
        // A damaged highest number must not lead to a search up to it.
        if missing > 100 * GAP {
            break;
        }
    }
    if highest.is_none() {
        // Behind the last row nothing was lost.
        lost = u64::saturating_sub(lost, missing.unsigned_abs());
    }
    (rows.into_values().collect(), lost, false)
}

/// The columns of the new file that a table of an older schema lacks.
async fn lacking(table: &str, columns: &[Column], source: &mut SqliteConnection) -> Vec<String> {
    let own: Result<Vec<Vec<u8>>, _> = sqlx::query_scalar(AssertSqlSafe(format!(
        "SELECT CAST(name AS BLOB) FROM pragma_table_info('{table}')"
    )))
    .fetch_all(source)
    .await;
    let own = own.unwrap_or_default();
    let names = columns.iter().map(|(name, _)| name);
    names
        .filter(|name| own.iter().all(|own| own != name.as_bytes()))
        .cloned()
        .collect()
}

async fn has_table(table: &str, source: &mut SqliteConnection) -> bool {
    let found: Result<i64, _> = sqlx::query_scalar("SELECT COUNT(*) FROM sqlite_master WHERE name = $1")
        .bind(table)
        .fetch_one(source)
        .await;
    found.is_ok_and(|count| count > 0)
}

/// The values of a row behind its number; `None` if one of them has a type that no column has.
fn values_of(row: &SqliteRow, columns: usize) -> Option<StoredRow> {
    (1..=columns)
        .map(|column| {
            let raw = row.try_get_raw(column).ok()?;
            if raw.is_null() {
                return Some(SealedValue::Nothing);
            }
            let kind = raw.type_info().name().to_owned();
            match kind.as_str() {
                "INTEGER" => row.try_get_unchecked(column).ok().map(SealedValue::Whole),
                "REAL" => row.try_get_unchecked(column).ok().map(SealedValue::Real),
                "TEXT" => row.try_get_unchecked(column).ok().map(SealedValue::Text),
                _ => None,
            }
        })
        .collect()
}

/// Writes rows, and counts those that the new file takes and those that it refuses (a lost run, a missing
/// number). Of rows with one key the first is taken.
pub(super) async fn insert_rows(
    table: &str,
    rows: &[StoredRow],
    target: &mut AnyConnection,
    saved: &mut Saved,
) -> Result<(), sqlx::Error> {
    let columns = columns_of(table, target).await?;
    let names: Vec<&str> = columns.iter().map(|(name, _)| name.as_str()).collect();
    let marks: Vec<String> = (1..=columns.len()).map(|k| format!("${k}")).collect();
    let insert = format!(
        "INSERT INTO {table} ({}) VALUES ({}) ON CONFLICT DO NOTHING",
        names.join(", "),
        marks.join(", ")
    );
    let mut transaction = target.begin().await?;
    for row in rows {
        let mut query = sqlx::query(AssertSqlSafe(insert.clone()));
        for value in row {
            query = match value {
                SealedValue::Nothing => query.bind(None::<i64>),
                SealedValue::Whole(value) => query.bind(*value),
                SealedValue::Real(value) => query.bind(*value),
                SealedValue::Text(value) => query.bind(value.clone()),
            };
        }
        match query.execute(&mut *transaction).await {
            Ok(done) => saved.read += done.rows_affected(),
            Err(_) => saved.lost += 1,
        }
    }
    transaction.commit().await
}
