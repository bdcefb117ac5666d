//! RAW: the words of the camera, unchanged.

use std::path::Path;

use evcal_core::decode::{Evt2Decoder, Evt3Decoder, Evt4Decoder, Evt21Decoder, EvtCounts, EvtRecord};
use evcal_core::event::Event;

use super::header::Header;
use super::write::OUTPUT;
use super::{TRIGGERS, store_counts};
use crate::bytes::ByteReader;
use crate::error::{RecordingError, RecordingErrorKind};
use crate::format::{FileFormat, Head, OpenResult, Uses};
use crate::options::RecordingOptions;
use crate::read_report::{ReadReport, Truncation};
use crate::reader::{Decode, Opened, RecordingInformation};
use crate::unsupported_format::UnsupportedFormat;

/// Prophesee RAW.
pub const FORMAT: FileFormat = FileFormat {
    output: Some(&OUTPUT),
    uses: Uses { growth: true, ..Uses::NONE },
    ..FileFormat::of_events(
        "Prophesee RAW",
        |head| Header::parse(&head.bytes).is_some_and(|header| encoding(&header).is_some()),
        open,
    )
};

/// Number of bytes that are decoded at a time; a multiple of the word size of every encoding.
const BLOCK: u64 = 1 << 15;

/// Returns the name of the encoding. Early files of third-generation sensors do not contain it; they are in EVT 2.0.
fn encoding(header: &Header) -> Option<&str> {
    let early = || header.get("plugin_name").filter(|name| name.contains("gen3")).map(|_| "2.0");
    header.get("evt").or_else(|| header.get("format")?.split(';').next()).or_else(early)
}

/// `true` if the halves of the EVT 2.1 words in `bytes` are exchanged: the half whose times increase is the upper one.
fn halves_are_swapped(bytes: &[u8]) -> bool {
    let (words, _) = bytes.as_chunks::<8>();
    let steps = |shift: u32| {
        let halves = words.iter().map(|word| (u64::from_le_bytes(*word) >> shift) as u32);
        let highs: Vec<u32> = halves.filter(|half| half >> 28 == 0x8).collect();
        highs.windows(2).filter(|pair| (1..=MOST_STEP).contains(&pair[1].wrapping_sub(pair[0]))).count()
    };
    steps(0) > steps(32)
}

/// Largest step between consecutive time highs of EVT 2.1 that counts as increasing, in units of 64 µs (0.1 s).
const MOST_STEP: u32 = 1600;

/// Decoder of the words, by encoding.
enum Words {
    Evt2(Evt2Decoder),
    Evt21 { decoder: Evt21Decoder, halves_swapped: bool },
    Evt3(Evt3Decoder),
    Evt4(Evt4Decoder),
}

impl Words {
    /// Creates the decoder for the data after `header`. `beginning` contains the first of them, for properties that the
    /// header lacks.
    fn new(header: &Header, beginning: &[u8]) -> Option<Self> {
        Some(match encoding(header)? {
            "2.0" | "EVT2" => Self::Evt2(Evt2Decoder::new()),
            "2.1" | "EVT21" => {
                let endianness = header.format_option("endianness").or_else(|| header.get("endianness"));
                let halves_swapped =
                    endianness.map_or_else(|| halves_are_swapped(beginning), |endianness| endianness == "legacy");
                Self::Evt21 { decoder: Evt21Decoder::new(), halves_swapped }
            }
            "3.0" | "EVT3" => Self::Evt3(Evt3Decoder::new()),
            "4.0" | "EVT4" => Self::Evt4(Evt4Decoder::new()),
            _ => return None,
        })
    }

    /// Decodes the whole words in `bytes` and passes the records to `take`. Returns the number of bytes left over.
    fn decode(&mut self, bytes: &[u8], take: &mut impl FnMut(EvtRecord)) -> usize {
        match self {
            Self::Evt2(decoder) => {
                let (words, rest) = bytes.as_chunks();
                words.iter().filter_map(|word| decoder.push(u32::from_le_bytes(*word))).for_each(take);
                rest.len()
            }
            Self::Evt21 { decoder, halves_swapped } => {
                let (words, rest) = bytes.as_chunks();
                let turn = if *halves_swapped { 32 } else { 0 };
                let words = words.iter().map(|word| u64::from_le_bytes(*word).rotate_left(turn));
                words.flat_map(|word| decoder.push(word)).for_each(take);
                rest.len()
            }
            Self::Evt3(decoder) => {
                let (words, rest) = bytes.as_chunks();
                words.iter().flat_map(|word| decoder.push(u16::from_le_bytes(*word))).for_each(take);
                rest.len()
            }
            Self::Evt4(decoder) => {
                let (words, rest) = bytes.as_chunks();
                words.iter().flat_map(|word| decoder.push(u32::from_le_bytes(*word))).for_each(take);
                rest.len()
            }
        }
    }

