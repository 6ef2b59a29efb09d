//! Opens databases. Foreign, newer and damaged files are refused before anything is written. Older
//! files are migrated.

use std::io::Read as _;
use std::path::Path;
use std::sync::LazyLock;
use std::time::Duration;

#[cfg(feature = "postgres")]
use sqlx::migrate::MigrateError;
use sqlx::migrate::{Migration, MigrationType, Migrator};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{AnyConnection, AssertSqlSafe, ConnectOptions as _, Connection as _, SqlSafeStr as _, SqliteConnection};
use tokio::runtime::Runtime;

#[cfg(feature = "postgres")]
use super::StoreLocation;
use super::lock::identity;
use super::log::refuse_damaged;
use super::{DatabaseKind, SqlStore, StoreError};

/// Version of the schema that this program writes. It also reads older versions.
pub const SCHEMA_VERSION: i64 = 5;

/// The first version whose rows are all sealed. Rows of an older database are sealed once, as they
/// are; those of a newer one never again, or damage would be sealed too.
const SEALED_SINCE: i64 = 4;

/// `SPHC`, in SQLite's application id: marks a database of spherecal.
pub(super) const APPLICATION_ID: i64 = 0x5350_4843;

/// How long another program's lock is waited for.
pub(super) const PATIENCE: Duration = Duration::from_millis(if cfg!(test) { 300 } else { 10_000 });

/// The migrations, oldest first. A released one never changes.
static MIGRATIONS: LazyLock<Migrator> = LazyLock::new(|| {
    let step = |version, name: &'static str, sql: &'static str| {
        Migration::new(version, name.into(), MigrationType::Simple, sql.into_sql_str(), false)
    };
    Migrator::with_migrations(vec![
        step(1, "first", include_str!("../migrations/0001_first.sql")),
        step(2, "sessions", include_str!("../migrations/0002_sessions.sql")),
        step(3, "arm", include_str!("../migrations/0003_arm.sql")),
        step(4, "seals", include_str!("../migrations/0004_seals.sql")),
        step(5, "fleet", include_str!("../migrations/0005_fleet.sql")),
    ])
});

pub(super) fn runtime(path: &Path) -> Result<Runtime, StoreError> {
    tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|source| StoreError::Io {
            path: path.to_owned(),
            source,
        })
}

/// A path as the driver's URL has it.
pub(super) fn url_of(path: &Path) -> Result<String, StoreError> {
    let io = |source| StoreError::Io {
        path: path.to_owned(),
        source,
    };
    let whole = std::path::absolute(path).map_err(io)?;
    let text = whole
        .to_str()
        .ok_or_else(|| io(std::io::Error::other("the path is not UTF-8")))?;
    let mut url = String::from("sqlite://");
    for byte in text.bytes() {
        if byte.is_ascii_alphanumeric() || b"/-_.~".contains(&byte) {
            url.push(char::from(byte));
        } else {
            url.push_str(&format!("%{byte:02X}"));
        }
    }
    Ok(url + "?mode=rw")
}

/// Takes or releases (`what`: "lock" or "unlock") the lock under which the tables of a PostgreSQL
/// database are made. It ends with the connection at the latest.
#[cfg(feature = "postgres")]
async fn advisory(connection: &mut AnyConnection, what: &str) -> Result<(), sqlx::Error> {
    // A number that other programs hardly use: the first letters of "spherecal".
    const LOCK: i64 = 0x7370_6865_7265;
    let statement = format!("SELECT CAST(pg_advisory_{what}({LOCK}) AS TEXT)");
    sqlx::query(AssertSqlSafe(statement))
        .execute(connection)
        .await
        .map(|_| ())
}

impl SqlStore {
    /// Opens a PostgreSQL database by its URL. Creates its tables if there are none.
    ///
    /// # Errors
    /// The server does not answer or refuses, or this program was built without the feature
    /// `postgres`.
    #[cfg(not(feature = "postgres"))]
    pub fn postgres(_url: &str) -> Result<Self, StoreError> {
        Err(StoreError::Feature {
            what: "a PostgreSQL store",
            feature: "postgres",
        })
    }

