//! Opens the copy of a damaged database: with its own list of tables, or with that of a fresh one.

use std::path::{Path, PathBuf};

use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions as _, SqliteConnection};

use super::Workshop;
use super::rows::{Column, Source, read_table};
use crate::file::APPLICATION_ID;
use crate::{SCHEMA_VERSION, StoreError};

/// Size of the header of a database, at the start of its first page, in bytes.
const HEADER: usize = 100;
/// Kinds of the pages of a table.
const INNER: u8 = 5;
const LEAF: u8 = 13;

/// A table of the new file and its columns.
pub(super) type TableColumns = (&'static str, Vec<Column>);

/// Why no copy can be read.
pub(super) enum NoSource {
    /// A file could not be written.
    Io(StoreError),
    /// A newer program wrote it: the version of its schema.
    Newer(i64),
    /// Nothing looks like a database of this program.
    Unreadable(sqlx::Error),
}

/// The copies that can be read, the one with the newest rows first. `fresh` are the bytes of a database of this
/// program without rows, which has these tables.
pub(super) async fn sources_of(
    workshop: &Workshop,
    fresh: &[u8],
    tables: &[TableColumns],
) -> Result<Vec<Source>, NoSource> {
    let model = workshop.folder.join("fresh.db");
    std::fs::write(&model, fresh).map_err(|source| NoSource::Io(workshop.io(source)))?;
    let mut model = open_copy(&model).await.map_err(NoSource::Unreadable)?;
    let sound = list_of(&mut model).await.map_err(NoSource::Unreadable)?;
    let (mut sources, mut unreadable) = (Vec::new(), sqlx::Error::RowNotFound);
    for copy in workshop.copies() {
        match source_of(workshop, copy, (fresh, &sound), tables).await {
            Ok(source) => sources.push(source),
            Err(NoSource::Unreadable(error)) => unreadable = error,
            Err(error) => return Err(error),
        }
    }
    if sources.is_empty() {
        return Err(NoSource::Unreadable(unreadable));
    }
    Ok(sources)
}

/// A copy to read, with its own list of tables or with that of the fresh database.
///
/// A list of tables that equals that of the fresh database is sound. Any other is damaged, or that of
/// another program. A newer program's is refused. Otherwise the one with which more rows can be read is taken.
async fn source_of(
    workshop: &Workshop,
    copy: &Path,
    (fresh, sound): (&[u8], &[ListedTable]),
    tables: &[TableColumns],
) -> Result<Source, NoSource> {
    let mut own = match open_copy(copy).await {
        Ok(mut own) => {
            if list_of(&mut own).await.is_ok_and(|list| list == sound) {
                return Ok(Source {
                    connection: own,
                    replaced: false,
                    older: false,
                });
            }
            let (version, ours) = version_of(&mut own).await;
            if ours && version > SCHEMA_VERSION {
                return Err(NoSource::Newer(version));
            }
            Ok(Source {
                connection: own,
                replaced: false,
                older: version < SCHEMA_VERSION,
            })
        }
        Err(error) => Err(error),
    };
    let replaced = with_list_of(workshop, copy, fresh).map_err(NoSource::Io)?;
    let other = open_copy(&replaced).await.map(|connection| Source {
        connection,
        replaced: true,
        older: false,
    });
    match (&mut own, other) {
        (Ok(mine), Ok(mut other)) => {
            if count(&mut other, tables).await > count(mine, tables).await {
                return Ok(other);
            }
        }
        (Err(_), Ok(other)) => return Ok(other),
        (_, Err(_)) => {}
    }
    own.map_err(NoSource::Unreadable)
}

/// The newest version that a file states, in its header or in its list of migrations, and whether it is a file of
/// spherecal. What cannot be read states nothing.
async fn version_of(source: &mut SqliteConnection) -> (i64, bool) {
    let mut number = async |statement: &'static str| {
        let found = sqlx::query_scalar::<_, Option<i64>>(statement)
            .fetch_one(&mut *source)
            .await;
        found.ok().flatten().unwrap_or(0)
    };
    let marked = number("PRAGMA user_version").await;
    let migrated = number("SELECT MAX(version) FROM _sqlx_migrations").await;
    (
        marked.max(migrated),
        number("PRAGMA application_id").await == APPLICATION_ID,
    )
}

/// Rows that can be read.
async fn count(source: &mut Source, tables: &[TableColumns]) -> usize {
    let mut rows = 0;
    for (table, columns) in tables {
        rows += read_table(table, columns, source).await.0.len();
    }
    rows
}

/// A table or an index of the list: its name, its first page and its statement, as bytes.
type ListedTable = (Vec<u8>, i64, Vec<u8>);

