//! Recordings as what an emulated DAVIS346 sends.
//!
//! A recording of USB transfers is sent as it is, with its frames, samples and faults. The events of
//! any other are encoded as the camera would have; time counts from the first.
//!
//! A thread of its own reads ahead, so that a slow disk does not delay the camera.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, SyncSender};
use std::thread;

use usb_davis::capture::CaptureError;
use usb_davis::dump::{DumpHeader, Identity};
use usb_davis::emulator::{CapturePieces, Piece, default_registers};
use usb_davis::protocol::{EncodeError, Encoder, Layout};
use usb_davis::{PRODUCT_ID, VENDOR_ID};

use evcal_core::sensor::Sensor;
use event_recordings::davis::wire_event;
use event_recordings::{OpenTransfers, Recording, RecordingError, RecordingOptions};

/// Pieces that are read ahead.
const AHEAD: usize = 64;
/// An encoded piece ends with this many bytes or after this time in microseconds.
const PIECE_BYTES: usize = 4096;
const PIECE_TIME: u64 = 1000;
/// Serial number of a camera whose recording names none.
const SERIAL: &str = "00000000";
/// Firmware of a camera whose recording names none.
const FIRMWARE: u16 = 6;

/// Why a recording cannot be played.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PlaybackError {
    /// It cannot be read.
    #[error("{0}")]
    Recording(#[from] RecordingError),
    /// Its transfers cannot be read.
    #[error("{}: {}", .0.display(), .1)]
    Capture(PathBuf, CaptureError),
    /// It comes from a larger sensor: width and height in pixels.
    #[error("{}: its sensor has {}x{} pixels; the emulated DAVIS346 has 346x260", .0.display(), .1.width, .1.height)]
    Sensor(PathBuf, Sensor),
    /// One of its events cannot be sent: its number, from 0.
    #[error("{}: event {} cannot be sent by a DAVIS346: {}", .0.display(), .1, .2)]
    Event(PathBuf, u64, EncodeError),
}

/// A recording to be played, any number of times.
#[derive(Clone)]
pub struct Playback {
    path: PathBuf,
    content: Content,
    header: DumpHeader,
}

#[derive(Clone)]
enum Content {
    Transfers(OpenTransfers, RecordingOptions),
    Events(Recording),
}

/// What a play sends.
pub type Pieces = mpsc::IntoIter<Piece>;

impl Playback {
    /// Looks at the recording at `path`.
    ///
    /// # Errors
    /// When it cannot be read, or comes from a sensor larger than that of a DAVIS346.
    pub fn open(path: &Path, options: RecordingOptions) -> Result<Self, PlaybackError> {
        let recording = Recording::new(path, options)?;
        if let Some(open) = recording.format().transfers {
            let options = recording.options();
            let capture = open(path, options).map_err(|error| PlaybackError::Capture(path.to_owned(), error))?;
            let header = capture.header().clone();
            return Ok(Self { path: path.to_owned(), content: Content::Transfers(open, options.clone()), header });
        }
        let reader = recording.open()?;
        let information = reader.information();
        let (width, height) = Layout::DAVIS346.dvs.size();
        if let Some(sensor) = information.sensor
            && (sensor.width > width || sensor.height > height)
        {
            return Err(PlaybackError::Sensor(path.to_owned(), sensor));
        }
        let serial = information.camera_name.as_deref().and_then(|name| name.strip_prefix("DAVIS346_"));
        let serial = serial.unwrap_or(SERIAL).to_owned();
        let identity = Identity { vendor_id: VENDOR_ID, product_id: PRODUCT_ID, device_version: FIRMWARE, serial };
        let header = DumpHeader { identity: Some(identity), registers: default_registers(), ..DumpHeader::default() };
        Ok(Self { path: path.to_owned(), content: Content::Events(recording), header })
    }

    /// What the recording says of its camera.
    pub fn header(&self) -> &DumpHeader {
        &self.header
    }

    /// Serial number of the camera.
    pub fn serial(&self) -> &str {
        self.header.identity.as_ref().map_or(SERIAL, |identity| &identity.serial)
    }

    /// Starts a play with each call, for [`usb_davis::emulator::Model::new`]. What ends a play too
    /// early comes out of the receiver.
    pub fn plays(self) -> (impl FnMut() -> Pieces + Send + 'static, Receiver<PlaybackError>) {
        let (errors, failures) = mpsc::channel();
        let play = move || {
            let (sender, pieces) = mpsc::sync_channel(AHEAD);
            let (playback, errors) = (self.clone(), errors.clone());
            thread::spawn(move || {
                if let Err(error) = playback.play(&sender) {
                    // Who does not listen need not know.
                    let _ = errors.send(error);
                }
            });
            pieces.into_iter()
        };
        (play, failures)
    }

    /// Reads the recording to its end, or until nobody takes the pieces.
    fn play(&self, pieces: &SyncSender<Piece>) -> Result<(), PlaybackError> {
        match &self.content {
            Content::Transfers(open, options) => {
                let unreadable = |error| PlaybackError::Capture(self.path.clone(), error);
                for piece in CapturePieces::new(open(&self.path, options).map_err(unreadable)?) {
                    let piece = piece.map_err(unreadable)?;
                    if pieces.send(piece).is_err() {
                        break;
                    }
                }
                Ok(())
            }
            Content::Events(recording) => play_events(recording, pieces),
        }
    }
}

