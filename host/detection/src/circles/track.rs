//! Circle tracks: circles from a detector, as a CSV file.
//!
//! The detection writes such files and a calibration reads them instead of a recording, so that a detector elsewhere (a
//! microcontroller) can provide the circles.
//!
//! One line per circle, below a line of names. Columns may have any order; separators are commas, semicolons or tabs; lines that
//! begin with `#` are comments.
//!
//! | column | | meaning |
//! |---|---|---|
//! | `t_s` or `t_us` | required, or `frame` | time of the centre, in seconds or microseconds |
//! | `x_px`, `y_px` | required | centre in pixels; (0, 0) is the centre of the top-left pixel |
//! | `column` (or `col`), `row` | both or none | position on the board, from 0; the index of the circle is row · columns + column |
//! | `frame` | optional | integer that circles of one frame share |
//! | `radius_px` | optional | radius in pixels |
//! | `t_start_s`, `t_end_s` (or `_us`) | optional | time window of the events of the circle |
//! | `vx_px_per_s`, `vy_px_per_s` (or `_per_us`) | optional | velocity of the centre |
//!
//! Optional fields may be empty. Other columns are ignored and reported. Without `frame`, a new frame begins where the time
//! differs from that of the previous line by more than 5 ms, or where a position on the board is repeated. Without `column` and
//! `row` the circles of a frame have no order, and the grid finder has to determine it.
//!
//! Without times, or with frames more than 0.05 s apart, each frame is a view with its own pose, and no trajectory connects them. Corners
//! or centres of dots that another program found in images are such a file. mrcal's files of corners are read too: their legend
//! `# filename x y` names the columns, and the lines of an image are the corners of the board, row by row.
//!
//! Times are on the recording's clock, minus the origin, which the comment `# time_origin_us 1643243628737093` states in
//! microseconds (0 without it). The comment `# sensor 346 x 260` states the size of the sensor. Without that comment, times beyond 10⁶ s get the whole seconds of the first line as origin,
//! because f64 seconds since 1970 have a resolution of only 0.2 µs.

mod parse;

use std::borrow::Borrow;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use evcal_core::pattern::{Layout, Pattern};
use evcal_core::sensor::Sensor;
use evcal_files::text;

use crate::circles::reference_frame::ReferenceFrame;
use crate::circles::reference_frame::UnorderedFrame;
pub use parse::{is_circle_track, parse};

/// The frames of a circle track, in the order of time.
#[derive(Clone, Debug, PartialEq)]
pub enum CircleFrames {
    /// The file contains the position of every circle on the board.
    Ordered(Vec<ReferenceFrame>),
    /// It does not.
    Unordered(Vec<UnorderedFrame>),
}

/// What a circle track states about its recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TrackSource {
    /// Size of the sensor in pixels, if it is known.
    pub sensor: Option<Sensor>,
    /// Time of the recording's clock at which the times of the frames are 0, in microseconds.
    pub time_origin_us: i64,
}

impl TrackSource {
    /// Writes the comments that state it.
    fn write(&self, output: &mut impl Write) -> io::Result<()> {
        if let Some(Sensor { width, height }) = self.sensor {
            writeln!(output, "# sensor {width} x {height}")?;
        }
        writeln!(output, "# time_origin_us {}", self.time_origin_us)
    }
}

/// A circle track.
#[derive(Clone, Debug, PartialEq)]
pub struct CircleTrack {
    /// The frames.
    pub frames: CircleFrames,
    /// The recording.
    pub source: TrackSource,
    /// Number of circles.
    pub circles: usize,
    /// Assumptions, ignored columns and losses, as sentences for the user.
    pub notes: Vec<String>,
}

/// Error of reading a circle track.
#[derive(Debug, thiserror::Error)]
#[error("{}: {kind}", path.display())]
pub struct CircleTrackError {
    /// The file.
    pub path: PathBuf,
    /// The reason.
    pub kind: CircleTrackErrorKind,
}

