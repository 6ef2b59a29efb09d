//! A disk without room, and a file that another program holds, on purpose: for
//! fault injection. Both are SQLite's own refusals, not imitations of them.

use std::time::Duration;

use sqlx::{AssertSqlSafe, Connection as _, Executor as _, SqliteConnection};

use super::open::url_of;
use super::{Kind, Store, StoreError};

/// Pages that SQLite allows a file by itself.
const PAGES_MOST: u32 = u32::MAX - 1;

impl Store {
    /// Whether it is a file of this computer, which both can happen to.
    pub fn is_file(&self) -> bool {
        self.remote.is_none() && self.kind == Kind::Sqlite
    }

    /// Lets the file find no room beyond the pages that it has, or room again.
    /// Does nothing to a store that is no file.
    ///
    /// # Errors
    /// When the database fails.
    pub fn fill_disk(&mut self, full: bool) -> Result<(), StoreError> {
        if !self.is_file() {
            return Ok(());
        }
        // No fewer pages than there are can be asked for: one means no more than those.
        let pages = if full { 1 } else { PAGES_MOST };
        self.block(async |c| {
            let statement = AssertSqlSafe(format!("PRAGMA max_page_count = {pages}"));
            sqlx::query(statement).execute(c).await.map(|_| ())
        })
    }

    /// Keeps the file in pages so small that a full disk is felt by the next
    /// recording, not only when there is no more room in the pages that it has.
    /// For a file that is empty yet.
    ///
    /// # Errors
    /// When the database fails.
    pub fn use_small_pages(&mut self) -> Result<(), StoreError> {
        self.block(async |c| {
            // The size of pages cannot change in write-ahead mode.
            for statement in [
                "PRAGMA journal_mode = DELETE",
                "PRAGMA page_size = 512",
                "VACUUM",
                "PRAGMA journal_mode = WAL",
            ] {
                sqlx::query(statement).execute(&mut *c).await?;
            }
            Ok(())
        })
    }

    /// Has another connection hold the file for so long; returns when it has it.
    /// Does nothing to a store that is no file.
    ///
    /// # Errors
    /// When the file cannot be opened a second time.
    pub fn hold_file(&self, time: Duration) -> Result<(), StoreError> {
        if !self.is_file() {
            return Ok(());
        }
        let url = url_of(&self.path)?;
        let path = self.path.clone();
        let (told, held) = std::sync::mpsc::sync_channel(1);
        std::thread::spawn(move || {
            let runtime = match super::open::runtime(&path) {
                Ok(runtime) => runtime,
                Err(error) => return drop(told.send(Err(error))),
            };
            let result = runtime.block_on(async {
                let mut connection = SqliteConnection::connect(&url).await?;
                connection.execute("BEGIN EXCLUSIVE").await?;
                Ok::<_, sqlx::Error>(connection)
            });
            let connection = match result {
                Ok(connection) => connection,
                Err(source) => return drop(told.send(Err(StoreError::of(&path, source)))),
            };
            drop(told.send(Ok(())));
            std::thread::sleep(time);
            // Closing gives up the lock.
            drop(runtime.block_on(connection.close()));
        });
        // A thread that ended without a word holds nothing.
        held.recv().unwrap_or(Ok(()))
    }
}
