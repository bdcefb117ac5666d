//! Words written by hand from the specifications, truncated and damaged streams, and round trips.

use std::vec::Vec;

use proptest::prelude::*;

use super::*;
use crate::event::{Event, Polarity};

fn event(t: i64, x: u16, y: u16, polarity: Polarity) -> Event {
    Event { t, x, y, polarity }
}

fn decode_evt2(decoder: &mut Evt2Decoder, words: &[u32]) -> Vec<EvtRecord> {
    words.iter().filter_map(|&word| decoder.push(word)).collect()
}

fn times(records: &[EvtRecord]) -> Vec<i64> {
    let time = |record: &EvtRecord| match record {
        EvtRecord::Event(event) => event.t,
        EvtRecord::Trigger(trigger) => trigger.t,
    };
    records.iter().map(time).collect()
}

/// Builds a word from type, time low and coordinates, without the decoder's shifts.
fn word(kind: u32, low: u32, x: u32, y: u32) -> u32 {
    kind * 0x1000_0000 + low * 0x40_0000 + x * 0x800 + y
}

const fn time_high(high: u32) -> u32 {
    0x8000_0000 + high
}

#[test]
fn evt2_words_made_by_hand() {
    let mut decoder = Evt2Decoder::new();
    let words = [
        0x0000_0000, // an event without time
        0x8000_0010, // 16 × 64 µs
        0x1140_1807, // ON, 5 µs, (3, 7)
        0x0fff_ffff, // OFF, 63 µs, (2047, 2047)
        0xa080_0301, // rising edge of input 3, 2 µs
        0xafff_e0fe, // falling edge of input 0, 63 µs; the bits between are not used
        0xe123_4567, // vendor
        0xf000_0000, // vendor
        0x2000_0000, // not a type of EVT 2.0
        0x8000_0011,
        0x0028_00f0, // OFF, 0 µs, (1280, 240)
    ];
    let expected = [
        EvtRecord::Event(event(1029, 3, 7, Polarity::On)),
        EvtRecord::Event(event(1087, 2047, 2047, Polarity::Off)),
        EvtRecord::Trigger(Trigger { t: 1026, channel: 3, rising: true }),
        EvtRecord::Trigger(Trigger { t: 1087, channel: 0, rising: false }),
        EvtRecord::Event(event(1088, 1280, 240, Polarity::Off)),
    ];
    assert_eq!(decode_evt2(&mut decoder, &words), expected);
    let counts = EvtCounts { without_time: 1, vendor: 2, unknown: 1, ..EvtCounts::default() };
    assert_eq!(*decoder.counts(), counts);
}

#[test]
fn evt2_time_continues_after_a_wrap() {
    let mut decoder = Evt2Decoder::new();
    let words =
        [time_high(0xfff_ffff), word(0, 63, 1, 1), time_high(0), word(0, 0, 1, 1), time_high(1), word(0, 0, 1, 1)];
    let wrap = 1_i64 << 34;
    assert_eq!(times(&decode_evt2(&mut decoder, &words)), [wrap - 1, wrap, wrap + 64]);
    assert_eq!(*decoder.counts(), EvtCounts::default());
}

#[test]
fn one_damaged_time_high_of_evt2_is_ignored() {
    for damaged in [0x0fff_0000, 90_000, 7] {
        let mut decoder = Evt2Decoder::new();
        let words = [
            time_high(1000),
            word(1, 0, 1, 1),
            time_high(damaged),
            word(1, 5, 2, 2),
            time_high(1001),
            word(1, 0, 3, 3),
        ];
        assert_eq!(times(&decode_evt2(&mut decoder, &words)), [64_000, 64_064], "{damaged}");
        let counts = EvtCounts { without_time: 1, false_leaps: 1, ..EvtCounts::default() };
        assert_eq!(*decoder.counts(), counts);
    }
}

