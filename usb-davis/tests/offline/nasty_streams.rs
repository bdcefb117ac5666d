//! Streams that no healthy camera sends. Each expected result is derived by hand from the wire words;
//! docs/davis346-streams.md describes the same cases.

use usb_davis::protocol::word::{Special, Word};
use usb_davis::protocol::{AnomalyKind, Decoder, DecoderCounts, Layout, Message, Polarity, Signal};

const OFF: Polarity = Polarity::Off;
const ON: Polarity = Polarity::On;

/// Messages in a form that owns its pixels.
#[derive(Clone, Debug, PartialEq)]
enum Seen {
    Event(u64, u16, u16, Polarity),
    Signal(u64, Signal),
    Reset(u64),
    Imu(u64, Option<[i16; 3]>, Option<i16>, Option<[i16; 3]>),
    Frame {
        start: u64,
        end: u64,
        exposure: [Option<u64>; 2],
        cycles: u32,
        size: (u16, u16),
        damaged: u16,
        pixels: Vec<u16>,
    },
    Anomaly(AnomalyKind, u64),
}

fn seen(message: Message<'_>) -> Vec<Seen> {
    vec![match message {
        Message::Events(events) => {
            return events.iter().map(|event| Seen::Event(event.time, event.x, event.y, event.polarity)).collect();
        }
        Message::Signal(event) => Seen::Signal(event.time, event.signal),
        Message::TimestampReset { previous } => Seen::Reset(previous),
        Message::Imu(sample) => {
            Seen::Imu(sample.time, sample.acceleration, sample.temperature, sample.angular_velocity)
        }
        Message::Frame(frame) => Seen::Frame {
            start: frame.start,
            end: frame.end,
            exposure: [frame.exposure_start, frame.exposure_end],
            cycles: frame.exposure_cycles,
            size: (frame.region.width, frame.region.height),
            damaged: frame.damaged_columns,
            pixels: frame.pixels.to_vec(),
        },
        Message::Anomaly(anomaly) => Seen::Anomaly(anomaly.kind, anomaly.offset),
        other => panic!("{other:?}"),
    }]
}

fn bytes(words: &[Word]) -> Vec<u8> {
    words.iter().flat_map(|word| word.emit().to_le_bytes()).collect()
}

/// Decodes in one piece, and asserts that pieces of 1, 2, 3, 7 and 512 bytes decode to the same.
fn decode_as(layout: Layout, words: &[Word]) -> (Vec<Seen>, DecoderCounts) {
    let bytes = bytes(words);
    let run = |piece: usize| {
        let mut messages = Vec::new();
        let mut decoder = Decoder::with_frames(layout, vec![0u16; 346 * 260]);
        for piece in bytes.chunks(piece) {
            decoder.decode(piece, |message| messages.extend(seen(message)));
        }
        (messages, decoder.counts())
    };
    let whole = run(bytes.len().max(1));
    for piece in [1, 2, 3, 7, 512] {
        assert_eq!(run(piece), whole, "pieces of {piece}");
    }
    whole
}

fn decode(words: &[Word]) -> Vec<Seen> {
    decode_as(Layout::DAVIS346, words).0
}

#[test]
fn wrap_with_multiplier_three() {
    let words = [Word::Timestamp(100), Word::Wrap(3), Word::Timestamp(7), Word::Row(1), Word::Column(2, ON)];
    assert_eq!(decode(&words), [Seen::Event(3 * 32768 + 7, 1, 2, ON)]);
}

#[test]
fn no_timestamp_after_a_wrap_means_zero() {
    let words = [Word::Timestamp(0x7FFF), Word::Wrap(1), Word::Row(1), Word::Column(2, OFF)];
    assert_eq!(decode(&words), [Seen::Event(32768, 1, 2, OFF)]);
}

#[test]
fn timestamp_reset_first_and_in_between() {
    let words = [
        Word::Special(Special::TimestampReset),
        Word::Timestamp(5),
        Word::Row(0),
        Word::Column(0, ON),
        Word::Wrap(2),
        Word::Timestamp(9),
        Word::Special(Special::TimestampReset),
        Word::Timestamp(4),
        Word::Row(0),
        Word::Column(0, ON),
    ];
    let expected = [Seen::Reset(0), Seen::Event(5, 0, 0, ON), Seen::Reset(65545), Seen::Event(4, 0, 0, ON)];
    assert_eq!(decode(&words), expected);
}

