//! What was met in one pass through a recording, in figures and in sentences.

use std::collections::BTreeMap;
use std::fmt;

use super::counted::counted;

/// Where a file ends although more should follow.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Truncation {
    /// Offset of the first byte that could not be used.
    pub byte: u64,
    /// What was cut off.
    pub lost: String,
}

impl fmt::Display for Truncation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the file is damaged or cut off: from byte {} on, {}", self.byte, self.lost)
    }
}

/// A counter of 32 bits that began anew behind its highest count.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct CounterWraps {
    /// How often.
    pub count: u64,
    /// The first event behind the first of them, counted from 1.
    pub first_event: u64,
}

impl fmt::Display for CounterWraps {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (times, first) = (counted(self.count, "time", "times"), if self.count == 1 { "" } else { "first " });
        let event = self.first_event;
        write!(f, "the counter of the times wrapped {times}, {first}at event {event}: times go on as if it had not")
    }
}

/// What was met in one pass through a recording.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct ReadReport {
    /// Events handed out.
    pub events: u64,
    /// Events dropped because they lie outside the sensor (or, when its size is not known, beyond
    /// column or row 32766).
    pub out_of_range: u64,
    /// Of those, events with a column or row below 0 or beyond 32766.
    pub no_pixel: u64,
    /// Of those outside the sensor, events that would lie in it with x and y exchanged; 0 where others would not then.
    pub exchanged: u64,
    /// Events earlier than one before them by at most 0.1 s: handed out with the time of the latest.
    pub steps_back: u64,
    /// The largest of these steps, in microseconds.
    pub largest_step_back: i64,
    /// Steps back by more than 0.1 s: the clock was reset. Times go on 1 s after the latest event.
    pub clock_resets: u64,
    /// Set when the counter of a table's times wrapped. Times go on as if it had not.
    pub counter_wraps: Option<CounterWraps>,
    /// Events left out because they are more than 0.1 s earlier than those before and behind them, as a
    /// DAVIS346 sends them now and then; at the beginning also those that are more than 0.1 s from all others.
    pub strays: u64,
    /// Places for events in the file that were never written.
    pub unwritten: u64,
    /// Packets left out because they could not be decoded.
    pub damaged_packets: u64,
    /// What was wrong with a camera's stream; nothing in formats that hold no such stream.
    pub stream: StreamFaults,
    /// Packets of other streams that were passed over, by stream.
    pub other_packets: BTreeMap<String, u64>,
    /// Pictures of the whole recording, where the reader of the events meets them on its way to its end.
    #[serde(skip)]
    pub frames: Option<u64>,
    /// Set when the file ends too early.
    pub truncated: Option<Truncation>,
}

impl ReadReport {
    /// Whether all events outside the sensor would lie in it with x and y exchanged, and those in it too.
    pub fn looks_exchanged(&self) -> bool {
        self.exchanged > 0 && self.exchanged == self.out_of_range
    }

    /// What there is to tell, in sentences.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        if self.steps_back > 0 {
            let (events, largest) = (counted(self.steps_back, "event is", "events are"), self.largest_step_back);
            warnings.push(format!("{events} up to {largest} µs earlier than one before, and got its time"));
        }
        if self.clock_resets > 0 {
            let times = counted(self.clock_resets, "time", "times");
            warnings.push(format!(
                "the clock of the recording was reset {times}: times after that are shifted, to go on 1 s later"
            ));
        }
        warnings.extend(self.counter_wraps.as_ref().map(CounterWraps::to_string));
        if self.strays > 0 {
            let strays = counted(self.strays, "stray event is", "stray events are");
            warnings.push(format!("{strays} left out: more than 0.1 s away from the events around"));
        }
        if self.out_of_range > 0 {
            let reason = if self.looks_exchanged() {
                "; with x and y exchanged all events would lie in it".to_owned()
            } else if self.no_pixel > 0 {
                let have = counted(self.no_pixel, "of them has", "of them have");
                format!("; {have} a column or row below 0 or beyond 32766")
            } else {
                String::new()
            };
            let outside = counted(
                self.out_of_range,
                "event lies outside the sensor and is left out",
                "events lie outside the sensor and are left out",
            );
            warnings.push(format!("{outside}{reason}"));
        }
        if self.unwritten > 0 {
            let events =
                counted(self.unwritten, "more event that was never written", "more events that were never written");
            warnings.push(format!("the file has room for {events}: was the recording ended early?"));
        }
        if self.damaged_packets > 0 {
            let packets = counted(self.damaged_packets, "damaged packet is", "damaged packets are");
            warnings.push(format!("{packets} left out"));
        }
        warnings.extend(self.stream.notes());
        warnings.extend(self.truncated.as_ref().map(Truncation::to_string));
        warnings
    }
}