impl evcal_files::remedy::Remedy for CircleTrackError {}

/// Problem of a line of a circle track.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CircleLineError {
    /// Two columns have the same meaning.
    #[error("column {0} has the same meaning as another column")]
    ColumnTwice(String),
    /// The line has more or fewer fields than the line of names.
    #[error("has {count} fields, not {expected} as the line of names")]
    FieldCount {
        /// Number of fields of the line.
        count: usize,
        /// Number of names.
        expected: usize,
    },
    /// A field is not a number.
    #[error("{field:?} is not a valid {name}")]
    Number {
        /// The text found there.
        field: String,
        /// The expected quantity.
        name: &'static str,
    },
    /// A radius is not positive.
    #[error("{field:?} is not a valid radius_px: a number above 0 is needed; leave it empty if it is not known")]
    Radius {
        /// The text found there.
        field: String,
    },
    /// A field is not an integer.
    #[error("{field:?} is not a valid {name}: a whole number from 0 is needed")]
    WholeNumber {
        /// The text found there.
        field: String,
        /// The expected quantity.
        name: &'static str,
    },
    /// A required field is empty.
    #[error("has no {0}")]
    Missing(&'static str),
    /// A circle has no position on the board, although others have one.
    #[error("has no {0} on the board; omit a circle if its position is not known")]
    MissingPlace(&'static str),
    /// A position is repeated within a frame.
    #[error("column {column}, row {row} occurs twice in frame {frame}")]
    PlaceTwice {
        /// Column on the board, from 0.
        column: u32,
        /// Row on the board, from 0.
        row: u32,
        /// Number of the frame.
        frame: u64,
    },
    /// Only some lines have frame numbers.
    #[error("has no frame number, while other lines have one")]
    FrameNumber,
}

/// Problem of a circle track.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CircleTrackErrorKind {
    /// Reading the file failed.
    #[error("cannot be read: {0}")]
    Io(#[from] io::Error),
    /// Required columns are missing.
    #[error(
        "line {line}: no column {missing} among the names; \
         a line of names such as `frame,t_s,x_px,y_px,column,row` must precede the circles"
    )]
    Columns {
        /// Number of the line of names, from 1.
        line: u64,
        /// The columns.
        missing: &'static str,
    },
    /// A line is not a circle.
    #[error("line {line}: {what}")]
    Line {
        /// Number of the line, from 1.
        line: u64,
        /// The problem.
        what: CircleLineError,
    },
    /// A circle is not on the board.
    #[error(
        "line {line}: column {column}, row {row} is not on the board {board}; \
         the file needs at least {rows}x{columns} (rows x columns): is it another board, or are rows and columns swapped?"
    )]
    OutsideBoard {
        /// Number of the line, from 1.
        line: u64,
        /// Column on the board, from 0.
        column: u32,
        /// Row on the board, from 0.
        row: u32,
        /// The expected board, for example `circles 3x6`.
        board: String,
        /// Number of rows that the file requires.
        rows: u64,
        /// Number of columns that the file requires.
        columns: u64,
    },
    /// The file contains no circle.
    #[error("contains no circles")]
    Empty,
}

/// Reads the circle track at `path`. The circles belong to a board of this pattern, and their frames to recording number
/// `recording` of the camera.
///
/// # Errors
/// [`CircleTrackError`] if the file cannot be read, or a line is invalid or not on the board. An incomplete last line is ignored
/// and noted.
pub fn read(path: &Path, pattern: &Pattern, recording: usize) -> Result<CircleTrack, CircleTrackError> {
    let error = |kind| CircleTrackError { path: path.to_owned(), kind };
    let bytes = text::bytes(path, text::TABLE).map_err(|io| error(io.into()))?;
    parse(&bytes, pattern, recording).map_err(error)
}

