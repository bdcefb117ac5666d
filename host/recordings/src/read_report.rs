//! Report of one pass through a recording, as numbers and as sentences.

use std::collections::BTreeMap;
use std::fmt;

use super::counted::counted;

/// End of a file that should contain more.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Truncation {
    /// Offset of the first byte that could not be used.
    pub byte: u64,
    /// Description of the lost part.
    pub lost: String,
}

impl fmt::Display for Truncation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the file is damaged or cut off: from byte {} on, {}", self.byte, self.lost)
    }
}

/// Wraps of a time counter: after its highest value it restarted at its lowest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct CounterWraps {
    /// Number of wraps.
    pub count: u64,
    /// Number of the first event after the first wrap, from 1.
    pub first_event: u64,
}

impl fmt::Display for CounterWraps {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (times, first) = (counted(self.count, "time", "times"), if self.count == 1 { "" } else { "first " });
        let event = self.first_event;
        write!(f, "the time counter wrapped {times}, {first}at event {event}: times continue as if it had not")
    }
}

/// Report of one pass through a recording.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct ReadReport {
    /// Events returned.
    pub events: u64,
    /// Events dropped because they lie outside the sensor (or, when its size is not known, beyond column or row 32766).
    pub out_of_range: u64,
    /// Events among `out_of_range` with a column or row below 0 or beyond 32766.
    pub no_pixel: u64,
    /// Events among `out_of_range` that would be inside the sensor with x and y exchanged. 0 if any event inside
    /// would then be outside.
    pub exchanged: u64,
    /// Events that are stored after later ones, by up to 0.1 s. They are sorted by time.
    pub sorted: u64,
    /// Largest difference between the time of such an event and the latest one before it, in microseconds.
    pub largest_delay: i64,
    /// Events that are stored too late to be sorted, because more than a million others precede them. They get the
    /// time of the latest event that was returned.
    pub steps_back: u64,
    /// Largest of these steps, in microseconds.
    pub largest_step_back: i64,
    /// Steps back by more than 0.1 s, which mean that the clock was reset. Times continue 1 s after the latest
    /// event.
    pub clock_resets: u64,
    /// Wraps of the time counter of a table, if any. Times continue as if it had not wrapped.
    pub counter_wraps: Option<CounterWraps>,
    /// Events dropped because they are more than 0.1 s earlier than the events before and after them (a DAVIS346 sends
    /// such events now and then), or at the beginning and more than 0.1 s away from all that follow.
    pub strays: u64,
    /// Space in the file that was reserved for events but never written, in events.
    pub unwritten: u64,
    /// Packets left out because they could not be decoded.
    pub damaged_packets: u64,
    /// Faults in a camera's USB stream; empty for formats that do not store such a stream.
    pub stream: StreamFaults,
    /// Packets of other streams that were passed over, by name of the stream.
    pub other_packets: BTreeMap<String, u64>,
    /// Number of frames in the whole recording. Known only at the end, and only if frames and events are read together.
    #[serde(skip)]
    pub frames: Option<u64>,
    /// The point at which the file ends, if it ends too early.
    pub truncated: Option<Truncation>,
}

impl ReadReport {
    /// `true` if with x and y exchanged all events would be inside the sensor.
    pub fn are_coordinates_exchanged(&self) -> bool {
        self.exchanged > 0 && self.exchanged == self.out_of_range
    }

