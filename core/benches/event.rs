//! Cost per event ahead of the windows: decoding, load shedding, filter, undistortion.

use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use evcal_core::budget::{EventBudget, LoadShedder};
use evcal_core::camera::{Camera, ModelKind};
use evcal_core::decode::{Evt2Decoder, Evt2Encoder, PackedDecoder, PackedEncoder};
use evcal_core::event::{Event, Polarity};
use evcal_core::filter::{EventFilter, FilterSettings, FilterStorage};
use evcal_core::sensor::Sensor;
use evcal_core::undistortion::{IdealCamera, UndistortionTable};

const SENSOR: Sensor = Sensor { width: 346, height: 260 };
const EVENTS: usize = 100_000;

fn main() {
    divan::main();
}

/// Returns one event per microsecond: rows of a moving edge, and every fourth event anywhere on the sensor.
fn events() -> Vec<Event> {
    let mut state = 1_u64;
    let mut random = |below: u64| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) % below
    };
    let event = |t: i64| {
        let on_edge = t % 4 != 0;
        let x = if on_edge { t as u64 / 400 % 346 } else { random(346) };
        Event { t, x: x as u16, y: random(260) as u16, polarity: if t % 2 == 0 { Polarity::On } else { Polarity::Off } }
    };
    (0..EVENTS as i64).map(event).collect()
}

#[divan::bench]
fn decode_evt2(bencher: Bencher) {
    let mut encoder = Evt2Encoder::new();
    let words: Vec<u32> = events().into_iter().flat_map(|event| encoder.encode(event).unwrap()).collect();
    bencher.counter(ItemsCount::new(EVENTS)).bench_local(|| {
        let mut decoder = Evt2Decoder::new();
        black_box(&words).iter().filter_map(|&word| decoder.push(word)).count()
    });
}

#[divan::bench]
fn decode_packed(bencher: Bencher) {
    let mut encoder = PackedEncoder::new();
    let words: Vec<u32> = events().into_iter().flat_map(|event| encoder.encode(event).unwrap()).collect();
    bencher.counter(ItemsCount::new(EVENTS)).bench_local(|| {
        let mut decoder = PackedDecoder::new();
        black_box(&words).iter().filter_map(|&word| decoder.push(word)).count()
    });
}

#[divan::bench]
fn shed(bencher: Bencher) {
    let events = events();
    bencher.counter(ItemsCount::new(EVENTS)).bench_local(|| {
        let mut shedder = LoadShedder::new(EventBudget::default());
        black_box(&events).iter().filter(|event| shedder.admit(event)).count()
    });
}

#[divan::bench]
fn filter(bencher: Bencher) {
    let events = events();
    let settings = FilterSettings { refractory_us: 500, ..FilterSettings::default() };
    let mut storage = Box::new(FilterStorage::<5655, 1024>::new());
    bencher.counter(ItemsCount::new(EVENTS)).bench_local(|| {
        let mut filter = EventFilter::new(SENSOR, settings, &mut storage).unwrap();
        for event in black_box(&events) {
            black_box(filter.judge(event));
        }
        *filter.counts()
    });
}

#[divan::bench]
fn undistort(bencher: Bencher) {
    let lens = [330.0, 330.0, 172.5, 129.5, -0.35, 0.15, 0.0, 0.0_f32];
    let camera = Camera::from_parameters(ModelKind::Radtan4, &lens).unwrap();
    let ideal = IdealCamera { fx: 330.0, fy: 330.0, cx: 172.5, cy: 129.5 };
    let table = UndistortionTable::new(&camera, &ideal, SENSOR, [44, 33], vec![[0.0; 2]; 1452]).unwrap();
    let events = events();
    bencher.counter(ItemsCount::new(EVENTS)).bench_local(|| {
        let undistorted = black_box(&events).iter().filter_map(|event| table.undistort(event.x.into(), event.y.into()));
        undistorted.fold([0.0_f32; 2], |sum, [x, y]| [sum[0] + x, sum[1] + y])
    });
}
