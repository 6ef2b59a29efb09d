//! The file of an SQLite database: its creation, its schema, and the checks before it is used.

use std::io::Read as _;
use std::path::Path;
use std::sync::LazyLock;
use std::time::Duration;

use sqlx::migrate::{Migration, MigrationType, Migrator};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{AssertSqlSafe, ConnectOptions as _, Connection as _, SqlSafeStr as _, SqliteConnection};

use super::StoreError;

/// Version of the schema that this program writes. It also reads older versions.
pub const SCHEMA_VERSION: i64 = 6;

/// `SPHC`, in SQLite's application id: marks a database of spherecal.
pub(super) const APPLICATION_ID: i64 = 0x5350_4843;

/// How long another program's lock is waited for.
pub(super) const PATIENCE: Duration = Duration::from_millis(if cfg!(test) { 300 } else { 10_000 });

/// The migrations, oldest first. A released one never changes.
pub(super) static MIGRATIONS: LazyLock<Migrator> = LazyLock::new(|| {
    let step = |version, name: &'static str, sql: &'static str| {
        Migration::new(version, name.into(), MigrationType::Simple, sql.into_sql_str(), false)
    };
    Migrator::with_migrations(vec![
        step(1, "first", include_str!("../migrations/0001_first.sql")),
        step(2, "sessions", include_str!("../migrations/0002_sessions.sql")),
        step(3, "arm", include_str!("../migrations/0003_arm.sql")),
        step(4, "seals", include_str!("../migrations/0004_seals.sql")),
        step(5, "fleet", include_str!("../migrations/0005_fleet.sql")),
        step(6, "overview", include_str!("../migrations/0006_overview.sql")),
    ])
});

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
pub(super) async fn make(path: &Path) -> Result<(), StoreError> {
    let mut name = path.as_os_str().to_owned();
    name.push(format!(".new-{}", std::process::id()));
    let draft = std::path::PathBuf::from(name);
    let io = StoreError::io(&draft);
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
pub(super) async fn bring_file_forward(path: &Path) -> Result<(), sqlx::Error> {
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
pub(super) fn is_fresh(path: &Path) -> std::io::Result<bool> {
    match std::fs::metadata(path) {
        Ok(metadata) => Ok(metadata.is_file() && metadata.len() == 0),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(true),
        Err(e) => Err(e),
    }
}

/// Refuses files that do not begin like an SQLite file.
pub(super) fn refuse_foreign(path: &Path, io: impl Fn(std::io::Error) -> StoreError) -> Result<(), StoreError> {
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
pub(super) async fn check(path: &Path) -> Result<i64, StoreError> {
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
