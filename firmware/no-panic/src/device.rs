//! Other code of a device: decoding, filtering, shedding, the link, and the whole pipeline.

use core::hint::black_box;

use evcal_core::budget::{EventBudget, LoadShedder};
use evcal_core::cluster::{row_bytes, row_count};
use evcal_core::decode::{Evt2Decoder, Evt2Encoder, Evt3Decoder, Evt21Decoder, PackedDecoder, PackedEncoder, Words};
use evcal_core::filter::{EventFilter, FilterSettings, FilterStorage};
use evcal_core::sensor::Sensor;
use evcal_core::window::Progress;
use evcal_detector::{Pipeline, Settings, Source, Storage};
use evcal_link::{Circle, Decoder, Encoder, Hello, Message, Statistics, WindowEnd};

use crate::detection::event;

/// From bytes to events and back.
#[inline(never)]
pub fn formats() {
    let (mut words, mut evt2, mut packed) = (Words::new(), Evt2Decoder::new(), PackedDecoder::new());
    let (words, evt2, packed) = (black_box(&mut words), black_box(&mut evt2), black_box(&mut packed));
    if let Some(word) = words.push(black_box(0)) {
        black_box((evt2.push(word), packed.push(word), *evt2.counts(), *packed.counts(), words.pending()));
    }
    let (mut evt21, mut evt3) = (Evt21Decoder::new(), Evt3Decoder::new());
    let (evt21, evt3) = (black_box(&mut evt21), black_box(&mut evt3));
    evt21.push(black_box(0)).chain(evt3.push(black_box(0))).for_each(|record| {
        black_box(record);
    });
    black_box((*evt21.counts(), *evt3.counts()));
    let (mut evt2, mut packed) = (Evt2Encoder::new(), PackedEncoder::new());
    let (evt2, packed) = (black_box(&mut evt2), black_box(&mut packed));
    black_box((evt2.encode(event()).is_ok(), evt2.time(black_box(0)), packed.encode(event()).is_ok()));
}

fn filter_settings() -> FilterSettings {
    FilterSettings {
        hot_events: black_box(1),
        hot_period_us: black_box(1),
        refractory_us: black_box(1),
        background_us: black_box(1),
    }
}

/// Filter and load shedding.
#[inline(never)]
pub fn filters() {
    let mut storage = FilterStorage::<1452, 512>::new();
    let sensor = Sensor { width: black_box(1), height: black_box(1) };
    if let Ok(mut filter) = EventFilter::new(sensor, filter_settings(), black_box(&mut storage)) {
        let filter = black_box(&mut filter);
        black_box((filter.judge(&event()), *filter.counts(), filter.cell_size()));
    }
    let budget = EventBudget { events_per_second: black_box(1), burst: black_box(1) };
    let mut shedder = LoadShedder::new(budget);
    let shedder = black_box(&mut shedder);
    black_box((shedder.admit(&event()), shedder.shed(), shedder.is_shedding()));
}

/// From messages to bytes and back.
#[inline(never)]
pub fn link() {
    let mut encoder = Encoder::new();
    let encoder = black_box(&mut encoder);
    for message in [
        Message::Hello(black_box(Hello::default())),
        Message::Circle(black_box(Circle::default())),
        Message::WindowEnd(black_box(WindowEnd::default())),
        Message::Statistics(black_box(Statistics::default())),
    ] {
        black_box(encoder.encode(&message));
    }
    let mut decoder = Decoder::new();
    let decoder = black_box(&mut decoder);
    black_box(decoder.push(black_box(0)));
    black_box((decoder.pending(), *decoder.counts()));
}

/// The whole program of a device.
#[inline(never)]
pub fn pipeline() {
    let mut storage = Storage::<{ row_bytes(346) }, { row_count(260) }, 2048, 128, 4000, 1452, 512>::new();
    let sensor = Sensor { width: black_box(1), height: black_box(1) };
    let settings = Settings { filter: filter_settings(), ..Settings::new(black_box("device"), sensor, black_box(1)) };
    let Ok(mut pipeline) = Pipeline::new(settings, black_box(&mut storage)) else { return };
    let pipeline = black_box(&mut pipeline);
    let mut send = |frame: &[u8]| {
        black_box(frame);
        black_box(true)
    };
    let mut source = if black_box(true) { Source::evt2() } else { Source::packed() };
    let source = black_box(&mut source);
    pipeline.announce(black_box(0), &mut send);
    while let Some(event) = source.push(black_box(0)) {
        let mut progress = pipeline.push(event);
        while progress == Progress::Complete {
            pipeline.detect();
            black_box((pipeline.circles(), pipeline.window_events()));
            progress = pipeline.report(&mut send);
        }
    }
    pipeline.count_undecodable(source.undecodable());
    pipeline.send_statistics(black_box(0), &mut send);
    black_box(pipeline.statistics());
}
