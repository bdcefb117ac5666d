//! Text and CSV: one event per line.
//!
//! Fields are separated by spaces, tabs, commas or semicolons. Lines that begin with `#` or `%` are comments.
//!
//! The columns are determined by the first of these that is available: [`RecordingOptions::columns`], a header line
//! (which may be the last comment), the values of the first lines. The unit of the times is determined by
//! [`RecordingOptions::time_unit`], the name of the column (`t_us`, `time [s]`…), or the values of the first lines.
//! Values with decimals are seconds. Whole numbers are nanoseconds in two cases: if the largest is at least 10¹⁷, or if
//! at least 20 of them differ, all are multiples of 1000 below 10¹⁵, and a camera can reach the event rate that
//! nanoseconds imply (at most 10⁸ events per second). Otherwise they are microseconds.
//! [`RecordingInformation::notes`] lists all guesses.
//!
//! Polarity is 1 (ON) and 0 or −1 (OFF), or `true` and `false`, or two other numbers; the larger number is ON. A line
//! with two whole numbers before the first event is taken as width and height of the sensor.

pub(crate) mod error;
mod layout;
mod number;
mod plain;

use evcal_core::sensor::Sensor;
use std::io::{BufRead, BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};

pub use error::LineError;
use error::MAX_LINE;
use evcal_core::event::{Event, Polarity};
use layout::Layout;

use super::bytes::{SourceFile, share};
use super::columns::{LayoutError, PolarityCode};
use super::counter::TimeCounter;
use super::encode::{Encode, OutputFormat, WriteError};
use crate::error::{RecordingError, RecordingErrorKind};
use crate::format::{FileFormat, Head, OpenResult, Uses};
use crate::options::{Column, RecordingOptions};
use crate::read_report::{ReadReport, Truncation};
use crate::reader::{Decode, Opened, RecordingInformation};

/// Text or CSV.
pub const FORMAT: FileFormat = FileFormat {
    output: Some(&OUTPUT),
    uses: Uses { columns: true, growth: true, ..Uses::NONE },
    ..FileFormat::of_events("text", recognise, Decoder::open)
};

/// Text with a title such as `t,x,y,p,us,346x260`.
pub const OUTPUT: OutputFormat = OutputFormat::of_events("csv", &["csv", "txt"], |file, description| {
    let file = BufWriter::with_capacity(1 << 18, file()?);
    Ok(Box::new(Encoder::new(file, description.sensor)?))
});

fn recognise(head: &Head) -> bool {
    head.text().is_some_and(|text| text.bytes().any(|byte| byte.is_ascii_digit()) || layout::is_named(text))
}

const BATCH: usize = 32_768;
/// Number of events in a batch while the file is still being written, so that they appear soon.
const GROWING_BATCH: usize = 256;
/// Mark that editors on Windows write at the beginning of a text file.
const BYTE_ORDER_MARK: &[u8] = "\u{feff}".as_bytes();

struct Decoder {
    path: PathBuf,
    file: BufReader<SourceFile>,
    layout: Layout,
    counter: TimeCounter,
    line: Vec<u8>,
    /// Number of the latest line, from 1.
    number: u64,
    /// Offset of the next line.
    byte: u64,
    /// Length of the file in bytes.
    length: u64,
    /// Length of the last field of the previous line.
    last_field: usize,
    /// Number of events from which a batch is returned.
    batch: usize,
}

/// Result of reading a line.
enum Line {
    End,
    Nothing,
    Event(Event),
}