    /// Opens a PostgreSQL database by its URL. Creates its tables if there are none.
    ///
    /// # Errors
    /// The server does not answer or refuses.
    #[cfg(feature = "postgres")]
    pub fn postgres(url: &str) -> Result<Self, StoreError> {
        sqlx::any::install_default_drivers();
        let path = std::path::PathBuf::from(StoreLocation::Postgres(url.to_owned()).to_string());
        let runtime = runtime(&path)?;
        let database = |source| StoreError::Server {
            url: path.display().to_string(),
            source,
        };
        let (connection, older) = runtime.block_on(async {
            let mut connection = AnyConnection::connect(url).await.map_err(database)?;
            // Until its rows are sealed, too, no other program looks at the tables.
            advisory(&mut connection, "lock").await.map_err(database)?;
            // A database without tables has no row to seal.
            let before: Option<i64> = sqlx::query_scalar("SELECT MAX(version) FROM _sqlx_migrations")
                .fetch_one(&mut connection)
                .await
                .unwrap_or(None);
            let older = before.is_some_and(|version| version < SEALED_SINCE);
            match MIGRATIONS.run(&mut connection).await {
                Ok(()) => Ok((connection, older)),
                Err(MigrateError::VersionMissing(found) | MigrateError::VersionMismatch(found)) => {
                    Err(StoreError::Version {
                        path: path.clone(),
                        found,
                        expected: SCHEMA_VERSION,
                    })
                }
                Err(error) => Err(database(error.into())),
            }
        })?;
        let mut store = Self {
            runtime,
            connection: Some(connection),
            kind: DatabaseKind::Postgres,
            path,
            durable: true,
            identity: None,
            chosen: None,
            reading: false,
            stated: false,
        };
        if older {
            store.seal_everything()?;
        }
        store.block(async |connection| advisory(connection, "unlock").await)?;
        Ok(store)
    }

    /// Opens the database, or creates it with its folder if there is none.
    ///
    /// # Errors
    /// The file is not a database of spherecal, has a newer version, is damaged or is not writable.
    pub fn create_or_open(path: &Path) -> Result<Self, StoreError> {
        if let Some(folder) = path.parent().filter(|f| !f.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).map_err(|source| StoreError::Io {
                path: folder.to_owned(),
                source,
            })?;
        }
        Self::connect(path, true)
    }

    /// Opens an existing database.
    ///
    /// # Errors
    /// Like [`SqlStore::create_or_open`], and when there is no file.
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
        sqlx::any::install_default_drivers();
        let runtime = runtime(path)?;
        let url = url_of(path)?;
        let fresh = is_fresh(path).map_err(io)?;
        if !fresh {
            refuse_foreign(path, io)?;
            refuse_damaged(path)?;
        }
        let (connection, version) = runtime.block_on(async {
            let failed = |source| StoreError::of(path, source);
            let version = if fresh && create {
                make(path).await?;
                SCHEMA_VERSION
            } else if fresh {
                return Err(StoreError::NotOurs { path: path.to_owned() });
            } else {
                check(path).await?
            };
            if version < SCHEMA_VERSION {
                bring_file_forward(path).await.map_err(failed)?;
                tracing::info!(path = %path.display(), version, now = SCHEMA_VERSION, "schema brought forward");
            }
            let mut connection = AnyConnection::connect(&url).await.map_err(failed)?;
            for (pragma, value) in [
                ("busy_timeout", PATIENCE.as_millis().to_string()),
                ("foreign_keys", "ON".to_owned()),
                ("journal_mode", "WAL".to_owned()),
                ("synchronous", "FULL".to_owned()),
            ] {
                sqlx::query(AssertSqlSafe(format!("PRAGMA {pragma} = {value}")))
                    .execute(&mut connection)
                    .await
                    .map_err(failed)?;
            }
            Ok((connection, version))
        })?;
        sync_folder(path);
        let mut store = Self {
            runtime,
            connection: Some(connection),
            kind: DatabaseKind::Sqlite,
            path: path.to_owned(),
            durable: true,
            identity: identity(path),
            chosen: None,
            reading: false,
            stated: false,
        };
        if version < SCHEMA_VERSION {
            if version < SEALED_SINCE {
                store.seal_everything()?;
            }
            // The mark is last: after a kill the migration is repeated.
            let mark = format!("PRAGMA user_version = {SCHEMA_VERSION}");
            store.block(async |connection| sqlx::query(AssertSqlSafe(mark)).execute(connection).await.map(|_| ()))?;
            store.settle()?;
        }
        Ok(store)
    }
}

impl Drop for SqlStore {
    /// Closes the database, so that only the one file remains.
    fn drop(&mut self) {
        if self.stated
            && let Err(error) = self.settle()
        {
            tracing::warn!(path = %self.path.display(), %error, "the log was not emptied; nothing is lost");
        }
        if let Some(connection) = self.connection.take()
            && let Err(error) = self.runtime.block_on(connection.close())
        {
            tracing::warn!(path = %self.path.display(), %error, "the database was not closed cleanly; nothing is lost");
        }
    }
}

