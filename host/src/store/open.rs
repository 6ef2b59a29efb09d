//! Opening: what is not ours or not our version is refused before anything is written.

use std::io::Read as _;
use std::path::Path;
use std::time::Duration;

use sqlx::migrate::Migrator;
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqliteSynchronous};
use sqlx::{AssertSqlSafe, ConnectOptions as _, Connection as _};

use super::{Store, StoreError};

/// Version of the schema that this program reads and writes.
pub const SCHEMA_VERSION: i64 = 1;

/// `SPHC`, in SQLite's application id: says whose database it is.
const APPLICATION_ID: i64 = 0x5350_4843;

/// How long another program's lock is waited for.
const PATIENCE: Duration = Duration::from_secs(10);

static MIGRATIONS: Migrator = sqlx::migrate!("./migrations");

impl Store {
    /// Opens the database, or makes it with its folder where there is none.
    ///
    /// # Errors
    /// A file that is not ours, of another version, damaged or not writable.
    pub fn create_or_open(path: &Path) -> Result<Self, StoreError> {
        if let Some(folder) = path.parent().filter(|f| !f.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).map_err(|source| StoreError::Io {
                path: folder.to_owned(),
                source,
            })?;
        }
        Self::connect(path, true)
    }

    /// Opens a database that is there.
    ///
    /// # Errors
    /// As [`Store::create_or_open`], and when there is none.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        if !path.exists() {
            return Err(StoreError::Missing { path: path.to_owned() });
        }
        Self::connect(path, false)
    }

    fn connect(path: &Path, create: bool) -> Result<Self, StoreError> {
        let io = |source| StoreError::Io {
            path: path.to_owned(),
            source,
        };
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(io)?;
        let fresh = is_fresh(path).map_err(io)?;
        if !fresh {
            refuse_foreign(path, io)?;
        }
        let connection = runtime.block_on(async {
            let database = |source| StoreError::Database {
                path: path.to_owned(),
                source,
            };
            if fresh {
                make(path, create).await.map_err(database)?;
            } else {
                check(path).await?;
            }
            SqliteConnectOptions::new()
                .filename(path)
                .foreign_keys(true)
                .busy_timeout(PATIENCE)
                .journal_mode(SqliteJournalMode::Wal)
                .synchronous(SqliteSynchronous::Full)
                .connect()
                .await
                .map_err(database)
        })?;
        Ok(Self {
            runtime,
            connection: Some(connection),
            path: path.to_owned(),
            durable: true,
        })
    }
}

impl Drop for Store {
    /// Closes the file, so that nothing but the one file is left of it.
    fn drop(&mut self) {
        if let Some(connection) = self.connection.take()
            && let Err(error) = self.runtime.block_on(connection.close())
        {
            tracing::warn!(path = %self.path.display(), %error, "the database was not closed cleanly; nothing is lost");
        }
    }
}

/// Makes the tables and signs the file, before write-ahead mode is switched on,
/// so that the signature stands in the file itself.
async fn make(path: &Path, create: bool) -> Result<(), sqlx::Error> {
    let mut connection = SqliteConnectOptions::new()
        .filename(path)
        .create_if_missing(create)
        .busy_timeout(PATIENCE)
        .connect()
        .await?;
    MIGRATIONS.run(&mut connection).await?;
    for (pragma, value) in [("application_id", APPLICATION_ID), ("user_version", SCHEMA_VERSION)] {
        sqlx::query(AssertSqlSafe(format!("PRAGMA {pragma} = {value}")))
            .execute(&mut connection)
            .await?;
    }
    connection.close().await
}

/// Whether there is nothing at `path` yet, or only an empty file.
fn is_fresh(path: &Path) -> std::io::Result<bool> {
    match std::fs::metadata(path) {
        Ok(metadata) => Ok(metadata.is_file() && metadata.len() == 0),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(true),
        Err(e) => Err(e),
    }
}

/// Refuses what does not even begin like an SQLite file.
fn refuse_foreign(path: &Path, io: impl Fn(std::io::Error) -> StoreError) -> Result<(), StoreError> {
    let mut magic = Vec::new();
    if path.is_file() {
        let file = std::fs::File::open(path).map_err(&io)?;
        file.take(16).read_to_end(&mut magic).map_err(&io)?;
    }
    if magic == b"SQLite format 3\0" {
        Ok(())
    } else {
        Err(StoreError::NotOurs { path: path.to_owned() })
    }
}

/// Reads version and owner without changing a page.
async fn check(path: &Path) -> Result<(), StoreError> {
    let damaged = |e: sqlx::Error| StoreError::Damaged {
        path: path.to_owned(),
        what: e.to_string(),
    };
    let mut connection = SqliteConnectOptions::new()
        .filename(path)
        .busy_timeout(PATIENCE)
        .connect()
        .await
        .map_err(damaged)?;
    let mut pragma = async |statement: &'static str| {
        sqlx::query_scalar::<_, i64>(statement)
            .fetch_one(&mut connection)
            .await
            .map_err(damaged)
    };
    let owner = pragma("PRAGMA application_id").await?;
    let version = pragma("PRAGMA user_version").await?;
    let good = sqlx::query_scalar::<_, String>("PRAGMA quick_check(1)")
        .fetch_one(&mut connection)
        .await
        .map_err(damaged)?;
    // Closing can fail only in ways that do not matter to a reader.
    let _ = connection.close().await;
    if owner != APPLICATION_ID {
        return Err(StoreError::NotOurs { path: path.to_owned() });
    }
    if version != SCHEMA_VERSION {
        return Err(StoreError::Version {
            path: path.to_owned(),
            found: version,
            expected: SCHEMA_VERSION,
        });
    }
    if good != "ok" {
        return Err(StoreError::Damaged {
            path: path.to_owned(),
            what: good,
        });
    }
    Ok(())
}
