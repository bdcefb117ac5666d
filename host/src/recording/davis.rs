//! Recordings of what a DAVIS346 sent over USB: `.dvraw` dumps, pcap and pcapng captures, and the
//! bare stream.
//!
//! Lost bytes and failed transfers are gaps: they are counted, events go on behind them, and the time
//! is put right by the computer's clock. Where the camera's clock was reset, times go on 1 s after the
//! latest one.

pub mod dump;
mod dump_sink;
mod extras;
mod messages;
mod transfers;

use std::path::Path;

use evcal_core::event::Event;
pub use messages::Messages;
pub use messages::{CameraClock, event};
use usb_davis::capture::{Capture, CaptureFormat, sniff};
use usb_davis::protocol::Message;

use super::extras::ReadExtras;
use super::{
    Decode, FileFormat, Head, ReadReport, RecordingError, RecordingInformation, RecordingOptions, StreamSummary,
};
pub use dump_sink::OUTPUT;

/// Dumps and captures, which begin with a mark.
pub const FORMAT: FileFormat = FileFormat {
    name: "DAVIS USB recording",
    recognise: |head| is(head, &[CaptureFormat::Dvraw, CaptureFormat::Packets]),
    events: |path, _| open(path, FORMAT.name),
    streams: |path, _| summarise(path),
    frames: Some(|path, _, visit| extras::visit_frames(path, visit)),
    extras: Some(open_extras),
    transfers: Some(|path| Capture::open(path)),
    output: Some(&dump_sink::OUTPUT),
};

/// The stream alone, which can be told from other files only by its words.
pub const BARE_FORMAT: FileFormat = FileFormat {
    name: "bare DAVIS stream",
    recognise: |head| is(head, &[CaptureFormat::BarePayload]),
    events: |path, _| open(path, BARE_FORMAT.name),
    output: None,
    ..FORMAT
};

const BATCH: usize = 32_768;

/// Names of what there is beside events.
const FRAMES: &str = "frames";
const INERTIAL: &str = "inertial samples";
const SIGNALS: &str = "signals";

fn is(head: &Head, formats: &[CaptureFormat]) -> bool {
    sniff(&head.bytes).is_some_and(|format| formats.contains(&format))
}

fn open_extras(path: &Path, _: &RecordingOptions) -> Result<Box<dyn ReadExtras>, RecordingError> {
    Ok(Box::new(extras::CameraExtras::open(path)?))
}

struct Transfers {
    messages: Messages,
    information: RecordingInformation,
}

fn open(path: &Path, format: &'static str) -> Result<Box<dyn Decode>, RecordingError> {
    let messages = Messages::open(path)?;
    let header = messages.header();
    let mut notes = Vec::new();
    if header.registers.is_empty() {
        notes.push("the recording does not hold the camera's registers: taken for a DAVIS346".to_owned());
    }
    let information = RecordingInformation {
        format,
        sensor: Some(header.registers.layout().dvs.size().into()),
        camera_name: header.identity.is_some().then(|| header.camera_name()),
        notes,
    };
    Ok(Box::new(Transfers { messages, information }))
}

impl Decode for Transfers {
    fn information(&self) -> &RecordingInformation {
        &self.information
    }

    fn decode(&mut self, batch: &mut Vec<Event>, report: &mut ReadReport) -> Result<bool, RecordingError> {
        let mut more = true;
        while more && batch.len() < BATCH {
            more = self.messages.next(|message, shift| {
                if let Message::Events(events) = message {
                    batch.extend(events.iter().map(|wire| event(wire, shift)));
                }
            })?;
        }
        self.messages.report(report);
        Ok(more)
    }
}

/// Counts what the stream holds.
fn summarise(path: &Path) -> Result<Vec<StreamSummary>, RecordingError> {
    let mut messages = Messages::open(path)?;
    let names = ["events", FRAMES, INERTIAL, SIGNALS];
    let mut summaries =
        names.map(|name| StreamSummary { name: name.to_owned(), packets: 0, elements: 0, times_us: None });
    let mut more = true;
    while more {
        let mut met = [false; 4];
        more = messages.next(|message, shift| {
            let time = |time: u64| i64::try_from(time).unwrap_or(i64::MAX).saturating_add(shift);
            let (index, count, first, last) = match message {
                Message::Events(events) => {
                    let Some((first, last)) = events.first().zip(events.last()) else { return };
                    (0, events.len() as u64, first.time, last.time)
                }
                Message::Frame(frame) => (1, 1, frame.start, frame.start),
                Message::Imu(sample) => (2, 1, sample.time, sample.time),
                Message::Signal(signal) => (3, 1, signal.time, signal.time),
                Message::Anomaly(_) | Message::TimestampReset { .. } => return,
            };
            if let (Some(summary), Some(met)) = (summaries.get_mut(index), met.get_mut(index)) {
                summary.packets += u64::from(!std::mem::replace(met, true));
                summary.elements += count;
                summary.times_us = Some((summary.times_us.map_or(time(first), |times| times.0), time(last)));
            }
        })?;
    }
    Ok(summaries.into())
}

#[cfg(test)]
mod tests {
    use evcal_core::event::Polarity;
    use usb_davis::dump::{Compression, DumpHeader, DumpWriter, Transfer, TransferStatus};
    use usb_davis::protocol::{Encoder, Layout, Polarity as WirePolarity, PolarityEvent};

    use evcal_core::sensor::Sensor;

    use super::*;
    use crate::recording::{Recording, RecordingOptions};

    #[test]
    fn dumps_and_bare_streams_give_the_events_they_were_made_of() {
        let mut encoder = Encoder::new(Layout::DAVIS346);
        let mut bytes = Vec::new();
        let expected: Vec<Event> = (0..100_000u32)
            .map(|index| {
                let (x, y) = ((index * 7 % 346) as u16, (index * 11 % 260) as u16);
                let event = PolarityEvent { time: u64::from(index) * 3, x, y, polarity: WirePolarity::On };
                encoder.event(&event, &mut bytes).expect("in order");
                Event { t: i64::from(index) * 3, x, y, polarity: Polarity::On }
            })
            .collect();
        let mut dump = DumpWriter::new(Vec::new(), &DumpHeader::default(), Compression::Zstd(1)).expect("a vector");
        for payload in bytes.chunks(8191) {
            let status = TransferStatus::Completed;
            let transfer = Transfer { host_ns: Some(0), gap_before: false, status, payload };
            dump.transfer(&transfer).expect("a vector takes it");
        }
        let dump = dump.finish().expect("a vector takes it");
        let directory = tempfile::tempdir().expect("a directory can be made");
        for (content, format) in [(dump, FORMAT.name), (bytes, BARE_FORMAT.name)] {
            let path = directory.path().join("recording");
            std::fs::write(&path, content).expect("it can be written");
            let recording = Recording::new(&path, RecordingOptions::default()).expect("it is known");
            assert_eq!(recording.format().name, format);
            let mut reader = recording.open().expect("it can be read");
            assert_eq!(reader.information().sensor, Some(Sensor::new(346, 260)));
            let (mut events, mut batch) = (Vec::new(), Vec::new());
            while reader.next_batch(&mut batch).expect("it is whole") {
                events.extend_from_slice(&batch);
            }
            assert_eq!(events, expected);
            assert_eq!(reader.report().damaged_packets, 0);
        }
    }
}