#[test]
fn unknown_words_are_counted_and_skipped() {
    let unknown = [0x0000, 0x0006, 0x0012, 0x0FFF, 0x5F00, 0x5400, 0x6C01];
    for word in unknown {
        let words = [Word::Timestamp(1), Word::Row(3), Word::Unknown(word), Word::Column(4, ON)];
        assert_eq!(decode(&words), [Seen::Anomaly(AnomalyKind::UnknownWord, 4), Seen::Event(1, 3, 4, ON)]);
    }
}

#[test]
fn addresses_beyond_the_sensor() {
    let words = [
        Word::Timestamp(1),
        Word::Row(345),
        Word::Column(259, ON),
        Word::Column(260, ON),
        Word::Column(0, OFF),
        Word::Row(346),
        Word::Column(1, ON),
        Word::Row(0),
        Word::Column(2, ON),
    ];
    let expected = [
        Seen::Event(1, 345, 259, ON),
        Seen::Anomaly(AnomalyKind::ColumnOutOfRange, 6),
        Seen::Event(1, 345, 0, OFF),
        Seen::Anomaly(AnomalyKind::RowOutOfRange, 10),
        // The row of this column is unknown; assigning it to row 345 would invent an event.
        Seen::Anomaly(AnomalyKind::ColumnWithoutRow, 12),
        Seen::Event(1, 0, 2, ON),
    ];
    assert_eq!(decode(&words), expected);
}

#[test]
fn a_row_without_columns_is_not_a_fault() {
    let words = [Word::Timestamp(1), Word::Row(7), Word::Timestamp(2), Word::Row(8), Word::Column(1, ON)];
    assert_eq!(decode(&words), [Seen::Event(2, 8, 1, ON)]);
}

#[test]
fn time_going_back_is_reported_and_used() {
    let words = [
        Word::Timestamp(500),
        Word::Row(0),
        Word::Column(0, ON),
        Word::Timestamp(400),
        Word::Column(1, ON),
        Word::Timestamp(450),
        Word::Column(2, ON),
    ];
    let expected = [
        Seen::Event(500, 0, 0, ON),
        Seen::Anomaly(AnomalyKind::TimeBackwards, 6),
        Seen::Event(400, 0, 1, ON),
        Seen::Event(450, 0, 2, ON),
    ];
    assert_eq!(decode(&words), expected);
}

#[test]
fn the_crossing_of_two_to_the_31() {
    let mut words = vec![Word::Wrap(0x0FFF); 16];
    words.extend([Word::Wrap(16), Word::Timestamp(1), Word::Row(0), Word::Column(0, ON)]);
    words.extend([Word::Wrap(0x7FF), Word::Wrap(1), Word::Timestamp(2), Word::Row(0), Word::Column(0, ON)]);
    let first = (16 * 4095 + 16) * 32768;
    assert_eq!(first, 1u64 << 31);
    assert_eq!(decode(&words), [Seen::Event(first + 1, 0, 0, ON), Seen::Event(first + 2048 * 32768 + 2, 0, 0, ON)]);
    // 36 of the largest wraps.
    let mut words = vec![Word::Wrap(0x7FF); 36];
    words.extend([Word::Timestamp(3), Word::Row(0), Word::Column(0, ON)]);
    assert_eq!(decode(&words), [Seen::Event(36 * 2047 * 32768 + 3, 0, 0, ON)]);
}

#[test]
fn connectors() {
    let words = [
        Word::Timestamp(1),
        Word::Special(Special::ExternalInputFalling),
        Word::Special(Special::ExternalInputRising),
        Word::Timestamp(2),
        Word::Special(Special::ExternalInputPulse),
        Word::Special(Special::GeneratorFalling),
        Word::Special(Special::GeneratorRising),
    ];
    assert_eq!(
        decode(&words),
        [
            Seen::Signal(1, Signal::ExternalInputFalling),
            Seen::Signal(1, Signal::ExternalInputRising),
            Seen::Signal(2, Signal::ExternalInputPulse),
            Seen::Signal(2, Signal::GeneratorFalling),
            Seen::Signal(2, Signal::GeneratorRising),
        ]
    );
}

