//! Events that can be read as often as needed.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;
use usb_davis::dump::Growth;

use crate::chain::{ChainDecoder, ChainExtras, OpenDecoder};
use crate::davis;
use crate::doubtful_unit::{Corrected, impossible_rate};
use crate::error::{RecordingError, RecordingErrorKind};
use crate::extras::{NoExtras, ReadExtras};
use crate::format::{FileFormat, StreamSummary};
use crate::formats::format_of;
use crate::memory::{self, MemoryDecoder};
use crate::options::{RecordingOptions, TimeUnit};
use crate::pictures::TimedImage;
use crate::reader::{Decode, EventReader};

/// Events, of a file or in memory, that can be read as often as needed.
#[derive(Clone)]
pub struct Recording {
    path: PathBuf,
    options: RecordingOptions,
    source: Source,
    span: Option<Range<i64>>,
}

/// Where the events of a recording are.
#[derive(Clone)]
enum Source {
    /// In its file.
    File(&'static FileFormat),
    /// Here, in the order in which they came.
    Memory(Arc<Vec<Event>>),
    /// In a dump that is being written, or was.
    Growing(Growth),
    /// In its file, of this format, and in others that continue it.
    Chain(&'static FileFormat, Arc<Vec<Recording>>),
}

impl Recording {
    /// Finds the format of the file at `path`.
    ///
    /// # Errors
    /// When the file cannot be read, is empty, holds no events or is of no known format, or when one of the options means nothing to that.
    pub fn new(path: impl Into<PathBuf>, options: RecordingOptions) -> Result<Self, RecordingError> {
        let path = path.into();
        let format = format_of(&path)?;
        if let Some(option) = format.uses.unused(&options) {
            let kind = RecordingErrorKind::NoEffect { option, format: format.name };
            return Err(RecordingError::new(&path, kind));
        }
        Ok(Self { path, options, source: Source::File(format), span: None })
    }

    /// A recording of events that are in memory, times in microseconds. They are checked as those of a file are:
    /// see [`EventReader::next_batch`]. `name` stands for them in reports and messages; of `options` the sensor counts.
    pub fn from_events(name: impl Into<PathBuf>, events: Vec<Event>, options: RecordingOptions) -> Self {
        Self { path: name.into(), options, source: Source::Memory(Arc::new(events)), span: None }
    }

    /// A recording of a camera that goes on: the first pass through it waits for what is still to come, until `growth` says that
    /// it ended. Waits for its beginning; `None` if it ended without one.
    pub fn growing(path: impl Into<PathBuf>, options: RecordingOptions, growth: Growth) -> Option<Self> {
        growth.wait_beyond(0)?;
        Some(Self { path: path.into(), options, source: Source::Growing(growth), span: None })
    }

    /// One recording of `files` that continue each other, in the order of time (see [`chains`](crate::continued::chains)); `None`
    /// without any.
    pub fn chain(files: Vec<Self>) -> Option<Self> {
        let mut files = files.into_iter();
        let first = files.next()?;
        let source = Source::Chain(first.format(), Arc::new(files.collect()));
        Some(Self { source, ..first })
    }

    /// The files that it is read from, in the order of time.
    pub fn files(&self) -> Vec<&Path> {
        let others = match &self.source {
            Source::Chain(_, others) => others.as_slice(),
            _ => &[],
        };
        std::iter::once(self.path()).chain(others.iter().map(Self::path)).collect()
    }

    /// The part of the recording in this span of time, in microseconds as in the file.
    pub fn section(&self, span: Range<i64>) -> Self {
        Self { span: Some(span), ..self.clone() }
    }

    /// Where the recording is; the name of one in memory.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Its format.
    pub fn format(&self) -> &'static FileFormat {
        match &self.source {
            Source::File(format) | Source::Chain(format, _) => format,
            Source::Memory(_) => &memory::FORMAT,
            Source::Growing(_) => &davis::FORMAT,
        }
    }

    /// Whether it may hold frames: its format does.
    pub fn may_hold_frames(&self) -> bool {
        self.format().frames.is_some()
    }

    /// The same with other options.
    pub(crate) fn with_options(&self, options: RecordingOptions) -> Self {
        let mut source = self.source.clone();
        if let Source::Chain(_, others) = &mut source {
            *others = Arc::new(others.iter().map(|other| other.with_options(options.clone())).collect());
        }
        Self { options, source, ..self.clone() }
    }

    /// Its first file alone.
    fn first(&self) -> Self {
        match &self.source {
            Source::Chain(format, _) => Self { source: Source::File(format), ..self.clone() },
            _ => self.clone(),
        }
    }

    /// What a user said about it.
    pub fn options(&self) -> &RecordingOptions {
        &self.options
    }

    /// What the file itself says of the sensor's size.
    pub fn own_sensor(&self) -> Option<Sensor> {
        let options = RecordingOptions { sensor: None, ..self.options.clone() };
        self.with_options(options).open().ok()?.information().sensor
    }

    /// Starts a pass through the recording, from its first event.
    ///
    /// # Errors
    /// When the file cannot be opened or its header cannot be understood.
    pub fn open(&self) -> Result<EventReader, RecordingError> {
        Ok(EventReader::new(&self.path, self.decoder()?, &self.options)?.within(self.span.clone()))
    }

    fn decoder(&self) -> Result<Box<dyn Decode>, RecordingError> {
        Ok(match &self.source {
            Source::File(format) => self.file_decoder(format)?,
            Source::Growing(growth) => davis::follow(&self.path, growth)?,
            Source::Memory(events) => Box::new(MemoryDecoder::new(Arc::clone(events), self.options.sensor)),
            Source::Chain(_, others) => {
                let open = |other: &Self| -> OpenDecoder {
                    let other = other.clone();
                    Box::new(move || other.decoder())
                };
                Box::new(ChainDecoder::new(self.first().decoder()?, others.iter().map(open)))
            }
        })
    }

    /// The decoder of its file, in the unit of time that the rate of its events makes likely.
    fn file_decoder(&self, format: &FileFormat) -> Result<Box<dyn Decode>, RecordingError> {
        let open = |options: &RecordingOptions| (format.events)(&self.path, options);
        let mut decoder = open(&self.options)?;
        if !decoder.is_unit_doubtful() {
            return Ok(decoder);
        }
        match impossible_rate(&mut *decoder) {
            None => open(&self.options),
            Some(rate) => {
                let stated = RecordingOptions { time_unit: Some(TimeUnit::Microseconds), ..self.options.clone() };
                Ok(Box::new(Corrected::new(open(&stated)?, rate)))
            }
        }
    }

    /// Counts what the streams of the recording hold; empty where there is but one stream of events.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn streams(&self) -> Result<Vec<StreamSummary>, RecordingError> {
        let mut streams = (self.format().streams)(&self.path, &self.options)?;
        if let Source::Chain(_, others) = &self.source {
            for other in others.iter() {
                streams.extend(other.streams()?);
            }
        }
        Ok(streams)
    }

