//! Date of a recording from its times.

use jiff::Timestamp;

/// Range of times in microseconds that are taken for times since 1970: the years 2000 to 2099.
const SINCE_1970: std::ops::Range<i64> = 946_684_800_000_000..4_102_444_800_000_000;

/// Returns the date of a time in microseconds since 1970; `None` if the time seems to count from elsewhere.
pub fn date(microseconds: i64) -> Option<String> {
    if !SINCE_1970.contains(&microseconds) {
        return None;
    }
    let second = Timestamp::from_second(microseconds / 1_000_000).ok()?;
    Some(second.to_string().replace('T', " ").replace('Z', " UTC"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_times_since_1970_have_a_date() {
        assert_eq!(date(1_643_243_628_737_093).as_deref(), Some("2022-01-27 00:33:48 UTC"));
        assert_eq!(date(951_782_400_000_000).as_deref(), Some("2000-02-29 00:00:00 UTC"));
        assert_eq!((date(0), date(3_600_000_000), date(i64::MAX), date(i64::MIN)), (None, None, None, None));
    }
}