fn imu(contents: u8, count: u8) -> Vec<Word> {
    let mut words = vec![Word::Timestamp(10), Word::Special(Special::ImuStart), Word::ImuScale(contents)];
    words.extend((1..=count).map(Word::ImuByte));
    words.extend([Word::Timestamp(12), Word::Special(Special::ImuEnd)]);
    words
}

#[test]
fn inertial_samples_whole_and_in_all_parts() {
    let (a, t, g) = (Some([0x0102, 0x0304, 0x0506]), Some(0x0708), Some([0x090A, 0x0B0C, 0x0D0E]));
    assert_eq!(decode(&imu(0xE5, 14)), [Seen::Imu(12, a, t, g)]);
    assert_eq!(decode(&imu(0x80, 6)), [Seen::Imu(12, a, None, None)]);
    assert_eq!(decode(&imu(0x40, 6)), [Seen::Imu(12, None, None, a)]);
    assert_eq!(decode(&imu(0x20, 2)), [Seen::Imu(12, None, Some(0x0102), None)]);
    assert_eq!(decode(&imu(0xA0, 8)), [Seen::Imu(12, a, t, None)]);
    assert_eq!(decode(&imu(0xC0, 12)), [Seen::Imu(12, a, None, Some([0x0708, 0x090A, 0x0B0C]))]);
    assert_eq!(decode(&imu(0x60, 8)), [Seen::Imu(12, None, Some(0x0102), Some([0x0304, 0x0506, 0x0708]))]);
}

#[test]
fn inertial_samples_short_long_and_broken() {
    assert_eq!(decode(&imu(0xE0, 13)), [Seen::Anomaly(AnomalyKind::ImuIncomplete, 34)]);
    let (a, t, g) = (Some([0x0102, 0x0304, 0x0506]), Some(0x0708), Some([0x090A, 0x0B0C, 0x0D0E]));
    assert_eq!(decode(&imu(0xE0, 15)), [Seen::Anomaly(AnomalyKind::ImuStray, 34), Seen::Imu(12, a, t, g)]);
    let mut words = imu(0xE0, 14);
    words.truncate(9);
    words.extend(imu(0xE0, 14));
    assert_eq!(decode(&words), [Seen::Anomaly(AnomalyKind::ImuIncomplete, 20), Seen::Imu(12, a, t, g)]);
    // The end of a sample that began before the stream is not a fault.
    let tail = &imu(0xE0, 14)[8..];
    let (messages, counts) = decode_as(Layout::DAVIS346, tail);
    assert_eq!((messages, counts.skipped), (vec![], 10));
}

#[test]
fn mirrored_inertial_axes_saturate() {
    let mut layout = Layout::DAVIS346;
    layout.imu.negate = [true, false, true];
    let mut words = vec![Word::Special(Special::ImuStart), Word::ImuScale(0x80)];
    words.extend([0x80, 0x00, 0x80, 0x00, 0x00, 0x05].map(Word::ImuByte));
    words.push(Word::Special(Special::ImuEnd));
    assert_eq!(decode_as(layout, &words).0, [Seen::Imu(0, Some([32767, -32768, -5]), None, None)]);
}

/// Returns the wire words of a frame of `width × height` user pixels at (10, 20); every pixel of wire column c and row
/// r has reset level 900 and signal level 900 − (100·c + r), and therefore the value 100·c + r.
fn frame(width: u16, height: u16, shutter: Special) -> Vec<Word> {
    let (columns, rows) = (height, width);
    let mut words = vec![Word::Timestamp(100), Word::Special(shutter)];
    words.extend([Word::Exposure(0x155), Word::Exposure(0x0AA), Word::Exposure(1)]);
    for corner in [10, 20, 10 + width - 1, 20 + height - 1] {
        let [high, low] = corner.to_be_bytes();
        words.extend([Word::RegionHigh(high), Word::RegionLow(low)]);
    }
    let column = |words: &mut Vec<Word>, start, level: &dyn Fn(u16) -> u16| {
        words.push(Word::Special(start));
        words.extend((0..rows).map(|row| Word::Sample(level(row))));
        words.push(Word::Special(Special::ColumnEnd));
    };
    let exposure = |words: &mut Vec<Word>| {
        words.extend([Word::Timestamp(200), Word::Special(Special::ExposureStart)]);
        words.extend([Word::Timestamp(300), Word::Special(Special::ExposureEnd)]);
    };
    if shutter == Special::FrameStartGlobalShutter {
        (0..columns).for_each(|_| column(&mut words, Special::ResetColumnStart, &|_| 900));
        exposure(&mut words);
        (0..columns).for_each(|c| column(&mut words, Special::SignalColumnStart, &|row| 900 - (100 * c + row)));
    } else {
        for c in 0..=columns {
            if c == 1 {
                exposure(&mut words);
            }
            if c < columns {
                column(&mut words, Special::ResetColumnStart, &|_| 900);
            }
            if c > 0 {
                column(&mut words, Special::SignalColumnStart, &|row| 900 - (100 * (c - 1) + row));
            }
        }
    }
    words.extend([Word::Timestamp(400), Word::Special(Special::FrameEnd)]);
    words
}

