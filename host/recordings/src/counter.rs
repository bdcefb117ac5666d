//! Unwrapping of times from a 32-bit counter.
//!
//! In microseconds, such a counter wraps after 71.6 min, or after 35.8 min if its highest bit is not used. Tables of
//! events contain its counts unchanged. A clock reset jumps back too, but from any count, whereas a wrap jumps from the
//! end of the counter's range to its beginning.

use crate::options::TimeUnit;
use crate::read_report::{CounterWraps, ReadReport};

/// Ranges of counters: the lowest count, and the highest count plus 1.
const RANGES: [(i128, i128); 3] = [(0, 1 << 32), (-(1 << 31), 1 << 31), (0, 1 << 31)];
/// A jump is a wrap if it begins within this many counts of the end of the range and ends within as many of its
/// beginning (16.8 s in microseconds).
const NEAR: i128 = 1 << 24;
/// A microsecond in nanoseconds.
const MICROSECOND: i128 = 1000;
/// Shortest jump in µs that can be a wrap. The shortest range, nanoseconds in 31 bits, is 2.1 s long.
const SHORTEST_WRAP: u64 = 2_000_000;

/// Clock that unwraps the times of a table.
pub struct TimeCounter {
    /// Possible durations of a count, in nanoseconds.
    counts: [i128; 2],
    /// Number of times seen so far, and the last of them (µs) as in the file.
    events: u64,
    last: Option<i64>,
    /// Sum of the wraps so far, in nanoseconds, and its maximum.
    wrapped: i128,
    most: i128,
    /// `wrapped` in microseconds.
    shift: i64,
}

impl TimeCounter {
    /// Creates a clock for times in this unit. Times in seconds or milliseconds may be divided counts of a microsecond
    /// counter.
    pub fn new(unit: TimeUnit) -> Self {
        let count = 10_i128.pow(unit.decimal_exponent().saturating_add(3).unsigned_abs());
        Self { counts: [count, count.min(MICROSECOND)], events: 0, last: None, wrapped: 0, most: 0, shift: 0 }
    }

    /// Returns the unwrapped time (µs) of the next event, which has the time `t` (µs) in the file.
    ///
    /// Events from before a wrap may follow it. The wrap is then undone for them, and redone for the next event.
    pub fn time(&mut self, t: i64, report: &mut ReadReport) -> i64 {
        self.events += 1;
        let last = self.last.replace(t).unwrap_or(t);
        if t.abs_diff(last) > SHORTEST_WRAP {
            self.wrapped += self.wrap(last, t);
            self.shift = i64::try_from((self.wrapped + MICROSECOND / 2).div_euclid(MICROSECOND)).unwrap_or(i64::MAX);
            if self.wrapped > self.most {
                self.most = self.wrapped;
                let wraps = report.counter_wraps.get_or_insert(CounterWraps { count: 0, first_event: self.events });
                wraps.count += 1;
            }
        }
        t.saturating_add(self.shift)
    }

    /// Returns the length of the wrap from the time `last` to the time `t`: negative if it is passed backwards, 0 if
    /// there is no wrap.
    fn wrap(&self, last: i64, t: i64) -> i128 {
        let [last, t] = [last, t].map(|time| i128::from(time) * MICROSECOND);
        let mut ranges =
            self.counts.iter().flat_map(|count| RANGES.map(|(start, end)| (start * count, end * count, count)));
        let wrap = |(start, end, count): (i128, i128, &i128)| {
            let near = NEAR * count;
            // The last count may have been rounded up to microseconds.
            let is_at_end = |time| (end - near..end + MICROSECOND).contains(&time);
            let is_at_start = |time| (start..start + near).contains(&time);
            if is_at_end(last) && is_at_start(t) {
                Some(end - start)
            } else if is_at_start(last) && is_at_end(t) {
                Some(start - end)
            } else {
                None
            }
        };
        ranges.find_map(wrap).unwrap_or(0)
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

    #[test]
    fn other_jumps_are_left_to_the_reader() {
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
