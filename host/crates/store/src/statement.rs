//! SQL statements that several tables share.

use sqlx::AnyConnection;

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
