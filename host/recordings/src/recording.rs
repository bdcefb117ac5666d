//! [`Recording`]: a source of events that can be read several times.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;
use usb_davis::dump::Growth;

use crate::chain::{ChainDecoder, OpenFile};
use crate::doubtful_unit::{impossible_rate, note_correction};
use crate::error::{RecordingError, RecordingErrorKind};
use crate::extras::Extras;
use crate::files::Files;
use crate::format::{FileFormat, HEAD_LENGTH, OpenResult, StreamSummary};
use crate::formats::format_of;
use crate::memory::{self, MemoryDecoder};
use crate::options::{RecordingOptions, TimeUnit};
use crate::pictures::{TimedImage, visit_frames};
use crate::reader::EventReader;
use crate::ros;

/// Longest wait for the first [`HEAD_LENGTH`] bytes of a recording that is still being written.
const BEGINNING: Duration = Duration::from_secs(1);

/// A recording, in a file or in memory. Its events can be read as often as needed.
#[derive(Clone)]
pub struct Recording {
    path: PathBuf,
    options: RecordingOptions,
    source: Source,
    files: Files,
    span: Option<Range<i64>>,
}

/// Storage of a recording's events.
#[derive(Clone)]
enum Source {
    /// A file of this format.
    File(&'static FileFormat),
    /// Memory, in the order in which the events were given.
    Memory(Arc<Vec<Event>>),
    /// A file of this format, followed by the files that continue it.
    Chain(&'static FileFormat, Arc<Vec<Recording>>),
}

impl Recording {
    /// Opens the file or folder at `path` and detects its format from its content.
    ///
    /// # Errors
    /// When the file cannot be read, is empty, is of an unknown format, or when an option does not apply to its
    /// format.
    pub fn new(path: impl Into<PathBuf>, options: RecordingOptions) -> Result<Self, RecordingError> {
        let path = path.into();
        let path = ros::folder_of(&path).unwrap_or(path);
        let format = format_of(&path)?;
        if let Some(option) = format.uses.unused(&options) {
            let kind = RecordingErrorKind::NoEffect { option, format: format.name };
            return Err(RecordingError::new(&path, kind));
        }
        let files = Files::new((format.files)(&path));
        Ok(Self { path, options, source: Source::File(format), files, span: None })
    }

    /// Creates a recording from events in memory, with times in microseconds. They pass the same checks as the events
    /// of a file (see [`EventReader::next_batch`]). Reports and messages call the recording `name`; of `options` only
    /// the sensor is used.
    pub fn from_events(name: impl Into<PathBuf>, events: Vec<Event>, options: RecordingOptions) -> Self {
        let source = Source::Memory(Arc::new(events));
        Self { path: name.into(), options, source, files: Files::default(), span: None }
    }

    /// Opens a recording that is still being written at `path`. A pass waits for more data until `growth` reports the end. This function
    /// waits for the beginning of the recording.
    ///
    /// # Errors
    /// As [`Recording::new`]; also if the recording ended without data, or has a format that cannot be read while it is written.
    pub fn growing(
        path: impl Into<PathBuf>,
        options: RecordingOptions,
        growth: Growth,
    ) -> Result<Self, RecordingError> {
        let path = path.into();
        // The format may follow from the first bytes alone, its details from more of them.
        growth.wait_beyond(0);
        growth.wait_at_most(HEAD_LENGTH, BEGINNING);
        let mut opened = Self::new(&path, RecordingOptions { growth: Some(growth.clone()), ..options.clone() });
        if matches!(&opened, Err(error) if matches!(error.kind, RecordingErrorKind::UnknownFormat { .. })) {
            growth.wait_at_most(HEAD_LENGTH, Duration::MAX);
            opened = Self::new(&path, RecordingOptions { growth: Some(growth), ..options });
        }
        Ok(opened?.still_written())
    }

    /// Joins `files`, which continue each other and are in order of time (see [`chains`](crate::continued::chains)),
    /// into one recording. `None` if `files` is empty.
    pub fn chain(files: Vec<Self>) -> Option<Self> {
        let mut files = files.into_iter();
        let first = files.next()?;
        let others: Vec<Self> = files.collect();
        let files = Files::joined(std::iter::once(&first).chain(&others).map(Self::source_files));
        let source = Source::Chain(first.format(), Arc::new(others));
        Some(Self { source, files, ..first })
    }

    /// Returns the paths of all files of this recording, in order of time.
    pub fn files(&self) -> Vec<&Path> {
        std::iter::once(self.path()).chain(self.others().iter().map(Self::path)).collect()
    }

    /// The files that continue the first one.
    fn others(&self) -> &[Self] {
        match &self.source {
            Source::Chain(_, others) => others,
            Source::File(_) | Source::Memory(_) => &[],
        }
    }

    /// Returns all files that are read, also those in a folder. Empty for a recording in memory, and for one that is
    /// still being written.
    pub fn source_files(&self) -> &Files {
        &self.files
    }

    /// Returns the section of the recording within `span`, in microseconds of the file's clock.
    pub fn section(&self, span: Range<i64>) -> Self {
        Self { span: Some(span), ..self.clone() }
    }

    /// Returns the recording of a file to which events are still appended: it is not an error that the file changes.
    pub fn still_written(self) -> Self {
        Self { files: Files::default(), ..self }
    }

    /// Path of the recording, or the name of a recording in memory.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Format of the recording.
    pub fn format(&self) -> &'static FileFormat {
        match &self.source {
            Source::File(format) | Source::Chain(format, _) => format,
            Source::Memory(_) => &memory::FORMAT,
        }
    }

    /// `true` if the format can contain frames.
    pub fn may_contain_frames(&self) -> bool {
        self.format().frames.is_some()
    }

    /// Returns the same recording with other options.
    pub(crate) fn with_options(&self, options: RecordingOptions) -> Self {
        let mut source = self.source.clone();
        if let Source::Chain(_, others) = &mut source {
            *others = Arc::new(others.iter().map(|other| other.with_options(options.clone())).collect());
        }
        Self { options, source, ..self.clone() }
    }

    /// Options with which the recording is read.
    pub fn options(&self) -> &RecordingOptions {
        &self.options
    }

    /// Returns the sensor size that the file itself contains; `None` if it has none or cannot be opened.
    pub fn own_sensor(&self) -> Option<Sensor> {
        let options = RecordingOptions { sensor: None, ..self.options.clone() };
        self.with_options(options).open().ok()?.information().sensor
    }

    /// Starts a pass through the recording, from its first event.
    ///
    /// # Errors
    /// When the file cannot be opened or its header is invalid.
    pub fn open(&self) -> Result<EventReader, RecordingError> {
        let reader = EventReader::new(&self.path, self.opened()?, &self.options)?;
        let reader = reader.limited_to(self.span.clone(), self.files.bytes());
        // Events of a camera are shown as they arrive; its clock keeps them in order.
        Ok(if self.options.growth.is_some() { reader.without_delay() } else { reader })
    }

    fn opened(&self) -> OpenResult {
        Ok(match &self.source {
            Source::File(format) => self.open_file(format)?,
            Source::Memory(events) => MemoryDecoder::open(Arc::clone(events), self.options.sensor),
            Source::Chain(format, others) => {
                let open = |other: &Self| -> OpenFile {
                    let other = other.clone();
                    Box::new(move || other.opened())
                };
                ChainDecoder::open(self.open_file(format)?, others.iter().map(open))
            }
        })
    }

    /// Opens the decoder of a file. If the unit of its times is doubtful, chooses the unit that gives a plausible
    /// event rate.
    fn open_file(&self, format: &FileFormat) -> OpenResult {
        let open =
            |options: &RecordingOptions| (format.events)(&self.path, options).map_err(RecordingError::of_the_start);
        let opened = open(&self.options)?;
        if !opened.is_unit_doubtful {
            return Ok(opened);
        }
        let Some(rate) = impossible_rate(opened.decoder) else { return open(&self.options) };
        let stated = RecordingOptions { time_unit: Some(TimeUnit::Microseconds), ..self.options.clone() };
        let mut opened = open(&stated)?;
        note_correction(&mut opened, rate);
        Ok(opened)
    }

    /// Counts the packets and elements of each stream. Empty for formats with a single event stream.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn streams(&self) -> Result<Vec<StreamSummary>, RecordingError> {
        let mut streams = (self.format().streams)(&self.path, &self.options)?;
        for other in self.others() {
            streams.extend(other.streams()?);
        }
        Ok(streams)
    }

