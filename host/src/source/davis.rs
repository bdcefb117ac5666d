//! Recordings of what a DAVIS346 sent over USB: `.dvraw` dumps, pcap and pcapng captures, and the
//! bare stream.
//!
//! Lost bytes and failed transfers are gaps: counted as damaged packets, and events go on behind
//! them.

pub mod dump;

use std::path::{Path, PathBuf};

use evcal_core::event::{Event, Polarity};
use usb_davis::capture::{Capture, CaptureError, CaptureFormat, sniff};
use usb_davis::protocol::{AnomalyKind, Decoder, Message, Polarity as WirePolarity};

use super::{Decode, Format, Head, ReadReport, SourceError, SourceErrorKind, SourceInformation, Truncation};

/// Dumps and captures, which begin with a mark.
pub const FORMAT: Format = Format {
    name: "DAVIS USB recording",
    recognise: |head| is(head, &[CaptureFormat::Dvraw, CaptureFormat::Packets]),
    open: |path, _| open(path, FORMAT.name),
    streams: |_| Ok(Vec::new()),
};

/// The stream alone, which can be told from other files only by its words.
pub const BARE_FORMAT: Format = Format {
    name: "bare DAVIS stream",
    recognise: |head| is(head, &[CaptureFormat::BarePayload]),
    open: |path, _| open(path, BARE_FORMAT.name),
    streams: |_| Ok(Vec::new()),
};

const BATCH: usize = 32_768;

fn is(head: &Head, formats: &[CaptureFormat]) -> bool {
    sniff(&head.bytes).is_some_and(|format| formats.contains(&format))
}

struct Transfers {
    path: PathBuf,
    capture: Capture,
    decoder: Decoder<Vec<u16>>,
    information: SourceInformation,
}

fn error(path: &Path, error: CaptureError) -> SourceError {
    match error {
        CaptureError::Io(error) => SourceError::io(path, error),
        error => SourceError::new(path, SourceErrorKind::Layout(error.to_string())),
    }
}

fn open(path: &Path, format: &'static str) -> Result<Box<dyn Decode>, SourceError> {
    let capture = Capture::open(path).map_err(|reason| error(path, reason))?;
    let header = capture.header();
    let decoder = header.decoder();
    let mut notes = Vec::new();
    if header.registers.is_empty() {
        notes.push("the recording does not hold the camera's registers: taken for a DAVIS346".to_owned());
    }
    let information = SourceInformation {
        format,
        sensor: Some(decoder.layout().dvs.size()),
        camera_name: header.identity.is_some().then(|| header.camera_name()),
        notes,
    };
    Ok(Box::new(Transfers { path: path.to_owned(), capture, decoder, information }))
}

impl Decode for Transfers {
    fn information(&self) -> &SourceInformation {
        &self.information
    }

    fn decode(&mut self, batch: &mut Vec<Event>, report: &mut ReadReport) -> Result<bool, SourceError> {
        let mut take = |message: Message<'_>| match message {
            Message::Events(events) => batch.extend(events.iter().map(|event| Event {
                t: i64::try_from(event.time).unwrap_or(i64::MAX),
                x: event.x,
                y: event.y,
                polarity: match event.polarity {
                    WirePolarity::Off => Polarity::Off,
                    WirePolarity::On => Polarity::On,
                },
            })),
            Message::Frame(_) => *report.other_packets.entry("frames".to_owned()).or_default() += 1,
            Message::Imu(_) => *report.other_packets.entry("inertial samples".to_owned()).or_default() += 1,
            Message::Signal(_) => *report.other_packets.entry("signals".to_owned()).or_default() += 1,
            Message::Anomaly(anomaly) if anomaly.kind == AnomalyKind::Gap => report.damaged_packets += 1,
            Message::Anomaly(_) | Message::TimestampReset { .. } => {}
        };
        let before = self.decoder.counts().events;
        loop {
            let more =
                self.capture.decode_next(&mut self.decoder, &mut take).map_err(|reason| error(&self.path, reason))?;
            if !more {
                break;
            }
            if self.decoder.counts().events - before >= BATCH as u64 {
                return Ok(true);
            }
        }
        let unfinished = self.capture.damage().unfinished;
        if unfinished > 0 {
            let byte = std::fs::metadata(&self.path).map_or(0, |file| file.len()).saturating_sub(unfinished);
            report.truncated = Some(Truncation { byte, lost: "a transfer is incomplete".to_owned() });
        }
        Ok(false)
    }
}

#[cfg(test)]
mod tests {
    use usb_davis::dump::{Compression, DumpHeader, DumpWriter, Transfer, TransferStatus};
    use usb_davis::protocol::{Encoder, Layout, PolarityEvent};

    use super::*;
    use crate::source::{Recording, SourceOptions};

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
            let recording = Recording::new(&path, SourceOptions::default()).expect("it is known");
            assert_eq!(recording.format(), format);
            let mut reader = recording.open().expect("it can be read");
            assert_eq!(reader.information().sensor, Some((346, 260)));
            let (mut events, mut batch) = (Vec::new(), Vec::new());
            while reader.next_batch(&mut batch).expect("it is whole") {
                events.extend_from_slice(&batch);
            }
            assert_eq!(events, expected);
            assert_eq!(reader.report().damaged_packets, 0);
        }
    }
}
