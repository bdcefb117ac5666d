//! Parts of a stream, each with its time.

use std::io::{Read, Seek};

use crate::capture::{Capture, CaptureError};
use crate::protocol::Decoder;

/// A part of the stream and the time at which the camera produces it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Piece {
    /// Time since the start in µs.
    pub time: u64,
    /// Bytes of the stream; at [`super::Pace::Real`] at most a few kilobytes, because more do not fit into the camera's
    /// FIFO.
    pub bytes: Vec<u8>,
}

/// Size of a piece of a recording in bytes, about the amount that the camera passes to its USB controller at once.
const PIECE_BYTES: usize = 8192;

/// Transfers of a recording, cut into pieces of 8 KiB. Their times are spread evenly between the arrival of the
/// previous transfer and of their own. If the recording contains no times of arrival, they follow the camera's clock.
pub struct CapturePieces<R: Read + Seek> {
    capture: Capture<R>,
    decoder: Decoder<Vec<u16>>,
    payload: Vec<u8>,
    /// Number of payload bytes already returned.
    taken: usize,
    /// Start of the transfer's arrival, in µs.
    began: u64,
    /// End of the transfer's arrival, in µs.
    arrived: u64,
}

impl<R: Read + Seek> CapturePieces<R> {
    /// Reads `capture` from its current position.
    pub fn new(capture: Capture<R>) -> Self {
        let decoder = capture.header().decoder();
        Self { capture, decoder, payload: Vec::new(), taken: 0, began: 0, arrived: 0 }
    }

    fn next_piece(&mut self) -> Result<Option<Piece>, CaptureError> {
        while self.taken >= self.payload.len() {
            let Some(transfer) = self.capture.next_transfer()? else { return Ok(None) };
            self.payload.clear();
            self.payload.extend_from_slice(transfer.payload);
            let time = match transfer.host_ns {
                Some(time) => time / 1000,
                None => {
                    self.decoder.decode(transfer.payload, |_| {});
                    self.decoder.time()
                }
            };
            (self.taken, self.began, self.arrived) = (0, self.arrived, time.max(self.arrived));
        }
        let end = (self.taken + PIECE_BYTES).min(self.payload.len());
        let bytes = self.payload.get(self.taken..end).unwrap_or_default().to_vec();
        self.taken = end;
        let part = u128::from(self.arrived - self.began) * end as u128 / self.payload.len().max(1) as u128;
        Ok(Some(Piece { time: self.began + part as u64, bytes }))
    }
}

impl<R: Read + Seek> Iterator for CapturePieces<R> {
    type Item = Result<Piece, CaptureError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.next_piece().transpose()
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;
    use crate::dump::{Compression, DumpHeader, DumpWriter, Transfer, TransferStatus};
    use crate::protocol::{Encoder, Layout, Polarity, PolarityEvent};

    fn pieces(file: Vec<u8>) -> Vec<Piece> {
        let capture = Capture::new(Cursor::new(file), None).expect("a recording");
        CapturePieces::new(capture).map(|piece| piece.expect("it is whole")).collect()
    }

    #[test]
    fn times_are_spread_over_the_time_of_a_transfer() {
        let mut dump = DumpWriter::new(Vec::new(), &DumpHeader::default(), Compression::None).expect("a vector");
        for (milliseconds, length) in [(10, 8192), (20, 4 * 8192), (21, 3), (21, 1)] {
            let payload = vec![1; length];
            let (status, host_ns) = (TransferStatus::Completed, Some(milliseconds * 1_000_000));
            dump.transfer(&Transfer { host_ns, gap_before: false, status, payload: &payload }).expect("a vector");
        }
        let pieces = pieces(dump.finish().expect("a vector"));
        let found: Vec<_> = pieces.iter().map(|piece| (piece.time, piece.bytes.len())).collect();
        let (one, whole) = (10_000, 8192);
        assert_eq!(
            found,
            [
                (one, whole),
                (12_500, whole),
                (15_000, whole),
                (17_500, whole),
                (20_000, whole),
                (21_000, 3),
                (21_000, 1)
            ]
        );
    }

    #[test]
    fn bare_payload_is_played_by_the_clock_of_the_camera() {
        let mut encoder = Encoder::new(Layout::DAVIS346);
        let mut bytes = Vec::new();
        for time in (0..3_000_000).step_by(20) {
            let event = PolarityEvent { time, x: 5, y: 6, polarity: Polarity::On };
            encoder.event(&event, &mut bytes).expect("in order");
        }
        let pieces = pieces(bytes.clone());
        let played: Vec<u8> = pieces.iter().flat_map(|piece| piece.bytes.iter().copied()).collect();
        assert_eq!(played, bytes);
        let (first, last) = (pieces.first().expect("many").time, pieces.last().expect("many").time);
        assert!(first < 100_000 && last.abs_diff(3_000_000) < 100, "{first} {last}");
        assert!(pieces.is_sorted_by_key(|piece| piece.time));
    }
}
