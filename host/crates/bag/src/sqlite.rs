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
use super::files::LARGER;
use super::topics::{BagMessage, Topic, full_name};
use spherecal_budget::files::{self, BAG_BYTES, NAME_BYTES, RECORD_BYTES};

const TOPICS: &str = "SELECT id, name, type, serialization_format FROM topics WHERE max(length(name), length(type), \
    length(serialization_format)) <= ?1 LIMIT ?2";
/// The next messages behind a time and id: some, and together at most as large as one record may be. Types that a bag is not
/// read for come without their data. The length of a value is read without the value.
const NEXT: &str = "WITH piece AS (SELECT m.id, m.topic_id, m.timestamp, length(m.data) <= ?3 AND (t.type LIKE '%JointState' OR \
    t.type LIKE '%Stamped' OR t.type LIKE '%TFMessage' OR t.type LIKE '%Odometry' OR t.type LIKE '%PoseArray' OR t.type LIKE \
    'std_msgs/%Int%') AS whole, length(m.data) AS bytes FROM messages m JOIN topics t ON t.id = m.topic_id WHERE \
    (m.timestamp, m.id) > (?1, ?2) ORDER BY m.timestamp, m.id LIMIT 256), summed AS (SELECT *, sum(bytes * whole) OVER \
    (ORDER BY timestamp, id) AS so_far, row_number() OVER (ORDER BY timestamp, id) AS number FROM piece) \
    SELECT s.id, s.topic_id, s.timestamp, CASE WHEN s.whole THEN m.data ELSE x'' END FROM summed s JOIN messages m ON m.id = s.id \
    WHERE s.so_far <= ?3 OR s.number = 1 ORDER BY s.timestamp, s.id";
/// Endings of the files in which SQLite keeps what is not yet in the bag.
const BESIDE: [&str; 2] = ["-wal", "-journal"];

/// Calls `each` for every message of a bag in SQLite, in the order of time, and `progress` with the bytes read so far.
/// Errors: a file that is no such bag, and what `each` refuses.
pub(crate) fn each_message(
    path: &Path,
    progress: &mut dyn FnMut(u64),
    each: &mut dyn FnMut(&BagMessage<'_>) -> Result<(), BagError>,
) -> Result<(), BagError> {
    // What is not a regular file is refused in the words of all files.
    let (file, bytes) = open_regular(path, BAG_BYTES, LARGER)?;
    drop(file);
    not_all(path)?;
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
    let query = sqlx::query(TOPICS)
        .bind(NAME_BYTES as i64)
        .bind(files::TOPICS as i64 + 1);
    let rows = runtime
        .block_on(query.fetch_all(&mut connection))
        .map_err(|e| failed(&e))?;
    if rows.len() > files::TOPICS {
        return Err(failed(&format!("it names more than {} topics", files::TOPICS)));
    }
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

/// Refuses a bag whose newest messages are in a file beside it, as a recorder leaves them that was killed or still runs:
/// SQLite would write to read them.
fn not_all(path: &Path) -> Result<(), BagError> {
    for ending in BESIDE {
        let mut beside = path.as_os_str().to_owned();
        beside.push(ending);
        if std::fs::metadata(&beside).is_ok_and(|m| m.len() > 0) {
            return Err(BagError::Kind {
                path: path.display().to_string(),
                what: format!(
                    "a recorder left {} beside it, with changes that are not in the bag",
                    spherecal_model::printable(&beside.to_string_lossy())
                ),
                remedy: "stop the recorder; if it was killed, `sqlite3 FILE 'PRAGMA journal_mode=DELETE'` takes them in",
            });
        }
    }
    Ok(())
}

async fn next(connection: &mut SqliteConnection, behind: (i64, i64)) -> Result<Vec<SqliteRow>, sqlx::Error> {
    let most = i64::try_from(RECORD_BYTES).unwrap_or(i64::MAX);
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