    /// Its frames and inertial samples, in order of time.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn open_extras(&self) -> Result<Box<dyn ReadExtras>, RecordingError> {
        if let Source::Chain(_, others) = &self.source {
            let first = self.first();
            let files = std::iter::once(&first).chain(others.iter()).map(Self::open_extras);
            return Ok(Box::new(ChainExtras { files: files.collect::<Result<_, _>>()? }));
        }
        match self.format().extras {
            Some(open) => open(&self.path, &self.options),
            None => Ok(Box::new(NoExtras)),
        }
    }

    /// Hands its frames to `visit`, in their order. What could not be read is returned in a sentence; it ends the frames, and is
    /// no error.
    ///
    /// # Errors
    /// When the file cannot be opened.
    pub fn visit_frames(&self, mut visit: impl FnMut(TimedImage)) -> Result<Option<String>, RecordingError> {
        let Some(frames) = self.format().frames else { return Ok(None) };
        let mut end = frames(&self.path, &self.options, &mut visit)?;
        if let Source::Chain(_, others) = &self.source {
            for other in others.iter() {
                end = end.and(frames(&other.path, &other.options, &mut visit)?);
            }
        }
        Ok(end.err().map(|error| match error.kind {
            RecordingErrorKind::FrameEncoding { .. } => error.to_string(),
            _ => format!("frames were read up to their damage only: {error}"),
        }))
    }

    /// Its picture whose exposure began at `start` (µs on its clock, to 1 µs); `None` where there is none that can be read.
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
        [aedat4::OUTPUT_UNCOMPRESSED, aedat4::OUTPUT_LZ4, aedat4::OUTPUT, text::OUTPUT, event_calib::OUTPUT];

    /// Events 5 ms apart, so that AEDAT4 puts two into a packet.
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

    /// The events, what the reader met, and the error that ended it.
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

    /// Every format that is written is read again, by its content, to the same events.
    #[test]
    fn one_recording_goes_through_every_writer() {
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
            assert!(!output.holds_sensor || recording.own_sensor() == Some(SENSOR), "{}", format.name);
        }
    }

    #[test]
    fn options_that_mean_nothing_to_a_format_are_refused() {
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
            // Of what was said of another recording that is left which means something.
            let left = options_for(&path, &options);
            assert!(Recording::new(&path, left.clone()).is_ok());
            assert_eq!(left.stream.is_some(), used.contains(&FormatOption::Stream));
        }
    }

    #[test]
    fn names_alone_are_a_recording_without_events() {
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
            (b"\x00\x01\x02\x03 and so on", "no format known"),
            (&[0; 1000], "no format known"),
            (b"Dear reader,\n", "no format known"),
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
    fn a_file_cut_at_any_byte_gives_its_whole_events_and_tells_of_the_loss() {
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
                        // A packet of two events, or at the very end the table.
                        _ => 8 + 64 + 30,
                    };
                    match &report.truncated {
                        Some(truncation) => assert!(truncation.byte <= cut && cut - truncation.byte <= limit),
                        // A cut between two events of a format without structure cannot be noticed.
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
    fn no_changed_byte_panics() {
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
        fn every_format_gives_back_what_was_written(events in any_events()) {
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
        fn no_bytes_panic(start in 0usize..4, bytes in prop::collection::vec(any::<u8>(), 0..400), text in "[0-9.,;eE \t\n#%a-y-]{0,300}") {
            let starts = [b"".as_slice(), b"#!AER-DAT4.0\r\n", b"#!AER-DAT4.0\r\n\x40\0\0\0\x10\0\0\0IOHE", b"t,x,y,p\n"];
            for rest in [&bytes, text.as_bytes()] {
                let (_directory, path) = file(&[starts[start], rest].concat());
                let _ = read(&path, &RecordingOptions::default());
            }
        }
    }
}
