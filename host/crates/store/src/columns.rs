//! Reads rows and the values of their columns, and checks the type of each value; statements that tables share.

use serde::de::DeserializeOwned;
use sqlx::any::AnyRow;
use sqlx::{AnyConnection, Row as _};

use super::{SqlStore, StoreError};

impl SqlStore {
    /// What a statement selects of one run (`$1`).
    pub(super) fn rows(&mut self, statement: &'static str, run: i64) -> Result<Vec<AnyRow>, StoreError> {
        self.block(async |connection| sqlx::query(statement).bind(run).fetch_all(connection).await)
    }

    /// A column's value, as what the database holds.
    pub(super) fn get<'r, T>(&self, row: &'r AnyRow, column: &'static str) -> Result<T, StoreError>
    where
        T: sqlx::Decode<'r, sqlx::Any> + sqlx::Type<sqlx::Any>,
    {
        row.try_get(column).map_err(|source| StoreError::of(&self.path, source))
    }

    /// A number that is not negative and fits the type.
    pub(super) fn count(&self, row: &AnyRow, column: &'static str) -> Result<u32, StoreError> {
        let value = self.get::<i64>(row, column)?;
        u32::try_from(value).map_err(|_| StoreError::Damaged {
            path: self.path.clone(),
            what: format!("{column} is {value}"),
        })
    }

    /// Three columns: a point or a force.
    pub(super) fn triple(&self, row: &AnyRow, columns: [&'static str; 3]) -> Result<[f64; 3], StoreError> {
        let [x, y, z] = columns;
        Ok([self.get(row, x)?, self.get(row, y)?, self.get(row, z)?])
    }

    pub(super) fn json<T: DeserializeOwned>(&self, row: &AnyRow, column: &'static str) -> Result<T, StoreError> {
        let text: String = self.get(row, column)?;
        serde_json::from_str(&text).map_err(|source| self.undecodable(column, source))
    }

    /// A column that holds the name of a value.
    pub(super) fn named<T: DeserializeOwned>(&self, row: &AnyRow, column: &'static str) -> Result<T, StoreError> {
        let text: String = self.get(row, column)?;
        serde_json::from_value(serde_json::Value::String(text)).map_err(|source| self.undecodable(column, source))
    }

    fn undecodable(&self, field: &'static str, source: serde_json::Error) -> StoreError {
        StoreError::Decode {
            path: self.path.clone(),
            field,
            source,
        }
    }

    /// Checks `digest` against the stored one. Older runs have none.
    pub(super) fn compare(&mut self, run: i64, subject: &str, digest: i64, what: &str) -> Result<(), StoreError> {
        let stored: Option<i64> = self.block(async |connection| {
            sqlx::query_scalar("SELECT digest FROM digests WHERE run = $1 AND subject = $2")
                .bind(run)
                .bind(subject)
                .fetch_optional(connection)
                .await
        })?;
        match stored {
            Some(stored) if stored != digest => Err(StoreError::Damaged {
                path: self.path.clone(),
                what: format!("{what} of run {run} differ from what was written"),
            }),
            _ => Ok(()),
        }
    }
}

pub(super) async fn put_digest(t: &mut AnyConnection, run: i64, subject: &str, digest: i64) -> Result<(), sqlx::Error> {
    sqlx::query(
        "INSERT INTO digests (run, subject, digest) VALUES ($1, $2, $3) \
         ON CONFLICT (run, subject) DO UPDATE SET digest = excluded.digest",
    )
    .bind(run)
    .bind(subject)
    .bind(digest)
    .execute(t)
    .await
    .map(|_| ())
}

/// An insertion of so many rows, with numbered placeholders, which both databases support.
pub(super) fn rows(insert: &str, rows: usize, columns: usize) -> String {
    let mut statement = format!("{insert} VALUES ");
    for row in 0..rows {
        statement.push_str(if row == 0 { "(" } else { ", (" });
        for column in 1..=columns {
            let comma = if column == 1 { "" } else { ", " };
            statement.push_str(&format!("{comma}${}", row * columns + column));
        }
        statement.push(')');
    }
    statement
}