/// Writes frames of a board of this pattern as a circle track. Every number is written so that it is read back as the same f64.
///
/// # Errors
/// Errors of `output`.
pub fn write<F: Borrow<ReferenceFrame>>(
    output: &mut impl Write,
    frames: impl IntoIterator<Item = F>,
    pattern: &Pattern,
    source: TrackSource,
) -> io::Result<()> {
    let columns = usize::from(pattern.columns.max(1));
    let optional = |value: Option<f64>| value.map(rounded).unwrap_or_default();
    writeln!(output, "# circles of a board {}", describe(pattern))?;
    source.write(output)?;
    writeln!(output, "frame,t_s,t_start_s,t_end_s,column,row,x_px,y_px,radius_px,vx_px_per_s,vy_px_per_s")?;
    for (number, frame) in frames.into_iter().enumerate() {
        let frame = frame.borrow();
        for circle in &frame.circles {
            writeln!(
                output,
                "{number},{},{},{},{},{},{},{},{},{},{}",
                second(circle.t),
                second(frame.start),
                second(frame.end),
                circle.index % columns,
                circle.index / columns,
                rounded(circle.center.x),
                rounded(circle.center.y),
                optional(circle.radius),
                optional(circle.velocity.map(|velocity| velocity.x)),
                optional(circle.velocity.map(|velocity| velocity.y)),
            )?;
        }
    }
    output.flush()
}

/// Writes circles whose positions on the board are not known as a circle track.
///
/// # Errors
/// Errors of `output`.
pub fn write_unordered<'a>(
    output: &mut impl Write,
    frames: impl IntoIterator<Item = &'a UnorderedFrame>,
    source: TrackSource,
) -> io::Result<()> {
    writeln!(output, "# circles of no known board")?;
    source.write(output)?;
    writeln!(output, "frame,t_s,t_start_s,t_end_s,x_px,y_px,radius_px")?;
    for (number, frame) in frames.into_iter().enumerate() {
        for circle in &frame.circles {
            let radius = circle.radius.map(rounded).unwrap_or_default();
            let (t, start, end) = (second(circle.t), second(frame.start), second(frame.end));
            let (x, y) = (rounded(circle.center.x), rounded(circle.center.y));
            writeln!(output, "{number},{t},{start},{end},{x},{y},{radius}")?;
        }
    }
    output.flush()
}

/// Formats a length in pixels or a speed, rounded to a millionth, far below the accuracy of circles.
fn rounded(value: f64) -> String {
    // Adds 0 to remove the sign of zero.
    ((value * 1e6).round() / 1e6 + 0.0).to_string()
}

/// Formats a time in seconds, rounded to a nanosecond.
fn second(value: f64) -> String {
    ((value * 1e9).round() / 1e9 + 0.0).to_string()
}

