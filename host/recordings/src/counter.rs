//! Unwrapping of times from a counter of 32, 24, 16 or 15 bits.
//!
//! In microseconds, a counter of 32 bits wraps after 71.6 min, or after 35.8 min if its highest bit is not used. Tables
//! of events contain its counts unchanged. A clock reset jumps back too, but from any count, whereas a wrap jumps from
//! the end of the counter's range to its beginning.

use crate::options::TimeUnit;
use crate::read_report::{CounterWraps, ReadReport};

/// Range of a counter.
#[derive(Clone, Copy)]
struct Range {
    /// Lowest count, and highest count plus 1.
    start: i128,
    end: i128,
    /// A jump is a wrap if it begins within this many counts of the end of the range and ends within as many of its
    /// beginning.
    near: i128,
    /// `true` if the range is so short that other recordings may look like this counter: the first times of a recording
    /// lie in the range, and a pause may jump across it.
    is_short: bool,
}

/// Ranges of counters. In microseconds, 2²⁴ counts are 16.8 s.
const RANGES: [Range; 7] = [
    Range { start: 0, end: 1 << 32, near: 1 << 24, is_short: false },
    Range { start: -(1 << 31), end: 1 << 31, near: 1 << 24, is_short: false },
    Range { start: 0, end: 1 << 31, near: 1 << 24, is_short: false },
    Range { start: 0, end: 1 << 24, near: 1 << 16, is_short: true },
    Range { start: 0, end: 1 << 16, near: 1 << 14, is_short: true },
    Range { start: -(1 << 15), end: 1 << 15, near: 1 << 14, is_short: true },
    Range { start: 0, end: 1 << 15, near: 1 << 13, is_short: true },
];
/// A microsecond in nanoseconds.
const MICROSECOND: i128 = 1000;
/// Shortest jump in µs that can be a wrap: 15 bits of microseconds are 33 ms long, 24 bits of nanoseconds 17 ms.
const SHORTEST_WRAP: u64 = 16_000;

/// Clock that unwraps the times of a table.
pub struct TimeCounter {
    /// Possible ranges, in nanoseconds.
    ranges: Vec<Range>,
    /// Number of times seen so far, and the last of them (µs) as in the file.
    events: u64,
    last: Option<i64>,
    /// Sum of the wraps so far, in nanoseconds, and its maximum.
    wrapped: i128,
    most: i128,
    /// `wrapped` in microseconds.
    shift: i64,
    /// End in µs of the short range that was wrapped, if any.
    short_end: Option<i64>,
}

impl TimeCounter {
    /// Creates a clock for times in this unit. Times in seconds or milliseconds may be divided counts of a microsecond
    /// counter.
    pub fn new(unit: TimeUnit) -> Self {
        let count = 10_i128.pow(unit.decimal_exponent().saturating_add(3).unsigned_abs());
        let counted = |Range { start, end, near, is_short }: Range, count: i128| Range {
            start: start * count,
            end: end * count,
            near: near * count,
            is_short,
        };
        let ranges = [count, count.min(MICROSECOND)].into_iter();
        let ranges = ranges.flat_map(|count| RANGES.map(|range| counted(range, count))).collect();
        Self { ranges, events: 0, last: None, wrapped: 0, most: 0, shift: 0, short_end: None }
    }

    /// Returns the unwrapped time (µs) of the next event, which has the time `t` (µs) in the file.
    ///
    /// Events from before a wrap may follow it. The wrap is then undone for them, and redone for the next event.
    pub fn time(&mut self, t: i64, report: &mut ReadReport) -> i64 {
        self.events += 1;
        let last = self.last.replace(t).unwrap_or(t);
        if self.short_end.is_some_and(|end| t > end) {
            // A counter of this range would not have counted that far, so it has not wrapped.
            (self.wrapped, self.most, self.shift, self.short_end) = (0, 0, 0, None);
            report.counter_wraps = None;
        } else if t.abs_diff(last) > SHORTEST_WRAP {
            self.wrap(last, t);
            if self.wrapped > self.most {
                self.most = self.wrapped;
                let wraps = report.counter_wraps.get_or_insert(CounterWraps { count: 0, first_event: self.events });
                wraps.count += 1;
            }
        }
        t.saturating_add(self.shift)
    }