fn play_events(recording: &Recording, pieces: &SyncSender<Piece>) -> Result<(), PlaybackError> {
    let mut reader = recording.open()?;
    let mut encoder = Encoder::new(Layout::DAVIS346);
    let (mut batch, mut number, mut start) = (Vec::new(), 0, None);
    let (mut bytes, mut began) = (Vec::new(), 0);
    while reader.next_batch(&mut batch)? {
        for event in &batch {
            // Readers hand out events in order of time.
            let time = event.t.abs_diff(*start.get_or_insert(event.t));
            if bytes.len() >= PIECE_BYTES || (time - began >= PIECE_TIME && !bytes.is_empty()) {
                let piece = Piece { time: encoder.time(), bytes: std::mem::take(&mut bytes) };
                if pieces.send(piece).is_err() {
                    return Ok(());
                }
            }
            if bytes.is_empty() {
                began = time;
            }
            encoder
                .event(&wire_event(event, time), &mut bytes)
                .map_err(|error| PlaybackError::Event(recording.path().to_owned(), number, error))?;
            number += 1;
        }
    }
    // That nobody takes it is no error.
    let _ = pieces.send(Piece { time: encoder.time(), bytes });
    Ok(())
}

#[cfg(test)]
mod tests {
    use evcal_core::event::{Event, Polarity};
    use usb_davis::dump::{Compression, DumpWriter, Transfer, TransferStatus};
    use usb_davis::protocol::{Decoder, Message, Polarity as WirePolarity};

    use super::*;
    use event_recordings::text;
    use event_recordings::write::EventWriter;

    fn events(count: i64) -> Vec<Event> {
        let event = |index: i64| Event {
            t: 1_643_243_628_737_093 + index * 37 + index / 1000 * 100_000,
            x: (index * 37 % 346) as u16,
            y: (index * 91 % 260) as u16,
            polarity: if index % 3 == 0 { Polarity::On } else { Polarity::Off },
        };
        (0..count).map(event).collect()
    }

    fn pieces(path: &Path) -> Vec<Piece> {
        let (mut play, failures) = Playback::open(path, RecordingOptions::default()).unwrap().plays();
        let pieces: Vec<Piece> = play().collect();
        assert_eq!(play().collect::<Vec<_>>(), pieces);
        assert!(failures.try_recv().is_err());
        pieces
    }

    #[test]
    fn events_of_a_file_are_what_a_camera_sends() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("events.csv");
        let events = events(20_000);
        let mut writer = EventWriter::create(&path, text::OUTPUT, Sensor::new(346, 260), "").unwrap();
        writer.write(&events).unwrap();
        writer.finish().unwrap();
        let pieces = pieces(&path);
        let mut decoder = Decoder::new(Layout::DAVIS346);
        let mut received = Vec::new();
        for piece in &pieces {
            assert!(piece.bytes.len() <= PIECE_BYTES + 8);
            decoder.decode(&piece.bytes, |message| match message {
                Message::Events(events) => received.extend_from_slice(events),
                other => panic!("{other:?}"),
            });
            assert_eq!(decoder.time(), piece.time);
        }
        assert_eq!(received.len(), events.len());
        for (received, event) in received.iter().zip(&events) {
            let time = (event.t - events[0].t) as u64;
            assert_eq!((received.time, received.x, received.y), (time, event.x, event.y));
            assert_eq!(received.polarity == WirePolarity::On, event.polarity == Polarity::On);
        }
    }

    #[test]
    fn transfers_are_sent_as_they_were() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("session.dvraw");
        let identity = Identity { vendor_id: 0x152A, product_id: 0x841A, device_version: 7, serial: "0042".to_owned() };
        let header = DumpHeader::new(Some(identity), default_registers());
        let mut dump = DumpWriter::new(Vec::new(), &header, Compression::Zstd(1)).unwrap();
        // Among them words that no camera sends.
        let payload: Vec<u8> = (0..100_001).map(|index| (index * 7 % 251) as u8).collect();
        for (host_ns, payload) in (1u64..).zip(payload.chunks(33_333)) {
            let transfer = Transfer {
                host_ns: Some(host_ns * 1_000_000),
                gap_before: false,
                status: TransferStatus::Completed,
                payload,
            };
            dump.transfer(&transfer).unwrap();
        }
        std::fs::write(&path, dump.finish().unwrap()).unwrap();
        let playback = Playback::open(&path, RecordingOptions::default()).unwrap();
        assert_eq!((playback.serial(), playback.header()), ("0042", &header));
        let sent: Vec<u8> = pieces(&path).into_iter().flat_map(|piece| piece.bytes).collect();
        assert_eq!(sent, payload);
    }

    #[test]
    fn what_a_davis346_cannot_send_is_refused_with_a_reason() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("large.csv");
        let large = [Event { t: 0, x: 639, y: 479, polarity: Polarity::On }];
        let mut writer = EventWriter::create(&path, text::OUTPUT, Sensor::new(640, 480), "").unwrap();
        writer.write(&large).unwrap();
        writer.finish().unwrap();
        let error = Playback::open(&path, RecordingOptions::default()).err().unwrap().to_string();
        assert!(error.contains("640x480") && error.contains("large.csv"), "{error}");
        std::fs::write(&path, "0 1 1 1\n10 2 2 0\n20 400 3 1\n").unwrap();
        let (mut play, failures) = Playback::open(&path, RecordingOptions::default()).unwrap().plays();
        assert_eq!(play().count(), 0);
        let error = failures.recv().unwrap().to_string();
        assert!(error.contains("event 2") && error.contains("(400, 3)"), "{error}");
    }
}
