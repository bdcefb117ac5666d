//! Decoder of the events in an `event_camera_msgs/EventPacket`, by encoding.

use evcal_core::decode::{Evt3Decoder, EvtCounts, EvtRecord};
use evcal_core::event::{Event, Polarity};

use super::fields::MessageError;

/// Names of the supported encodings.
pub const ENCODINGS: [&str; 4] = ["evt3", "libcaer", "libcaer_cmp", "mono"];

/// Decoder of the packets of one topic. Its state continues from one packet to the next.
#[derive(Default)]
pub struct PacketDecoder {
    evt3: Evt3Decoder,
    libcaer: Libcaer,
    compressed: LibcaerCompressed,
    /// Number of edges at trigger inputs so far.
    pub triggers: u64,
}

/// State of the encoding `libcaer` within a packet.
#[derive(Default)]
struct Libcaer {
    /// Latest time in the words.
    latest: u32,
    /// What the overflows of the times add.
    turn: u64,
}

/// State of the encoding `libcaer_cmp` within a packet.
#[derive(Default)]
struct LibcaerCompressed {
    high: u64,
    low: u64,
    x: u16,
    first_row: u16,
    on: bool,
}

impl PacketDecoder {
    /// Begins a packet.
    pub fn begin_packet(&mut self) {
        (self.libcaer, self.compressed) = Default::default();
    }

    /// Decodes `payload`, a part of a packet that ends between words, and appends its events. `time_base` is in ns.
    pub fn decode(
        &mut self,
        encoding: &[u8],
        time_base: u64,
        payload: &[u8],
        events: &mut Vec<Event>,
    ) -> Result<(), MessageError> {
        match encoding {
            b"evt3" => {
                let words = payload.as_chunks().0.iter().flat_map(|word| self.evt3.push(u16::from_le_bytes(*word)));
                for record in words {
                    match record {
                        EvtRecord::Event(event) => events.push(event),
                        EvtRecord::Trigger(_) => self.triggers += 1,
                    }
                }
            }
            b"libcaer_cmp" => self.compressed.decode(time_base, payload, events),
            b"libcaer" => self.libcaer.decode(time_base, payload, events),
            b"mono" => {
                let words = payload.as_chunks().0.iter().map(|word| u64::from_le_bytes(*word));
                events.extend(words.map(|word| mono(time_base, word)));
            }
            _ => return Err(MessageError::Encoding),
        }
        Ok(())
    }

    /// Counts of the `evt3` decoder.
    pub fn counts(&self) -> &EvtCounts {
        self.evt3.counts()
    }
}

/// Converts a time from ns to µs.
fn microseconds(nanoseconds: u64) -> i64 {
    // The largest u64 divided by 1000 fits in an i64.
    (nanoseconds / 1000) as i64
}

fn polarity(on: bool) -> Polarity {
    if on { Polarity::On } else { Polarity::Off }
}

/// Decodes an event of the encoding `mono`, a word of 64 bits. From the lowest bit: 32 bits of time in ns after the
/// base, 16 of x, 15 of y, 1 of polarity.
fn mono(time_base: u64, word: u64) -> Event {
    Event {
        t: microseconds(time_base.saturating_add(word & 0xffff_ffff)),
        x: (word >> 32) as u16,
        y: (word >> 48) as u16 & 0x7fff,
        polarity: polarity(word >> 63 == 1),
    }
}

impl Libcaer {
    /// Decodes polarity events of AEDAT 3.1: u32 with bit 0 valid, 1 polarity, 2–16 y, 17–31 x; i32 time in µs after the
    /// base, which may overflow within a packet.
    fn decode(&mut self, time_base: u64, payload: &[u8], events: &mut Vec<Event>) {
        for &[a, b, c, d, e, f, g, h] in payload.as_chunks().0 {
            let (data, t) = (u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h]) & 0x7fff_ffff);
            if self.latest.saturating_sub(t) > 1 << 30 {
                self.turn = self.turn.saturating_add(1 << 31);
            }
            self.latest = t;
            if data & 1 == 1 {
                events.push(Event {
                    t: microseconds(time_base).saturating_add_unsigned(self.turn.saturating_add(t.into())),
                    x: (data >> 17) as u16,
                    y: (data >> 2) as u16 & 0x7fff,
                    polarity: polarity(data & 2 != 0),
                });
            }
        }
    }
}

