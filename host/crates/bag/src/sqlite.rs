//! The messages of a bag in SQLite (`.db3`), the default of ROS 2 until Humble.
//!
//! Tables `topics` (id, name, type, serialization_format) and `messages` (id, topic_id, timestamp in ns, data). They are
//! read in the order of time, some rows at once, and only messages of the types that a bag is read for with their data.

use std::collections::HashMap;
use std::path::Path;
use std::rc::Rc;

use spherecal_model::open_regular;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection, SqliteRow};
use sqlx::{ConnectOptions as _, Row as _};

use super::error::BagError;
use super::files::{LARGER, MOST_BAG_BYTES};
use super::message::{BagMessage, MOST_RECORD_BYTES, Topic, full_name};

/// The next messages behind a time and id. Types that a bag is not read for come without their data.
const NEXT: &str = "SELECT m.id, m.topic_id, m.timestamp, CASE WHEN length(m.data) <= ?3 AND (t.type LIKE '%JointState' OR \
    t.type LIKE '%Stamped' OR t.type LIKE '%TFMessage' OR t.type LIKE '%Odometry' OR t.type LIKE '%PoseArray' OR t.type LIKE \
    'std_msgs/%Int%') THEN m.data ELSE x'' END FROM messages m JOIN topics t ON t.id = m.topic_id WHERE (m.timestamp, m.id) > \
    (?1, ?2) ORDER BY m.timestamp, m.id LIMIT 256";

/// Calls `each` for every message of a bag in SQLite, in the order of time, and `progress` with the bytes read so far.
///
/// # Errors
/// A file that is no such bag, and what `each` refuses.
pub(crate) fn each_message(
    path: &Path,
    progress: &mut dyn FnMut(u64),
    each: &mut dyn FnMut(&BagMessage<'_>) -> Result<(), BagError>,
) -> Result<(), BagError> {
    // What is not a regular file is refused in the words of all files.
    let (file, bytes) = open_regular(path, MOST_BAG_BYTES, LARGER)?;
    drop(file);
    let failed = |what: &dyn std::fmt::Display| BagError::Database {
        path: path.display().to_string(),
        what: what.to_string(),
    };
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|e| failed(&e))?;
    // Read only, and without files beside it.
    let options = SqliteConnectOptions::new()
        .filename(path)
        .read_only(true)
        .immutable(true);
    let mut connection = runtime.block_on(options.connect()).map_err(|e| failed(&e))?;
    let query = "SELECT id, name, type, serialization_format FROM topics";
    let rows = runtime
        .block_on(sqlx::query(query).fetch_all(&mut connection))
        .map_err(|e| failed(&e))?;
    let mut topics: HashMap<i64, Rc<Topic>> = HashMap::new();
    for row in rows {
        let (id, topic) = topic(&row).map_err(|e| failed(&e))?;
        topics.insert(id, Rc::new(topic));
    }
    let mut behind = (i64::MIN, i64::MIN);
    let mut seen = 0;
    loop {
        let rows = runtime
            .block_on(next(&mut connection, behind))
            .map_err(|e| failed(&e))?;
        if rows.is_empty() {
            progress(bytes);
            return Ok(());
        }
        for row in rows {
            let read = || -> Result<(i64, i64, i64, Vec<u8>), sqlx::Error> {
                Ok((row.try_get(0)?, row.try_get(1)?, row.try_get(2)?, row.try_get(3)?))
            };
            let (id, number, time_ns, data) = read().map_err(|e| failed(&e))?;
            behind = (time_ns, id);
            seen += data.len() as u64;
            let Some(topic) = topics.get(&number) else { continue };
            each(&BagMessage {
                topic,
                time_ns,
                data: &data,
            })?;
        }
        progress(seen.min(bytes));
    }
}

async fn next(connection: &mut SqliteConnection, behind: (i64, i64)) -> Result<Vec<SqliteRow>, sqlx::Error> {
    let most = i64::try_from(MOST_RECORD_BYTES).unwrap_or(i64::MAX);
    sqlx::query(NEXT)
        .bind(behind.0)
        .bind(behind.1)
        .bind(most)
        .fetch_all(connection)
        .await
}

fn topic(row: &SqliteRow) -> Result<(i64, Topic), sqlx::Error> {
    let kind: String = row.try_get(2)?;
    Ok((
        row.try_get(0)?,
        Topic {
            name: row.try_get(1)?,
            kind: full_name(&kind),
            encoding: row.try_get(3)?,
        },
    ))
}
