//! A stream in which every event follows from its number.

use usb_davis::emulator::Piece;
use usb_davis::protocol::{Encoder, Layout, Polarity, PolarityEvent};

/// Returns event number `index`: three events per microsecond, all over the sensor.
pub fn event(index: u64) -> PolarityEvent {
    let mixed = index.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 32;
    PolarityEvent {
        time: index / 3,
        x: (mixed % 346) as u16,
        y: (mixed / 346 % 260) as u16,
        polarity: if mixed & 0x80_0000 == 0 { Polarity::Off } else { Polarity::On },
    }
}

/// Returns `count` events as pieces of about 16 KiB.
pub fn events(count: u64) -> impl Iterator<Item = Piece> + Send + 'static {
    let mut encoder = Encoder::new(Layout::DAVIS346);
    (0..count).step_by(3000).map(move |first| {
        let mut bytes = Vec::new();
        for index in first..(first + 3000).min(count) {
            encoder.event(&event(index), &mut bytes).expect("in order");
        }
        Piece { time: event(first).time, bytes }
    })
}

/// Returns the total number of bytes of all pieces.
pub fn total(pieces: impl Iterator<Item = Piece>) -> u64 {
    pieces.map(|piece| piece.bytes.len() as u64).sum()
}
