//! Simulates, from outside the store, the faults of the host's computer that affect the store's
//! file.

use std::path::PathBuf;
use std::time::Duration;

use spherecal_link::JournalError;
use spherecal_sim::inject::FileLock;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions as _, Connection as _, Executor as _, SqliteConnection};
use tokio::runtime::Runtime;

/// Locks the SQLite file at `path` for a time, as another program would: with a separate connection
/// on a separate thread.
pub fn file_lock(path: PathBuf) -> FileLock {
    Box::new(move |time| lock(path.clone(), time))
}

/// Returns when the file is locked.
fn lock(path: PathBuf, time: Duration) -> Result<(), JournalError> {
    let (told, held) = std::sync::mpsc::sync_channel(1);
    std::thread::spawn(move || {
        let runtime = match tokio::runtime::Builder::new_current_thread().enable_all().build() {
            Ok(runtime) => runtime,
            Err(error) => return drop(told.send(Err(JournalError::store(error)))),
        };
        let connection = match runtime.block_on(locked(&path)) {
            Ok(connection) => connection,
            Err(error) => return drop(told.send(Err(JournalError::store(error)))),
        };
        drop(told.send(Ok(())));
        std::thread::sleep(time);
        unlock(&runtime, connection);
    });
    // A thread that ended without a message holds no lock.
    held.recv().unwrap_or(Ok(()))
}

async fn locked(path: &std::path::Path) -> Result<SqliteConnection, sqlx::Error> {
    let mut connection = SqliteConnectOptions::new().filename(path).connect().await?;
    connection.execute("BEGIN EXCLUSIVE").await?;
    Ok(connection)
}

/// Closing gives up the lock.
fn unlock(runtime: &Runtime, connection: SqliteConnection) {
    drop(runtime.block_on(connection.close()));
}