/// Writes the folder's entries to the disk. Otherwise a power cut could remove the write-ahead log
/// with its data from the folder. Not every system supports this.
pub(super) fn sync_folder(path: &Path) {
    let folder = path.parent().filter(|f| !f.as_os_str().is_empty());
    let synced = std::fs::File::open(folder.unwrap_or(Path::new("."))).and_then(|folder| folder.sync_all());
    if let Err(error) = synced {
        tracing::debug!(path = %path.display(), %error, "the folder could not be synchronised");
    }
}

/// Creates a database completely under a temporary name, marks it, and only then renames it. So a
/// kill in between leaves no half-written database.
async fn make(path: &Path) -> Result<(), StoreError> {
    let mut name = path.as_os_str().to_owned();
    name.push(format!(".new-{}", std::process::id()));
    let draft = std::path::PathBuf::from(name);
    let io = |source| StoreError::Io {
        path: draft.clone(),
        source,
    };
    if draft.exists() {
        std::fs::remove_file(&draft).map_err(io)?;
    }
    let made = async {
        let mut connection = SqliteConnectOptions::new()
            .filename(&draft)
            .create_if_missing(true)
            .busy_timeout(PATIENCE)
            .connect()
            .await?;
        bring_forward(&mut connection).await?;
        let mark = format!("PRAGMA user_version = {SCHEMA_VERSION}");
        sqlx::query(AssertSqlSafe(mark)).execute(&mut connection).await?;
        connection.close().await
    };
    made.await.map_err(|source| StoreError::of(path, source))?;
    std::fs::rename(&draft, path).map_err(io)?;
    sync_folder(path);
    Ok(())
}

/// Checks that names and types of tables and columns are text. SQLite accepts others, but the
/// driver then never returns from the first query.
async fn names_are_text(connection: &mut SqliteConnection) -> Result<bool, sqlx::Error> {
    let rows: Vec<Vec<u8>> =
        sqlx::query_scalar("SELECT CAST(name || tbl_name || COALESCE(sql, '') AS BLOB) AS words FROM sqlite_master")
            .fetch_all(connection)
            .await?;
    Ok(rows.iter().all(|words| std::str::from_utf8(words).is_ok()))
}

/// Brings an older file to this program's schema.
async fn bring_file_forward(path: &Path) -> Result<(), sqlx::Error> {
    let mut connection = SqliteConnectOptions::new()
        .filename(path)
        .busy_timeout(PATIENCE)
        .connect()
        .await?;
    bring_forward(&mut connection).await?;
    connection.close().await
}

/// Migrates the tables to this program's schema and marks the file as ours. Each step is a
/// transaction. The version is marked by the caller, after everything else.
async fn bring_forward(connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
    MIGRATIONS.run(&mut *connection).await?;
    let mark = format!("PRAGMA application_id = {APPLICATION_ID}");
    sqlx::query(AssertSqlSafe(mark)).execute(&mut *connection).await?;
    Ok(())
}

/// Whether the path has no file yet, or only an empty one.
fn is_fresh(path: &Path) -> std::io::Result<bool> {
    match std::fs::metadata(path) {
        Ok(metadata) => Ok(metadata.is_file() && metadata.len() == 0),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(true),
        Err(e) => Err(e),
    }
}

/// Refuses files that do not begin like an SQLite file.
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

/// Reads version and owner and checks every page without changing one. The connection is read-only,
/// so it does not move the log into the file either. Returns the version.
async fn check(path: &Path) -> Result<i64, StoreError> {
    let damaged = |source: sqlx::Error| match StoreError::of(path, source) {
        StoreError::Database { path, source } => StoreError::Damaged {
            path,
            what: source.to_string(),
        },
        other => other,
    };
    let mut connection = SqliteConnectOptions::new()
        .filename(path)
        .read_only(true)
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
    if owner == APPLICATION_ID && version > SCHEMA_VERSION {
        return Err(StoreError::Version {
            path: path.to_owned(),
            found: version,
            expected: SCHEMA_VERSION,
        });
    }
    let good = sqlx::query_scalar::<_, String>("PRAGMA integrity_check(1)")
        .fetch_one(&mut connection)
        .await
        .map_err(damaged)?;
    let words = names_are_text(&mut connection).await.map_err(damaged)?;
    // An error while closing does not matter to a reader.
    let _ = connection.close().await;
    if owner != APPLICATION_ID {
        return Err(StoreError::NotOurs { path: path.to_owned() });
    }
    if good != "ok" {
        return Err(StoreError::Damaged {
            path: path.to_owned(),
            what: good,
        });
    }
    if !words {
        return Err(StoreError::Damaged {
            path: path.to_owned(),
            what: "the list of its tables is no text".to_owned(),
        });
    }
    if version < 1 {
        return Err(StoreError::Damaged {
            path: path.to_owned(),
            what: format!("its schema version is {version}"),
        });
    }
    Ok(version)
}
