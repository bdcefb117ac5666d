//! Properties: decoding the encoder's output returns its input, however the stream is split, and no bytes stop the
//! decoder.

use proptest::prelude::*;
use usb_davis::protocol::{
    Decoder, Encoder, Frame, ImuLayout, ImuModel, ImuSample, ImuScale, Layout, Message, PixelArray, Polarity,
    PolarityEvent, Region, Shutter, Signal, SignalEvent, frame_steps,
};

#[derive(Clone, Debug, PartialEq)]
enum Item {
    Event(PolarityEvent),
    Signal(SignalEvent),
    Imu(ImuSample),
    Frame { shutter: Shutter, times: [u64; 4], cycles: u32, region: Region, pixels: Vec<u16> },
    Reset { previous: u64 },
}

fn items(message: Message<'_>) -> Vec<Item> {
    vec![match message {
        Message::Events(events) => return events.iter().copied().map(Item::Event).collect(),
        Message::Signal(event) => Item::Signal(event),
        Message::Imu(sample) => Item::Imu(sample),
        Message::TimestampReset { previous } => Item::Reset { previous },
        Message::Frame(frame) => Item::Frame {
            shutter: frame.shutter,
            times: [
                frame.start,
                frame.exposure_start.expect("exposure start was sent"),
                frame.exposure_end.expect("exposure end was sent"),
                frame.end,
            ],
            cycles: frame.exposure_cycles,
            region: frame.region,
            pixels: frame.pixels.to_vec(),
        },
        other => panic!("{other:?}"),
    }]
}

/// An item to append, with its distance in time from the previous one.
#[derive(Clone, Debug)]
enum Next {
    Event(u64, u16, u16, bool),
    Signal(u64, usize),
    Imu(u64, Option<[i16; 3]>, Option<i16>, Option<[i16; 3]>, u8, u8),
    Frame { shutter: bool, spans: [u64; 4], cycles: u32, region: Region, seed: u16 },
    Reset,
}

const SIGNALS: [Signal; 5] = [
    Signal::ExternalInputRising,
    Signal::ExternalInputFalling,
    Signal::ExternalInputPulse,
    Signal::GeneratorRising,
    Signal::GeneratorFalling,
];

fn later() -> impl Strategy<Value = u64> {
    prop_oneof![8 => 0..3u64, 4 => 0..40_000u64, 1 => 0..500_000_000u64]
}

fn axes() -> impl Strategy<Value = Option<[i16; 3]>> {
    proptest::option::of(proptest::array::uniform3(-32767..=32767i16))
}

fn next() -> impl Strategy<Value = Next> {
    let region = (0..346u16, 0..260u16).prop_flat_map(|(x, y)| {
        (1..=(346 - x).min(12), 1..=(260 - y).min(12)).prop_map(move |(width, height)| Region { x, y, width, height })
    });
    prop_oneof![
        40 => (later(), 0..346u16, 0..260u16, any::<bool>()).prop_map(|(t, x, y, on)| Next::Event(t, x, y, on)),
        3 => (later(), 0..5usize).prop_map(|(t, signal)| Next::Signal(t, signal)),
        3 => (later(), axes(), any::<Option<i16>>(), axes(), 0..4u8, 0..4u8)
            .prop_map(|(t, a, temperature, g, ascale, gscale)| Next::Imu(t, a, temperature, g, ascale, gscale)),
        2 => (any::<bool>(), proptest::array::uniform4(later()), 0..1u32 << 30, region, any::<u16>())
            .prop_map(|(shutter, spans, cycles, region, seed)| Next::Frame { shutter, spans, cycles, region, seed }),
        1 => Just(Next::Reset),
    ]
}

fn layouts() -> impl Strategy<Value = Layout> {
    let array = (any::<bool>(), any::<bool>(), any::<bool>());
    (array, proptest::array::uniform3(any::<bool>())).prop_map(|((swap_axes, mirror_columns, mirror_rows), negate)| {
        let (columns, rows) = if swap_axes { (260, 346) } else { (346, 260) };
        let array = PixelArray { columns, rows, swap_axes, mirror_columns: false, mirror_rows: false };
        Layout {
            dvs: array,
            aps: PixelArray { mirror_columns, mirror_rows, ..array },
            imu: ImuLayout { model: ImuModel::Mpu9250, negate },
        }
    })
}

