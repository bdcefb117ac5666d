//! Frames: sequence number, kind, body and CRC, in COBS (Cheshire and Baker 1999) with a zero at the end.

use crc::{CRC_32_ISO_HDLC, Crc};
use heapless::Vec;

/// Largest size of a frame before COBS in bytes: sequence number (2), kind (1), body, CRC (4).
pub(crate) const MAX_CONTENT: usize = 250;

/// Largest size of a frame on the wire in bytes: COBS adds one byte to content shorter than 254 bytes, and the
/// terminating zero one more.
pub const MAX_FRAME: usize = MAX_CONTENT + 2;

/// Number of bytes before the body.
pub(crate) const HEADER: usize = 3;

/// A frame as sent over the wire.
pub type Frame = Vec<u8, MAX_FRAME>;

static CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Sequence number, kind and body of a frame that passed its checks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Content<'a> {
    pub sequence: u16,
    pub kind: u8,
    pub body: &'a [u8],
}

/// Appends the CRC to `content`, and returns the result in COBS with a terminating zero.
///
/// Returns `None` if the content is too long for a frame.
pub(crate) fn seal(content: &[u8]) -> Option<Frame> {
    let mut whole: Vec<u8, MAX_CONTENT> = Vec::from_slice(content).ok()?;
    whole.extend_from_slice(&CRC.checksum(content).to_le_bytes()).ok()?;
    let mut frame = Frame::new();
    for run in whole.split(|&byte| byte == 0) {
        frame.push(u8::try_from(run.len()).ok()?.checked_add(1)?).ok()?;
        frame.extend_from_slice(run).ok()?;
    }
    frame.push(0).ok()?;
    Some(frame)
}

/// Decodes COBS: `coded` is a frame without its zero, `room` receives the decoded bytes.
///
/// Returns `None` if the frame is damaged.
pub(crate) fn open<'a>(mut coded: &[u8], room: &'a mut Vec<u8, MAX_CONTENT>) -> Option<Content<'a>> {
    room.clear();
    while let Some((&code, rest)) = coded.split_first() {
        let (run, rest) = rest.split_at_checked(usize::from(code).checked_sub(1)?)?;
        room.extend_from_slice(run).ok()?;
        if !rest.is_empty() {
            room.push(0).ok()?;
        }
        coded = rest;
    }
    let (content, checksum) = room.split_last_chunk::<4>()?;
    if CRC.checksum(content) != u32::from_le_bytes(*checksum) {
        return None;
    }
    let (&[low, high, kind], body) = content.split_first_chunk::<HEADER>()?;
    Some(Content { sequence: u16::from_le_bytes([low, high]), kind, body })
}

#[cfg(test)]
mod tests {
    use std::vec;

    use super::*;

    /// Built by hand from the layout in `docs/layouts.md`; the CRC was computed by zlib.
    #[test]
    fn a_frame_has_the_documented_layout() {
        let content = [0x02, 0x01, 0x01, 0x00, 0x05];
        let frame = seal(&content).unwrap();
        assert_eq!(frame, [4, 0x02, 0x01, 0x01, 6, 0x05, 0xa0, 0x5d, 0xf6, 0x75, 0]);
        let mut room = Vec::new();
        let expected = Content { sequence: 0x0102, kind: 1, body: &[0, 5] };
        assert_eq!(open(&frame[..10], &mut room), Some(expected));
    }

    #[test]
    fn content_may_be_as_long_as_documented_and_no_longer() {
        for fill in [0, 7] {
            let content = vec![fill; MAX_CONTENT - 4];
            let frame = seal(&content).unwrap();
            assert!(frame.len() <= MAX_FRAME && frame.iter().filter(|&&byte| byte == 0).count() == 1);
            let mut room = Vec::new();
            assert_eq!(open(&frame[..frame.len() - 1], &mut room).unwrap().body, &content[HEADER..]);
            assert_eq!(seal(&vec![fill; MAX_CONTENT - 3]), None);
        }
    }
}
