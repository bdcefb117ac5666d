//! Circle streams: the data of a detector on a microcontroller, from a file or a serial port.
//!
//! The frames are defined by `evcal-link` (`docs/layouts.md` describes them byte by byte). The circles of a window become a frame
//! of a [`CircleTrack`] without indices on the board, which the grid finder then determines. Damaged, lost and unknown frames
//! lose their content; all of them are counted and reported.

use evcal_core::sensor::Sensor;
use evcal_files::text;
use std::path::Path;

use evcal_link::{Circle, Decoder, DecoderCounts, Hello, Losses, Message, PROTOCOL_VERSION, Statistics, WindowEnd};
use nalgebra::Vector2;

use crate::circles::reference_frame::UnorderedCircle;
use crate::circles::reference_frame::UnorderedFrame;
use crate::circles::track::{CircleFrames, CircleTrack, CircleTrackError, TrackSource};

/// Time between the last window before a device restarted and the first one after, in microseconds: longer than the largest gap
/// within a trajectory.
const RESTART_GAP_US: i64 = 1_000_000;

/// A circle stream that was read to its end.
#[derive(Clone, Debug)]
pub struct CircleStream {
    /// The circles.
    pub track: CircleTrack,
    /// Last report of the device about itself.
    pub hello: Option<Hello>,
    /// Counts of the device since it started, as last reported.
    pub statistics: Option<Statistics>,
    /// Counts of the link.
    pub link: DecoderCounts,
}

/// Returns `true` if a file that begins with these bytes is a circle stream: a frame in it passes its checks.
pub fn is_circle_stream(head: &[u8]) -> bool {
    let mut decoder = Decoder::new();
    head.iter().any(|&byte| decoder.push(byte).is_some())
}

/// Reads the circle stream in the file at `path`.
///
/// # Errors
/// [`CircleTrackError`] if the file cannot be read or contains no circle.
pub fn read(path: &Path) -> Result<CircleStream, CircleTrackError> {
    let bytes = text::bytes(path, text::TABLE)
        .map_err(|error| CircleTrackError { path: path.to_owned(), kind: error.into() })?;
    let mut receiver = Receiver::new();
    receiver.push(&bytes);
    receiver.finish().ok_or_else(|| CircleTrackError {
        path: path.to_owned(),
        kind: crate::circles::track::CircleTrackErrorKind::Empty,
    })
}

/// A circle and its time in microseconds.
type TimedCircle = (i64, UnorderedCircle);

/// The circles of one window, on the clock of the whole stream.
struct WindowCircles {
    start_us: i64,
    end_us: i64,
    circles: Vec<TimedCircle>,
}

/// Decodes the bytes of a circle stream as they arrive.
#[derive(Default)]
pub struct Receiver {
    decoder: Decoder,
    hello: Option<Hello>,
    statistics: Option<Statistics>,
    windows: Vec<WindowCircles>,
    /// Number of the window whose circles are being received.
    number: Option<u32>,
    circles: Vec<TimedCircle>,
    /// Added to times of the device; grows when it restarts.
    offset_us: i64,
    last_us: i64,
    restarts: u32,
    not_finite: u64,
    without_end: u64,
    incomplete: u64,
    over_capacity: u64,
    losses: [u64; 7],
    /// The first sensor that the device reported.
    sensor: Option<Sensor>,
    /// The latest sensor that differs from the first.
    other_sensor: Option<Sensor>,
}

impl Receiver {
    /// Creates a receiver for the beginning of a stream, or any position in it.
    pub fn new() -> Self {
        Self::default()
    }

