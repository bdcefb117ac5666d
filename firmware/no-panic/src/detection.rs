//! Detection: from events to windows to circles.

use core::hint::black_box;

use evcal_core::circle::{CircleSettings, Extraction, fit_circle};
use evcal_core::cluster::{CentralMoments, ClusterSettings, PixelSums, row_bytes, row_count};
use evcal_core::detector::{Detector, DetectorSettings};
use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;
use evcal_core::window::{EventStorage, Outcome, Progress, WindowBuffer, WindowPlanner, WindowSettings, WindowState};
use nalgebra::RealField;

use crate::any;

/// Returns an event that is unknown to the compiler.
pub fn event() -> Event {
    let polarity = if black_box(true) { Polarity::On } else { Polarity::Off };
    black_box(Event { t: black_box(0), x: black_box(1), y: black_box(2), polarity: polarity.opposite() })
}

fn window_settings() -> WindowSettings {
    WindowSettings {
        step: black_box(1),
        min_interval: black_box(1),
        max_interval: black_box(1),
        gap: black_box(1),
        most_events: black_box(1),
        fewest_events: black_box(1),
    }
}

fn outcome() -> Outcome {
    if black_box(true) { Outcome::Found } else { Outcome::NotFound { unique_pixels: black_box(1) } }
}

/// Both front ends of the window policy.
#[inline(never)]
pub fn windows() {
    let mut storage = EventStorage::<64>::new();
    let mut buffer = WindowBuffer::new(window_settings(), black_box(0), black_box(&mut storage));
    let buffer = black_box(&mut buffer);
    while black_box(buffer.push(event())) == Progress::Complete {
        buffer.events().for_each(|event| {
            black_box(event);
        });
        black_box((buffer.window().center_us(), buffer.window().is_empty(), *buffer.counts()));
        black_box(buffer.report(outcome()));
    }
    let events = [event(); 8];
    let events: &[Event] = black_box(&events);
    let mut planner = WindowPlanner::new(window_settings(), black_box(0), black_box(0));
    let planner = black_box(&mut planner);
    while let Some(window) = planner.next(events) {
        black_box(window);
        planner.report(outcome());
    }
    black_box((planner.state(), planner.too_few_events()));
    let mut state = WindowState::new(window_settings(), black_box(0));
    let state = black_box(&mut state);
    state.report(outcome());
    state.skip_to(black_box(0));
    black_box((state.start_us(), state.end_us(), state.length()));
}

/// Clusters and circles, by either method.
#[inline(never)]
pub fn detector<T: RealField + Copy>() {
    type Detector346<T> = Detector<T, { row_bytes(346) }, { row_count(260) }, 2048, 128>;
    let mut detector = Detector346::<T>::new();
    let detector = black_box(&mut detector);
    let settings = DetectorSettings {
        cluster: ClusterSettings { epsilon: black_box(1.0), min_points: black_box(1), min_pixels: black_box(1) },
        extraction: if black_box(true) { Extraction::Hard } else { Extraction::Soft },
        circle: CircleSettings {
            neighbours: black_box(1),
            min_facing: any(),
            min_radius: any(),
            max_radius: any(),
            min_arc: any(),
            max_radius_ratio: any(),
            min_radius_ratio: any(),
            max_center_offset: any(),
            max_error: any(),
            max_relative_error: any(),
            max_soft_error: any(),
        },
    };
    let events = [event(); 8];
    let events: &[Event] = black_box(&events);
    let sensor = Sensor { width: black_box(1), height: black_box(1) };
    if let Ok(detection) = detector.detect(sensor, events.iter().copied(), &settings) {
        black_box((detection, detection.overflowed(), detection.clusters.unique_pixels()));
    }
    black_box(detector.circles());
    for polarity in [Polarity::On, Polarity::Off] {
        for cluster in detector.clusters(polarity) {
            black_box(cluster.extent());
            for run in detector.runs(cluster) {
                black_box(run.length());
                run.pixels().for_each(|pixel| {
                    black_box(pixel);
                });
            }
        }
    }
    moments::<T>();
}

#[inline(never)]
fn moments<T: RealField + Copy>() {
    let mut sums = PixelSums::default();
    let sums = black_box(&mut sums);
    sums.add_run(black_box(1), black_box(1), black_box(1));
    let moved = sums.moved(black_box(1), black_box(1));
    let (Some(moments), Some(others)) =
        (CentralMoments::<T>::new(sums, black_box(1), black_box(1)), CentralMoments::<T>::new(&moved, 0, 0))
    else {
        return;
    };
    black_box(fit_circle(&black_box(moments.joined(&others))));
}
