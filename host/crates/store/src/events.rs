//! Writes the numbered events of the controller: phases, contacts, couplings, faults and
//! recordings. A batch is one transaction, and each event is written once.

use spherecal_model::name_of;
use spherecal_shared::protocol::host::{Contact, Coupled, Event, FaultReport, PhaseChange, Recording};
use sqlx::any::AnyArguments;
use sqlx::query::Query;
use sqlx::{Any, AnyConnection, AssertSqlSafe};

use super::columns::{put_digest, rows};
use super::digest::{self, recording_subject};
use super::seal::{CONTACTS, COUPLINGS, FAULTS, Key, PHASES, RECORDINGS, Sealed, forget_removed, seal};
use super::{SqlStore, StoreError};

/// An event and its key: the session of the run in which it happened, and a number that is unique
/// in that session.
#[derive(Clone, Copy, Debug)]
pub struct Placed<'a> {
    /// Session of the run.
    pub session: i64,
    /// Number within it.
    pub event: i64,
    /// What happened.
    pub body: &'a Event,
}

/// How an event that is stored already is treated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum KnownEvent {
    /// It stays as it is.
    Stays,
    /// It is replaced.
    IsReplaced,
}

impl SqlStore {
    /// Writes a batch of events in one transaction.
    pub(super) fn write_events(
        &mut self,
        run: i64,
        events: &[Placed<'_>],
        known: KnownEvent,
    ) -> Result<(), StoreError> {
        let measured = events.iter().any(|placed| {
            matches!(
                placed.body,
                Event::Recording(_) | Event::Contact(_) | Event::Coupled(_) | Event::Fault(_)
            )
        });
        self.set_durable(measured)?;
        self.write(async |t| {
            for placed in events {
                let session = placed.session;
                let key = (run, session, placed.event);
                if known == KnownEvent::IsReplaced {
                    forget(t, key).await?;
                }
                match placed.body {
                    Event::Phase(phase) => insert_phase(t, key, phase).await?,
                    Event::Contact(contact) => insert_contact(t, key, contact).await?,
                    Event::Coupled(coupled) => insert_coupled(t, key, coupled).await?,
                    Event::Recording(recording) => insert_recording(t, key, recording, known).await?,
                    Event::Fault(fault) => insert_fault(t, key, fault).await?,
                    Event::Banner(_)
                    | Event::Held { .. }
                    | Event::Reply { .. }
                    | Event::Passed { .. }
                    | Event::Telemetry(_)
                    | Event::Statistics(_) => {}
                }
            }
            Ok(())
        })
    }

    /// Removes the events of a run, except recordings, that do not belong to `session` or that came
    /// after event `last` of it.
    pub(super) fn forget_after(&mut self, run: i64, session: i64, last: i64) -> Result<(), StoreError> {
        self.write(async |t| {
            for statement in FORGET_AFTER {
                sqlx::query(statement)
                    .bind(run)
                    .bind(session)
                    .bind(last)
                    .execute(&mut *t)
                    .await?;
            }
            for table in EVENTS {
                forget_removed(t, &table, run).await?;
            }
            Ok(())
        })
    }
}

/// Run, session and number of an event.
type EventKey = (i64, i64, i64);

/// The tables of events, recordings excepted.
const EVENTS: [Sealed; 4] = [PHASES, CONTACTS, COUPLINGS, FAULTS];

/// What is known of one event, recordings excepted.
const FORGET: [&str; 4] = [
    "DELETE FROM phases WHERE run = $1 AND session = $2 AND event = $3",
    "DELETE FROM contacts WHERE run = $1 AND session = $2 AND event = $3",
    "DELETE FROM couplings WHERE run = $1 AND session = $2 AND event = $3",
    "DELETE FROM faults WHERE run = $1 AND session = $2 AND event = $3",
];

/// Selects the rows that do not belong to a session or lie after an event.
const FORGET_AFTER: [&str; 4] = [
    "DELETE FROM phases WHERE run = $1 AND (session <> $2 OR event > $3)",
    "DELETE FROM contacts WHERE run = $1 AND (session <> $2 OR event > $3)",
    "DELETE FROM couplings WHERE run = $1 AND (session <> $2 OR event > $3)",
    "DELETE FROM faults WHERE run = $1 AND (session <> $2 OR event > $3)",
];

/// Removes one event and its digest.
async fn forget(t: &mut AnyConnection, key: EventKey) -> Result<(), sqlx::Error> {
    let (run, session, event) = key;
    for (statement, table) in FORGET.iter().zip(EVENTS) {
        if keyed(key, statement).execute(&mut *t).await?.rows_affected() > 0 {
            sqlx::query("DELETE FROM digests WHERE run = $1 AND subject = $2")
                .bind(run)
                .bind(format!("{} {session} {event}", table.name))
                .execute(&mut *t)
                .await?;
        }
    }
    Ok(())
}

/// Writes one event, and seals it if it is new.
async fn put(
    t: &mut AnyConnection,
    table: &Sealed,
    key: EventKey,
    insert: Query<'static, Any, AnyArguments>,
) -> Result<(), sqlx::Error> {
    let (run, session, event) = key;
    if insert.execute(&mut *t).await?.rows_affected() > 0 {
        seal(t, table, run, &[Key::Whole(session), Key::Whole(event)]).await?;
    }
    Ok(())
}

/// A statement on one event. Its first three values are the event's key.
fn keyed(key: EventKey, statement: &'static str) -> Query<'static, Any, AnyArguments> {
    sqlx::query(statement).bind(key.0).bind(key.1).bind(key.2)
}

async fn insert_phase(t: &mut AnyConnection, key: EventKey, phase: &PhaseChange) -> Result<(), sqlx::Error> {
    let insert = keyed(
        key,
        "INSERT INTO phases (run, session, event, phase, previous, time_us, tick) VALUES ($1, $2, $3, $4, $5, $6, $7) \
         ON CONFLICT DO NOTHING",
    )
    .bind(name_of(phase.phase))
    .bind(name_of(phase.from))
    .bind(phase.time_us as i64)
    .bind(phase.tick as i64);
    put(t, &PHASES, key, insert).await
}

async fn insert_contact(t: &mut AnyConnection, key: EventKey, contact: &Contact) -> Result<(), sqlx::Error> {
    let ([tx, ty, tz], [px, py, pz]) = (contact.tare_n, contact.tcp_m);
    let insert = keyed(
        key,
        "INSERT INTO contacts (run, session, event, sphere, time_us, force_n, peak_n, tare_x_n, tare_y_n, tare_z_n, \
         tcp_x_m, tcp_y_m, tcp_z_m, travel_m, latency_ticks, early_crossings) \
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14, $15, $16) ON CONFLICT DO NOTHING",
    )
    .bind(i64::from(contact.sphere))
    .bind(contact.time_us as i64)
    .bind(real(contact.force_n))
    .bind(real(contact.peak_n))
    .bind(real(tx))
    .bind(real(ty))
    .bind(real(tz))
    .bind(real(px))
    .bind(real(py))
    .bind(real(pz))
    .bind(real(contact.travel_m))
    .bind(i64::from(contact.latency_ticks))
    .bind(i64::from(contact.early_crossings));
    put(t, &CONTACTS, key, insert).await
}

async fn insert_coupled(t: &mut AnyConnection, key: EventKey, coupled: &Coupled) -> Result<(), sqlx::Error> {
    let [x, y, z] = coupled.centre_m;
    let insert = keyed(
        key,
        "INSERT INTO couplings (run, session, event, sphere, time_us, centre_x_m, centre_y_m, centre_z_m, shift_m, \
         test_m) VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10) ON CONFLICT DO NOTHING",
    )
    .bind(i64::from(coupled.sphere))
    .bind(coupled.time_us as i64)
    .bind(real(x))
    .bind(real(y))
    .bind(real(z))
    .bind(real(coupled.shift_m))
    .bind(real(coupled.test_m));
    put(t, &COUPLINGS, key, insert).await
}

async fn insert_fault(t: &mut AnyConnection, key: EventKey, fault: &FaultReport) -> Result<(), sqlx::Error> {
    // Value and limit as text: a fault may report a NaN, which a column of numbers cannot hold.
    let insert = keyed(
        key,
        "INSERT INTO faults (run, session, event, fault, phase, time_us, tick, joint, value, bound) \
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10) ON CONFLICT DO NOTHING",
    )
    .bind(name_of(fault.fault))
    .bind(name_of(fault.phase))
    .bind(fault.time_us as i64)
    .bind(fault.tick as i64)
    .bind(i64::from(fault.joint))
    .bind(format!("{:?}", fault.value))
    .bind(format!("{:?}", fault.limit));
    put(t, &FAULTS, key, insert).await
}

/// Where a recording stands among those of its run: by session, then by event. It depends on nothing that
/// can be lost, so a recording that is made again comes to the place that it had.
///
/// An event has the number of its handshake above its lowest 32 bits.
fn position_of((_, session, event): EventKey) -> i64 {
    (session << 48) | event
}

/// Writes a recording. One that is stored already stays as it is; of a run that is repeated from its start,
/// it gets the place at which the repetition made it.
async fn insert_recording(
    t: &mut AnyConnection,
    key: EventKey,
    r: &Recording,
    known: KnownEvent,
) -> Result<(), sqlx::Error> {
    let (run, session, _) = key;
    let [fx, fy, fz] = r.force_n;
    let of_pose = [Key::Whole(r.sphere.into()), Key::Whole(r.pose.into())];
    let inserted = sqlx::query(
        "INSERT INTO recordings (run, sphere, pose, position, session, start_us, end_us, samples, gaps, tcp_spread_m, \
         force_x_n, force_y_n, force_z_n) \
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13) ON CONFLICT DO NOTHING",
    )
    .bind(run)
    .bind(i64::from(r.sphere))
    .bind(i64::from(r.pose))
    .bind(position_of(key))
    .bind(session)
    .bind(r.start_us as i64)
    .bind(r.end_us as i64)
    .bind(i64::from(r.count))
    .bind(i64::from(r.gaps))
    .bind(real(r.tcp_spread_m))
    .bind(real(fx))
    .bind(real(fy))
    .bind(real(fz))
    .execute(&mut *t)
    .await?;
    if inserted.rows_affected() == 0 {
        if known == KnownEvent::IsReplaced {
            let moved = sqlx::query(
                "UPDATE recordings SET position = $4, session = $5 \
                 WHERE run = $1 AND sphere = $2 AND pose = $3 AND (position <> $4 OR session <> $5)",
            )
            .bind(run)
            .bind(i64::from(r.sphere))
            .bind(i64::from(r.pose))
            .bind(position_of(key))
            .bind(session)
            .execute(&mut *t)
            .await?;
            if moved.rows_affected() > 0 {
                seal(t, &RECORDINGS, run, &of_pose).await?;
            }
        }
        return Ok(());
    }
    seal(t, &RECORDINGS, run, &of_pose).await?;
    let subject = recording_subject(r.sphere, r.pose);
    put_digest(t, run, &subject, digest::of_recording(r)).await?;
    if r.q.is_empty() || r.tau.is_empty() {
        return Ok(());
    }
    let statement = rows(
        "INSERT INTO recording_joints (run, sphere, pose, joint, q_mean_rad, q_std_rad, q_min_rad, q_max_rad, \
         tau_mean_nm, tau_std_nm, tau_min_nm, tau_max_nm)",
        r.q.len().min(r.tau.len()),
        12,
    );
    let mut insert = sqlx::query(AssertSqlSafe(statement));
    for ((q, tau), joint) in r.q.iter().zip(&r.tau).zip(1i64..) {
        insert = insert
            .bind(run)
            .bind(i64::from(r.sphere))
            .bind(i64::from(r.pose))
            .bind(joint);
        for signal in [q, tau] {
            insert = insert
                .bind(real(signal.mean))
                .bind(real(signal.std))
                .bind(real(signal.min))
                .bind(real(signal.max));
        }
    }
    insert.execute(t).await.map(|_| ())
}

/// A number as it is stored. SQLite drops the sign of a zero, so every store drops it, and a run
/// has the same bits in all of them.
fn real(value: f64) -> f64 {
    value + 0.0
}