impl LibcaerCompressed {
    /// Decodes words of 16 bits, with their type in bits 15–12: 0 time high, 1 time low (12 bits each, µs after the base),
    /// 2 column, 3 row and polarity (bit 11) of an event, 4 first row and polarity of a group, 5 one bit for each row of
    /// the group, set if it has an event.
    fn decode(&mut self, time_base: u64, payload: &[u8], events: &mut Vec<Event>) {
        for word in payload.as_chunks().0 {
            let word = u16::from_le_bytes(*word);
            let (mut y, mut mask) = (word & 0x7ff, 0);
            match word >> 12 {
                0 => self.high = u64::from(word & 0xfff),
                1 => self.low = u64::from(word & 0xfff),
                2 => self.x = word & 0x7ff,
                3 => (self.on, mask) = (word & 0x800 != 0, 1),
                4 => (self.on, self.first_row) = (word & 0x800 != 0, word & 0x7f8),
                5 => {
                    (y, mask) = (self.first_row, word & 0xff);
                    self.first_row = self.first_row.saturating_add(8);
                }
                _ => {}
            }
            let t = microseconds(time_base.saturating_add((self.high << 12 | self.low) * 1000));
            let event = Event { t, x: self.x, y, polarity: polarity(self.on) };
            let rows = (0..8).filter(|bit| mask >> bit & 1 == 1);
            events.extend(rows.map(|bit| Event { y: event.y.saturating_add(bit), ..event }));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decode(encoding: &str, time_base: u64, payload: &[u8]) -> Vec<Event> {
        let mut events = Vec::new();
        PacketDecoder::default().decode(encoding.as_bytes(), time_base, payload, &mut events).unwrap();
        events
    }

    fn event(t: i64, x: u16, y: u16, polarity: Polarity) -> Event {
        Event { t, x, y, polarity }
    }

    #[test]
    fn compressed_words_are_decoded() {
        let words = [0x0001_u16, 0x1002, 0x2003, 0x3804, 0x3005, 0x400b, 0x5081, 0x5002, 0x6fff, 0x1003, 0x3801];
        let payload: Vec<u8> = words.into_iter().flat_map(u16::to_le_bytes).collect();
        // Times 2 000 000 µs and 0x1002 µs.
        let t = 2_004_098;
        let expected = [
            event(t, 3, 4, Polarity::On),
            event(t, 3, 5, Polarity::Off),
            event(t, 3, 8, Polarity::Off),
            event(t, 3, 15, Polarity::Off),
            event(t, 3, 17, Polarity::Off),
            event(t + 1, 3, 1, Polarity::On),
        ];
        assert_eq!(decode("libcaer_cmp", 2_000_000_000, &payload), expected);
    }

    #[test]
    fn libcaer_words_are_decoded() {
        let records: [[u32; 2]; 3] =
            [[3 << 17 | 4 << 2 | 3, 0x7fff_ffff], [5 << 17 | 6 << 2, 7], [5 << 17 | 6 << 2 | 1, 0]];
        let payload: Vec<u8> = records.iter().flatten().flat_map(|word| word.to_le_bytes()).collect();
        let expected = [event(0x7fff_ffff + 2, 3, 4, Polarity::On), event(0x8000_0000 + 2, 5, 6, Polarity::Off)];
        assert_eq!(decode("libcaer", 2999, &payload), expected);
    }

    #[test]
    fn mono_words_are_decoded() {
        let word: u64 = 1 << 63 | 259 << 48 | 345 << 32 | 5999;
        assert_eq!(decode("mono", 1001, &word.to_le_bytes()), [event(7, 345, 259, Polarity::On)]);
    }

    #[test]
    fn the_state_of_evt3_continues_between_packets() {
        let mut decoder = PacketDecoder::default();
        let mut events = Vec::new();
        for words in [[0x8001_u16, 0x6002, 0x0007], [0x2003, 0xa001, 0x2804]] {
            let payload: Vec<u8> = words.into_iter().flat_map(u16::to_le_bytes).collect();
            decoder.decode(b"evt3", 5, &payload, &mut events).unwrap();
        }
        assert_eq!(events, [event(4098, 3, 7, Polarity::Off), event(4098, 4, 7, Polarity::On)]);
        assert_eq!(decoder.triggers, 1);
        assert_eq!(decoder.decode(b"jpeg", 0, &[], &mut events), Err(MessageError::Encoding));
    }
}
