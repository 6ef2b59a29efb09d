//! Dates and times in UTC, in the format of the store and the files (RFC 3339).

use ::time::format_description::well_known::Rfc3339;
use ::time::{Date, Month, OffsetDateTime};

/// Julian day of 1970-01-01.
const EPOCH_JULIAN_DAY: i32 = 2_440_588;

/// Now, with seconds.
pub fn now_utc() -> String {
    let seconds = OffsetDateTime::now_utc().unix_timestamp();
    utc(u64::try_from(seconds).unwrap_or(0))
}

/// Seconds since 1970 as RFC 3339.
pub fn utc(seconds: u64) -> String {
    let time = i64::try_from(seconds)
        .ok()
        .and_then(|seconds| OffsetDateTime::from_unix_timestamp(seconds).ok());
    // Only a year beyond 9999 cannot be written.
    time.and_then(|time| time.format(&Rfc3339).ok()).unwrap_or_default()
}

/// Days since 1970 of an RFC 3339 time.
pub fn days(utc: &str) -> Option<f64> {
    let time = OffsetDateTime::parse(utc, &Rfc3339).ok()?.to_utc();
    let whole = time.date().to_julian_day() - EPOCH_JULIAN_DAY;
    let (h, m, s) = time.time().as_hms();
    let seconds = f64::from(s) + f64::from(time.nanosecond()) * 1e-9;
    Some(f64::from(whole) + (f64::from(h) * 3600.0 + f64::from(m) * 60.0 + seconds) / 86_400.0)
}

/// The date of an RFC 3339 time, or of a date alone, `YYYY-MM-DD`.
fn date(utc: &str) -> Option<Date> {
    let whole = if utc.len() == 10 {
        OffsetDateTime::parse(&format!("{utc}T00:00:00Z"), &Rfc3339)
    } else {
        OffsetDateTime::parse(utc, &Rfc3339)
    };
    whole.ok().map(OffsetDateTime::date)
}

/// Whether a text is a date, `YYYY-MM-DD`, or an RFC 3339 time.
pub fn is_date(utc: &str) -> bool {
    date(utc).is_some()
}

/// The date so many months after a date or time, `YYYY-MM-DD`. A day that the month does not
/// have is its last one.
pub fn months_after(utc: &str, months: u32) -> Option<String> {
    let from = date(utc)?;
    let number = from.year() * 12 + i32::from(u8::from(from.month())) - 1 + i32::try_from(months).ok()?;
    let (year, month) = (number.div_euclid(12), number.rem_euclid(12) + 1);
    let month = Month::try_from(u8::try_from(month).ok()?).ok()?;
    let to = Date::from_calendar_date(year, month, from.day().min(month.length(year))).ok()?;
    Some(to.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a date is a year or a day off, if a day that a month does not have is carried into
    // the next month, or if something that is no date gives one.
    #[test]
    fn months_are_added_by_the_calendar() {
        for (from, months, to) in [
            ("2026-11-23T10:00:00Z", 12, "2027-11-23"),
            ("2026-11-23", 2, "2027-01-23"),
            ("2026-12-31", 2, "2027-02-28"),
            ("2028-02-29T00:00:00Z", 12, "2029-02-28"),
            ("2027-12-31", 2, "2028-02-29"),
            ("2026-01-15", 0, "2026-01-15"),
        ] {
            assert_eq!(months_after(from, months).as_deref(), Some(to), "{from} {months}");
        }
        for none in [
            "",
            "2026-13-01",
            "2026-02-30",
            "23.11.2026",
            "2026-1-01",
            "2026-11-23 x",
            "2026-11-23Tx",
            "\u{e9}2026-11-23",
        ] {
            assert!(!is_date(none) && months_after(none, 1).is_none(), "{none}");
        }
    }

    // Fails if a date is off by a day anywhere near a leap day.
    #[test]
    fn dates_are_days() {
        assert_eq!(days("1970-01-01T00:00:00Z"), Some(0.0));
        assert_eq!(days("2024-03-01T12:00:00Z"), Some(19_783.5));
        assert_eq!(days("2000-02-29T00:00:00Z"), Some(11_016.0));
        assert_eq!(days("yesterday"), None);
        assert_eq!(utc(1_767_323_045), "2026-01-02T03:04:05Z");
        for day in [0u64, 59, 60, 11_016, 19_782, 19_783, 20_000] {
            assert_eq!(days(&utc(day * 86_400)), Some(day as f64));
        }
    }
}
