//! Dates and times in UTC, in the format of the store and the files (RFC 3339).

use ::time::OffsetDateTime;
use ::time::format_description::well_known::Rfc3339;

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

#[cfg(test)]
mod tests {
    use super::*;

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