/// What was wrong with a stream as a camera sends it.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct StreamFaults {
    /// Places where bytes were lost.
    pub gaps: u64,
    /// Those after which the time was put right by the computer's clock, because words that count time
    /// had been lost.
    pub repaired_gaps: u64,
    /// By how much that was in all, in microseconds.
    pub restored_us: u64,
    /// Which times those are, in order.
    pub repaired_times: Vec<RepairedTimes>,
    /// Time that had been added without need and was taken back at a later gap, in microseconds.
    pub taken_back_us: u64,
    /// How often the camera's clock was reset after it had told a time. Times go on 1 s after the latest.
    pub clock_resets: u64,
    /// Events that the camera dropped because the computer read too slowly, if it was asked.
    pub dropped: u64,
    /// Words that no healthy camera sends, by what is wrong with them.
    pub faults: BTreeMap<&'static str, u64>,
}

/// Times of a camera's stream that were put right because words that count time had been lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct RepairedTimes {
    /// The first of them in microseconds.
    pub from_us: i64,
    /// By how much it and all later ones were put later, in microseconds.
    pub restored_us: u64,
    /// How much of that was too much, in microseconds: times are late by it up to a later gap.
    pub excess_us: u64,
}

/// How many repairs are named.
const REPAIRS_NAMED: usize = 10;

impl StreamFaults {
    /// What there is to tell, in sentences.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if self.gaps > 0 {
            notes.push(format!("bytes of the stream were lost in {}", counted(self.gaps, "place", "places")));
        }
        if self.repaired_gaps > 0 {
            notes.push(format!(
                "in {} of them words that count the camera's time were lost too, {:.3} s in all; the computer's clock shows how much",
                self.repaired_gaps,
                self.restored_us as f64 / 1e6
            ));
            let named = self.repaired_times.iter().take(REPAIRS_NAMED).map(|times| {
                let restored = times.restored_us as f64 / 1e3;
                let excess = match times.excess_us {
                    0 => String::new(),
                    excess => format!(" ({:.3} ms of that are too much, up to a later gap)", excess as f64 / 1e3),
                };
                format!("by {restored:.3} ms from {:.6} s on{excess}", times.from_us as f64 / 1e6)
            });
            let more = match self.repaired_times.len().saturating_sub(REPAIRS_NAMED) {
                0 => String::new(),
                more => format!(", and in {}", counted(more as u64, "more place", "more places")),
            };
            let named = named.collect::<Vec<_>>().join(", ");
            notes.push(format!("later times were moved to make up for it: {named}{more}"));
        }
        if self.taken_back_us > 0 {
            let taken_back = self.taken_back_us as f64 / 1e3;
            notes.push(format!("{taken_back:.3} ms too much was added, and taken back at a later gap"));
        }
        if self.dropped > 0 {
            let events = counted(self.dropped, "event", "events");
            notes.push(format!("the camera dropped {events} because the computer read too slowly"));
        }
        if self.clock_resets > 0 {
            let times = counted(self.clock_resets, "time", "times");
            notes.push(format!("the camera's clock was reset {times}; later times are shifted"));
        }
        notes.extend(self.faults.iter().map(|(what, count)| format!("in the camera's stream: {what} ({count})")));
        notes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// "1 stray events … are left out", "reset 1 times".
    #[test]
    fn what_was_met_once_is_told_in_the_singular() {
        let stream = StreamFaults { gaps: 1, dropped: 1, clock_resets: 1, ..StreamFaults::default() };
        let report = |count| ReadReport {
            steps_back: count,
            largest_step_back: 7,
            clock_resets: count,
            counter_wraps: Some(CounterWraps { count, first_event: 7 }),
            strays: count,
            out_of_range: count,
            no_pixel: count,
            unwritten: count,
            damaged_packets: count,
            ..ReadReport::default()
        };
        let once = ReadReport { stream, ..report(1) };
        assert_eq!(
            once.warnings(),
            [
                "1 event is up to 7 µs earlier than one before, and got its time",
                "the clock of the recording was reset 1 time: times after that are shifted, to go on 1 s later",
                "the counter of the times wrapped 1 time, at event 7: times go on as if it had not",
                "1 stray event is left out: more than 0.1 s away from the events around",
                "1 event lies outside the sensor and is left out; 1 of them has a column or row below 0 or beyond 32766",
                "the file has room for 1 more event that was never written: was the recording ended early?",
                "1 damaged packet is left out",
                "bytes of the stream were lost in 1 place",
                "the camera dropped 1 event because the computer read too slowly",
                "the camera's clock was reset 1 time; later times are shifted",
            ]
        );
        let twice = report(2).warnings();
        assert_eq!(
            twice[2],
            "the counter of the times wrapped 2 times, first at event 7: times go on as if it had not"
        );
        assert_eq!(twice[3], "2 stray events are left out: more than 0.1 s away from the events around");
        assert_eq!(
            twice[4],
            "2 events lie outside the sensor and are left out; 2 of them have a column or row below 0 or beyond 32766"
        );
    }
}
