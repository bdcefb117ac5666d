//! The pipeline sends the circles that it finds, and counts its losses.

use std::vec::Vec;

use evcal_core::budget::EventBudget;
use evcal_core::decode::Evt2Encoder;
use evcal_core::event::{Event, Polarity};
use evcal_core::filter::FilterSettings;
use evcal_core::sensor::Sensor;
use evcal_core::window::Progress;
use evcal_link::{Decoder, Losses, Message};

use super::*;

type Storage346 = Storage<{ row_bytes(346) }, { row_count(260) }, 2048, 128, 4000, 1452, 512>;

const SENSOR: Sensor = Sensor { width: 346, height: 260 };

/// Returns settings without filter and shedding, for a board of `circles` dots.
fn settings(circles: u16) -> Settings {
    let filter = FilterSettings { hot_events: 0, refractory_us: 0, background_us: 0, ..FilterSettings::default() };
    let budget = EventBudget { events_per_second: u32::MAX, burst: u32::MAX };
    Settings { filter, budget, ..Settings::new("test", SENSOR, circles) }
}

/// Returns the events of 36 dots of radius 8 px that move to the right at 500 px/s for a time: every pixel triggers an
/// event when an edge crosses it.
fn moving_dots(duration_us: i64) -> Vec<Event> {
    let mut events = Vec::new();
    for dot in 0..36 {
        let (left, top) = (f64::from(30 + (dot % 9) * 32), f64::from(40 + (dot / 9) * 50));
        for row in -7..=7 {
            let half = (64.0 - f64::from(row * row)).sqrt();
            for (side, polarity) in [(-half, Polarity::On), (half, Polarity::Off)] {
                for t in (0..duration_us).step_by(100) {
                    let before = left + side + 500e-6 * (t - 100) as f64;
                    let after = left + side + 500e-6 * t as f64;
                    if before.floor() < after.floor() {
                        events.push(Event { t, x: after.floor() as u16, y: (top + f64::from(row)) as u16, polarity });
                    }
                }
            }
        }
    }
    events.sort_by_key(|event| event.t);
    events
}

/// Returns all messages for these events, and the statistics at the end.
fn run(settings: Settings, events: &[Event], mut room: impl FnMut() -> bool) -> (Vec<Message>, evcal_link::Statistics) {
    let mut storage = std::boxed::Box::new(Storage346::new());
    let mut pipeline = Pipeline::new(settings, &mut storage).unwrap();
    let mut decoder = Decoder::new();
    let mut messages = Vec::new();
    let mut send = |frame: &[u8]| {
        let sent = room();
        if sent {
            messages.extend(frame.iter().filter_map(|&byte| decoder.push(byte)));
        }
        sent
    };
    pipeline.announce(0, &mut send);
    for &event in events {
        let mut progress = pipeline.push(event);
        while progress == Progress::Complete {
            pipeline.detect();
            progress = pipeline.report(&mut send);
        }
    }
    (messages, pipeline.statistics())
}

#[test]
fn the_dots_are_sent_with_their_positions() {
    let (messages, statistics) = run(settings(36), &moving_dots(40_000), || true);
    assert!(matches!(&messages[0], Message::Hello(hello) if hello.first && hello.sensor_width == 346));
    let circles: Vec<_> = messages
        .iter()
        .filter_map(|message| match message {
            Message::Circle(circle) => Some(*circle),
            _ => None,
        })
        .collect();
    assert!(statistics.windows_sent >= 2 && circles.len() >= 60, "{statistics:?}");
    for circle in &circles {
        let moved = 500e-6 * circle.time_us as f32;
        // The circle belongs to the middle of its window. The tolerance is 1 px along the motion and 0.5 px across it.
        let (column, row) = ((circle.x - 30.0 - moved) / 32.0, (circle.y - 40.0) / 50.0);
        assert!((column - column.round()).abs() * 32.0 < 1.0 && (row - row.round()).abs() * 50.0 < 0.5, "{circle:?}");
        assert!((circle.radius - 8.0).abs() < 1.0, "{circle:?}");
    }
    // Each window ends with its count of circles.
    for message in &messages {
        if let Message::WindowEnd(end) = message {
            let sent = circles.iter().filter(|circle| circle.window == end.window).count();
            assert_eq!(sent, usize::from(end.circles));
            assert!(sent >= 30);
        }
    }
}

#[test]
fn filtered_and_shed_events_are_counted() {
    let budget = EventBudget { events_per_second: 50_000, burst: 1000 };
    let mut events = moving_dots(60_000);
    events.push(Event { t: 60_001, x: 346, y: 0, polarity: Polarity::On });
    let (_, statistics) = run(Settings { budget, filter: FilterSettings::default(), ..settings(36) }, &events, || true);
    let losses = statistics.losses;
    assert_eq!((statistics.events as usize, losses.undecodable, losses.overflow), (events.len(), 1, 0));
    assert!(losses.shed > 0 && losses.background > 0, "{losses:?}");
}

#[test]
fn frames_lost_in_a_full_output_are_counted_by_both_sides() {
    let mut number = 0;
    let (messages, statistics) = run(settings(36), &moving_dots(40_000), || {
        number += 1;
        number % 5 != 0
    });
    assert!(statistics.frames_unsent > 10);
    assert_eq!(messages.len() as u32 + statistics.frames_unsent, number);
}

#[test]
fn losses_are_sent_with_the_windows() {
    let mut events = moving_dots(60_000);
    // The first part of the stream also contains events outside the sensor.
    for index in 0..50 {
        events.insert(index * 20, Event { x: 400, ..events[index * 20] });
    }
    let (messages, statistics) = run(settings(36), &events, || true);
    let sent = messages.iter().fold(Losses::default(), |sum, message| match message {
        Message::WindowEnd(end) => Losses {
            undecodable: sum.undecodable + end.losses.undecodable,
            in_gap: sum.in_gap + end.losses.in_gap,
            ..sum
        },
        _ => sum,
    });
    assert_eq!(sent.undecodable, 50);
    assert!(sent.in_gap > 0 && sent.in_gap <= statistics.losses.in_gap);
}

#[test]
fn a_sensor_beyond_the_storage_is_rejected() {
    let mut storage = std::boxed::Box::new(Storage346::new());
    let settings = Settings::new("test", Sensor { width: 640, height: 480 }, 36);
    assert!(matches!(Pipeline::new(settings, &mut storage), Err(SetupError::Detector(_))));
}

#[test]
fn bytes_and_words_decode_to_the_same_events() {
    let events = moving_dots(5000);
    let mut encoder = Evt2Encoder::new();
    let words: Vec<u32> = events.iter().flat_map(|&event| encoder.encode(event).unwrap().to_vec()).collect();
    let mut source = Source::evt2();
    let by_words: Vec<Event> = words.iter().filter_map(|&word| source.push_word(word)).collect();
    let mut source = Source::evt2();
    let by_bytes: Vec<Event> =
        words.iter().flat_map(|word| word.to_le_bytes()).filter_map(|byte| source.push(byte)).collect();
    assert_eq!(by_words, events);
    assert_eq!(by_bytes, events);
    assert_eq!(source.undecodable(), 0);
}
