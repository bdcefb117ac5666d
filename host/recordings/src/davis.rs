//! Recordings of the USB stream of a DAVIS346: `.dvraw` dumps, pcap and pcapng captures, and the bare stream.
//!
//! Lost bytes and failed transfers are gaps. They are counted, events continue after them, and the time is corrected by
//! the computer's clock. After a reset of the camera's clock, times continue 1 s after the latest one.

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

use super::date::date;
use crate::error::{RecordingError, RecordingErrorKind};
use crate::format::{FileFormat, Head, OpenResult, StreamSummary, Uses};
use crate::options::{FormatOption, RecordingOptions};
use crate::read_report::ReadReport;
use crate::reader::{Decode, Opened, RecordingInformation};
pub use dump_sink::OUTPUT;

/// Dumps and captures, which are recognised by their first bytes.
pub const FORMAT: FileFormat = FileFormat {
    name: "DAVIS USB recording",
    recognise: |head| is(head, &[CaptureFormat::Dvraw, CaptureFormat::Packets]),
    events: |path, options| open(path, options, FORMAT.name),
    files: |path| vec![path.to_owned()],
    streams: summarise,
    frames: Some(extras::items),
    extras: Some(extras::open),
    transfers: Some(|path, options| Capture::open_device(path, options.device)),
    output: Some(&dump_sink::OUTPUT),
    uses: Uses { device: true, growth: true, ..Uses::NONE },
};

/// The bare stream, which is recognised only by its words.
pub const BARE_FORMAT: FileFormat = FileFormat {
    name: "bare DAVIS stream",
    recognise: |head| is(head, &[CaptureFormat::BarePayload]),
    events: |path, options| open(path, options, BARE_FORMAT.name),
    output: None,
    uses: Uses::NONE,
    ..FORMAT
};

const BATCH: usize = 32_768;

/// Names of the content other than events.
const FRAMES: &str = "frames";
const INERTIAL: &str = "IMU samples";
const SIGNALS: &str = "signals";

fn is(head: &Head, formats: &[CaptureFormat]) -> bool {
    sniff(&head.bytes).is_some_and(|format| formats.contains(&format))
}

struct Transfers {
    messages: Messages,
    /// Number of events from which a batch is returned.
    batch: usize,
}

fn open(path: &Path, options: &RecordingOptions, format: &'static str) -> OpenResult {
    // A dump contains a single camera.
    if options.device.is_some() && options.growth.is_none() && is(&Head::read(path)?, &[CaptureFormat::Dvraw]) {
        let kind = RecordingErrorKind::NoEffect { option: FormatOption::Device, format: "dump of one camera" };
        return Err(RecordingError::new(path, kind));
    }
    let (messages, batch) = match &options.growth {
        // Events appear with their transfer.
        Some(growth) => (Messages::follow(path, growth)?, 1),
        None => (Messages::open(path, options.device)?, BATCH),
    };
    let header = messages.header();
    let mut notes = Vec::new();
    if header.registers.is_empty() {
        notes.push("the recording does not contain the camera's registers: assumed a DAVIS346".to_owned());
    }
    let information = RecordingInformation {
        format,
        sensor: Some(header.registers.layout().dvs.size().into()),
        camera_name: header.identity.is_some().then(|| header.camera_name()),
        began: i64::try_from(header.start_unix_ns / 1000).ok().and_then(date),
        notes,
    };
    Ok(Opened::new(information, Transfers { messages, batch }))
}

impl Decode for Transfers {
    fn decode(&mut self, batch: &mut Vec<Event>, report: &mut ReadReport) -> Result<bool, RecordingError> {
        let mut more = Ok(true);
        while matches!(more, Ok(true)) && batch.len() < self.batch {
            more = self.messages.next(|message, shift| {
                if let Message::Events(events) = message {
                    batch.extend(events.iter().map(|wire| event(wire, shift)));
                }
            });
        }
        // Also reports what precedes damage.
        self.messages.report(report);
        more
    }

    fn done(&self) -> Option<f64> {
        self.messages.done()
    }
}