#[test]
fn a_confirmed_jump_of_evt2_time_is_followed() {
    // Two seconds were lost; then the sensor is restarted.
    let mut decoder = Evt2Decoder::new();
    let words = [
        time_high(1000),
        word(1, 0, 1, 1),
        time_high(32_250),
        time_high(32_251),
        word(1, 3, 1, 1),
        time_high(0),
        time_high(1),
        word(1, 9, 1, 1),
        time_high(2),
        word(1, 0, 1, 1),
    ];
    let end = 32_251 * 64;
    assert_eq!(times(&decode_evt2(&mut decoder, &words)), [64_000, end + 3, end + 64 + 9, end + 128]);
    let counts = EvtCounts { leaps: 1, clock_resets: 1, ..EvtCounts::default() };
    assert_eq!(*decoder.counts(), counts);
}

#[test]
fn evt21_words_made_by_hand() {
    let mut decoder = Evt21Decoder::new();
    let words = [
        0x1000_0000_0000_0001, // an event without time
        0x8000_0010_0000_0000, // 16 × 64 µs
        0x1140_1807_8000_0005, // ON, 5 µs, (3, 7): columns 3, 5 and 34
        0x0fff_ffff_0000_0000, // no pixel at all
        0x0028_00f0_0000_0001, // OFF, 0 µs, (1280, 240)
        0xa080_0301_0000_0000, // rising edge of input 3, 2 µs
        0xe123_4567_0000_0000, // vendor
    ];
    let expected = [
        EvtRecord::Event(event(1029, 3, 7, Polarity::On)),
        EvtRecord::Event(event(1029, 5, 7, Polarity::On)),
        EvtRecord::Event(event(1029, 34, 7, Polarity::On)),
        EvtRecord::Event(event(1024, 1280, 240, Polarity::Off)),
        EvtRecord::Trigger(Trigger { t: 1026, channel: 3, rising: true }),
    ];
    let records: Vec<EvtRecord> = words.iter().flat_map(|&word| decoder.push(word)).collect();
    assert_eq!(records, expected);
    assert_eq!(*decoder.counts(), EvtCounts { without_time: 1, vendor: 1, ..EvtCounts::default() });
}

fn decode_evt3(decoder: &mut Evt3Decoder, words: &[u16]) -> Vec<EvtRecord> {
    words.iter().flat_map(|&word| decoder.push(word)).collect()
}

#[test]
fn evt3_words_made_by_hand() {
    let mut decoder = Evt3Decoder::new();
    let words = [
        0x2003, // no row, no time
        0x0007, 0x2003, // no time
        0x8002, 0x2003, // time low is zero before the first one: OFF at (3, 7)
        0x6005, 0x2803, // 8197 µs, ON at (3, 7)
        0x0907, 0x2004, // row 263 of the other camera, OFF
        0x3809, 0x4801, 0x5082, 0x4001, // ON: 9, 20; 22, 28; 29
        0x5001, // the group continues: 41
        0xa301, // rising edge of input 3
        0x8003, 0x2001, // time low is zero again
        0x1005, 0x2001, 0x4fff, // no events
        0xe123, 0x7123, 0xf123, 0xd123, // vendor
        0x9000, 0xb000, 0xc000, // not types of EVT 3.0
    ];
    let on = |x| EvtRecord::Event(event(8197, x, 263, Polarity::On));
    let expected = [
        EvtRecord::Event(event(8192, 3, 7, Polarity::Off)),
        EvtRecord::Event(event(8197, 3, 7, Polarity::On)),
        EvtRecord::Event(event(8197, 4, 263, Polarity::Off)),
        on(9),
        on(20),
        on(22),
        on(28),
        on(29),
        on(41),
        EvtRecord::Trigger(Trigger { t: 8197, channel: 3, rising: true }),
        EvtRecord::Event(event(12_288, 1, 263, Polarity::Off)),
    ];
    assert_eq!(decode_evt3(&mut decoder, &words), expected);
    let counts = EvtCounts { without_time: 1, without_row: 3, vendor: 4, unknown: 3, ..EvtCounts::default() };
    assert_eq!(*decoder.counts(), counts);
}

#[test]
fn evt3_time_continues_after_a_wrap_and_a_repeated_time_high_changes_nothing() {
    let mut decoder = Evt3Decoder::new();
    let words = [0x0001, 0x8fff, 0x6fff, 0x2000, 0x8fff, 0x2000, 0x8000, 0x6001, 0x2000, 0x8001, 0x2000];
    let wrap = 1_i64 << 24;
    assert_eq!(times(&decode_evt3(&mut decoder, &words)), [wrap - 1, wrap - 1, wrap + 1, wrap + 4096]);
    assert_eq!(*decoder.counts(), EvtCounts::default());
}