impl Decoder {
    fn open(path: &Path, options: &RecordingOptions) -> OpenResult {
        let head = Head::read(path)?;
        let layout = head.text().ok_or(LayoutError::NoText).and_then(|text| layout::find(text, options));
        let layout = layout.map_err(|what| RecordingError::new(path, RecordingErrorKind::Layout(what)))?;
        let io = |error| RecordingError::io(path, error);
        let file = SourceFile::open(path, options.growth.as_ref()).map_err(io)?;
        let length = file.length().map_err(io)?;
        let mut file = BufReader::with_capacity(1 << 18, file);
        let mut byte = 0;
        while file.fill_buf().map_err(io)?.starts_with(BYTE_ORDER_MARK) {
            file.consume(BYTE_ORDER_MARK.len());
            byte += BYTE_ORDER_MARK.len() as u64;
        }
        let information = RecordingInformation {
            format: FORMAT.name,
            sensor: layout.sensor,
            notes: layout.notes.clone(),
            ..RecordingInformation::default()
        };
        let path = path.to_owned();
        let (line, counter) = (Vec::new(), TimeCounter::new(layout.time_unit));
        let batch = if options.growth.is_some() { GROWING_BATCH } else { BATCH };
        let (number, last_field) = (0, 0);
        let is_unit_doubtful = layout.is_unit_doubtful;
        let decoder = Self { path, file, layout, counter, line, number, byte, length, last_field, batch };
        Ok(Opened { is_unit_doubtful, ..Opened::new(information, decoder) })
    }

    /// Reads the next event with the fast parser ([`plain`]), if the line has the usual form and is completely in the
    /// buffer.
    fn next_plain_line(&mut self) -> Option<Event> {
        if self.number < self.layout.first_line || self.layout.code != PolarityCode::USUAL {
            return None;
        }
        let plain = plain::event(self.file.buffer(), &self.layout)?;
        self.file.consume(plain.length);
        self.byte += plain.length as u64;
        self.number += 1;
        self.last_field = plain.last_field;
        Some(plain.event)
    }

    fn next_line(&mut self, report: &mut ReadReport) -> Result<Line, RecordingError> {
        self.line.clear();
        let read = self.file.by_ref().take(MAX_LINE).read_until(b'\n', &mut self.line);
        let length = read.map_err(|error| RecordingError::io(&self.path, error))?;
        if length == 0 {
            return Ok(Line::End);
        }
        let start = self.byte;
        self.byte += length as u64;
        self.number += 1;
        let whole = self.line.ends_with(b"\n");
        if !whole && length as u64 == MAX_LINE {
            return Err(self.error(LineError::TooLong));
        }
        if self.number <= self.layout.first_line {
            return Ok(Line::Nothing);
        }
        let line = self.line.trim_ascii();
        if is_comment(line) {
            return Ok(Line::Nothing);
        }
        let last_field = line.iter().rev().take_while(|byte| !is_separator(byte)).count();
        let event = event(line, &self.layout);
        // A line without its end may have lost digits of its last field, unless this field is a polarity, which has
        // only one digit.
        let ends_in_polarity = self.layout.columns.as_slice().last() == Some(&Column::P);
        let shorter = !ends_in_polarity && last_field < self.last_field;
        self.last_field = last_field;
        match event {
            Ok(event) if whole || !shorter => Ok(Line::Event(event)),
            Ok(_) | Err(_) if !whole => {
                let lost = format!("line {} is incomplete ({length} bytes)", self.number);
                report.truncated = Some(Truncation { byte: start, lost });
                Ok(Line::End)
            }
            Ok(event) => Ok(Line::Event(event)),
            Err(what) => Err(self.error(what)),
        }
    }

    fn error(&self, what: LineError) -> RecordingError {
        RecordingError::new(&self.path, RecordingErrorKind::Line { line: self.number, what })
    }
}

impl Decode for Decoder {
    fn decode(&mut self, batch: &mut Vec<Event>, report: &mut ReadReport) -> Result<bool, RecordingError> {
        while batch.len() < self.batch {
            let line = match self.next_plain_line() {
                Some(event) => Line::Event(event),
                None => self.next_line(report)?,
            };
            match line {
                Line::End => return Ok(false),
                Line::Nothing => {}
                Line::Event(event) => batch.push(Event { t: self.counter.time(event.t, report), ..event }),
            }
        }
        Ok(true)
    }

    fn done(&self) -> Option<f64> {
        Some(share(self.byte, self.length))
    }
}

fn is_comment(line: &[u8]) -> bool {
    matches!(line.first(), None | Some(b'#' | b'%'))
}

fn is_separator(byte: &u8) -> bool {
    matches!(byte, b' ' | b'\t' | b',' | b';')
}

/// Iterator over the fields of a line, from left to right. Fields are separated by spaces and tabs, or by one comma or
/// semicolon with optional spaces around it; quotes around a field are left out.
struct Fields<'a> {
    /// The rest of the line after the fields returned so far; `None` after the last one.
    rest: Option<&'a [u8]>,
}

