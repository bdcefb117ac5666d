//! A recording without a file: events in memory, for example from an array of another program.

use std::path::Path;
use std::sync::Arc;

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;

use super::bytes::share;
use super::format::FileFormat;
use crate::error::{RecordingError, RecordingErrorKind};
use crate::read_report::ReadReport;
use crate::reader::{Decode, Opened, RecordingInformation};

/// Number of events per batch.
const BATCH: usize = 1 << 16;

/// Format of events in memory. It matches no file: [`Recording::open`](super::Recording::open) uses [`MemoryDecoder`]
/// instead.
pub const FORMAT: FileFormat = FileFormat::of_events(
    "events in memory",
    |_| false,
    |path: &Path, _| Err(RecordingError::new(path, RecordingErrorKind::NotAFile)),
);

/// Decoder of events in memory.
pub struct MemoryDecoder {
    events: Arc<Vec<Event>>,
    next: usize,
}

impl MemoryDecoder {
    /// Starts at the first of `events`. `sensor` is their sensor, if known.
    pub fn open(events: Arc<Vec<Event>>, sensor: Option<Sensor>) -> Opened {
        let information = RecordingInformation { format: FORMAT.name, sensor, ..RecordingInformation::default() };
        Opened::new(information, Self { events, next: 0 })
    }
}

impl Decode for MemoryDecoder {
    fn decode(&mut self, batch: &mut Vec<Event>, _: &mut ReadReport) -> Result<bool, RecordingError> {
        let rest = self.events.get(self.next..).unwrap_or_default();
        let events = rest.get(..BATCH).unwrap_or(rest);
        batch.extend_from_slice(events);
        self.next += events.len();
        Ok(self.next < self.events.len())
    }

    fn done(&self) -> Option<f64> {
        Some(share(self.next as u64, self.events.len() as u64))
    }
}

#[cfg(test)]
mod tests {
    use evcal_core::event::Polarity;

    use super::*;
    use crate::{Recording, RecordingOptions};

    fn event(t: i64, x: u16) -> Event {
        Event { t, x, y: 1, polarity: Polarity::On }
    }

    #[test]
    fn events_in_memory_can_be_read_again_and_pass_the_same_checks() {
        let mut events: Vec<Event> = (0..BATCH as i64 + 10).map(|index| event(100 + index, 3)).collect();
        // A step back, and a pixel outside the sensor.
        events[5].t -= 3;
        events[7].x = 20;
        let sensor = Some(Sensor::new(20, 10));
        let recording = Recording::from_events("array", events, RecordingOptions { sensor, ..Default::default() });
        for _ in 0..2 {
            let mut reader = recording.open().unwrap();
            let (mut all, mut batch) = (Vec::new(), Vec::new());
            while reader.next_batch(&mut batch).unwrap() {
                all.extend_from_slice(&batch);
            }
            assert_eq!(all.len(), BATCH + 9);
            assert_eq!((all[5].t, all[6].t, all[7].t), (104, 106, 108));
            assert_eq!((reader.report().sorted, reader.report().out_of_range), (1, 1));
            assert_eq!(reader.information().sensor, sensor);
        }
        let part = recording.section(110..120);
        let mut batch = Vec::new();
        assert!(part.open().unwrap().next_batch(&mut batch).unwrap());
        assert_eq!(batch.len(), 10);
        assert!(!recording.may_contain_frames() && recording.streams().unwrap().is_empty());
    }

    #[test]
    fn an_empty_list_is_not_an_error() {
        let recording = Recording::from_events("array", Vec::new(), RecordingOptions::default());
        assert!(!recording.open().unwrap().next_batch(&mut Vec::new()).unwrap());
    }
}