    /// Decodes the next bytes.
    pub fn push(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            if let Some(message) = self.decoder.push(byte) {
                self.take(message);
            }
        }
    }

    /// Returns the numbers of windows and circles so far.
    pub fn progress(&self) -> (usize, usize) {
        (self.windows.len(), self.windows.iter().map(|window| window.circles.len()).sum())
    }

    /// Returns `true` if a circle was received.
    pub fn has_circle(&self) -> bool {
        !self.windows.is_empty() || !self.circles.is_empty()
    }

    /// Returns the number of frames of the link that passed their checks so far.
    pub fn frames(&self) -> u32 {
        self.decoder.counts().frames
    }

    /// Returns the circles, and the counts of everything else; `None` without circles.
    pub fn finish(mut self) -> Option<CircleStream> {
        self.close_without_end();
        let origin_us = self.windows.first()?.start_us;
        let notes = self.notes();
        let seconds = |time_us: i64| time_us.saturating_sub(origin_us) as f64 * 1e-6;
        let circles = self.windows.iter().map(|window| window.circles.len()).sum();
        let frames = self.windows.into_iter().map(|window| UnorderedFrame {
            start: seconds(window.start_us),
            end: seconds(window.end_us),
            circles: window
                .circles
                .into_iter()
                .map(|(time_us, circle)| UnorderedCircle { t: seconds(time_us), ..circle })
                .collect(),
        });
        let track = CircleTrack {
            frames: CircleFrames::Unordered(frames.collect()),
            source: TrackSource { sensor: self.sensor, time_origin_us: origin_us },
            circles,
            notes,
        };
        Some(CircleStream { track, hello: self.hello, statistics: self.statistics, link: *self.decoder.counts() })
    }

    fn take(&mut self, message: Message) {
        match message {
            Message::Hello(hello) => {
                if hello.first && (self.hello.is_some() || !self.windows.is_empty()) {
                    self.restart(device_time(hello.time_us));
                }
                let sensor = Sensor::new(hello.sensor_width, hello.sensor_height);
                let sides = 1..=Sensor::MOST_PIXELS_A_SIDE;
                let is_possible = sides.contains(&sensor.width) && sides.contains(&sensor.height);
                if is_possible && *self.sensor.get_or_insert(sensor) != sensor {
                    self.other_sensor = Some(sensor);
                }
                self.hello = Some(hello);
            }
            Message::Circle(circle) => self.take_circle(&circle),
            Message::WindowEnd(end) => self.close(&end),
            Message::Statistics(statistics) => self.statistics = Some(statistics),
        }
    }

    fn take_circle(&mut self, circle: &Circle) {
        if self.number != Some(circle.window) {
            self.close_without_end();
        }
        let values = [circle.x, circle.y, circle.radius];
        if values.iter().any(|value| !value.is_finite()) {
            self.not_finite += 1;
            return;
        }
        self.number = Some(circle.window);
        let [x, y, radius] = values.map(f64::from);
        let unordered = UnorderedCircle { t: 0.0, center: Vector2::new(x, y), radius: Some(radius), velocity: None };
        self.circles.push((device_time(circle.time_us), unordered));
    }

    fn close(&mut self, end: &WindowEnd) {
        if self.number.is_some_and(|number| number != end.window) {
            self.close_without_end();
        }
        let capacity = [end.pixels_over_capacity, end.clusters_over_capacity, end.circles_over_capacity];
        self.over_capacity += u64::from(capacity.iter().any(|&count| count > 0));
        for (sum, lost) in self.losses.iter_mut().zip(causes(&end.losses)) {
            *sum += u64::from(lost.1);
        }
        self.incomplete += u64::from(self.circles.len() < usize::from(end.circles));
        let start_us = device_time(end.start_us);
        self.store(start_us, start_us.saturating_add(i64::from(end.length_us)));
    }

    /// Ends a window whose end was lost: its times follow from its circles.
    fn close_without_end(&mut self) {
        let times = || self.circles.iter().map(|(time_us, _)| *time_us);
        if let (Some(first), Some(last)) = (times().min(), times().max()) {
            self.without_end += 1;
            self.store(first, last);
        }
    }

    /// Stores the current circles as a window between two times of the device.
    fn store(&mut self, start_us: i64, end_us: i64) {
        self.number = None;
        let circles = std::mem::take(&mut self.circles);
        if circles.is_empty() {
            return;
        }
        if start_us.saturating_add(self.offset_us) < self.last_us {
            self.restart(start_us);
        }
        let shift = |time_us: i64| time_us.saturating_add(self.offset_us);
        let window = WindowCircles {
            start_us: shift(start_us),
            end_us: shift(end_us),
            circles: circles.into_iter().map(|(time_us, circle)| (shift(time_us), circle)).collect(),
        };
        self.last_us = window.start_us;
        self.windows.push(window);
    }

    /// Handles a restart of the device's clock at `time_us`; the time of the stream continues.
    fn restart(&mut self, time_us: i64) {
        self.close_without_end();
        self.restarts += 1;
        let last_us = self.windows.last().map_or(0, |window| window.end_us);
        self.offset_us = last_us.saturating_add(RESTART_GAP_US).saturating_sub(time_us);
        self.last_us = i64::MIN;
    }

    /// Returns notes for the user, as sentences.
    fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if let Some(hello) = &self.hello {
            notes.push(format!("sent by {:?}, {} x {} pixels", hello.device, hello.sensor_width, hello.sensor_height));
            if hello.protocol > PROTOCOL_VERSION {
                notes.push(format!(
                    "the device speaks version {} of the circle stream, this program {PROTOCOL_VERSION}: some of it may not be understood",
                    hello.protocol
                ));
            }
        }
        if let (Some(first), Some(last)) = (self.sensor, self.other_sensor) {
            notes.push(format!("the device changed its sensor from {first} to {last} pixels: is it one recording?"));
        }
        let link = self.decoder.counts();
        for (count, what) in [
            (u64::from(link.damaged), "frames of the link arrived damaged and were dropped"),
            (u64::from(link.lost), "frames of the link are missing: damaged, lost on the way or never sent"),
            (u64::from(link.unknown), "frames have an unknown type: the device is newer than this program"),
            (u64::from(link.malformed), "frames are intact but invalid: the device is faulty"),
            (u64::from(self.restarts), "times the device restarted; the times after it are shifted"),
            (self.without_end, "windows lack their end"),
            (self.incomplete, "windows lack some of their circles"),
            (self.not_finite, "circles are not numbers and were dropped"),
            (self.over_capacity, "windows exceeded the capacity of the detector"),
        ] {
            if count > 0 {
                notes.push(format!("{count} {what}"));
            }
        }
        let lost = self.losses.iter().zip(causes(&Losses::default())).filter(|(count, _)| **count > 0);
        let lost: Vec<String> = lost.map(|(count, (cause, _))| format!("{count} {cause}")).collect();
        if !lost.is_empty() {
            notes.push(format!("events that reached no window on the device: {}", lost.join(", ")));
        }
        notes
    }
}