impl<'a> Fields<'a> {
    fn of(line: &'a [u8]) -> Self {
        let line = line.trim_ascii();
        Self { rest: (!line.is_empty()).then_some(line) }
    }
}

impl<'a> Iterator for Fields<'a> {
    type Item = &'a [u8];

    fn next(&mut self) -> Option<&'a [u8]> {
        let rest = self.rest?;
        let (field, after) = rest.split_at(rest.iter().position(is_separator).unwrap_or(rest.len()));
        let spaces = after.iter().take_while(|byte| matches!(byte, b' ' | b'\t')).count();
        let after = after.get(spaces..).unwrap_or_default();
        self.rest = match after.split_first() {
            // A separator at the end of the line is followed by an empty field.
            Some((b',' | b';', after)) => Some(after.trim_ascii_start()),
            Some(_) => Some(after),
            None => None,
        };
        Some(field.strip_prefix(b"\"").and_then(|field| field.strip_suffix(b"\"")).unwrap_or(field))
    }
}

/// Parses the event of a line.
fn event(line: &[u8], layout: &Layout) -> Result<Event, LineError> {
    let columns = layout.columns.as_slice();
    let mut event = Event { t: 0, x: 0, y: 0, polarity: Polarity::Off };
    let (mut count, mut wrong) = (0, None);
    for field in Fields::of(line) {
        if let (Some(column), None) = (columns.get(count), &wrong) {
            wrong = put(&mut event, *column, field, layout).err();
        }
        count += 1;
    }
    if count != columns.len() {
        return Err(LineError::FieldCount { count, columns: layout.columns.clone() });
    }
    wrong.map_or(Ok(event), Err)
}

/// Stores the field of a column in `event`.
fn put(event: &mut Event, column: Column, field: &[u8], layout: &Layout) -> Result<(), LineError> {
    let unit = layout.time_unit;
    let shown = || String::from_utf8_lossy(field).into_owned();
    let pixel = |axis| number::pixel(field).ok_or_else(|| LineError::Pixel { field: shown(), axis });
    match column {
        Column::T => {
            event.t = number::microseconds(field, unit).ok_or_else(|| LineError::Time { field: shown(), unit })?;
        }
        Column::X => event.x = pixel("x")?,
        Column::Y => event.y = pixel("y")?,
        Column::P => {
            let wrong = || LineError::Polarity { field: shown(), known: layout.code.to_string() };
            event.polarity = number::polarity(field, layout.code).ok_or_else(wrong)?;
        }
        Column::Ignored => {}
    }
    Ok(())
}

/// Encoder of text: a title such as `t,x,y,p,us,346x260`, and one line per event with the first four columns (time in
/// microseconds; polarity 1 is ON, 0 is OFF). Other programs refuse comments, or read them as events. They need the names
/// t, x, y and p, and ignore the names after them.
struct Encoder<W> {
    output: W,
    line: String,
}

impl<W: Write> Encoder<W> {
    fn new(mut output: W, sensor: Sensor) -> Result<Self, WriteError> {
        writeln!(output, "t,x,y,p,us,{}x{}", sensor.width, sensor.height)?;
        Ok(Self { output, line: String::new() })
    }
}