/// Returns layout, rows and columns as in a board description.
fn describe(pattern: &Pattern) -> String {
    let layout = match pattern.layout {
        Layout::Asymmetric => "acircles",
        Layout::Symmetric => "circles",
    };
    format!("{layout}:{}x{}", pattern.rows, pattern.columns)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use nalgebra::Vector2;

    use super::*;
    use crate::circles::reference_frame::{ObservedCircle, SeenIn};

    const PATTERN: Pattern = Pattern { layout: Layout::Symmetric, rows: 3, columns: 6 };

    /// Two circles of one frame as in EF-Calib's data: columns in another order, `col`, velocity per µs.
    const FOREIGN: &str = "\
frame,t_s,t_start_s,t_end_s,x_px,y_px,col,row,vx_px_per_us,vy_px_per_us
0,0.445933,0.438582,0.450831,56.5709,114.0796,0,0,-0.000078590,-0.000273686
0,0.446052,0.438663,0.450793,86.9169,113.3089,1,2,0.000010846,-0.000214650
1,0.482107,0.470000,0.490000,57.0001,104.1,5,1,0,0
";

    fn ordered(text: &str) -> Vec<ReferenceFrame> {
        match parse(text.as_bytes(), &PATTERN, 0).unwrap().frames {
            CircleFrames::Ordered(frames) => frames,
            CircleFrames::Unordered(_) => panic!("has column and row"),
        }
    }

    fn failure(text: &str) -> String {
        parse(text.as_bytes(), &PATTERN, 0).unwrap_err().to_string()
    }

    #[test]
    fn a_file_of_another_program_is_read() {
        let frames = ordered(FOREIGN);
        assert_eq!(frames.len(), 2);
        let [first, second] = frames[0].circles[..] else { panic!("two circles") };
        assert_eq!((frames[0].start, frames[0].end), (0.438582, 0.450831));
        assert_eq!((first.index, second.index), (0, 13));
        assert_eq!((second.t, second.center), (0.446052, Vector2::new(86.9169, 113.3089)));
        assert!((second.velocity.unwrap() - Vector2::new(10.846, -214.65)).norm() < 1e-9);
        assert_eq!(second.radius, None);
        assert_eq!(frames[1].circles[0].index, 11);
    }

    #[test]
    fn frames_without_times_are_a_second_apart() {
        let frames = ordered("frame,x_px,y_px,column,row\n4,12.5,20,1,0\n2,10,20,0,0\n4,14,30,1,2\n");
        let circles = |frame: &ReferenceFrame| Vec::from_iter(frame.circles.iter().map(|circle| circle.index));
        assert_eq!(frames.iter().map(circles).collect::<Vec<_>>(), [vec![0], vec![1, 13]]);
        assert_eq!(frames.iter().map(ReferenceFrame::t).collect::<Vec<_>>(), [2.0, 4.0]);
        let without = failure("x_px,y_px,column,row\n10,20,0,0\n");
        assert!(without.contains("no column t_s or t_us among the names"), "{without}");
    }

    /// Two images of a board of three rows of six corners, the second without its first corner; the board was not found in a third.
    #[test]
    fn corners_of_mrcal_are_read() {
        let mut text = String::from("## generated by a detector\n# filename x y level\n");
        for image in ["a.jpg", "b.jpg"] {
            for index in 0..18 {
                let corner = format!("{}.25 {}.5 0", 10 * index, index);
                let corner = if image == "b.jpg" && index == 0 { "- - -" } else { &corner };
                text += &format!("{image} {corner}\n");
            }
        }
        text += "c.jpg - - -\n";
        let frames = ordered(&text);
        assert_eq!(frames.iter().map(|frame| frame.circles.len()).collect::<Vec<_>>(), [18, 17]);
        let last = frames[1].circles[16];
        assert_eq!((last.index, last.center), (17, Vector2::new(170.25, 17.5)));
        assert!(is_circle_track(&text) && !is_circle_track("# filename of the events\n0 1 2 1\n"));
    }

    #[test]
    fn order_of_columns_and_separator_do_not_matter() {
        let turned = |line: &str| {
            let mut fields: Vec<&str> = line.split(',').collect();
            fields.rotate_left(4);
            fields.reverse();
            fields.join("; ")
        };
        let text: String = FOREIGN.lines().map(|line| turned(line) + "\r\n").collect();
        assert_eq!(ordered(&text), ordered(FOREIGN));
    }

    #[test]
    fn without_a_frame_column_time_gaps_and_repeated_positions_separate_frames() {
        let text = "\
t_us,x_px,y_px,column,row
1000,1,1,0,0
1500,2,1,1,0
6000,3,1,2,0
11001,1,2,3,0
11500,1,3,4,0
11600,1,4,3,0
";
        let counts: Vec<usize> = ordered(text).iter().map(|frame| frame.circles.len()).collect();
        assert_eq!(counts, [3, 2, 1]);
        assert_eq!(ordered(text)[0].t(), 0.0035);
    }

    #[test]
    fn without_positions_circles_are_unordered() {
        let text = "x_px,y_px,t_us,frame,radius_px\n5,6,1000,7,2.5\n7,8,900,7,\n1,2,100,3,1\n";
        let track = parse(text.as_bytes(), &PATTERN, 0).unwrap();
        let CircleFrames::Unordered(frames) = track.frames else { panic!("no places") };
        assert_eq!(track.circles, 3);
        // In the order of time, whatever the numbers.
        assert_eq!(frames.iter().map(|frame| frame.circles.len()).collect::<Vec<_>>(), [1, 2]);
        assert_eq!((frames[1].start, frames[1].end), (0.0009, 0.001));
        assert_eq!(frames[1].circles[0].radius, Some(2.5));
        assert_eq!(frames[1].circles[1].radius, None);
    }

    #[test]
    fn a_wrong_board_is_named_with_the_line() {
        let board = Pattern { rows: 6, columns: 3, ..PATTERN };
        let message = parse(FOREIGN.as_bytes(), &board, 0).unwrap_err().to_string();
        assert!(message.contains("line 4") && message.contains("column 5, row 1"), "{message}");
        assert!(message.contains("circles:6x3") && message.contains("at least 3x6"), "{message}");
    }

    #[test]
    fn bad_lines_are_named() {
        let head = "frame,t_s,x_px,y_px,column,row\n";
        for (line, part) in [
            ("0,nan,1,1,0,0\n", "nan"),
            ("0,0,inf,1,0,0\n", "inf"),
            ("0,0,1,1,0\n", "5 fields"),
            ("0,0,1,1,0,-1\n", "-1"),
            ("0,0,1,1,,0\n", "column"),
            ("0,0,,1,0,0\n", "x_px"),
            ("x,0,1,1,0,0\n", "frame"),
            ("0,0,1,1,0,0\n0,0,2,2,0,0\n", "line 3: column 0, row 0 occurs twice in frame 0"),
        ] {
            let message = failure(&format!("{head}{line}"));
            assert!(message.contains("line ") && message.contains(part), "{line:?}: {message}");
        }
        for radius in ["-3", "0", "-0", "nan"] {
            let message = failure(&format!("t_s,x_px,y_px,radius_px\n0,1,1,2\n1,1,1,{radius}\n"));
            assert!(message.contains("line 3") && message.contains("radius_px"), "{radius}: {message}");
        }
        assert!(failure("frame,t_s,x_px,column,row\n0,0,1,0,0\n").contains("y_px"));
        assert!(failure("t_s,x_px,y_px,row\n0,1,0,0\n").contains("column"));
        assert!(failure("").contains("no circles"));
        assert!(failure(head).contains("no circles"));
    }

    #[test]
    fn an_incomplete_last_line_is_ignored_and_reported() {
        let cut = &FOREIGN[..FOREIGN.len() - 5];
        let track = parse(cut.as_bytes(), &PATTERN, 0).unwrap();
        assert_eq!(track.circles, 2);
        assert!(track.notes.iter().any(|note| note.contains("line 4")), "{:?}", track.notes);
    }

    #[test]
    fn a_truncated_file_keeps_the_circles_before_the_cut() {
        let all = ordered(FOREIGN);
        let first_line = FOREIGN.find('\n').unwrap();
        for length in 0..FOREIGN.len() {
            match parse(&FOREIGN.as_bytes()[..length], &PATTERN, 0) {
                Ok(track) => {
                    let CircleFrames::Ordered(frames) = track.frames else { panic!("has places") };
                    let lines = FOREIGN[..length].lines().count() - 1;
                    assert!(track.circles <= lines && track.circles + 1 >= lines);
                    assert_eq!(frames[0].circles[0], all[0].circles[0]);
                }
                Err(_) => assert!(length < first_line + 80),
            }
        }
    }

    #[test]
    fn times_since_1970_get_an_origin() {
        let text = "t_us,x_px,y_px,column,row\n1643243628737093,1,1,0,0\n1643243628737593,2,1,1,0\n";
        let track = parse(text.as_bytes(), &PATTERN, 0).unwrap();
        assert_eq!(track.source.time_origin_us, 1_643_243_628_000_000);
        let CircleFrames::Ordered(frames) = track.frames else { panic!("has places") };
        assert_eq!(frames[0].circles[0].t, 0.737093);
        assert!(track.notes.iter().any(|note| note.contains("1643243628")), "{:?}", track.notes);
    }

    /// Numbers with the resolution of the file: millionths.
    fn number() -> impl Strategy<Value = f64> {
        let finite = any::<f64>().prop_filter("finite", |value| value.is_finite() && value.abs() < 1e6);
        prop_oneof![-1e3f64..1e3, finite].prop_map(|value| (value * 1e6).round() / 1e6 + 0.0)
    }

    fn circle() -> impl Strategy<Value = ObservedCircle> {
        let velocity = prop::option::of((number(), number()));
        (
            0usize..18,
            number(),
            (number(), number()),
            prop::option::of((500_000..100_000_000).prop_map(|radius| f64::from(radius) / 1e6)),
            velocity,
        )
            .prop_map(|(index, t, (x, y), radius, velocity)| ObservedCircle {
                index,
                t,
                center: Vector2::new(x, y),
                radius,
                velocity: velocity.map(|(x, y)| Vector2::new(x, y)),
            })
    }

    #[test]
    fn numbers_are_written_with_significant_digits_only() {
        let circle = ObservedCircle {
            index: 0,
            t: 0.032,
            center: Vector2::new(158.6337127685547, -0.00000001),
            radius: Some(4.827169895172119),
            velocity: None,
        };
        let (start, end, seen_in) = (0.027999999999999997, 0.1 + 0.2, SeenIn::Circles);
        let frame = ReferenceFrame { recording: 0, start, end, circles: vec![circle], seen_in };
        let mut bytes = Vec::new();
        write(&mut bytes, [&frame], &PATTERN, TrackSource::default()).unwrap();
        let text = String::from_utf8(bytes).unwrap();
        assert_eq!(text.lines().last(), Some("0,0.032,0.028,0.3,0,0,158.633713,0,4.82717,,"));
    }

    proptest! {
        #[test]
        fn written_tracks_are_read_back(
            frames in prop::collection::vec(prop::collection::vec(circle(), 1..18), 1..5), origin in any::<i64>(), width in any::<u16>()
        ) {
            let frames: Vec<ReferenceFrame> = frames
                .into_iter()
                .enumerate()
                .map(|(number, mut circles)| {
                    circles.sort_by_key(|circle| circle.index);
                    circles.dedup_by_key(|circle| circle.index);
                    let [start, end] = [10, 40].map(|after| f64::from(number as u32 * 100 + after) / 1e3);
                    ReferenceFrame { recording: 2, start, end, circles, seen_in: SeenIn::Circles }
                })
                .collect();
            let mut bytes = Vec::new();
            let source = TrackSource { sensor: (width > 0).then(|| Sensor::new(width, 260)), time_origin_us: origin };
            write(&mut bytes, &frames, &PATTERN, source).unwrap();
            prop_assert!(is_circle_track(std::str::from_utf8(&bytes).unwrap()));
            let track = parse(&bytes, &PATTERN, 2).unwrap();
            prop_assert_eq!(track.frames, CircleFrames::Ordered(frames));
            prop_assert_eq!((track.source, track.notes), (source, Vec::new()));
        }

        #[test]
        fn arbitrary_bytes_do_not_panic(bytes in prop::collection::vec(any::<u8>(), 0..300), text in "[0-9,.;#\n e-]{0,200}") {
            let _ = parse(&bytes, &PATTERN, 0);
            let _ = parse(format!("t_s,x_px,y_px,column,row,frame\n{text}").as_bytes(), &PATTERN, 0);
        }
    }
}