    /// Adds the length of the wrap from the time `last` to the time `t` (µs), if there is one, or subtracts it if the
    /// wrap is passed backwards. A short one is passed backwards only after it was passed forwards, because a pause
    /// looks the same.
    fn wrap(&mut self, last: i64, t: i64) {
        let [last, t] = [last, t].map(|time| i128::from(time) * MICROSECOND);
        let wrapped = self.wrapped;
        let wrap = |range: &Range| {
            let Range { start, end, near, is_short } = *range;
            // The last count may have been rounded up to microseconds.
            let is_at_end = |time| (end - near..end + MICROSECOND).contains(&time);
            let is_at_start = |time| (start..start + near).contains(&time);
            if is_at_end(last) && is_at_start(t) {
                Some((end - start, *range))
            } else if is_at_start(last) && is_at_end(t) && (!is_short || wrapped >= end - start) {
                Some((start - end, *range))
            } else {
                None
            }
        };
        let Some((length, range)) = self.ranges.iter().find_map(wrap) else { return };
        let microseconds = |time: i128| i64::try_from((time + MICROSECOND / 2).div_euclid(MICROSECOND));
        self.wrapped += length;
        self.shift = microseconds(self.wrapped).unwrap_or(i64::MAX);
        self.short_end = microseconds(range.end).ok().filter(|_| range.is_short);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::KEPT;

    /// Returns the unwrapped times (µs).
    fn times(unit: TimeUnit, times: impl IntoIterator<Item = i64>) -> (Vec<i64>, Option<CounterWraps>) {
        let (mut counter, mut report) = (TimeCounter::new(unit), ReadReport::default());
        let times = times.into_iter().map(|t| counter.time(t, &mut report)).collect();
        (times, report.counter_wraps)
    }

    #[test]
    fn times_continue_after_a_wrap() {
        for (kept, wraps, first_event) in [(KEPT[0], 2, 431), (KEPT[1], 3, 216), (KEPT[2], 5, 216)] {
            // 3 h in steps of 10 s.
            let truth: Vec<i64> = (0..1080).map(|index| index * 10_000_000 + 7).collect();
            let (times, met) = times(TimeUnit::Microseconds, truth.iter().map(|t| kept(*t)));
            assert_eq!(times, truth);
            assert_eq!(met, Some(CounterWraps { count: wraps, first_event }));
        }
    }

    #[test]
    fn events_around_the_wrap_may_come_in_any_order() {
        let wrap = 1 << 32;
        // 100 µs apart; every third event is 3 ms late, every seventh 5 ms early.
        let mut truth: Vec<i64> = (-200..200).map(|index| wrap + index * 100).collect();
        truth.sort_by_key(|t| {
            t + [3000, 0, 0][(t / 100 % 3) as usize] - [5000, 0, 0, 0, 0, 0, 0][(t / 100 % 7) as usize]
        });
        let crossings = truth.windows(2).filter(|pair| pair[0] < wrap && pair[1] >= wrap).count();
        assert!(crossings > 10);
        let first_event = truth.iter().position(|t| *t >= wrap).unwrap() as u64 + 1;
        let (times, met) = times(TimeUnit::Microseconds, truth.iter().map(|t| KEPT[0](*t)));
        assert_eq!((times, met), (truth, Some(CounterWraps { count: 1, first_event })));
    }

    /// The first event of a file may be from after the wrap, and the second from before it.
    #[test]
    fn a_file_may_begin_at_the_wrap() {
        let (times, met) = times(TimeUnit::Microseconds, [2, u32::MAX.into(), 3, 4_294_967_294, 5, 6]);
        assert_eq!((times, met), (vec![2, -1, 3, -2, 5, 6], None));
    }

    #[test]
    fn the_unit_of_the_column_determines_the_range() {
        // 32 bits of nanoseconds: 10 min in steps of 5 ms, to the nearest µs.
        let truth: Vec<i64> = (0..120_000).map(|index| index * 5_000_321).collect();
        let rounded = |count: i64| (count + 500) / 1000;
        let (nanoseconds, met) = times(TimeUnit::Nanoseconds, truth.iter().map(|count| rounded(KEPT[0](*count))));
        assert!(nanoseconds.iter().zip(&truth).all(|(t, count)| t.abs_diff(rounded(*count)) <= 1));
        assert_eq!(met.unwrap().count, (truth[truth.len() - 1] >> 32) as u64);
        // 32 bits of milliseconds, and microseconds in a column of milliseconds.
        let end = 1 << 32;
        assert_eq!(times(TimeUnit::Milliseconds, [(end - 1) * 1000, 1000]).0, [(end - 1) * 1000, (end + 1) * 1000]);
        assert_eq!(times(TimeUnit::Milliseconds, [end - 1, 1]).0, [end - 1, end + 1]);
        // In microseconds, no counter has a range of 49.7 days.
        assert_eq!(times(TimeUnit::Microseconds, [(end - 1) * 1000, 1000]).0, [(end - 1) * 1000, 1000]);
    }

    /// Times in µs and in ms, in steps of 301 or 5003 counts and with one late event in seven.
    #[test]
    fn short_counters_are_unwrapped() {
        for (bits, lowest, step) in [(24, 0, 5003), (16, 0, 301), (16, -(1 << 15), 301), (15, 0, 301)] {
            let kept = |t: i64| (t - lowest).rem_euclid(1 << bits) + lowest;
            let truth: Vec<i64> =
                (0..20_000).map(|index| index * step - if index % 7 == 6 { 2 * step } else { 0 }).collect();
            let wraps = (truth.iter().max().unwrap() - lowest) >> bits;
            for (unit, scale) in [(TimeUnit::Microseconds, 1), (TimeUnit::Milliseconds, 1000)] {
                let (times, met) = times(unit, truth.iter().map(|t| kept(*t) * scale));
                assert!(times.iter().zip(&truth).all(|(time, t)| *time == t * scale), "{bits} bits from {lowest}");
                assert_eq!(met.map(|met| met.count as i64), Some(wraps));
            }
        }
    }

    /// Late events at the beginning, and a pause of 31 ms.
    #[test]
    fn times_beyond_a_short_range_are_not_unwrapped() {
        let late = (0..600).map(|index| index * 100 - if index > 290 && index % 9 == 0 { 27_000 } else { 0 });
        for given in [late.collect::<Vec<i64>>(), vec![0, 500, 31_500, 31_600, 40_000, 70_000]] {
            let (times, met) = times(TimeUnit::Microseconds, given.iter().copied());
            assert_eq!((times.last(), met), (given.last(), None));
        }
        assert_eq!(times(TimeUnit::Microseconds, [0, 500, 31_500, 40_000]).0, [0, 500, 31_500, 40_000]);
    }

    #[test]
    fn other_jumps_are_not_wraps() {
        let (end, second) = (1_i64 << 32, 1_000_000);
        for [before, after] in [
            [4000 * second, 0],
            [end - 20 * second, 0],
            [end - 1, 20 * second],
            [end + 1, 0],
            [end / 2 - 20 * second, -end / 2],
            [end / 2 + 1, 0],
            [end / 2 - 1, -end / 2 + 20 * second],
            [5 * second, 0],
            [0, 71 * 60 * second],
            [i64::MAX, i64::MIN],
        ] {
            assert_eq!(times(TimeUnit::Microseconds, [before, after]), (vec![before, after], None));
        }
    }

    #[test]
    fn endless_wraps_end_at_the_largest_time() {
        let end = 1_i64 << 32;
        let second = 1_000_000;
        let round = [0, end / 4, end - 1].map(|count| count * second);
        let (times, _) = times(TimeUnit::Seconds, std::iter::repeat_n(round, 5000).flatten());
        assert!(times.is_sorted() && times.last() == Some(&i64::MAX));
    }
}