/// Times of a device fit into 63 bits for 292 000 years.
fn device_time(time_us: u64) -> i64 {
    i64::try_from(time_us).unwrap_or(i64::MAX / 4).min(i64::MAX / 4)
}

/// Returns the causes of lost events, with counts.
fn causes(losses: &Losses) -> [(&'static str, u32); 7] {
    [
        ("undecodable", losses.undecodable),
        ("of hot pixels", losses.hot),
        ("without a neighbour", losses.background),
        ("of refractory pixels", losses.refractory),
        ("dropped for lack of time", losses.shed),
        ("beyond the capacity of a window", losses.overflow),
        ("between windows", losses.in_gap),
    ]
}

#[cfg(test)]
mod tests {
    use evcal_link::{DeviceName, Encoder};

    use super::*;

    fn hello(first: bool) -> Message {
        let device = DeviceName::try_from("test 1").unwrap();
        Message::Hello(Hello {
            protocol: PROTOCOL_VERSION,
            first,
            device,
            sensor_width: 320,
            sensor_height: 240,
            ..Hello::default()
        })
    }

    /// The messages of a window of `count` circles that starts at `start_us` and is 4 ms long.
    fn window(number: u32, start_us: u64, count: u16) -> Vec<Message> {
        let circle = |index: u16| {
            let x = 10.0 * f32::from(index) + 0.25;
            let time_us = start_us + 2000;
            Message::Circle(Circle { window: number, time_us, x, y: 7.5, radius: 4.0, ..Circle::default() })
        };
        let losses = Losses { shed: 3, ..Losses::default() };
        let end =
            WindowEnd { window: number, start_us, length_us: 4000, circles: count, losses, ..WindowEnd::default() };
        (0..count).map(circle).chain([Message::WindowEnd(end)]).collect()
    }

    fn encode(messages: &[Message]) -> Vec<Vec<u8>> {
        let mut encoder = Encoder::new();
        messages.iter().map(|message| encoder.encode(message).to_vec()).collect()
    }

    fn receive(bytes: &[u8]) -> Option<CircleStream> {
        let mut receiver = Receiver::new();
        for part in bytes.chunks(5) {
            receiver.push(part);
        }
        receiver.finish()
    }

    fn frames(stream: &CircleStream) -> &[UnorderedFrame] {
        match &stream.track.frames {
            CircleFrames::Unordered(frames) => frames,
            CircleFrames::Ordered(_) => panic!("a stream knows no places"),
        }
    }

    #[test]
    fn windows_become_frames() {
        let messages = [vec![hello(true)], window(0, 5_000_000, 2), window(1, 5_010_000, 0), window(2, 5_020_000, 3)];
        let stream = receive(&encode(&messages.concat()).concat()).unwrap();
        assert_eq!((stream.track.source.sensor, stream.track.circles), (Some(Sensor::new(320, 240)), 5));
        assert_eq!(stream.track.source.time_origin_us, 5_000_000);
        let [first, second] = frames(&stream) else { panic!() };
        assert_eq!((first.start, first.end, first.circles.len()), (0.0, 0.004, 2));
        assert_eq!((second.start, second.end, second.circles.len()), (0.02, 0.024, 3));
        let expected =
            UnorderedCircle { t: 0.022, center: Vector2::new(20.25, 7.5), radius: Some(4.0), velocity: None };
        assert_eq!(second.circles[2], expected);
        assert_eq!(
            stream.track.notes,
            [
                "sent by \"test 1\", 320 x 240 pixels",
                "events that reached no window on the device: 9 dropped for lack of time"
            ]
        );
    }

    #[test]
    fn a_lost_end_and_lost_circles_are_reported() {
        let messages = [vec![hello(true)], window(0, 0, 2), window(1, 10_000, 2), window(2, 20_000, 2)].concat();
        let mut parts = encode(&messages);
        parts[5].clear(); // a circle of window 1
        parts[3].clear(); // the end of window 0
        let stream = receive(&parts.concat()).unwrap();
        assert_eq!(frames(&stream).iter().map(|frame| frame.circles.len()).collect::<Vec<_>>(), [2, 1, 2]);
        assert_eq!((frames(&stream)[0].start, frames(&stream)[0].end), (0.0, 0.0));
        let notes = stream.track.notes.join("; ");
        for part in ["2 frames of the link are missing", "1 windows lack their end", "1 windows lack some"] {
            assert!(notes.contains(part), "{notes}");
        }
    }

    #[test]
    fn time_continues_when_a_device_restarts() {
        let run = [vec![hello(true)], window(0, 1000, 1), window(1, 11_000, 1)].concat();
        let bytes = encode(&run).concat();
        // The first message of the second run arrives, that of the third does not.
        let third = encode(&run)[1..].concat();
        let stream = receive(&[bytes.clone(), bytes, third].concat()).unwrap();
        let starts: Vec<f64> = frames(&stream).iter().map(|frame| frame.start).collect();
        assert!(starts.is_sorted() && starts.len() == 6, "{starts:?}");
        assert!(starts[2] - starts[1] > 1.0 && starts[4] - starts[3] > 1.0, "{starts:?}");
        assert!((starts[3] - starts[2] - 0.01).abs() < 1e-9, "{starts:?}");
        assert!(stream.track.notes.iter().any(|note| note.starts_with("2 times the device restarted")));
    }

    /// The restarts move times towards both ends of the range of 64 bits. Their difference must not overflow.
    #[test]
    fn restarts_with_extreme_times_do_not_overflow() {
        let hello_at = |time_us| Message::Hello(Hello { first: true, time_us, ..Hello::default() });
        let mut messages = vec![hello(true), hello_at(u64::MAX)];
        messages.extend(window(0, 0, 1));
        for number in 1..8 {
            messages.push(hello_at(0));
            messages.extend(window(number, u64::MAX / 8, 1));
        }
        let stream = receive(&encode(&messages).concat()).unwrap();
        let starts: Vec<f64> = frames(&stream).iter().map(|frame| frame.start).collect();
        assert!(stream.track.source.time_origin_us < 0 && starts.len() == 8 && starts.is_sorted(), "{starts:?}");
    }

    #[test]
    fn a_change_of_the_sensor_is_reported_with_the_first_and_the_last_size() {
        let mut messages = window(0, 0, 1);
        for sensor_width in [320, 640, 320, 346, 320] {
            messages.push(Message::Hello(Hello { sensor_width, sensor_height: 240, ..Hello::default() }));
        }
        let stream = receive(&encode(&messages).concat()).unwrap();
        assert_eq!(stream.track.source.sensor, Some(Sensor::new(320, 240)));
        let notes = stream.track.notes.join("; ");
        assert!(notes.contains("changed its sensor from 320 x 240 to 346 x 240 pixels"), "{notes}");
    }

    /// A sensor of 65,535 × 65,535 pixels filled the memory.
    #[test]
    fn an_impossible_sensor_is_not_taken() {
        let hello = |sensor_width, sensor_height| Hello { sensor_width, sensor_height, ..Hello::default() };
        for (width, height, taken) in [(u16::MAX, 260, None), (346, u16::MAX, None), (346, 260, Some(()))] {
            let messages = [vec![Message::Hello(hello(width, height))], window(0, 0, 1)].concat();
            let sensor = receive(&encode(&messages).concat()).unwrap().track.source.sensor;
            assert_eq!(sensor, taken.map(|()| Sensor::new(width, height)));
        }
    }

    #[test]
    fn streams_are_recognised_and_other_bytes_are_not() {
        let messages = [vec![hello(true)], window(0, 0, 2)].concat();
        let bytes = encode(&messages).concat();
        assert!(is_circle_stream(&bytes) && is_circle_stream(&bytes[9..]));
        for other in [b"".as_slice(), b"t_us,x,y,p\n1,2,3,1\n", &[0; 1000], &bytes[..20]] {
            assert!(!is_circle_stream(other));
            assert!(receive(other).is_none());
        }
        assert!(receive(&encode(&[hello(true)]).concat()).is_none());
    }

    #[test]
    fn circles_that_are_not_numbers_are_dropped() {
        let bad = |x| Message::Circle(Circle { x, radius: 1.0, ..Circle::default() });
        let stream = receive(&encode(&[bad(f32::NAN), bad(f32::INFINITY), bad(3.0)]).concat()).unwrap();
        assert_eq!(stream.track.circles, 1);
        assert!(stream.track.notes.iter().any(|note| note.starts_with("2 circles are not numbers")));
    }
}