    fn counts(&self) -> &EvtCounts {
        match self {
            Self::Evt2(decoder) => decoder.counts(),
            Self::Evt21 { decoder, .. } => decoder.counts(),
            Self::Evt3(decoder) => decoder.counts(),
            Self::Evt4(decoder) => decoder.counts(),
        }
    }
}

struct Decoder {
    file: ByteReader,
    words: Words,
    block: Vec<u8>,
    triggers: u64,
    /// Time in µs from which the words count.
    zero: i64,
}

fn open(path: &Path, options: &RecordingOptions) -> OpenResult {
    let unsupported = RecordingErrorKind::Unsupported(UnsupportedFormat::PropheseeEncoding);
    let head = Head::read(path)?;
    let words = |header: Header| {
        let words = Words::new(&header, head.bytes.get(header.length..).unwrap_or_default())?;
        Some((words, header))
    };
    let Some((words, header)) = Header::parse(&head.bytes).and_then(words) else {
        return Err(RecordingError::new(path, unsupported));
    };
    let mut file = ByteReader::following(path, options.growth.as_ref())?;
    file.seek(header.length as u64)?;
    let (sensor, camera_name) = (header.sensor(), header.camera_name());
    let (zero, notes) = header.zero();
    let information = RecordingInformation { format: FORMAT.name, sensor, camera_name, began: header.date(), notes };
    Ok(Opened::new(information, Decoder { file, words, block: Vec::new(), triggers: 0, zero }))
}

impl Decode for Decoder {
    fn decode(&mut self, batch: &mut Vec<Event>, report: &mut ReadReport) -> Result<bool, RecordingError> {
        let wanted = self.file.block(BLOCK);
        self.file.read(&mut self.block, wanted)?;
        let (triggers, zero) = (&mut self.triggers, self.zero);
        let rest = self.words.decode(&self.block, &mut |record| match record {
            EvtRecord::Event(event) => batch.push(Event { t: event.t.saturating_add(zero), ..event }),
            EvtRecord::Trigger(_) => *triggers += 1,
        });
        store_counts(self.words.counts(), report);
        if self.triggers > 0 {
            report.other_packets.insert(TRIGGERS.to_owned(), self.triggers);
        }
        if rest > 0 {
            let byte = self.file.position() - rest as u64;
            report.truncated = Some(Truncation { byte, lost: format!("{rest} bytes of a word are left") });
        }
        Ok(self.block.len() as u64 == wanted)
    }

    fn done(&self) -> Option<f64> {
        Some(self.file.done())
    }
}

#[cfg(test)]
mod tests {
    use evcal_core::event::Polarity;
    use evcal_core::sensor::Sensor;

    use super::*;
    use crate::testing::{self, Outcome};

    /// Returns `count` pairs of events, every 20 µs at two neighbouring pixels. They span several time highs.
    fn events(count: i64) -> Vec<Event> {
        (0..count)
            .flat_map(|index| {
                let polarity = if index % 3 == 0 { Polarity::On } else { Polarity::Off };
                let first =
                    Event { t: 70_000 + index * 20, x: 7 + index as u16 % 300, y: index as u16 % 200, polarity };
                [first, Event { x: first.x + 1, ..first }]
            })
            .collect()
    }

    /// Encodes events in EVT 2.0.
    fn evt2(events: &[Event]) -> Vec<u32> {
        let mut words = vec![0xa000_0101];
        let mut high = 0;
        for event in events {
            if event.t as u32 >> 6 != high {
                high = event.t as u32 >> 6;
                words.push(0x8000_0000 + high);
            }
            let on = u32::from(event.polarity == Polarity::On);
            words.push((((on << 6) + event.t as u32 % 64) * 2048 + u32::from(event.x)) * 2048 + u32::from(event.y));
        }
        words
    }

    /// Returns words of EVT 4.0: those of EVT 2.0 with other types, and two neighbours as a vector.
    fn evt4(words: &[u32]) -> Vec<[u8; 4]> {
        let mut converted: Vec<u32> = Vec::new();
        let mut words = words.iter().peekable();
        while let Some(word) = words.next() {
            let (kind, content) = (word >> 28, word & 0xfff_ffff);
            match words.next_if_eq(&&(word + 2048)).filter(|_| kind < 2) {
                Some(_) => converted.extend([(0xc + kind) << 28 | content, 3]),
                None if kind < 2 => converted.push((0xa + kind) << 28 | content),
                None => converted.push(if kind == 8 { 0xe } else { 0x9 } << 28 | content),
            }
        }
        converted.into_iter().map(u32::to_le_bytes).collect()
    }

    fn evt3(events: &[Event]) -> Vec<u16> {
        let mut words = Vec::new();
        for pair in events.chunks(2) {
            let (t, on) = (pair[0].t as u32, u16::from(pair[0].polarity == Polarity::On) * 0x800);
            words.extend([0x8000 + (t / 4096) as u16, 0x6000 + (t % 4096) as u16, pair[0].y]);
            words.extend([0x3000 + on + pair[0].x, 0x5003]);
        }
        words
    }

