//! Messages survive encoding, damage and decoding.

use std::vec::Vec;

use proptest::prelude::*;

use super::*;

fn losses() -> impl Strategy<Value = Losses> {
    any::<[u32; 7]>().prop_map(|[undecodable, hot, background, refractory, shed, overflow, in_gap]| Losses {
        undecodable,
        hot,
        background,
        refractory,
        shed,
        overflow,
        in_gap,
    })
}

fn circle() -> impl Strategy<Value = Message> {
    (any::<u32>(), any::<u64>(), any::<[f32; 4]>(), any::<[u16; 2]>()).prop_map(|(window, time_us, numbers, pixels)| {
        let ([x, y, radius, error], [on_pixels, off_pixels]) = (numbers, pixels);
        Message::Circle(Circle { window, time_us, x, y, radius, error, on_pixels, off_pixels })
    })
}

fn window_end() -> impl Strategy<Value = Message> {
    (any::<u64>(), any::<[u32; 6]>(), any::<[u16; 2]>(), losses()).prop_map(|(start_us, numbers, found, losses)| {
        let [window, length_us, events, pixels_over_capacity, clusters_over_capacity, circles_over_capacity] = numbers;
        Message::WindowEnd(WindowEnd {
            window,
            start_us,
            length_us,
            events,
            clusters: found[0],
            circles: found[1],
            pixels_over_capacity,
            clusters_over_capacity,
            circles_over_capacity,
            losses,
        })
    })
}

fn hello() -> impl Strategy<Value = Message> {
    let name = "[ -~]{0,32}".prop_map(|name| DeviceName::try_from(name.as_str()).unwrap());
    (any::<[u16; 9]>(), any::<u64>(), name, any::<[u32; 8]>(), any::<[f32; 3]>()).prop_map(
        |(small, time_us, device, large, real)| {
            Message::Hello(Hello {
                protocol: small[0],
                first: false,
                time_us,
                device,
                sensor_width: small[1],
                sensor_height: small[2],
                step_us: large[0],
                min_interval: small[3],
                max_interval: small[4],
                gap: small[5],
                most_events: large[1],
                fewest_events: large[2],
                fewest_circles: small[6],
                epsilon: real[0],
                min_points: small[7],
                min_pixels: small[8],
                min_radius: real[1],
                max_radius: real[2],
                refractory_us: large[3],
                background_us: large[4],
                hot_events: small[0],
                capacity_events: large[5],
                capacity_runs: large[6],
                capacity_clusters: large[7],
            })
        },
    )
}

fn statistics() -> impl Strategy<Value = Message> {
    (any::<[u64; 2]>(), any::<[u32; 6]>(), losses()).prop_map(|([time_us, events], numbers, losses)| {
        let [windows, windows_too_few_events, windows_sent, frames_unsent, out_of_order, sensor_overflows] = numbers;
        Message::Statistics(Statistics {
            time_us,
            events,
            windows,
            windows_too_few_events,
            windows_sent,
            frames_unsent,
            out_of_order,
            sensor_overflows,
            losses,
        })
    })
}

/// Messages are compared by their bytes, so that NaN equals NaN.
fn message() -> impl Strategy<Value = Message> {
    prop_oneof![circle(), window_end(), hello(), statistics()]
}

fn encode(messages: &[Message]) -> Vec<Frame> {
    let mut encoder = Encoder::new();
    messages.iter().map(|message| encoder.encode(message)).collect()
}

fn decode(decoder: &mut Decoder, bytes: impl IntoIterator<Item = u8>) -> Vec<Message> {
    bytes.into_iter().filter_map(|byte| decoder.push(byte)).collect()
}

/// Returns the bytes of a message, which distinguish values that `==` does not (NaN).
fn body(message: &Message) -> (u8, Vec<u8>) {
    let mut room = [0; MAX_FRAME];
    let length = message.write_body(&mut room).unwrap();
    (message.kind(), room[..length].to_vec())
}

fn bodies(messages: &[Message]) -> Vec<(u8, Vec<u8>)> {
    messages.iter().map(body).collect()
}

/// A change of a stream of bytes.
#[derive(Clone, Debug)]
enum Damage {
    Change(prop::sample::Index, u8),
    Insert(prop::sample::Index, u8),
    Remove(prop::sample::Index, usize),
}

