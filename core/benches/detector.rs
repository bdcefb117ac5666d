//! Speed of the stages from the events of a window to circle candidates: `cargo bench --bench detector`.
//!
//! The window is synthetic: 36 dots of radius 9 px on a 346×260 sensor that move by 1.5 px, each event at a pixel of
//! the swept edge, plus the given number of noise events.

use divan::Bencher;
use divan::counter::ItemsCount;
use evcal_core::circle::Extraction;
use evcal_core::cluster::{row_bytes, row_count};
use evcal_core::detector::{Detector, DetectorSettings};
use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;
use evcal_core::window::{Outcome, WindowPlanner, WindowSettings};

fn main() {
    divan::main();
}

const SENSOR: Sensor = Sensor { width: 346, height: 260 };

type Detector346<T> = Detector<T, { row_bytes(346) }, { row_count(260) }, 4096, 256>;

/// Generator of uniformly distributed numbers in [0, 1): xorshift64*.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// Returns `count` events of the dots, sorted by time over `duration_us`, and `noise` events anywhere on the sensor.
fn window(count: usize, noise: usize, duration_us: i64) -> Vec<Event> {
    let mut random = Random(0x1234_5678_9abc_def1);
    let mut events: Vec<Event> = (0..count + noise)
        .map(|index| {
            let moment = random.next();
            let t = (moment * duration_us as f64) as i64;
            if index >= count {
                let polarity = if random.next() < 0.5 { Polarity::Off } else { Polarity::On };
                return Event { t, x: (random.next() * 346.0) as u16, y: (random.next() * 260.0) as u16, polarity };
            }
            let dot = (random.next() * 36.0) as usize;
            let (row, column) = (dot / 4, dot % 4);
            let center_x = 60.0 + (2 * column + row % 2) as f64 * 30.0 + (moment - 0.5) * 1.5;
            let center_y = 20.0 + row as f64 * 27.0;
            // The number of events of an edge is proportional to its speed perpendicular to itself.
            let angle = (2.0 * random.next() - 1.0).asin();
            let (sin, cos) = angle.sin_cos();
            let polarity = if random.next() < 0.5 { Polarity::Off } else { Polarity::On };
            let side = if polarity == Polarity::Off { 1.0 } else { -1.0 };
            let radius = 9.0 + (random.next() - 0.5) * 0.6;
            let (x, y) = (center_x + side * radius * cos, center_y + radius * sin);
            Event { t, x: x.round() as u16, y: y.round() as u16, polarity }
        })
        .collect();
    events.sort_by_key(|event| event.t);
    events
}

fn detect<T: nalgebra::RealField + Copy>(bencher: Bencher<'_, '_>, noise: usize, extraction: Extraction) {
    let events = window(4000 - noise, noise, 3000);
    let mut detector = Box::new(Detector346::<T>::new());
    let settings = DetectorSettings { extraction, ..DetectorSettings::default() };
    let detection = detector.detect(SENSOR, events.iter().copied(), &settings).expect("the sensor fits");
    assert!(detection.circles.circles >= 30, "{detection:?}");
    bencher
        .counter(ItemsCount::new(events.len()))
        .bench_local(|| detector.detect(SENSOR, divan::black_box(&events).iter().copied(), &settings));
}

#[divan::bench(args = [0, 400, 1200])]
fn hard_f64(bencher: Bencher<'_, '_>, noise: usize) {
    detect::<f64>(bencher, noise, Extraction::Hard);
}

#[divan::bench(args = [0, 400, 1200])]
fn hard_f32(bencher: Bencher<'_, '_>, noise: usize) {
    detect::<f32>(bencher, noise, Extraction::Hard);
}

#[divan::bench(args = [0, 400, 1200])]
fn soft_f64(bencher: Bencher<'_, '_>, noise: usize) {
    detect::<f64>(bencher, noise, Extraction::Soft);
}

/// The window policy alone, over 60 ms; every second window contains the pattern.
#[divan::bench]
fn window_planner(bencher: Bencher<'_, '_>) {
    let events = window(80_000, 0, 60_000);
    bencher.counter(ItemsCount::new(events.len())).bench_local(|| {
        let mut planner = WindowPlanner::new(WindowSettings::default(), 0, 60_000);
        let mut windows = 0_u32;
        while let Some(window) = planner.next(divan::black_box(&events)) {
            windows += 1;
            let unique_pixels = window.len() as u32;
            planner.report(if windows.is_multiple_of(2) {
                Outcome::Found
            } else {
                Outcome::NotFound { unique_pixels }
            });
        }
        windows
    });
}
