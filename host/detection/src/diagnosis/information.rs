//! Summary of a recording.

mod other_span;
mod statistics;
mod text;

use std::ops::ControlFlow;

use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;
use evcal_files::visible;
use serde::{Serialize, Serializer};

pub use self::other_span::OtherSpan;
use self::statistics::Statistics;
use crate::diagnosis::flicker::Flicker;
use crate::diagnosis::silent_lines::SilentLines;
use crate::diagnosis::time_steps::CoarseTimes;
use event_recordings::date::date;
use event_recordings::likely_sensor::likely_sensor;
use event_recordings::{ReadReport, Recording, RecordingError, StreamSummary};

/// Number of gaps and hot pixels that are listed.
const LISTED: usize = 10;
/// Summary of a recording.
#[derive(Debug, Serialize)]
pub struct Information {
    /// The file.
    pub path: String,
    /// Name of its format.
    pub format: &'static str,
    /// Model and serial number of the camera.
    pub camera_name: Option<String>,
    /// Time of the recording, if the file contains it.
    pub began: Option<String>,
    /// Width and height of the sensor in pixels, if known.
    pub sensor: Option<Sensor>,
    /// The smallest usual sensor that contains all events, if the recording does not name one.
    pub likely_sensor: Option<Sensor>,
    /// Timestamps of the first and the last event in µs.
    pub times_us: Option<(i64, i64)>,
    /// Time from the first to the last event in seconds.
    pub duration_s: f64,
    /// Number of events.
    pub events: u64,
    /// Share of ON events, 0 to 1; `None` without events.
    pub on_share: Option<f64>,
    /// Events per second over the whole recording.
    pub mean_rate: f64,
    /// The 10 ms with the most events.
    pub peak: Option<Peak>,
    /// Times when the readout was saturated; `None` if it never was.
    pub saturation: Option<SaturatedReadout>,
    /// Flicker of the light, if there is any.
    pub flicker: Option<Flicker>,
    /// Resolution of the timestamps, if they are coarser than a camera's.
    pub coarse_times: Option<CoarseTimes>,
    /// Number of intervals of more than 0.1 s without events.
    pub gap_count: u64,
    /// The longest gaps, in the order of time.
    pub longest_gaps: Vec<Gap>,
    /// Number of pixels that sent an event.
    pub active_pixels: u64,
    /// Number of pixels with more than ten times the events of the median active pixel, and more than 50.
    pub hot_pixel_count: u64,
    /// The hot pixels with the most events.
    pub hottest_pixels: Vec<HotPixel>,
    /// Columns without events, if most columns have many.
    pub dead_columns: Vec<u16>,
    /// Rows without events, if most rows have many.
    pub dead_rows: Vec<u16>,
    /// Meaning of the columns and rows without events.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub silent: Option<SilentLines>,
    /// Everything in the file, by stream; empty for formats with one stream of events.
    pub streams: Vec<StreamSummary>,
    /// Streams whose time span differs from the events' time span.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub other_spans: Vec<OtherSpan>,
    /// Statistics of the reader.
    pub report: ReadReport,
    /// Assumptions of the reader.
    pub notes: Vec<String>,
    /// Reason why reading stopped before the end.
    #[serde(serialize_with = "serialize_error")]
    pub error: Option<RecordingError>,
}

/// Serialises the error without the file name.
fn serialize_error<S: Serializer>(error: &Option<RecordingError>, serializer: S) -> Result<S::Ok, S::Error> {
    error.as_ref().map(|error| error.kind.to_string()).serialize(serializer)
}

/// The 10 ms of a recording with the most events.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Peak {
    /// Events per second.
    pub rate: f64,
    /// Time in seconds after the first event.
    pub t_s: f64,
}

/// Saturation of the readout, in which events are late.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SaturatedReadout {
    /// Events per second that the readout can send.
    pub rate: f64,
    /// Duration of the saturation in seconds.
    pub duration_s: f64,
    /// Start of the first saturated interval, in seconds after the first event.
    pub t_s: f64,
}

/// A time without events.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Gap {
    /// Start in seconds after the first event.
    pub t_s: f64,
    /// Duration in seconds.
    pub duration_s: f64,
}

/// A pixel that sends far more events than others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct HotPixel {
    /// Column.
    pub x: u16,
    /// Row.
    pub y: u16,
    /// Number of its events.
    pub events: u64,
}