/// Counts the content of the stream by kind.
fn summarise(path: &Path, options: &RecordingOptions) -> Result<Vec<StreamSummary>, RecordingError> {
    let mut messages = Messages::open(path, options.device)?;
    let names = ["events", FRAMES, INERTIAL, SIGNALS];
    let mut summaries = names.map(|name| StreamSummary::new(name.to_owned()));
    let mut more = true;
    while more {
        let mut met = [false; 4];
        more = messages.next_whole(|message, shift| {
            let time = |time: u64| i64::try_from(time).unwrap_or(i64::MAX).saturating_add(shift);
            let (index, count, first, last) = match message {
                Message::Events(events) => {
                    let Some((first, last)) = events.first().zip(events.last()) else { return };
                    (0, events.len() as u64, first.time, last.time)
                }
                Message::Frame(frame) => (1, 1, frame.start, frame.start),
                Message::Imu(sample) => (2, 1, sample.time, sample.time),
                Message::Signal(signal) => (3, 1, signal.time, signal.time),
                _ => return,
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
    use usb_davis::capture::DeviceAddress;
    use usb_davis::dump::{Compression, DumpHeader, DumpWriter, Transfer, TransferStatus};
    use usb_davis::protocol::{Encoder, Layout, Polarity as WirePolarity, PolarityEvent};

    use evcal_core::sensor::Sensor;

    use super::*;
    use crate::{Recording, RepairedTimes};

    #[test]
    fn events_are_read_back_from_dumps_and_bare_streams() {
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
            assert_eq!((reader.report().damaged_packets, reader.report().frames), (0, Some(0)));
        }
    }

    #[test]
    fn corrected_times_are_listed() {
        let mut encoder = Encoder::new(Layout::DAVIS346);
        let mut dump = DumpWriter::new(Vec::new(), &DumpHeader::default(), Compression::None).expect("a vector");
        // After a restart of the clock there is one transfer every millisecond; the transfers of 0.1 s are lost.
        let mut reset = Vec::new();
        encoder
            .event(&PolarityEvent { time: 5, x: 1, y: 2, polarity: WirePolarity::On }, &mut reset)
            .expect("in order");
        encoder.timestamp_reset(&mut reset);
        let mut transfer = |milliseconds: u64, gap_before, payload: &[u8]| {
            let (host_ns, status) = (Some(milliseconds * 1_000_000), TransferStatus::Completed);
            dump.transfer(&Transfer { host_ns, gap_before, status, payload }).expect("a vector");
        };
        transfer(0, false, &reset);
        for milliseconds in 1..1000 {
            let mut payload = Vec::new();
            let time = milliseconds * 1000;
            let event = PolarityEvent { time, x: 1, y: 2, polarity: WirePolarity::On };
            encoder.event(&event, &mut payload).expect("in order");
            if !(500..600).contains(&milliseconds) {
                transfer(milliseconds, milliseconds == 600, &payload);
            }
        }
        let directory = tempfile::tempdir().expect("a directory can be made");
        let path = directory.path().join("gap.dvraw");
        std::fs::write(&path, dump.finish().expect("a vector")).expect("it can be written");
        let mut reader = Recording::new(&path, RecordingOptions::default()).expect("known").open().expect("readable");
        let (mut batch, mut last) = (Vec::new(), 0);
        while reader.next_batch(&mut batch).expect("it is whole") {
            last = batch.last().map_or(last, |event| event.t);
        }
        // Times continue 1 s after the 5 us before the restart.
        assert_eq!(last, 1_000_005 + 999_000);
        let stream = &reader.report().stream;
        let wraps = 600_000 / 32_768 - 499_000 / 32_768;
        let repaired = RepairedTimes { from_us: 1_000_005 + 600_000, restored_us: wraps * 32_768, excess_us: 0 };
        assert_eq!((stream.gaps, &stream.repaired_times[..]), (1, &[repaired][..]));
        let notes = stream.notes().join("\n");
        assert!(notes.contains("later times were corrected: by 98.304 ms from 1.600005 s on"), "{notes}");
    }

    /// Returns a pcap file of usbmon with one completed transfer from endpoint 0x82 of each device on bus 2.
    fn pcap(transfers: &[(u8, &[u8])]) -> Vec<u8> {
        let mut file = [0xA1B2_C3D4u32, 0x0004_0002, 0, 0, 1 << 18, 220].map(u32::to_le_bytes).concat();
        for (device, payload) in transfers {
            let length = payload.len() as u32;
            file.extend([1000, 0, 64 + length, 64 + length].map(u32::to_le_bytes).concat());
            let mut header = [0; 64];
            header[8..16].copy_from_slice(&[b'C', 3, 0x82, *device, 2, 0, b'-', 0]);
            header[32..36].copy_from_slice(&length.to_le_bytes());
            header[36..40].copy_from_slice(&length.to_le_bytes());
            file.extend(header);
            file.extend(*payload);
        }
        file
    }

    #[test]
    fn one_of_several_cameras_in_a_capture_can_be_chosen() {
        let directory = tempfile::tempdir().expect("a directory can be made");
        let path = directory.path().join("two.pcap");
        std::fs::write(&path, pcap(&[(4, &one_event(44)), (5, &one_event(55))])).expect("it can be written");
        let open = |device| {
            let options = RecordingOptions { device, ..RecordingOptions::default() };
            Recording::new(&path, options).expect("it is known")
        };
        let error = open(None).open().map(|_| ()).expect_err("which one is not said").to_string();
        assert!(error.contains("2.4, 2.5") && error.contains("may be the camera"), "{error}");
        for (device, x) in [(4, 44), (5, 55)] {
            let recording = open(Some(DeviceAddress { bus: 2, device }));
            let mut batch = Vec::new();
            recording.open().expect("it can be read").next_batch(&mut batch).expect("it is whole");
            assert_eq!(batch.iter().map(|event| event.x).collect::<Vec<_>>(), [x]);
            let streams = recording.streams().expect("it can be read");
            assert_eq!(streams.iter().map(|stream| stream.elements).sum::<u64>(), 1);
        }
    }

    fn one_event(x: u16) -> Vec<u8> {
        let mut bytes = Vec::new();
        let event = PolarityEvent { time: 5, x, y: 2, polarity: WirePolarity::On };
        Encoder::new(Layout::DAVIS346).event(&event, &mut bytes).expect("in order");
        bytes
    }

    #[test]
    fn events_before_damage_in_a_capture_are_read_and_the_damage_is_reported() {
        let directory = tempfile::tempdir().expect("a directory can be made");
        let path = directory.path().join("damaged.pcap");
        let good = pcap(&[(4, &one_event(44))]);
        // A packet with an impossible length, then a good one.
        let damage = [1000, 0, 0x7FFF_FFFFu32, 64].map(u32::to_le_bytes).concat();
        let behind = pcap(&[(4, &one_event(55))]).split_off(24);
        std::fs::write(&path, [good.clone(), damage, behind].concat()).expect("it can be written");
        let recording = Recording::new(&path, RecordingOptions::default()).expect("it is known");
        let (mut reader, mut batch) = (recording.open().expect("it can be read"), Vec::new());
        assert!(reader.next_batch(&mut batch).expect("the events before it"));
        assert_eq!(batch.iter().map(|event| event.x).collect::<Vec<_>>(), [44]);
        match reader.next_batch(&mut batch).expect_err("it is damaged").kind {
            RecordingErrorKind::Damaged { byte, what, .. } => {
                assert_eq!((byte, &what[..]), (good.len() as u64, "a packet of 2147483647 bytes"));
            }
            other => panic!("{other}"),
        }
        let streams = recording.streams().expect("what is before it");
        assert_eq!(streams.iter().map(|stream| stream.elements).sum::<u64>(), 1);
        assert!(extras::open(&path, &RecordingOptions::default()).is_ok());
    }

    #[test]
    fn a_capture_may_be_cut_off_within_its_last_packet() {
        let directory = tempfile::tempdir().expect("a directory can be made");
        let path = directory.path().join("cut.pcap");
        let begins = pcap(&[(4, &one_event(44))]).len();
        let whole = pcap(&[(4, &one_event(44)), (4, &one_event(55))]);
        for length in [begins + 1, begins + 40, whole.len() - 1] {
            std::fs::write(&path, &whole[..length]).expect("it can be written");
            let recording = Recording::new(&path, RecordingOptions::default()).expect("it is known");
            let (mut reader, mut batch) = (recording.open().expect("it can be read"), Vec::new());
            while reader.next_batch(&mut batch).expect("it is not damaged") {}
            assert_eq!(reader.report().truncated.as_ref().map(|cut| cut.byte), Some(begins as u64));
        }
    }
}