/// Some writers give a single time high. Late events around a wrap, and a time high that comes after all, change
/// nothing.
#[test]
fn a_time_low_of_evt3_that_falls_has_wrapped() {
    let single: Vec<u16> =
        [0x8010, 0x0001].into_iter().chain((0..900).flat_map(|step| [0x6000 | (step * 700 % 4096), 0x2000])).collect();
    let expected: Vec<i64> = (0..900).map(|step| 0x10 * 4096 + step * 700).collect();
    assert_eq!(times(&decode_evt3(&mut Evt3Decoder::new(), &single)), expected);
    let words = [
        0x8010, 0x0001, 0x6ffe, 0x2000, // the time high is lost
        0x6001, 0x2000, 0x8011, 0x6002, 0x2000, 0x8012, 0x6001, 0x2000, 0x8013, 0x6000, 0x2000, 0x6ffd, 0x2000, 0x6003,
        0x2000, // a late event, then one that looks like a wrap
        0x8014, 0x6001, 0x2000,
    ];
    let base = 0x10 * 4096;
    let expected = [0xffe, 0x1001, 0x1002, 0x2001, 0x3000, 0x3ffd, 0x4003, 0x4001].map(|t| base + t);
    assert_eq!(times(&decode_evt3(&mut Evt3Decoder::new(), &words)), expected);
}

#[test]
fn evt4_words_made_by_hand() {
    let mut decoder = Evt4Decoder::new();
    let words = [
        word(0xa, 0, 1, 1), // no time
        0xe000_0010,
        word(0xb, 5, 3, 7),
        word(0xa, 6, 2047, 2047), // events at 1029 and 1030 µs
        word(0xc, 7, 100, 9),
        0x8000_0005, // OFF at 100, 102 and 131
        word(0xd, 7, 100, 9),
        0xe000_0010, // a mask that looks like a time high: ON at 104, 129, 130 and 131
        0xffff_ffff,
        word(0x9, 8, 0, 0x0301), // padding; rising edge of input 3
        0x6000_0014,
        0x7000_0001,
        0x0000_0000,
        0x8000_0000, // vendor; not types of EVT 4.0
        0xe000_0011,
        word(0xb, 0, 4, 4),
    ];
    let on = |t, x, y| EvtRecord::Event(event(t, x, y, Polarity::On));
    let off = |t, x, y| EvtRecord::Event(event(t, x, y, Polarity::Off));
    let expected = [
        on(1029, 3, 7),
        off(1030, 2047, 2047),
        off(1031, 100, 9),
        off(1031, 102, 9),
        off(1031, 131, 9),
        on(1031, 104, 9),
        on(1031, 129, 9),
        on(1031, 130, 9),
        on(1031, 131, 9),
        EvtRecord::Trigger(Trigger { t: 1032, channel: 3, rising: true }),
        on(1088, 4, 4),
    ];
    let records: Vec<EvtRecord> = words.iter().flat_map(|&word| decoder.push(word)).collect();
    assert_eq!(records, expected);
    assert_eq!(*decoder.counts(), EvtCounts { without_time: 1, vendor: 2, unknown: 2, ..EvtCounts::default() });
}

#[test]
fn one_damaged_time_high_of_evt3_is_ignored_and_a_reset_is_followed() {
    let mut decoder = Evt3Decoder::new();
    let words = [
        0x0001, 0x8100, 0x6001, 0x2000, 0x8900, 0x2000, 0x8101, 0x6002, 0x2000, // one word damaged
        0x8002, 0x6000, 0x2000, 0x8003, 0x6004, 0x2000, // the sensor starts again
    ];
    let base = 0x100 * 4096;
    assert_eq!(times(&decode_evt3(&mut decoder, &words)), [base + 1, base + 4098, base + 8196]);
    let counts = EvtCounts { without_time: 2, false_leaps: 1, clock_resets: 1, ..EvtCounts::default() };
    assert_eq!(*decoder.counts(), counts);
}