fn whole_frame(pixels: &[u16]) -> Seen {
    Seen::Frame {
        start: 100,
        end: 400,
        exposure: [Some(200), Some(300)],
        cycles: 0x155 | 0x0AA << 10 | 1 << 20,
        size: (3, 2),
        damaged: 0,
        pixels: pixels.to_vec(),
    }
}

#[test]
fn regions_in_all_orientations_and_both_shutters() {
    // (register 2.2, picture): bit 2 swaps; bit 1 mirrors wire columns, bit 0 wire rows.
    let expected: [(u32, [u16; 6]); 4] = [
        (0b100, [0, 1, 2, 100, 101, 102]),
        (0b101, [2, 1, 0, 102, 101, 100]),
        (0b110, [100, 101, 102, 0, 1, 2]),
        (0b111, [102, 101, 100, 2, 1, 0]),
    ];
    for shutter in [Special::FrameStartGlobalShutter, Special::FrameStartRollingShutter] {
        for (orientation, pixels) in expected {
            let layout = Layout::from_registers(|register| {
                (register == usb_davis::registers::aps::ORIENTATION).then_some(orientation)
            });
            let (messages, _) = decode_as(layout, &frame(3, 2, shutter));
            assert_eq!(messages, [whole_frame(&pixels)], "{shutter:?} {orientation:03b}");
        }
    }
    // Without the swap, wire columns are the user's columns: the same words are 2 columns of 3 samples, for a region of
    // 3 columns of 2 samples.
    let mut layout = Layout::DAVIS346;
    layout.aps.swap_axes = false;
    let (messages, _) = decode_as(layout, &frame(3, 2, Special::FrameStartGlobalShutter));
    assert!(matches!(messages.last(), Some(Seen::Anomaly(AnomalyKind::FrameIncomplete, _))), "{messages:?}");
}

#[test]
fn saturation() {
    let mut words = frame(3, 2, Special::FrameStartGlobalShutter);
    let samples: Vec<usize> = (0..words.len()).filter(|&index| matches!(words[index], Word::Sample(_))).collect();
    let mut set = |sample: usize, level: u16| words[samples[sample]] = Word::Sample(level);
    set(0, 383); // reset level too low
    set(6, 300);
    set(7, 0); // signal level zero
    set(2, 384); // reset level just high enough, and below the signal level
    set(8, 400);
    assert_eq!(decode(&words), [whole_frame(&[1023, 1023, 0, 100, 101, 102])]);
}

#[test]
fn a_lost_column_end_is_harmless() {
    let mut words = frame(3, 2, Special::FrameStartGlobalShutter);
    let end = words.iter().position(|&word| word == Word::Special(Special::ColumnEnd)).expect("one");
    words.remove(end);
    assert_eq!(
        decode(&words),
        [Seen::Anomaly(AnomalyKind::ColumnEndLost, 2 * end as u64), whole_frame(&[0, 1, 2, 100, 101, 102])]
    );
}

#[test]
fn a_lost_sample_loses_its_pixel_and_is_reported() {
    let words = frame(3, 2, Special::FrameStartGlobalShutter);
    let samples: Vec<usize> = (0..words.len()).filter(|&index| matches!(words[index], Word::Sample(_))).collect();
    for (lost, pixels) in [
        // The last signal sample of the first column, and the last reset sample of the second.
        (samples[8], [0, 1, 0, 100, 101, 102]),
        (samples[5], [0, 1, 2, 100, 101, 0]),
    ] {
        let mut words = words.clone();
        words.remove(lost);
        let mut expected = whole_frame(&pixels);
        if let Seen::Frame { damaged, .. } = &mut expected {
            *damaged = 1;
        }
        assert_eq!(decode(&words), [Seen::Anomaly(AnomalyKind::ColumnIncomplete, 2 * lost as u64), expected]);
    }
}