    /// Describes everything that a user should know, as sentences.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        if self.sorted > 0 {
            let (events, largest) = (counted(self.sorted, "event is", "events are"), self.largest_delay);
            warnings.push(format!("{events} stored up to {largest} µs after later ones, and sorted by time"));
        }
        if self.steps_back > 0 {
            let (events, largest) = (counted(self.steps_back, "event is", "events are"), self.largest_step_back);
            warnings.push(format!(
                "{events} stored too late to be sorted, up to {largest} µs earlier than a previous event, and given its time"
            ));
        }
        if self.clock_resets > 0 {
            let times = counted(self.clock_resets, "time", "times");
            warnings.push(format!(
                "the clock of the recording was reset {times}: later times are shifted, to continue 1 s after the latest event"
            ));
        }
        warnings.extend(self.counter_wraps.as_ref().map(CounterWraps::to_string));
        if self.strays > 0 {
            let strays = counted(self.strays, "stray event is", "stray events are");
            warnings.push(format!("{strays} left out: more than 0.1 s away from neighbouring events"));
        }
        if self.out_of_range > 0 {
            let reason = if self.are_coordinates_exchanged() {
                "; with x and y exchanged all events would be inside".to_owned()
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
            warnings.push(format!("the file has space for {events}: was the recording stopped early?"));
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

/// Faults in the stream that a camera sends.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct StreamFaults {
    /// Places where bytes were lost.
    pub gaps: u64,
    /// Gaps after which the time was corrected by the computer's clock, because words that count time were lost.
    pub repaired_gaps: u64,
    /// Sum of these corrections, in microseconds.
    pub restored_us: u64,
    /// The corrections, in order.
    pub repaired_times: Vec<RepairedTimes>,
    /// Corrections that were too large and were undone at a later gap, in microseconds.
    pub taken_back_us: u64,
    /// Number of resets of the camera's clock, after its first time. Times continue 1 s after the latest.
    pub clock_resets: u64,
    /// Events that the camera dropped because the computer read too slowly, if the camera reported it.
    pub dropped: u64,
    /// Counts of words that a healthy camera does not send, by kind of fault.
    pub faults: BTreeMap<&'static str, u64>,
}

/// A correction of the times of a camera's stream after words that count time were lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct RepairedTimes {
    /// First corrected time in microseconds.
    pub from_us: i64,
    /// Amount added to this time and all later ones, in microseconds.
    pub restored_us: u64,
    /// Part of that amount that was too much, in microseconds. Times are late by it until a later gap.
    pub excess_us: u64,
}

/// Largest number of corrections that are listed one by one.
const REPAIRS_NAMED: usize = 10;

impl StreamFaults {
    /// Describes the faults as sentences.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if self.gaps > 0 {
            notes.push(format!("bytes of the stream were lost in {}", counted(self.gaps, "place", "places")));
        }
        if self.repaired_gaps > 0 {
            notes.push(format!(
                "in {} of them time was lost too: {:.3} s in all, according to the computer's clock",
                self.repaired_gaps,
                self.restored_us as f64 / 1e6
            ));
            let named = self.repaired_times.iter().take(REPAIRS_NAMED).map(|times| {
                let restored = times.restored_us as f64 / 1e3;
                let excess = match times.excess_us {
                    0 => String::new(),
                    excess => format!(" ({:.3} ms too much, until a later gap)", excess as f64 / 1e3),
                };
                format!("by {restored:.3} ms from {:.6} s on{excess}", times.from_us as f64 / 1e6)
            });
            let more = match self.repaired_times.len().saturating_sub(REPAIRS_NAMED) {
                0 => String::new(),
                more => format!(", and in {}", counted(more as u64, "more place", "more places")),
            };
            let named = named.collect::<Vec<_>>().join(", ");
            notes.push(format!("later times were corrected: {named}{more}"));
        }
        if self.taken_back_us > 0 {
            let taken_back = self.taken_back_us as f64 / 1e3;
            notes
                .push(format!("{taken_back:.3} ms of these corrections were too much, and were undone at a later gap"));
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

    /// Guards against "1 stray events" and "reset 1 times".
    #[test]
    fn a_count_of_one_is_written_in_the_singular() {
        let stream = StreamFaults { gaps: 1, dropped: 1, clock_resets: 1, ..StreamFaults::default() };
        let report = |count| ReadReport {
            sorted: count,
            largest_delay: 9,
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
                "1 event is stored up to 9 µs after later ones, and sorted by time",
                "1 event is stored too late to be sorted, up to 7 µs earlier than a previous event, and given its time",
                "the clock of the recording was reset 1 time: later times are shifted, to continue 1 s after the latest event",
                "the time counter wrapped 1 time, at event 7: times continue as if it had not",
                "1 stray event is left out: more than 0.1 s away from neighbouring events",
                "1 event lies outside the sensor and is left out; 1 of them has a column or row below 0 or beyond 32766",
                "the file has space for 1 more event that was never written: was the recording stopped early?",
                "1 damaged packet is left out",
                "bytes of the stream were lost in 1 place",
                "the camera dropped 1 event because the computer read too slowly",
                "the camera's clock was reset 1 time; later times are shifted",
            ]
        );
        let twice = report(2).warnings();
        assert_eq!(twice[3], "the time counter wrapped 2 times, first at event 7: times continue as if it had not");
        assert_eq!(twice[4], "2 stray events are left out: more than 0.1 s away from neighbouring events");
        assert_eq!(
            twice[5],
            "2 events lie outside the sensor and are left out; 2 of them have a column or row below 0 or beyond 32766"
        );
    }
}