/// If the step were not followed, the events after it would be lost, and a second word of that time would shift all
/// later times.
#[test]
fn small_backward_steps_of_evt_time_are_followed() {
    let mut decoder = Evt3Decoder::new();
    let words = [0x0001, 0x8065, 0x6000, 0x2000, 0x8064, 0x2000, 0x8064, 0x2000, 0x8065, 0x2000, 0x8066, 0x2000];
    let time = |high: i64| high * 4096;
    assert_eq!(times(&decode_evt3(&mut decoder, &words)), [0x65, 0x64, 0x64, 0x65, 0x66].map(time));
    assert_eq!(*decoder.counts(), EvtCounts::default());
    // Across the wrap of the counter.
    let mut decoder = Evt2Decoder::new();
    let words = [time_high(0xfff_ffff), time_high(0), word(0, 1, 1, 1), time_high(0xfff_fffe), word(0, 2, 1, 1)];
    assert_eq!(times(&decode_evt2(&mut decoder, &words)), [(1 << 34) + 1, (1 << 34) - 128 + 2]);
    assert_eq!(*decoder.counts(), EvtCounts::default());
}

#[test]
fn packed_words_made_by_hand() {
    let mut decoder = PackedDecoder::new();
    let words = [
        0x0000_0001, // before any time
        0x8000_03e8, // 1000 µs
        0x0020_0c07, // ON, 0 µs, (3, 7)
        0x7fdf_ffff, // OFF, 511 µs, (2047, 1023)
        0xffff_ffff, // 2³¹ − 1 µs: 2147482647 µs later is a step back
        0x0040_0000, // OFF, 1 µs, (0, 0)
        0x8000_0005, // 6 µs later, past the wrap
        0x0000_0000,
    ];
    let decoded: Vec<Event> = words.iter().filter_map(|&word| decoder.push(word)).collect();
    let expected = [
        event(1000, 3, 7, Polarity::On),
        event(1511, 2047, 1023, Polarity::Off),
        event(1512, 0, 0, Polarity::Off),
        event(1517, 0, 0, Polarity::Off),
    ];
    assert_eq!(decoded, expected);
    assert_eq!(*decoder.counts(), PackedCounts { before_time: 1, clock_resets: 1 });
}

#[test]
fn events_that_do_not_fit_are_rejected() {
    for (x, y, packed, evt2) in [(2047, 1023, true, true), (0, 1024, false, true), (2048, 0, false, false)] {
        let event = event(0, x, y, Polarity::On);
        assert_eq!(PackedEncoder::new().encode(event).is_ok(), packed);
        assert_eq!(Evt2Encoder::new().encode(event).is_ok(), evt2);
    }
    assert_eq!(Evt2Encoder::new().encode(event(0, 0, 2048, Polarity::On)), Err(DoesNotFit));
}

/// Events in order of time with pauses up to `pause`; the first comes before the clock of packed records wraps.
fn events(rows: u16, pause: i64) -> impl Strategy<Value = Vec<Event>> {
    let step = prop_oneof![3 => 0_i64..100, 1 => 0..pause];
    let part = (step, 0_u16..2048, 0..rows, any::<bool>());
    (0_i64..1 << 30, prop::collection::vec(part, 0..200)).prop_map(|(start, parts)| {
        let mut t = start;
        let event = |(step, x, y, on)| {
            t += step;
            event(t, x, y, if on { Polarity::On } else { Polarity::Off })
        };
        parts.into_iter().map(event).collect()
    })
}