#[test]
fn surplus_samples_are_dropped() {
    let mut words = frame(3, 2, Special::FrameStartGlobalShutter);
    let end = words.iter().position(|&word| word == Word::Special(Special::ColumnEnd)).expect("one");
    words.insert(end, Word::Sample(5));
    let mut expected = whole_frame(&[0, 1, 2, 100, 101, 102]);
    if let Seen::Frame { damaged, .. } = &mut expected {
        *damaged = 1;
    }
    let messages = decode(&words);
    assert_eq!(messages[0], Seen::Anomaly(AnomalyKind::ColumnOverfull, 2 * end as u64));
    assert_eq!(messages[1..], [expected]);
}

#[test]
fn a_lost_column_loses_only_its_frame() {
    let whole = frame(3, 2, Special::FrameStartGlobalShutter);
    let start = whole.iter().position(|&word| word == Word::Special(Special::SignalColumnStart)).expect("one");
    let mut words = whole.clone();
    words.drain(start..start + 5);
    let again = words.len() as u64;
    words.push(Word::Wrap(1));
    words.extend(&whole);
    let messages = decode(&words);
    assert_eq!(messages[0], Seen::Anomaly(AnomalyKind::FrameIncomplete, 2 * (again - 1)));
    assert!(matches!(&messages[1..], [Seen::Frame { start: 32868, damaged: 0, .. }]), "{messages:?}");
}

#[test]
fn a_restart_of_the_clock_loses_the_frame_in_progress() {
    let whole = frame(3, 2, Special::FrameStartGlobalShutter);
    let exposure = whole.iter().position(|&word| word == Word::Special(Special::ExposureEnd)).expect("one");
    // Between the columns, before the corners, and within a column.
    for at in [exposure, 4, 16] {
        let mut words = whole.clone();
        words.insert(at, Word::Special(Special::TimestampReset));
        words.push(Word::Wrap(1));
        words.extend(&whole);
        let (messages, counts) = decode_as(Layout::DAVIS346, &words);
        assert_eq!(messages[0], Seen::Anomaly(AnomalyKind::FrameAcrossReset, 2 * at as u64));
        assert!(matches!(messages[1], Seen::Reset(_)), "{messages:?}");
        assert!(matches!(&messages[2..], [Seen::Frame { start: 32868, damaged: 0, .. }]), "{messages:?}");
        assert_eq!((counts.frames, counts.anomalies.total()), (1, 1));
    }
}

#[test]
fn a_surplus_end_of_a_column_is_reported_and_harmless() {
    let whole = frame(3, 2, Special::FrameStartGlobalShutter);
    let end = whole.iter().position(|&word| word == Word::Special(Special::ColumnEnd)).expect("one");
    let first = whole.iter().position(|&word| word == Word::Special(Special::ResetColumnStart)).expect("one");
    for at in [end, first] {
        let mut words = whole.clone();
        words.insert(at, Word::Special(Special::ColumnEnd));
        let place = if at == end { end + 1 } else { first };
        assert_eq!(
            decode(&words),
            [Seen::Anomaly(AnomalyKind::FrameStray, 2 * place as u64), whole_frame(&[0, 1, 2, 100, 101, 102])]
        );
    }
}

#[test]
fn a_frame_cut_by_the_next_one() {
    let whole = frame(3, 2, Special::FrameStartGlobalShutter);
    let mut words = whole[..20].to_vec();
    words.push(Word::Wrap(1));
    words.extend(&whole);
    let messages = decode(&words);
    assert_eq!(messages[0], Seen::Anomaly(AnomalyKind::FrameIncomplete, 44));
    assert!(matches!(&messages[1..], [Seen::Frame { start: 32868, damaged: 0, .. }]), "{messages:?}");
}