    /// Opens the frames and IMU samples, which are returned in order of time.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn open_extras(&self) -> Result<Extras, RecordingError> {
        let Some(open) = self.format().extras else { return Ok(Extras::default()) };
        let mut extras = open(&self.path, &self.options)?;
        for other in self.others() {
            extras = extras.followed_by(other.open_extras()?);
        }
        Ok(extras)
    }

    /// Passes the frames to `visit`, in file order. Damage ends the frames without an error; the returned sentence then
    /// names what could not be read.
    ///
    /// # Errors
    /// When the file cannot be opened.
    pub fn visit_frames(&self, mut visit: impl FnMut(TimedImage)) -> Result<Option<String>, RecordingError> {
        let Some(frames) = self.format().frames else { return Ok(None) };
        let mut end = Ok(());
        for file in std::iter::once(self).chain(self.others()) {
            end = end.and(visit_frames(frames(&file.path, &file.options)?, &file.path, &mut visit));
        }
        Ok(end.err().map(|error| match error.kind {
            RecordingErrorKind::FrameEncoding { .. } => error.to_string(),
            _ => format!("frames could be read only up to the damage: {error}"),
        }))
    }

    /// Returns the frame whose exposure began within 1 µs of `start` (µs on the recording's clock); `None` if no
    /// readable frame matches.
    pub fn image_at(&self, start: i64) -> Option<TimedImage> {
        let mut found = None;
        let seen = self.visit_frames(|image| {
            if found.is_none() && image.exposure.0.abs_diff(start) <= 1 {
                found = Some(image);
            }
        });
        seen.ok().and(found)
    }
}