/// Reads the whole recording once.
///
/// # Errors
/// [`RecordingError`] if it cannot be opened. A later error is stored in [`Information::error`], with the statistics of
/// everything before it.
pub fn gather(recording: &Recording) -> Result<Information, RecordingError> {
    let mut information = gather_while(recording, &mut |_| ControlFlow::Continue(()))?;
    information.streams = recording.streams()?;
    // While a file is written, its other streams are longer than the events that were read before.
    if recording.source_files().check().is_ok() {
        let other_span = |stream| OtherSpan::new(stream, information.times_us?);
        information.other_spans = information.streams.iter().filter_map(other_span).collect();
    }
    let extras = recording.open_extras()?;
    information.notes.extend(extras.chosen().into_iter().chain(extras.passed_over()));
    Ok(information)
}

/// Does the same as [`gather`] for the events alone, which it passes to `visit` until it returns `Break`:
/// [`Information::streams`] is empty.
///
/// # Errors
/// As for [`gather`].
pub fn gather_while(
    recording: &Recording,
    visit: &mut dyn FnMut(&[Event]) -> ControlFlow<()>,
) -> Result<Information, RecordingError> {
    let mut reader = recording.open()?;
    let mut statistics = Statistics::default();
    let mut events = Vec::new();
    let error = loop {
        match reader.next_batch(&mut events) {
            Ok(true) => {
                events.iter().for_each(|event| statistics.add(event));
                if visit(&events).is_break() {
                    break None;
                }
            }
            Ok(false) => break None,
            Err(error) => break Some(error),
        }
    };
    let known = reader.information();
    let times_us = statistics.first.map(|first| (first, statistics.latest));
    let duration_s = times_us.map_or(0.0, |(first, last)| seconds(last - first));
    let (hot_pixel_count, hottest_pixels) = statistics.hot_pixels();
    let coarse_times = statistics.steps.coarse(statistics.first.unwrap_or(0));
    let may_flicker = !coarse_times.is_some_and(|times| times.looks_like_flicker());
    let likely_sensor = match known.sensor {
        None if statistics.events > 0 => likely_sensor(statistics.largest.0, statistics.largest.1),
        _ => None,
    };
    Ok(Information {
        path: visible::path(recording.path()),
        format: known.format,
        camera_name: known.camera_name.clone(),
        began: known.began.clone().or_else(|| date(statistics.first?)),
        sensor: known.sensor,
        likely_sensor,
        times_us,
        duration_s,
        events: statistics.events,
        on_share: (statistics.events > 0).then(|| statistics.on_events as f64 / statistics.events as f64),
        mean_rate: if duration_s > 0.0 { statistics.events as f64 / duration_s } else { 0.0 },
        peak: statistics.peak(),
        saturation: statistics.saturation(),
        flicker: statistics.bins.flicker().filter(|_| may_flicker),
        coarse_times,
        gap_count: statistics.gap_count,
        longest_gaps: statistics.gaps(),
        active_pixels: statistics.pixels.len() as u64,
        hot_pixel_count,
        hottest_pixels,
        dead_columns: statistics.dead_lines(|x, _| x),
        dead_rows: statistics.dead_lines(|_, y| y),
        silent: known.sensor.or(likely_sensor).and_then(|sensor| statistics.silent(sensor)),
        streams: Vec::new(),
        other_spans: Vec::new(),
        report: reader.report().clone(),
        notes: known.notes.clone(),
        error,
    })
}

fn seconds(microseconds: i64) -> f64 {
    microseconds as f64 / 1e6
}