/// Encodes `nexts`, and returns the expected items. In half of the cases, events of the next items fall between the
/// steps of a frame, as they do on the wire.
fn encode(layout: Layout, nexts: &[Next]) -> (Vec<u8>, Vec<Item>) {
    let mut encoder = Encoder::new(layout);
    let (mut bytes, mut items) = (Vec::new(), Vec::new());
    let mut time = 0;
    for next in nexts {
        match *next {
            Next::Event(span, x, y, on) => {
                time += span;
                let polarity = if on { Polarity::On } else { Polarity::Off };
                let event = PolarityEvent { time, x, y, polarity };
                encoder.event(&event, &mut bytes).expect("in order");
                items.push(Item::Event(event));
            }
            Next::Signal(span, signal) => {
                time += span;
                let event = SignalEvent { time, signal: SIGNALS[signal] };
                encoder.signal(&event, &mut bytes).expect("in order");
                items.push(Item::Signal(event));
            }
            Next::Imu(span, acceleration, temperature, angular_velocity, accelerometer, gyroscope) => {
                time += span;
                let scale = ImuScale { accelerometer, gyroscope };
                let model = layout.imu.model;
                let sample = ImuSample { time, acceleration, angular_velocity, temperature, scale, model };
                encoder.imu(&sample, &mut bytes).expect("in order");
                items.push(Item::Imu(sample));
            }
            Next::Frame { shutter, spans, cycles, region, seed } => {
                let times = spans.map(|span| {
                    time += span;
                    time
                });
                let count = region.width * region.height;
                let pixels: Vec<u16> = (0..count).map(|index| index.wrapping_mul(seed) % 1024).collect();
                let frame = Frame {
                    shutter: if shutter { Shutter::Global } else { Shutter::Rolling },
                    start: times[0],
                    exposure_start: Some(times[1]),
                    exposure_end: Some(times[2]),
                    end: times[3],
                    exposure_cycles: cycles,
                    region,
                    damaged_columns: 0,
                    pixels: &pixels,
                };
                for (step_time, step) in frame_steps(&layout, &frame) {
                    encoder.frame_step(step_time, &frame, step, &mut bytes).expect("in order");
                    if seed % 2 == 1 {
                        let event =
                            PolarityEvent { time: step_time, x: seed % 346, y: seed % 260, polarity: Polarity::On };
                        encoder.event(&event, &mut bytes).expect("in order");
                        items.push(Item::Event(event));
                    }
                }
                let frame = Item::Frame { shutter: frame.shutter, times, cycles, region, pixels };
                let after_last_step = usize::from(seed % 2 == 1);
                items.insert(items.len() - after_last_step, frame);
            }
            Next::Reset => {
                encoder.timestamp_reset(&mut bytes);
                items.push(Item::Reset { previous: time });
                time = 0;
            }
        }
    }
    (bytes, items)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn encoded_streams_decode_to_themselves(
        layout in layouts(),
        nexts in proptest::collection::vec(next(), 0..120),
        cuts in proptest::collection::vec(1..700usize, 1..20),
    ) {
        let (bytes, expected) = encode(layout, &nexts);
        let mut decoder = Decoder::with_frames(layout, vec![0u16; 346 * 260]);
        let mut decoded = Vec::new();
        let mut rest = &bytes[..];
        for &cut in cuts.iter().cycle() {
            let (piece, after) = rest.split_at(cut.min(rest.len()));
            decoder.decode(piece, |message| decoded.extend(items(message)));
            rest = after;
            if rest.is_empty() {
                break;
            }
        }
        prop_assert_eq!(decoder.counts().bytes, bytes.len() as u64);
        prop_assert_eq!(decoded, expected);
    }

    #[test]
    fn any_bytes_are_accepted_and_splitting_changes_nothing(
        bytes in proptest::collection::vec(any::<u8>(), 0..4000),
        piece in 1..300usize,
        gap in any::<bool>(),
    ) {
        let run = |piece: usize| {
            let mut decoder = Decoder::with_frames(Layout::DAVIS346, vec![0u16; 346 * 260]);
            let mut messages = Vec::new();
            for piece in bytes.chunks(piece) {
                decoder.decode(piece, |message| {
                    match message {
                        Message::Events(events) => {
                            assert!(events.iter().all(|event| event.x < 346 && event.y < 260));
                            return messages.extend(events.iter().map(|event| format!("{event:?}")));
                        }
                        Message::Frame(Frame { region, pixels, .. }) => {
                            assert_eq!(pixels.len(), usize::from(region.width) * usize::from(region.height));
                        }
                        _ => {}
                    }
                    messages.push(format!("{message:?}"));
                });
                if gap {
                    decoder.gap(|_| {});
                }
            }
            assert_eq!(decoder.counts().bytes, bytes.len() as u64);
            messages
        };
        let cut = run(piece);
        if !gap {
            prop_assert_eq!(cut, run(bytes.len().max(1)));
        }
    }
}