fn damage() -> impl Strategy<Value = Damage> {
    let at = any::<prop::sample::Index>;
    prop_oneof![
        (at(), 1_u8..).prop_map(|(at, change)| Damage::Change(at, change)),
        (at(), any::<u8>()).prop_map(|(at, byte)| Damage::Insert(at, byte)),
        (at(), 1_usize..80).prop_map(|(at, count)| Damage::Remove(at, count)),
    ]
}

fn apply(damage: &Damage, bytes: &mut Vec<u8>) {
    match damage {
        Damage::Change(at, change) => {
            let at = at.index(bytes.len());
            bytes[at] ^= change;
        }
        Damage::Insert(at, byte) => bytes.insert(at.index(bytes.len()), *byte),
        Damage::Remove(at, count) => {
            let from = at.index(bytes.len());
            bytes.drain(from..(from + count).min(bytes.len() - 1).max(from));
        }
    }
}

/// Returns `true` if `part` is `whole` with some elements removed.
fn is_subsequence<T: PartialEq>(part: &[T], whole: &[T]) -> bool {
    let mut rest = whole.iter();
    part.iter().all(|item| rest.any(|other| other == item))
}

proptest! {
    #[test]
    fn every_message_survives_a_round_trip(messages in prop::collection::vec(message(), 1..20)) {
        let frames = encode(&messages);
        prop_assert!(frames.iter().all(|frame| !frame.is_empty() && frame.iter().position(|&byte| byte == 0) == Some(frame.len() - 1)));
        let mut decoder = Decoder::new();
        let decoded = decode(&mut decoder, frames.iter().flatten().copied());
        prop_assert_eq!(bodies(&decoded), bodies(&messages));
        let counts = DecoderCounts { frames: messages.len() as u32, ..DecoderCounts::default() };
        prop_assert_eq!((*decoder.counts(), decoder.pending()), (counts, 0));
    }

    /// A receiver that joins at any byte decodes every following whole message, and counts no loss.
    #[test]
    fn a_stream_can_be_joined_anywhere(messages in prop::collection::vec(message(), 2..8), at in any::<prop::sample::Index>()) {
        let frames = encode(&messages);
        let bytes: Vec<u8> = frames.iter().flatten().copied().collect();
        let from = at.index(bytes.len());
        let mut decoder = Decoder::new();
        let decoded = decode(&mut decoder, bytes[from..].iter().copied());
        let mut end = bytes.len();
        let whole = frames.iter().rev().take_while(|frame| { end -= frame.len(); end >= from }).count();
        prop_assert_eq!(bodies(&decoded), bodies(&messages[messages.len() - whole..]));
        prop_assert_eq!((decoder.counts().lost, decoder.counts().damaged), (0, 0));
        prop_assert!(decoder.counts().damaged_at_start <= 1);
    }

    /// The bytes between the first and the last frame are changed, inserted or removed. Nevertheless, every decoded
    /// message was sent, the order is the same, and each missing message is counted.
    #[test]
    fn damage_never_makes_a_wrong_message(
        messages in prop::collection::vec(message(), 3..12),
        damages in prop::collection::vec(damage(), 1..8),
    ) {
        let frames = encode(&messages);
        let (first, rest) = frames.split_first().unwrap();
        let (last, middle) = rest.split_last().unwrap();
        let mut bytes: Vec<u8> = middle.iter().flatten().copied().collect();
        for damage in &damages {
            apply(damage, &mut bytes);
        }
        let mut decoder = Decoder::new();
        // The zero ends a frame that the damage left incomplete.
        let decoded = decode(&mut decoder, first.iter().copied().chain(bytes).chain([0]).chain(last.iter().copied()));
        prop_assert!(is_subsequence(&bodies(&decoded), &bodies(&messages)));
        let counts = decoder.counts();
        prop_assert_eq!(counts.frames as usize, decoded.len());
        prop_assert_eq!((counts.frames + counts.lost) as usize, messages.len());
        prop_assert_eq!((counts.restarts, counts.unknown, counts.malformed), (0, 0, 0));
    }

    #[test]
    fn noise_is_not_a_message(bytes in prop::collection::vec(prop_oneof![Just(0), any::<u8>()], 0..2000)) {
        let mut decoder = Decoder::new();
        prop_assert_eq!(decode(&mut decoder, bytes), []);
        prop_assert_eq!(decoder.counts().frames, 0);
    }
}