#[test]
fn a_region_beyond_the_sensor_is_cut_or_dropped() {
    // Last y = 300 is limited to 259; two columns are far too few for that region.
    let mut words = frame(3, 2, Special::FrameStartGlobalShutter);
    words[11] = Word::RegionHigh(300u16.to_be_bytes()[0]);
    words[12] = Word::RegionLow(300u16.to_be_bytes()[1]);
    let messages = decode(&words);
    assert_eq!(messages[0], Seen::Anomaly(AnomalyKind::FrameOutOfRange, 26));
    assert!(matches!(messages[1..], [Seen::Anomaly(AnomalyKind::FrameIncomplete, _)]), "{messages:?}");
    // First x after last x.
    words[6] = Word::RegionLow(20);
    words[11] = Word::RegionHigh(0);
    words[12] = Word::RegionLow(21);
    assert_eq!(decode(&words), [Seen::Anomaly(AnomalyKind::FrameOutOfRange, 26)]);
}

#[test]
fn a_frame_in_progress_when_the_stream_begins_is_not_a_fault() {
    let whole = frame(3, 2, Special::FrameStartRollingShutter);
    let (messages, counts) = decode_as(Layout::DAVIS346, &whole[9..]);
    assert_eq!(messages, []);
    assert_eq!(counts.anomalies.total(), 0);
    assert!(counts.skipped > 20);
}

#[test]
fn a_gap_drops_incomplete_items() {
    let whole = frame(3, 2, Special::FrameStartGlobalShutter);
    let mut decoder = Decoder::with_frames(Layout::DAVIS346, vec![0u16; 346 * 260]);
    let mut messages = Vec::new();
    let mut take = |message: Message<'_>| messages.extend(seen(message));
    let mut cut = bytes(&whole[..20]);
    cut.extend([0x55, 0x10, 0x99]); // a row, and half a word that must not be joined with the next byte
    decoder.decode(&cut, &mut take);
    decoder.gap(&mut take);
    decoder.decode(&bytes(&whole[20..]), &mut take);
    decoder.decode(&bytes(&[Word::Column(1, ON), Word::Row(2), Word::Column(1, ON)]), &mut take);
    let after = 43 + 2 * (whole.len() as u64 - 20);
    assert_eq!(
        messages,
        [
            Seen::Anomaly(AnomalyKind::Gap, 43),
            Seen::Anomaly(AnomalyKind::ColumnWithoutRow, after),
            Seen::Event(400, 2, 1, ON)
        ]
    );
    assert_eq!(decoder.counts().anomalies.of(AnomalyKind::Gap), 1);
}

#[test]
fn frames_are_skipped_without_memory_and_dropped_with_too_little() {
    let stream = bytes(&frame(3, 2, Special::FrameStartGlobalShutter));
    let mut decoder = Decoder::new(Layout::DAVIS346);
    decoder.decode(&stream, |message| panic!("{message:?}"));
    assert_eq!(decoder.counts().anomalies.total(), 0);
    let mut decoder = Decoder::with_frames(Layout::DAVIS346, [0; 5]);
    let mut messages = Vec::new();
    decoder.decode(&stream, |message| messages.extend(seen(message)));
    assert_eq!(messages, [Seen::Anomaly(AnomalyKind::FrameTooLarge, 26)]);
}

#[test]
fn after_a_gap_events_wait_for_a_word_that_carries_time() {
    let mut decoder = Decoder::new(Layout::DAVIS346);
    let mut messages = Vec::new();
    let mut take = |message: Message<'_>| messages.extend(seen(message));
    decoder.decode(&bytes(&[Word::Timestamp(5), Word::Row(1), Word::Column(1, ON)]), &mut take);
    for words in [
        [Word::Row(2), Word::Column(2, ON), Word::Timestamp(9), Word::Row(3), Word::Column(3, ON)],
        [Word::Row(4), Word::Column(4, ON), Word::Wrap(1), Word::Row(5), Word::Column(5, ON)],
    ] {
        decoder.gap(&mut take);
        decoder.decode(&bytes(&words), &mut take);
    }
    let expected = [
        Seen::Event(5, 1, 1, ON),
        Seen::Anomaly(AnomalyKind::Gap, 6),
        Seen::Event(9, 3, 3, ON),
        Seen::Anomaly(AnomalyKind::Gap, 16),
        Seen::Event(32768, 5, 5, ON),
    ];
    assert_eq!(messages, expected);
    assert_eq!(decoder.counts().skipped, 4);
}