/// The list of tables: names, first pages and statements, as bytes.
async fn list_of(source: &mut SqliteConnection) -> Result<Vec<ListedTable>, sqlx::Error> {
    sqlx::query_as(
        "SELECT CAST(name AS BLOB), rootpage, CAST(COALESCE(sql, '') AS BLOB) FROM sqlite_master ORDER BY 2, 1",
    )
    .fetch_all(source)
    .await
}

/// Opens a copy that may be shorter than its header says, and checks whether its list of tables is
/// readable.
async fn open_copy(copy: &Path) -> Result<SqliteConnection, sqlx::Error> {
    let mut connection = SqliteConnectOptions::new()
        .filename(copy)
        .pragma("writable_schema", "ON")
        .connect()
        .await?;
    let known: i64 = sqlx::query_scalar(
        "SELECT COUNT(*) FROM sqlite_master WHERE type = 'table' AND name IN ('runs', 'recordings', 'poses')",
    )
    .fetch_one(&mut connection)
    .await?;
    if known == 3 {
        Ok(connection)
    } else {
        Err(sqlx::Error::RowNotFound)
    }
}

/// A second copy without log, in which the pages of the list of tables are those of `fresh`.
fn with_list_of(workshop: &Workshop, copy: &Path, fresh: &[u8]) -> Result<PathBuf, StoreError> {
    let page = page_size(fresh);
    let mut bytes = std::fs::read(copy).map_err(|source| workshop.io(source))?;
    let pages = u32::try_from(bytes.len() / page).unwrap_or(u32::MAX);
    for number in pages_of_list(fresh) {
        let place = (number - 1) * page..number * page;
        if let (Some(old), Some(new)) = (bytes.get_mut(place.clone()), fresh.get(place)) {
            old.copy_from_slice(new);
        }
    }
    // Its own number of pages, no free pages, and no write-ahead mode.
    for (at, value) in [(28, pages), (32, 0), (36, 0)] {
        if let Some(slot) = bytes.get_mut(at..at + 4) {
            slot.copy_from_slice(&value.to_be_bytes());
        }
    }
    if let Some(slot) = bytes.get_mut(18..20) {
        slot.copy_from_slice(&[1, 1]);
    }
    let path = copy.with_extension("replaced.db");
    std::fs::write(&path, &bytes).map_err(|source| workshop.io(source))?;
    Ok(path)
}

fn page_size(database: &[u8]) -> usize {
    let size = database.get(16..18).and_then(|b| b.try_into().ok());
    size.map_or(4096, |b| usize::from(u16::from_be_bytes(b))).max(512)
}

/// The pages of a sound database that hold its list of tables, from 1: a tree from the first page on.
fn pages_of_list(database: &[u8]) -> Vec<usize> {
    let page = page_size(database);
    let (mut found, mut next) = (Vec::new(), vec![1]);
    while let Some(number) = next.pop() {
        let begin = (number - 1) * page;
        let Some(bytes) = database.get(begin..begin + page) else {
            continue;
        };
        found.push(number);
        let at = if number == 1 { HEADER } else { 0 };
        let short = |at: usize| {
            bytes
                .get(at..at + 2)
                .and_then(|b| b.try_into().ok())
                .map(u16::from_be_bytes)
        };
        let long = |at: usize| {
            bytes
                .get(at..at + 4)
                .and_then(|b| b.try_into().ok())
                .map(u32::from_be_bytes)
        };
        if bytes.get(at) != Some(&INNER) {
            debug_assert_eq!(bytes.get(at), Some(&LEAF));
            continue;
        }
        let cells = usize::from(short(at + 3).unwrap_or(0));
        let places = (0..cells).filter_map(|k| short(at + 12 + 2 * k)).map(usize::from);
        let children = places.filter_map(long).chain(long(at + 8));
        next.extend(
            children
                .filter_map(|child| usize::try_from(child).ok())
                .filter(|child| {
                    // A page is not its own child.
                    *child > 1 && !found.contains(child)
                }),
        );
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SqlStore;

    // Fails if a page of the list of tables is missed: its damage could then not be mended.
    #[test]
    fn the_pages_of_the_list_hold_every_statement() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a.db");
        drop(SqlStore::create_or_open(&path).expect("made"));
        let bytes = std::fs::read(&path).expect("read");
        let size = page_size(&bytes);
        let pages = pages_of_list(&bytes);
        assert!(pages.len() > 1 && pages.contains(&1), "{pages:?}");
        let of_list = |words: &[u8]| {
            let within = |number: &usize| {
                bytes[(number - 1) * size..number * size]
                    .windows(words.len())
                    .any(|w| w == words)
            };
            pages.iter().any(within)
        };
        for table in super::super::TABLES {
            assert!(of_list(format!("CREATE TABLE {table} (").as_bytes()), "{table}");
        }
    }
}