impl<W: Write> Encode for Encoder<W> {
    fn write(&mut self, events: &[Event]) -> Result<(), WriteError> {
        use std::fmt::Write as _;
        for event in events {
            self.line.clear();
            // Writing into a String cannot fail.
            let _ = writeln!(self.line, "{},{},{},{}", event.t, event.x, event.y, event.polarity.index());
            self.output.write_all(self.line.as_bytes())?;
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), WriteError> {
        Ok(self.output.flush()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::options::TimeUnit;
    use crate::{Recording, testing};

    fn read(
        text: &[u8],
        options: RecordingOptions,
    ) -> Result<(Vec<Event>, RecordingInformation, ReadReport), RecordingError> {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("events");
        std::fs::write(&path, text).unwrap();
        let mut reader = Recording::new(&path, options)?.open()?;
        let (mut all, mut batch) = (Vec::new(), Vec::new());
        while reader.next_batch(&mut batch)? {
            all.extend_from_slice(&batch);
        }
        Ok((all, reader.information().clone(), reader.report().clone()))
    }

    fn default(text: &str) -> (Vec<Event>, RecordingInformation, ReadReport) {
        read(text.as_bytes(), RecordingOptions::default()).unwrap()
    }

    fn failure(text: &str) -> String {
        read(text.as_bytes(), RecordingOptions::default()).unwrap_err().to_string()
    }

    fn event(t: i64, x: u16, y: u16, polarity: Polarity) -> Event {
        Event { t, x, y, polarity }
    }

    #[test]
    fn usual_notations_give_the_same_events() {
        let expected =
            [event(3811, 96, 133, Polarity::Off), event(3820, 5, 7, Polarity::On), event(4001, 345, 259, Polarity::On)];
        for text in [
            "0.003811000 96 133 0\n0.003820 5 7 1\n0.004001 345 259 1\n",
            "3811 96 133 -1\n3820 5 7 1\n4001 345 259 1\n",
            "3811,96,133,0\r\n3820,5,7,1\r\n4001,345,259,1",
            "\u{feff}x;y;p;t\n96;133;0;3811\n5;7;1;3820\n345;259;1;4001\n",
            "96,133,0,3811\n5,7,1,3820\n345,259,1,4001\n",
            "t_ns\tx\ty\tpolarity\n3811000\t96\t133\tFalse\n3820000\t5\t7\tTrue\n4001000\t345\t259\tTrue\n",
            "# recorded with a camera\n# timestamp[us] x y pol\n3811 96 133 0\n\n# between\n3820 5 7 1\n4001 345 259 1\n",
            ",p,y,x,\"time (ms)\"\n0,0,133,96,3.811\n1,1,7,5,3.82\n2,1,259,345,4.001\n",
            "346 260\n3.811e-03 9.6e+01 1.33e+02 0.0e+00\n3.820e-03 5 7 1.0\n4.001e-03 345 259 1\n",
        ] {
            assert_eq!(default(text).0, expected, "{text}");
        }
    }

    /// Two numbers other than 0 and 1 are taken for polarities. A single other number among 0 and 1 is an error.
    #[test]
    fn the_larger_of_two_numbers_is_on() {
        let lines = |off: &str, on: &str, odd: &str| {
            let polarity = |index: usize| [if index == 24 { odd } else { off }, on, on][index % 3];
            (1..40).map(|index| format!("{index} 5 7 {}\n", polarity(index))).collect::<String>()
        };
        let expected = default(&lines("0", "1", "0")).0;
        for (off, on) in [("-1", "1"), ("0", "255"), ("1", "2"), ("-1.0", "0.5"), ("-128", "127")] {
            assert_eq!(default(&lines(off, on, off)).0, expected, "{off} {on}");
        }
        assert!(failure(&lines("0", "1", "255")).contains("line 24: \"255\" is not a polarity (1, 0 or -1)"));
    }

    #[test]
    fn guesses_are_noted_and_options_are_not() {
        let (_, information, _) = default("0.1 5 7 1\n0.2 6 8 0\n");
        assert!(information.notes.iter().any(|note| note.contains("t,x,y,p")), "{:?}", information.notes);
        assert!(information.notes.iter().any(|note| note.contains("seconds")), "{:?}", information.notes);
        let (_, information, _) = default("t_us,x,y,p\n1,5,7,1\n");
        assert_eq!(information.notes, [""; 0]);
    }

    #[test]
    fn nanoseconds_are_recognised() {
        let relative: String = (1..=30).map(|index| format!("{} 1 2 1\n", index * 7000)).collect();
        assert_eq!(default(&relative).0[1].t, 14);
        assert_eq!(default("1643243628737093123 1 2 1\n").0[0].t, 1_643_243_628_737_093);
        assert_eq!(default("1643243628737093 1 2 1\n").0[0].t, 1_643_243_628_737_093);
    }

    #[test]
    fn options_take_precedence() {
        let options = RecordingOptions {
            columns: Some("-,y,x,p,t".parse().unwrap()),
            time_unit: Some(TimeUnit::Milliseconds),
            ..RecordingOptions::default()
        };
        let (events, information, _) = read(b"9 7 5 1 2\n9 8 6 0 3\n", options).unwrap();
        assert_eq!(events, [event(2000, 5, 7, Polarity::On), event(3000, 6, 8, Polarity::Off)]);
        assert_eq!(information.notes, [""; 0]);
    }

    /// Columns beyond the sixteenth must not be dropped.
    #[test]
    fn columns_far_to_the_right_are_read() {
        let others = |field: &str| [field; 16].join(",");
        let expected = [event(3811, 96, 133, Polarity::On), event(3820, 5, 7, Polarity::Off)];
        let lines = format!("{0},3811,96,133,1\n{0},3820,5,7,0\n", others("0.5"));
        assert_eq!(default(&format!("{},t_us,x,y,p\n{lines}", others("gain"))).0, expected);
        let columns = format!("{},t,x,y,p", others("-"));
        let options = RecordingOptions {
            columns: Some(columns.parse().unwrap()),
            time_unit: Some(TimeUnit::Microseconds),
            ..RecordingOptions::default()
        };
        assert_eq!(read(lines.as_bytes(), options).unwrap().0, expected);
        assert!(failure(&lines).contains("it has 20 fields in a row"));
    }

    /// An empty field is not a number, but the line is still an event.
    #[test]
    fn a_first_event_with_empty_fields_is_not_a_header() {
        let expected = [event(1, 5, 7, Polarity::On), event(2, 6, 8, Polarity::Off)];
        for (lines, columns) in [
            ("1,5,7,1,\n2,6,8,0,\n", "t,x,y,p,-"),
            ("1,,5,7,1\n2,,6,8,0\n", "t,-,x,y,p"),
            (",0,1,2,3\n0,1,5,7,1\n1,2,6,8,0\n", "-,t,x,y,p"),
        ] {
            let options = RecordingOptions { columns: Some(columns.parse().unwrap()), ..RecordingOptions::default() };
            assert_eq!(read(lines.as_bytes(), options).unwrap().0, expected, "{lines}");
        }
        assert!(failure("1,5,7,1,\n2,6,8,0,\n").contains("it has 5 fields in a row"));
    }

    /// The mark is not part of the first time.
    #[test]
    fn a_byte_order_mark_is_skipped_without_header_too() {
        let (events, _, report) = default("\u{feff}0.001 5 6 1\n0.002 7 8 0\n0.0");
        assert_eq!(events, [event(1000, 5, 6, Polarity::On), event(2000, 7, 8, Polarity::Off)]);
        assert_eq!(report.truncated.unwrap().byte, 27);
    }

    #[test]
    fn times_continue_after_a_counter_wrap() {
        let text = |wrap: i64, time: &dyn Fn(i64) -> String| {
            let events = testing::events_around(wrap);
            let line =
                |event: &Event| format!("{} {} {} {}\n", time(event.t), event.x, event.y, event.polarity.index());
            events.iter().map(line).collect::<String>().into_bytes()
        };
        let seconds = |t: i64| format!("{}.{:06}", t / 1_000_000, t % 1_000_000);
        for (kept, wrap) in testing::KEPT.into_iter().zip([1 << 32, 1 << 31, 1 << 31]) {
            testing::check_wrap(&text(wrap, &|t| kept(t).to_string()), &text(wrap, &|t| t.to_string()));
        }
        testing::check_wrap(&text(1 << 32, &|t| seconds(testing::KEPT[0](t))), &text(1 << 32, &seconds));
    }

    /// The reset is a minute before the end of the counter's range.
    #[test]
    fn a_clock_reset_is_not_a_counter_wrap() {
        let line = |t: i64| format!("{t} 5 7 1\n");
        let (before, after) = ((4_235_000_000..).step_by(100).take(200), (0..).step_by(100).take(200));
        let (events, _, report) = default(&before.clone().chain(after.clone()).map(line).collect::<String>());
        let expected = before.chain(after.map(|t| 4_235_000_000 + 19_900 + 1_000_000 + t));
        assert!(events.iter().map(|event| event.t).eq(expected));
        assert_eq!((report.clock_resets, report.counter_wraps, report.strays), (1, None, 0));
    }

    /// Whole milliseconds look like nanoseconds; the title says that they are microseconds.
    #[test]
    fn written_text_states_unit_and_sensor_after_the_names() {
        let at = |t| Event { t, x: 345, y: 259, polarity: Polarity::On };
        let events: Vec<Event> = (1..100).map(|index| at(index * 40_000)).collect();
        let mut content = Vec::new();
        let mut encoder = Encoder::new(&mut content, Sensor::new(346, 260)).unwrap();
        encoder.write(&events).unwrap();
        encoder.finish().unwrap();
        drop(encoder);
        assert!(content.starts_with(b"t,x,y,p,us,346x260\n40000,345,259,1\n"));
        let (read, information, _) = default(std::str::from_utf8(&content).unwrap());
        assert_eq!((read, information.sensor, information.notes), (events, Some(Sensor::new(346, 260)), vec![]));
        // Other names after the first four are columns.
        let (_, information, _) = default("t,x,y,p,us,gain\n1,2,3,1,5,6\n");
        assert_eq!(information.sensor, None);
    }

    #[test]
    fn the_size_of_the_sensor_is_read() {
        for text in [
            "346 260\n1 2 3 1\n",
            "t,x,y,p,us,346x260\n1,2,3,1\n",
            "# sensor 346 x 260\nt_us,x,y,p\n1,2,3,1\n",
            "%geometry:346,260\n2,3,1,1\n",
            "t,x@346,y@260,on\r\n1,2,3,1\r\n",
        ] {
            let options = RecordingOptions {
                columns: text.starts_with('%').then(|| "x,y,p,t".parse().unwrap()),
                ..RecordingOptions::default()
            };
            let (events, information, _) = read(text.as_bytes(), options).unwrap();
            assert_eq!((events.len(), information.sensor), (1, Some(Sensor::new(346, 260))));
            assert_eq!((events[0].t, events[0].x, events[0].y), (1, 2, 3));
        }
        let (events, _, report) =
            default("# sensor 346 x 260\nt_us,x,y,p\n1,346,3,1\n2,-1,3,1\n3,99999,3,1\n4,0,0,0\n");
        assert_eq!((events.len(), report.out_of_range), (1, 3));
    }

    #[test]
    fn bad_lines_are_named() {
        for (line, part) in [
            ("nan 1 2 1", "\"nan\""),
            ("inf 1 2 1", "\"inf\""),
            ("5 nan 2 1", "\"nan\""),
            ("5 1.5 2 1", "\"1.5\""),
            ("5 1 2 2", "\"2\""),
            ("5 1 2", "3 fields"),
            ("5 1 2 1 1", "5 fields"),
            ("5,,1,2,1", "5 fields"),
            ("5,1,2,", "\"\""),
            ("zzz", "1 field, not 4"),
        ] {
            let message = failure(&format!("1 1 2 1\n2 1 2 0\n{line}\n9 1 2 1\n"));
            assert!(message.contains("line 3") && message.contains(part), "{line}: {message}");
        }
        let long = "1".repeat(5000);
        assert!(failure(&format!("1 1 2 1\n{long}\n")).contains("line 2"));
    }

    #[test]
    fn a_wrong_header_or_unclear_columns_are_reported() {
        for text in [
            "a,b,c,d\n1,2,3,1\n",
            "t,x,y\n1,2,3\n",
            "1 2 3\n",
            "1 2 3 4 5\n",
            "1 2 3 4\n2 3 4 5\n",
            "t,x,y,p,p\n1,2,3,1,1\n",
        ] {
            let message = failure(text);
            let parts = ["t, x, y and p were expected", "not clear which columns are time, x, y and polarity"];
            assert!(parts.iter().any(|part| message.contains(part)), "{text}: {message}");
        }
    }

    #[test]
    fn a_last_line_that_lost_digits_is_dropped() {
        // x y p t: the time of the last line was 4001.
        let (events, _, report) = default("96,133,0,3811\n5,7,1,3820\n345,259,1,40");
        assert_eq!(events.len(), 2);
        let truncation = report.truncated.unwrap();
        assert_eq!(truncation.byte, 25);
        assert!(truncation.lost.contains("line 3"));
        let (events, _, report) = default("3811 96 133 0\n3820 5 7 1\n4001 345 25");
        assert_eq!((events.len(), report.truncated.unwrap().byte), (2, 25));
    }
}