impl Information {
    /// Returns the polarity of all events, if they have only one.
    pub fn only_polarity(&self) -> Option<Polarity> {
        match self.on_share? {
            0.0 => Some(Polarity::Off),
            1.0 => Some(Polarity::On),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use event_recordings::RecordingOptions;
    use event_recordings::encode::OutputFormat;
    use event_recordings::write::EventWriter;

    fn of(path: &Path) -> Information {
        gather(&Recording::new(path, RecordingOptions::default()).unwrap()).unwrap()
    }

    /// 1000 events at 1 kev/s cycling over 100 pixels, 500 in 5 ms from 2 s on at (7, 7), and one at 3 s.
    fn write(path: &Path, output: OutputFormat) {
        let on = |index: i64| if index % 4 == 0 { Polarity::On } else { Polarity::Off };
        let calm = (0..1000).map(|index| Event { t: index * 1000, x: index as u16 % 100, y: 9, polarity: on(index) });
        let burst = (0..500).map(|index| Event { t: 2_000_000 + index * 10, x: 7, y: 7, polarity: on(index) });
        let last = Event { t: 3_000_000, x: 345, y: 259, polarity: Polarity::Off };
        let events: Vec<Event> = calm.chain(burst).chain([last]).collect();
        let mut writer = EventWriter::create(path, output, Sensor::new(346, 260), "camera 1").unwrap();
        writer.write(&events).unwrap();
        writer.finish().unwrap();
    }

    #[test]
    fn statistics_agree_with_the_events() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("recording.aedat4");
        write(&path, OutputFormat::from_extension(&path).unwrap());
        let information = of(&path);
        assert_eq!((information.events, information.times_us), (1501, Some((0, 3_000_000))));
        assert_eq!(information.on_share, Some(375.0 / 1501.0));
        assert_eq!(information.mean_rate, 1501.0 / 3.0);
        assert_eq!(information.peak, Some(Peak { rate: 50_000.0, t_s: 2.0 }));
        let gaps = [Gap { t_s: 0.999, duration_s: 1.001 }, Gap { t_s: 2.00499, duration_s: 0.99501 }];
        assert_eq!((information.gap_count, information.longest_gaps.as_slice()), (2, gaps.as_slice()));
        let hottest = [HotPixel { x: 7, y: 7, events: 500 }];
        assert_eq!((information.active_pixels, information.hot_pixel_count), (102, 1));
        assert_eq!(information.hottest_pixels, hottest);
        assert_eq!(information.streams.len(), 1);
        assert_eq!(information.streams[0].elements, 1501);
        assert_eq!((information.sensor, information.likely_sensor), (Some(Sensor::new(346, 260)), None));
        let text = information.to_string();
        for part in ["AEDAT4", "camera 1", "346 x 260", "25.0 % ON", "(7, 7): 500"] {
            assert!(text.contains(part), "{text}");
        }
        assert!(serde_json::to_string(&information).unwrap().contains("\"gap_count\":2"));
    }

    /// A pixel of a short recording with eleven events must not be called hot, in agreement with the verdict of a calibration.
    #[test]
    fn few_events_do_not_make_a_pixel_hot() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("recording.csv");
        let lines = |count: usize| {
            let calm = (0..100).map(|x| format!("{x},{x},9,1\n"));
            "t_us,x,y,p\n".to_owned()
                + &calm.chain((0..count).map(|t| format!("{},7,7,1\n", 100 + t))).collect::<String>()
        };
        for (count, hot) in [(50, 0), (51, 1)] {
            std::fs::write(&path, lines(count)).unwrap();
            assert_eq!(of(&path).hot_pixel_count, hot, "{count}");
        }
    }

    #[test]
    fn a_sensor_that_is_not_given_is_guessed() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("recording.bin");
        write(&path, OutputFormat::from_extension(&path).unwrap());
        let information = of(&path);
        assert_eq!((information.sensor, information.likely_sensor), (None, Some(Sensor::new(346, 260))));
    }

    #[test]
    fn an_error_keeps_the_statistics_before_it() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("recording.csv");
        std::fs::write(&path, "t_us,x,y,p\n1,2,3,1\n2,2,3,1\n3,2,3,nan\n").unwrap();
        let information = of(&path);
        assert_eq!(information.events, 2);
        assert!(information.error.unwrap().to_string().contains("line 4"));
    }

    /// The largest rate over 10 ms used to be below the mean rate.
    #[test]
    fn a_recording_of_milliseconds_has_no_largest_rate() {
        let of = |step: i64| {
            let event = |index: i64| Event { t: index * step, x: 1, y: 2, polarity: Polarity::On };
            let events = (0..=3000).map(event).collect();
            let recording = Recording::from_events("events", events, RecordingOptions::default());
            gather_while(&recording, &mut |_| ControlFlow::Continue(())).unwrap()
        };
        let (short, long) = (of(1), of(4));
        assert_eq!(short.peak, None);
        assert!(long.peak.is_some_and(|peak| peak.rate >= 0.8 * long.mean_rate), "{:?}", long.peak);
        assert!(short.to_string().contains("mean 1.000 Mev/s\n"), "{short}");
    }
}