#[test]
fn the_longest_messages_fit_a_frame() {
    let losses = Losses {
        undecodable: u32::MAX,
        hot: u32::MAX,
        background: u32::MAX,
        refractory: u32::MAX,
        shed: u32::MAX,
        overflow: u32::MAX,
        in_gap: u32::MAX,
    };
    let hello = Hello {
        protocol: u16::MAX,
        first: true,
        time_us: u64::MAX,
        device: DeviceName::try_from("0123456789abcdef0123456789abcdef").unwrap(),
        sensor_width: u16::MAX,
        sensor_height: u16::MAX,
        step_us: u32::MAX,
        min_interval: u16::MAX,
        max_interval: u16::MAX,
        gap: u16::MAX,
        most_events: u32::MAX,
        fewest_events: u32::MAX,
        fewest_circles: u16::MAX,
        epsilon: f32::MAX,
        min_points: u16::MAX,
        min_pixels: u16::MAX,
        min_radius: f32::MAX,
        max_radius: f32::MAX,
        refractory_us: u32::MAX,
        background_us: u32::MAX,
        hot_events: u16::MAX,
        capacity_events: u32::MAX,
        capacity_runs: u32::MAX,
        capacity_clusters: u32::MAX,
    };
    let statistics = Statistics {
        time_us: u64::MAX,
        events: u64::MAX,
        windows: u32::MAX,
        windows_too_few_events: u32::MAX,
        windows_sent: u32::MAX,
        frames_unsent: u32::MAX,
        out_of_order: u32::MAX,
        sensor_overflows: u32::MAX,
        losses,
    };
    let messages = [Message::Hello(hello), Message::Statistics(statistics)];
    let bytes: Vec<u8> = encode(&messages).into_iter().flatten().collect();
    assert_eq!(decode(&mut Decoder::new(), bytes), messages);
}

/// The example in `docs/layouts.md` equals the encoded message.
#[test]
fn the_documented_example_equals_the_encoded_message() {
    let circle =
        Circle { time_us: 1_000_000, x: 1.0, y: 2.0, radius: 3.0, on_pixels: 5, off_pixels: 6, ..Circle::default() };
    let documented =
        include_str!("../../../docs/layouts.md").lines().find(|line| line.starts_with("01 01 02")).unwrap();
    let bytes: Vec<u8> = documented.split(' ').map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect();
    assert_eq!(Encoder::new().encode(&Message::Circle(circle)).as_slice(), bytes);
}

#[test]
fn frames_that_were_not_sent_are_lost() {
    let mut encoder = Encoder::new();
    let mut decoder = Decoder::new();
    let message = Message::Circle(Circle::default());
    // So many frames that the sequence numbers wrap. The receiver cannot miss the last frame that is not sent, because
    // no frame follows it.
    let sent: Vec<Frame> = (0..200_000).map(|_| encoder.encode(&message)).collect();
    let bytes =
        sent.iter().enumerate().filter(|(number, _)| number % 3 != 1).flat_map(|(_, frame)| frame.iter().copied());
    let decoded = decode(&mut decoder, bytes).len();
    assert_eq!((decoded, decoder.counts().lost), (133_333, 66_666));
}

#[test]
fn unknown_kinds_are_counted_and_longer_bodies_understood() {
    let message = Message::Circle(Circle { window: 3, x: 1.5, ..Circle::default() });
    let (kind, mut long_body) = body(&message);
    long_body.extend_from_slice(b"more");
    let content = |sequence: u8, kind, body: &[u8]| {
        let content: Vec<u8> = [sequence, 0, kind].into_iter().chain(body.iter().copied()).collect();
        frame::seal(&content).unwrap()
    };
    let stream = [content(0, 77, b"?"), content(1, kind, &long_body), content(2, kind, &long_body[..4])];
    let mut decoder = Decoder::new();
    assert_eq!(decode(&mut decoder, stream.into_iter().flatten()), [message]);
    let counts = DecoderCounts { frames: 1, unknown: 1, malformed: 1, ..DecoderCounts::default() };
    assert_eq!(*decoder.counts(), counts);
}

#[test]
fn a_restarted_device_loses_nothing() {
    let hello = |first| Message::Hello(Hello { first, ..Hello::default() });
    let run = encode(&[hello(true), hello(false), hello(false)]);
    let mut decoder = Decoder::new();
    // The second run arrives with its first message, the third without it.
    let bytes = run.iter().chain(&run).chain(&run[1..]).flatten().copied();
    assert_eq!(decode(&mut decoder, bytes).len(), 8);
    let counts = DecoderCounts { frames: 8, restarts: 2, ..DecoderCounts::default() };
    assert_eq!(*decoder.counts(), counts);
}