    fn file(header: &str, words: impl IntoIterator<Item = impl AsRef<[u8]>>) -> Vec<u8> {
        let mut bytes = format!("% date 2026-09-10 10:00:00\n% serial_number 00001\n{header}").into_bytes();
        words.into_iter().for_each(|word| bytes.extend_from_slice(word.as_ref()));
        bytes
    }

    /// Returns files of all encodings with the same events.
    fn files(events: &[Event]) -> Vec<Vec<u8>> {
        let words = evt2(events);
        // The two events of a pair share a word of EVT 2.1; each time high has its own word.
        let mut wide: Vec<u64> = Vec::new();
        for &word in &words {
            match wide.last_mut() {
                Some(last) if word >> 29 == 0 && (*last >> 32) as u32 + 2048 == word => *last |= 2,
                _ => wide.push(u64::from(word) << 32 | u64::from(word >> 29 == 0)),
            }
        }
        vec![
            file("% evt 2.0\n% geometry 346x260\n", words.iter().map(|word| word.to_le_bytes())),
            file("% format EVT21;height=260;width=346\n% end\n", wide.iter().map(|word| word.to_le_bytes())),
            file(
                "% format EVT21;endianness=legacy;height=260;width=346\n% end\n",
                wide.iter().map(|word| word.rotate_left(32).to_le_bytes()),
            ),
            // Neither header states the order of the halves.
            file("% evt 2.1\n% geometry 346x260\n% end\n", wide.iter().map(|word| word.to_le_bytes())),
            file("% evt 2.1\n% geometry 346x260\n% end\n", wide.iter().map(|word| word.rotate_left(32).to_le_bytes())),
            file("% format EVT3;height=260;width=346\n% end\n", evt3(events).iter().map(|word| word.to_le_bytes())),
            file("% evt 4.0\n% format EVT4;height=260;width=346\n% end\n", evt4(&words)),
            // A file of the first third-generation cameras.
            file(
                "% plugin_name hal_plugin_gen31_fx3\n% geometry 346x260\n",
                words.iter().map(|word| word.to_le_bytes()),
            ),
        ]
    }

    #[test]
    fn every_encoding_is_decoded_to_the_encoded_events() {
        let events = events(20_000);
        for content in files(&events) {
            let Outcome { events: read, information, report, error } = testing::read(&content);
            let information = information.unwrap();
            assert_eq!((read.len(), error), (events.len(), None));
            assert!(read == events);
            assert_eq!((information.format, information.sensor), ("Prophesee RAW", Some(Sensor::new(346, 260))));
            assert_eq!(information.camera_name.as_deref(), Some("00001"));
            assert!(report.truncated.is_none() && report.stream.clock_resets == 0);
        }
    }

    /// faery counts times from the first event and writes its time into the header.
    #[test]
    fn the_time_of_the_header_is_added() {
        let events = events(100);
        let header = "% evt 2.0\n% geometry 346x260\n% t0 1000000\n% end\n";
        let outcome = testing::read(&file(header, evt2(&events).iter().map(|word| word.to_le_bytes())));
        let later: Vec<Event> = events.iter().map(|event| Event { t: event.t + 1_000_000, ..*event }).collect();
        assert!(outcome.events == later);
        assert!(outcome.information.unwrap().notes[0].contains("count from 1000000 µs"));
    }

    /// A time high, a row and a column come before the first time low; and there is one time high only.
    #[test]
    fn events_before_a_time_low_and_after_a_wrap_are_read() {
        let words = [0x8010_u16, 7, 0x2803, 0x6fff, 0x2004, 0x6001, 0x2005];
        let content = file("% evt 3.0\n% geometry 346x260\n% end\n", words.map(u16::to_le_bytes));
        let times: Vec<i64> = testing::read(&content).events.iter().map(|event| event.t).collect();
        assert_eq!(times, [0x10000, 0x10fff, 0x11001]);
    }

    #[test]
    fn triggers_and_unusable_words_are_counted() {
        let words = [0x0000_0000_u32, 0x8000_0010, 0xa000_0101, 0x1140_1807, 0x3000_0000];
        let content = file("% evt 2.0\n% geometry 346x260\n", words.map(u32::to_le_bytes));
        let outcome = testing::read(&content);
        assert_eq!(outcome.events, [Event { t: 1029, x: 3, y: 7, polarity: Polarity::On }]);
        assert_eq!(outcome.report.other_packets.get(TRIGGERS), Some(&1));
        assert_eq!(outcome.report.stream.faults.values().copied().collect::<Vec<_>>(), [1, 1]);
    }

    #[test]
    fn damage_loses_as_little_as_possible() {
        for content in files(&events(12)) {
            testing::check_damage(&content);
        }
    }

    #[test]
    fn another_encoding_is_rejected_with_a_reason() {
        let error = testing::read(&file("% evt 5.0\n", [[0; 8]])).error.unwrap();
        assert!(error.contains("EVT 2.0, 2.1, 3.0 or 4.0"), "{error}");
    }
}