#[cfg(test)]
mod tests {
    use evcal_core::event::{Event, Polarity};
    use proptest::prelude::*;
    use tempfile::TempDir;

    use super::*;
    use crate::encode::OutputFormat;
    use crate::write::EventWriter;
    use crate::{Damage, FORMATS, FormatOption, ReadReport, TimeUnit, aedat4, event_calib, options_for, text};

    const SENSOR: Sensor = Sensor::new(346, 260);
    const OUTPUTS: [OutputFormat; 5] =
        [aedat4::OUTPUT_UNCOMPRESSED, aedat4::OUTPUT_ZSTANDARD, aedat4::OUTPUT, text::OUTPUT, event_calib::OUTPUT];

    /// Returns events 5 ms apart, so that AEDAT4 writes two events per packet.
    fn events(count: i64) -> Vec<Event> {
        (0..count)
            .map(|index| Event {
                t: 1_643_243_628_737_093 + index * 5000,
                x: (index * 37 % 346) as u16,
                y: (index * 91 % 260) as u16,
                polarity: if index % 3 == 0 { Polarity::On } else { Polarity::Off },
            })
            .collect()
    }

    fn write(path: &Path, output: OutputFormat, events: &[Event]) {
        let mut writer = EventWriter::create(path, output, SENSOR, "DAVIS346 <&> 1").unwrap();
        for part in events.chunks(7) {
            writer.write(part).unwrap();
        }
        writer.finish().unwrap();
    }

    /// Reads all events. Returns them with the report and the error that ended the pass, if any.
    fn read(path: &Path, options: &RecordingOptions) -> (Vec<Event>, ReadReport, Option<RecordingError>) {
        let opened = Recording::new(path, options.clone()).and_then(|recording| recording.open());
        let mut reader = match opened {
            Ok(reader) => reader,
            Err(error) => return (Vec::new(), ReadReport::default(), Some(error)),
        };
        let (mut all, mut batch) = (Vec::new(), Vec::new());
        loop {
            match reader.next_batch(&mut batch) {
                Ok(true) => all.extend_from_slice(&batch),
                Ok(false) => return (all, reader.report().clone(), None),
                Err(error) => return (all, reader.report().clone(), Some(error)),
            }
        }
    }

