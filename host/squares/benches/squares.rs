//! Cost per event of the reconstruction of pictures, and cost per picture of finding its board.

use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;
use evcal_squares::checkerboard::find_checkerboard;
use evcal_squares::picture::Picture;
use evcal_squares::quads::find_quads;
use evcal_squares::reconstruction::{Reconstruction, ReconstructionOptions};

const SENSOR: Sensor = Sensor { width: 346, height: 260 };
const EVENTS: i64 = 2_000_000;
const SQUARE: usize = 24;

fn main() {
    // On one core, so that the figures are processor time.
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global().unwrap();
    divan::main();
}

/// Returns one event per microsecond: rows of an edge that moves, every fourth anywhere on the sensor.
fn events() -> Vec<Event> {
    let mut state = 1_u64;
    let mut random = |below: u64| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) % below
    };
    let event = |t: i64| {
        let on_edge = t % 4 != 0;
        let x = if on_edge { t as u64 / 3000 % 346 } else { random(346) };
        Event { t, x: x as u16, y: random(260) as u16, polarity: if t % 2 == 0 { Polarity::On } else { Polarity::Off } }
    };
    (0..EVENTS).map(event).collect()
}

/// Events to pictures for three time constants; the pictures are included.
#[divan::bench(sample_count = 5)]
fn reconstruction(bencher: Bencher) {
    let events = events();
    bencher.counter(ItemsCount::new(events.len())).bench_local(|| {
        let mut reconstruction = Reconstruction::new(ReconstructionOptions::new(SENSOR));
        let mut moments = 0;
        for part in events.chunks(100_000) {
            reconstruction.push(part, |block| moments += block.len());
        }
        reconstruction.finish(|block| moments += block.len());
        moments
    });
}

/// Returns a board of 6 × 9 inner corners without perspective.
fn checkerboard() -> Picture {
    let (width, height) = (usize::from(SENSOR.width), usize::from(SENSOR.height));
    let value = |index: usize| {
        let (x, y) = ((index % width).wrapping_sub(50) / SQUARE, (index / width).wrapping_sub(46) / SQUARE);
        if x < 10 && y < 7 && (x + y).is_multiple_of(2) { 0.1 } else { 0.9 }
    };
    Picture::new(width, height, (0..width * height).map(value).collect()).unwrap().blurred(0.7)
}

#[divan::bench]
fn corners_of_a_checkerboard(bencher: Bencher) {
    let picture = checkerboard();
    bencher.bench_local(|| find_checkerboard(black_box(&picture), 6, 9, None).unwrap().len());
}

#[divan::bench]
fn quadrilaterals(bencher: Bencher) {
    let picture = checkerboard();
    bencher.bench_local(|| find_quads(black_box(&picture)).len());
}
