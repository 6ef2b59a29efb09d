//! Opens databases. Foreign, newer and damaged files are refused before anything is written. Older
//! files are migrated.

use std::path::Path;

#[cfg(feature = "postgres")]
use sqlx::migrate::MigrateError;
use sqlx::{AnyConnection, AssertSqlSafe, Connection as _};
use tokio::runtime::Runtime;

#[cfg(feature = "postgres")]
use super::StoreLocation;
#[cfg(feature = "postgres")]
use super::file::MIGRATIONS;
use super::file::{PATIENCE, SCHEMA_VERSION, bring_file_forward, check, is_fresh, make, refuse_foreign, sync_folder};
use super::lock::identity;
use super::log::refuse_damaged;
use super::{DatabaseKind, SqlStore, StoreError};

/// The first version whose rows are all sealed. Rows of an older database are sealed once, as they
/// are; those of a newer one never again, or damage would be sealed too.
const SEALED_SINCE: i64 = 4;

pub(super) fn runtime(path: &Path) -> Result<Runtime, StoreError> {
    tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(StoreError::io(path))
}

/// A path as the driver's URL has it.
pub(super) fn url_of(path: &Path) -> Result<String, StoreError> {
    let io = StoreError::io(path);
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
            std::fs::create_dir_all(folder).map_err(StoreError::io(folder))?;
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
        let io = StoreError::io(path);
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