    fn file(content: &[u8]) -> (TempDir, PathBuf) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("recording");
        std::fs::write(&path, content).unwrap();
        (directory, path)
    }

    #[test]
    fn the_format_is_found_from_the_content() {
        for (output, format) in OUTPUTS.into_iter().zip(["AEDAT4", "AEDAT4", "AEDAT4", "text", "EventCalib binary"]) {
            let (_directory, path) = file(b"");
            write(&path, output, &events(100));
            assert_eq!(format_of(&path).unwrap().name, format);
            let recording = Recording::new(&path, RecordingOptions::default()).unwrap();
            let reader = recording.open().unwrap();
            let information = reader.information();
            assert_eq!(information.format, format);
            assert_eq!(information.sensor, (format != "EventCalib binary").then_some(SENSOR));
            assert_eq!(information.camera_name.as_deref(), (format == "AEDAT4").then_some("DAVIS346 <&> 1"));
        }
    }

    /// Every writable format is detected by content and read back to the same events.
    #[test]
    fn every_written_format_is_read_back() {
        let start = 1_000_003;
        let events: Vec<Event> = events(3000)
            .iter()
            .enumerate()
            .map(|(index, event)| Event { t: start + index as i64 / 3 * 17 + index as i64 / 500 * 30_000, ..*event })
            .collect();
        let outputs: Vec<_> = FORMATS.iter().filter_map(|format| Some((format, format.output?))).collect();
        assert!(outputs.len() >= 7);
        for (format, output) in outputs {
            let directory = tempfile::tempdir().unwrap();
            let path = directory.path().join("recording");
            write(&path, *output, &events);
            let recording = Recording::new(&path, RecordingOptions::default()).unwrap();
            assert_eq!(recording.format().name, format.name);
            let (read, report, error) = read(&path, &RecordingOptions::default());
            assert!(error.is_none(), "{}: {error:?}", format.name);
            assert!(read == events, "{}: {} events", format.name, read.len());
            assert_eq!((report.events, report.out_of_range, report.strays), (3000, 0, 0), "{}", format.name);
            assert!(!output.contains_sensor || recording.own_sensor() == Some(SENSOR), "{}", format.name);
        }
    }

    /// Words of formats that evcal does not write: `count` events, one each 100 µs.
    fn records(count: u32) -> impl Iterator<Item = (u32, u32, u32)> {
        (0..count).map(|index| (100 * index, index % 340, index % 240))
    }

    fn dat(count: u32) -> Vec<u8> {
        let words = records(count).flat_map(|(t, x, y)| [t, 1 << 28 | y << 14 | x]).flat_map(u32::to_le_bytes);
        b"% Data file\n% Version 2\n% Height 260\n% Width 346\n\x0c\x08".iter().copied().chain(words).collect()
    }

    fn event_stream(count: u32) -> Vec<u8> {
        let words = records(count).flat_map(|(_, x, y)| [100 << 1 | 1, x as u8, (x >> 8) as u8, y as u8, 0]);
        b"Event Stream\x02\x00\x00\x01\x5a\x01\x04\x01".iter().copied().chain(words).collect()
    }

    fn aedat2(count: u32) -> Vec<u8> {
        let words = records(count).flat_map(|(t, x, y)| [y << 22 | x << 12, t]).flat_map(u32::to_be_bytes);
        b"#!AER-DAT2.0\r\n# AEChip: eu.seebetter.ini.chips.davis.Davis346red\r\n".iter().copied().chain(words).collect()
    }

    fn aedat3(count: u32) -> Vec<u8> {
        let mut bytes = b"#!AER-DAT3.1\r\n#Format: RAW\r\n#Source 1: DAVIS346\r\n#!END-HEADER\r\n".to_vec();
        for (t, x, y) in records(count) {
            bytes.extend(
                [1_u8, 0, 1, 0].into_iter().chain([8_u32, 4, 0, 1, 1, 1].into_iter().flat_map(u32::to_le_bytes)),
            );
            bytes.extend([(x << 15 | y) << 2 | 3, t].into_iter().flat_map(u32::to_le_bytes));
        }
        bytes
    }

    /// Files arrive in pieces that end anywhere, with the beginning cut too.
    #[test]
    fn a_recording_can_be_read_while_it_is_written() {
        let events: Vec<Event> = events(30_000)
            .iter()
            .enumerate()
            .map(|(index, event)| Event { t: 1_000_003 + 100 * index as i64, ..*event })
            .collect();
        let mut files = vec![
            ("Prophesee DAT", dat(20_000)),
            ("Event Stream", event_stream(20_000)),
            ("AEDAT 2.0", aedat2(20_000)),
            ("AEDAT 3", aedat3(3000)),
        ];
        for format in FORMATS.iter().filter(|format| format.uses.growth) {
            if let Some(output) = format.output {
                let (_directory, path) = file(b"");
                write(&path, *output, &events);
                files.push((format.name, std::fs::read(&path).unwrap()));
            }
        }
        let names: std::collections::BTreeSet<&str> = files.iter().map(|(name, _)| *name).collect();
        let growing =
            FORMATS.iter().filter(|format| format.uses.growth && format.name != crate::davis::BARE_FORMAT.name);
        assert_eq!(names, growing.map(|format| format.name).collect());
        for (name, content) in files {
            let (directory, whole) = file(&content);
            let (expected, _, error) = read(&whole, &RecordingOptions::default());
            assert!(error.is_none() && expected.len() >= 3000, "{name}: {error:?}");
            let (growth, path) = (Growth::default(), directory.path().join("growing"));
            let read = std::thread::scope(|scope| {
                let reading = scope.spawn(|| {
                    let recording = Recording::growing(&path, RecordingOptions::default(), growth.clone()).unwrap();
                    assert_eq!(recording.format().name, name);
                    let (mut reader, mut batch, mut all) = (recording.open().unwrap(), Vec::new(), Vec::new());
                    let mut early = false;
                    while reader.next_batch(&mut batch).unwrap() {
                        all.append(&mut batch);
                        early |= all.len() < expected.len() / 2;
                    }
                    assert!(early, "{name}: events are returned while the file grows");
                    all
                });
                let mut out = std::fs::File::create_new(&path).unwrap();
                let mut written = 0;
                for (index, piece) in content.chunks(content.len() / 40 + 1).enumerate() {
                    if index == 15 {
                        // The beginning of a short file is waited for.
                        std::thread::sleep(BEGINNING + Duration::from_millis(300));
                    }
                    std::io::Write::write_all(&mut out, piece).unwrap();
                    written += piece.len() as u64;
                    growth.set(written);
                    std::thread::sleep(Duration::from_millis(5));
                }
                growth.end();
                reading.join().unwrap()
            });
            assert!(read == expected, "{name}: {} of {} events", read.len(), expected.len());
        }
    }

    #[test]
    fn a_recording_without_data_or_of_a_whole_format_cannot_be_read_while_it_is_written() {
        let (_directory, empty) = file(b"");
        let growth = Growth::default();
        growth.end();
        assert!(Recording::growing(&empty, RecordingOptions::default(), growth.clone()).is_err());
        let (_directory, path) = file(b"");
        write(&path, crate::numpy::OUTPUT, &events(100));
        let error = Recording::growing(&path, RecordingOptions::default(), growth).map(|_| ()).unwrap_err();
        assert!(matches!(error.kind, RecordingErrorKind::NoEffect { option: FormatOption::Growth, .. }), "{error}");
    }

    /// Writers of other programs store packets that overlap in time.
    #[test]
    fn events_out_of_order_are_sorted_in_every_format() {
        let truth: Vec<Event> = (0..6000)
            .map(|index| Event {
                t: 1_000_003 + 17 * index,
                x: index as u16 % 346,
                y: index as u16 % 260,
                polarity: Polarity::On,
            })
            .collect();
        // Blocks of 20 ms, reversed, with single events 40 ms late.
        let mut given = truth.clone();
        given.chunks_mut(1200).for_each(<[Event]>::reverse);
        for place in (100..3000).step_by(300) {
            let event = given.remove(place);
            given.insert(place + 2400, event);
        }
        let formats = FORMATS.iter().filter_map(|format| format.output);
        // The words of RAW and dvraw, the packets of MCAP and the columns of HDF5 in evcal's layout cannot express this.
        let formats = formats.filter(|output| !["raw", "dvraw", "mcap", "hdf5"].contains(&output.name));
        let mut names = Vec::new();
        for output in formats {
            let directory = tempfile::tempdir().unwrap();
            let path = directory.path().join("recording");
            write(&path, *output, &given);
            let (events, report, error) = read(&path, &RecordingOptions::default());
            assert!(error.is_none(), "{}: {error:?}", output.name);
            assert!(events == truth, "{}: {} events", output.name, events.len());
            assert!(report.sorted > 5000 && report.steps_back == 0 && report.clock_resets == 0, "{}", output.name);
            names.push(output.name);
        }
        assert!(names.len() >= 5, "{names:?}");
    }

    #[test]
    fn options_that_do_not_apply_to_a_format_are_rejected() {
        let options = RecordingOptions {
            stream: Some("events".to_owned()),
            columns: Some("t,x,y,p".parse().unwrap()),
            time_unit: Some(TimeUnit::Seconds),
            device: Some("1.2".parse().unwrap()),
            ..RecordingOptions::default()
        };
        let only = |option: FormatOption| RecordingOptions {
            stream: options.stream.clone().filter(|_| option == FormatOption::Stream),
            columns: options.columns.clone().filter(|_| option == FormatOption::Columns),
            time_unit: options.time_unit.filter(|_| option == FormatOption::TimeUnit),
            device: options.device.filter(|_| option == FormatOption::Device),
            ..RecordingOptions::default()
        };
        for (output, used) in [
            (aedat4::OUTPUT, vec![FormatOption::Stream]),
            (text::OUTPUT, vec![FormatOption::Columns, FormatOption::TimeUnit]),
            (event_calib::OUTPUT, vec![]),
        ] {
            let (_directory, path) = file(b"");
            write(&path, output, &events(100));
            for option in [FormatOption::Stream, FormatOption::Columns, FormatOption::TimeUnit, FormatOption::Device] {
                match Recording::new(&path, only(option)) {
                    Ok(_) => assert!(used.contains(&option), "{} {option}", output.name),
                    Err(RecordingError { kind: RecordingErrorKind::NoEffect { option: named, format }, .. }) => {
                        assert_eq!((named, format), (option, format_of(&path).unwrap().name));
                        assert!(!used.contains(&option), "{} {option}", output.name);
                    }
                    Err(error) => panic!("{error}"),
                }
            }
            // `Uses::of` keeps only the options that apply.
            let left = options_for(&path, &options);
            assert!(Recording::new(&path, left.clone()).is_ok());
            assert_eq!(left.stream.is_some(), used.contains(&FormatOption::Stream));
        }
    }

    #[test]
    fn a_header_without_rows_is_a_recording_without_events() {
        for content in [&b"t_us,x,y,p\n"[..], b"x y p t\n", b"# t x y p\n"] {
            let (_directory, path) = file(content);
            let (read, report, error) = read(&path, &RecordingOptions::default());
            assert_eq!((read.len(), report.events), (0, 0));
            assert!(error.is_none(), "{error:?}");
        }
    }

    #[test]
    fn a_recording_can_be_read_again() {
        let (_directory, path) = file(b"");
        write(&path, text::OUTPUT, &events(50));
        let recording = Recording::new(&path, RecordingOptions::default()).unwrap();
        for _ in 0..2 {
            let mut batch = Vec::new();
            assert!(recording.open().unwrap().next_batch(&mut batch).unwrap());
            assert_eq!(batch, events(50));
        }
    }

    #[test]
    fn files_without_events_are_refused_with_a_reason() {
        for (content, part) in [
            (b"".as_slice(), "empty"),
            (b"#ROSBAG V1.2\n", "ROS bag"),
            (b"\x89HDF\r\n\x1a\n", "HDF5"),
            (b"#!AER-DAT1.0\r\n", "AEDAT 1"),
            (b"% evt 5.0\n% end\n", "Prophesee"),
            (b"\x00\x01\x02\x03 and so on", "unknown format"),
            (&[0; 1000], "unknown format"),
            (b"Dear reader,\n", "unknown format"),
        ] {
            let (_directory, path) = file(content);
            let (_, _, error) = read(&path, &RecordingOptions::default());
            let message = error.unwrap().to_string();
            assert!(message.contains(part) && message.contains("recording"), "{message}");
        }
        let directory = tempfile::tempdir().unwrap();
        assert!(format_of(directory.path()).err().unwrap().to_string().contains("is a folder"));
        assert!(format_of(&directory.path().join("absent")).err().unwrap().to_string().contains("absent"));
    }

    #[test]
    fn a_file_cut_at_any_byte_returns_its_whole_events_and_reports_the_loss() {
        let events = events(12);
        for output in OUTPUTS {
            let (_directory, path) = file(b"");
            write(&path, output, &events);
            let length = std::fs::metadata(&path).unwrap().len();
            let mut more = events.len();
            for cut in (0..length).rev() {
                std::fs::File::options().write(true).open(&path).unwrap().set_len(cut).unwrap();
                let (read, report, error) = read(&path, &RecordingOptions::default());
                assert_eq!(read, events[..read.len()], "{output:?} cut at {cut}");
                assert!(read.len() <= more);
                more = read.len();
                if !read.is_empty() {
                    assert!(error.is_none(), "{output:?} cut at {cut}: {error:?}");
                    let limit = match output.name {
                        "csv" => 27,
                        "bin" => 25,
                        // The loss is a packet of two events or, at the very end, the table.
                        _ => 8 + 64 + 30,
                    };
                    match &report.truncated {
                        Some(truncation) => assert!(truncation.byte <= cut && cut - truncation.byte <= limit),
                        // A cut between two events cannot be detected in a format without structure.
                        None if output == event_calib::OUTPUT => assert_eq!(cut % 25, 0),
                        None if output == text::OUTPUT => assert!(report.events <= 12),
                        None => assert_eq!(read.len(), events.len()),
                    }
                }
            }
            assert_eq!(more, 0);
        }
    }

    #[test]
    fn files_with_a_changed_byte_do_not_panic() {
        let events = events(5);
        for output in OUTPUTS {
            let (_directory, path) = file(b"");
            write(&path, output, &events);
            let mut changed = std::fs::read(&path).unwrap();
            for position in 0..changed.len() {
                let change = [0x01, 0x80, 0xff][position % 3];
                changed[position] ^= change;
                std::fs::write(&path, &changed).unwrap();
                changed[position] ^= change;
                for damage in [Damage::Refuse, Damage::Skip] {
                    let (read, report, _) = read(&path, &RecordingOptions { damage, ..RecordingOptions::default() });
                    assert_eq!(read.len() as u64, report.events);
                    assert!(read.is_sorted_by_key(|event| event.t));
                }
                if let Ok(recording) = Recording::new(&path, RecordingOptions::default()) {
                    let _ = recording.streams();
                }
            }
        }
    }

    fn any_events() -> impl Strategy<Value = Vec<Event>> {
        let step = prop_oneof![0i64..20, 0i64..20_000];
        let event = (step, 0..SENSOR.width, 0..SENSOR.height, any::<bool>());
        (-1_000_000i64..2_000_000_000_000_000, prop::collection::vec(event, 1..300)).prop_map(|(mut t, steps)| {
            let event = |(step, x, y, on)| {
                t += step;
                Event { t, x, y, polarity: if on { Polarity::On } else { Polarity::Off } }
            };
            steps.into_iter().map(event).collect()
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
                fn every_format_returns_what_was_written(events in any_events()) {
            for output in OUTPUTS {
                let (_directory, path) = file(b"");
                write(&path, output, &events);
                let (read, report, error) = read(&path, &RecordingOptions::default());
                prop_assert!(error.is_none(), "{output:?}: {error:?}");
                prop_assert_eq!(&read, &events, "{:?}", output);
                let expected = ReadReport { events: events.len() as u64, ..ReadReport::default() };
                prop_assert_eq!(report, expected);
            }
        }

        #[test]
        fn arbitrary_bytes_do_not_panic(start in 0usize..4, bytes in prop::collection::vec(any::<u8>(), 0..400), text in "[0-9.,;eE \t\n#%a-y-]{0,300}") {
            let starts = [b"".as_slice(), b"#!AER-DAT4.0\r\n", b"#!AER-DAT4.0\r\n\x40\0\0\0\x10\0\0\0IOHE", b"t,x,y,p\n"];
            for rest in [&bytes, text.as_bytes()] {
                let (_directory, path) = file(&[starts[start], rest].concat());
                let _ = read(&path, &RecordingOptions::default());
            }
        }
    }
}