proptest! {
    #[test]
    fn packed_events_survive_a_round_trip(events in events(1024, 1_000_000_000)) {
        let (mut encoder, mut words, mut decoder) = (PackedEncoder::new(), Words::new(), PackedDecoder::new());
        let coded: Vec<u8> = events
            .iter()
            .flat_map(|&event| encoder.encode(event).unwrap())
            .flat_map(u32::to_le_bytes)
            .collect();
        let decoded: Vec<Event> =
            coded.iter().filter_map(|&byte| words.push(byte)).filter_map(|word| decoder.push(word)).collect();
        prop_assert_eq!(decoded, events);
        prop_assert_eq!((*decoder.counts(), words.pending()), (PackedCounts::default(), 0));
    }

    #[test]
    fn evt2_events_survive_a_round_trip(events in events(2048, 1_000_000)) {
        let (mut encoder, mut decoder) = (Evt2Encoder::new(), Evt2Decoder::new());
        let words: Vec<u32> = events.iter().flat_map(|&event| encoder.encode(event).unwrap()).collect();
        let expected: Vec<EvtRecord> = events.into_iter().map(EvtRecord::Event).collect();
        prop_assert_eq!(decode_evt2(&mut decoder, &words), expected);
        prop_assert_eq!(*decoder.counts(), EvtCounts::default());
    }

    #[test]
    fn evt4_events_survive_a_round_trip(events in events(2048, 1_000_000)) {
        let (mut encoder, mut decoder) = (Evt4Encoder::new(), Evt4Decoder::new());
        let mut decoded = Vec::new();
        for event in &events {
            for word in encoder.encode(*event).unwrap() {
                decoded.extend(decoder.push(word));
            }
        }
        prop_assert_eq!(decoded, events.into_iter().map(EvtRecord::Event).collect::<Vec<_>>());
    }

    /// Encodes words of EVT 3.0 in a second way: each event alone, or with its neighbours of the same time as groups of
    /// 12, 12 and 8.
    #[test]
    fn evt3_events_are_decoded_alone_and_in_groups(start in 0_u32..4096, rows in prop::collection::vec((0_u32..3000, 0_u16..2048, 0_u16..2000, any::<bool>(), any::<u32>()), 0..60)) {
        let (mut words, mut expected) = (std::vec![0x8000 | start as u16, 0x6000], Vec::new());
        let mut t = start * 4096;
        for (step, y, x, on, mask) in rows {
            let before = t;
            t += step;
            words.extend((before / 4096 + 1..=t / 4096).map(|high| 0x8000 | (high & 0xfff) as u16));
            words.push(0x6000 | (t & 0xfff) as u16);
            words.push(y);
            let polarity = u16::from(on) << 11;
            let columns = (0..32).filter(|bit| mask >> bit & 1 == 1).map(|bit| x + bit);
            let events = columns.clone().map(|x| event(i64::from(t), x, y, if on { Polarity::On } else { Polarity::Off }));
            expected.extend(events.map(EvtRecord::Event));
            if mask % 3 == 0 {
                words.extend(columns.filter(|&x| x < 2048).map(|x| 0x2000 | polarity | x));
                expected.retain(|record| !matches!(record, EvtRecord::Event(event) if event.x > 2047));
            } else {
                words.push(0x3000 | polarity | x);
                words.extend([0x4000 | (mask & 0xfff) as u16, 0x4000 | (mask >> 12 & 0xfff) as u16, 0x5000 | (mask >> 24) as u16]);
            }
        }
        let mut decoder = Evt3Decoder::new();
        let decoded = decode_evt3(&mut decoder, &words);
        prop_assert_eq!(decoded, expected);
        prop_assert_eq!(*decoder.counts(), EvtCounts::default());
    }

    /// For any input, times of EVT 3.0 step back by less than eleven time highs, the largest step that is followed plus
    /// one.
    #[test]
    fn backward_steps_of_evt3_time_are_bounded_for_any_input(words in prop::collection::vec(any::<u16>(), 0..400)) {
        let mut latest = i64::MIN;
        for t in times(&decode_evt3(&mut Evt3Decoder::new(), &words)) {
            prop_assert!(t > latest.saturating_sub(11 * 4096));
            latest = latest.max(t);
        }
    }

    /// For any input, times step back by less than one time high plus the largest step that is followed, and every word
    /// is counted.
    #[test]
    fn backward_steps_of_evt2_time_are_bounded_for_any_input(words in prop::collection::vec(any::<u32>(), 0..300)) {
        let mut decoder = Evt2Decoder::new();
        let records = decode_evt2(&mut decoder, &words);
        let mut latest = i64::MIN;
        for t in times(&records) {
            prop_assert!(t > latest.saturating_sub(64 + 10 * 4096));
            latest = latest.max(t);
        }
        let counts = decoder.counts();
        let highs = words.iter().filter(|&&word| word >> 28 == 8).count();
        let skipped = (counts.without_time + counts.vendor + counts.unknown) as usize;
        prop_assert_eq!(records.len() + skipped + highs, words.len());
    }
}
