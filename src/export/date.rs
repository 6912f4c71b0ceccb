//! Calendar dates from nanosecond stamps, where the stamps are Unix time at all.

/// A moment in UTC.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct UtcDate {
    year: i64,
    month: i64,
    day: i64,
    /// Nanoseconds since midnight.
    of_day_ns: i64,
}

impl UtcDate {
    /// `None` for stamps outside the years 2000 to 2099: a camera's own counter, not a calendar.
    /// Civil date from days by Hinnant's algorithm (proleptic Gregorian).
    pub(super) fn from_unix_nanos(nanos: i64) -> Option<Self> {
        const DAY_NS: i64 = 86_400_000_000_000;
        let shifted = nanos.div_euclid(DAY_NS) + 719_468;
        let era = shifted.div_euclid(146_097);
        let day_of_era = shifted.rem_euclid(146_097);
        let year_of_era =
            (day_of_era - day_of_era / 1_460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
        let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
        let march_month = (5 * day_of_year + 2) / 153;
        let month = if march_month < 10 {
            march_month + 3
        } else {
            march_month - 9
        };
        let year = year_of_era + era * 400 + i64::from(month <= 2);
        (2000..2100).contains(&year).then_some(Self {
            year,
            month,
            day: day_of_year - (153 * march_month + 2) / 5 + 1,
            of_day_ns: nanos.rem_euclid(DAY_NS),
        })
    }

    /// yyyy-mm-dd.
    pub(super) fn day(&self) -> String {
        format!("{:04}-{:02}-{:02}", self.year, self.month, self.day)
    }

    /// yyyy.
    pub(super) fn year(&self) -> String {
        self.year.to_string()
    }

    /// hh:mm:ss.ff
    pub(super) fn time(&self) -> String {
        let hundredths = self.of_day_ns / 10_000_000;
        let seconds = hundredths / 100;
        format!(
            "{:02}:{:02}:{:02}.{:02}",
            seconds / 3600,
            seconds / 60 % 60,
            seconds % 60,
            hundredths % 100
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_days() {
        // `date -u -d @1775001600`: 2026-04-01 00:00:00.
        let date = UtcDate::from_unix_nanos(1_775_001_600_000_000_000).unwrap();
        assert_eq!(
            (date.day(), date.time()),
            ("2026-04-01".into(), "00:00:00.00".into())
        );
        // `date -u -d @1709251199`: 2024-02-29 23:59:59.
        let date = UtcDate::from_unix_nanos(1_709_251_199_990_000_000).unwrap();
        assert_eq!(
            (date.day(), date.time()),
            ("2024-02-29".into(), "23:59:59.99".into())
        );
        assert_eq!(date.year(), "2024");
    }

    #[test]
    fn a_camera_s_own_counter_has_no_date() {
        for nanos in [0, 12_000_000_000, -5, i64::MAX, i64::MIN] {
            assert_eq!(UtcDate::from_unix_nanos(nanos), None);
        }
    }
}
