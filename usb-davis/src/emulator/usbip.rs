//! Messages of USB/IP, protocol version 1.1.1 (`Documentation/usb/usbip_protocol.rst` of Linux), as used by the
//! kernel's virtual host controller once a device is attached.
//!
//! A message is a header of 48 bytes with big-endian numbers, followed by data: the data of a write after a submission,
//! the data of a read after its answer.

use std::io::{self, Read};

const HEADER_BYTES: usize = 48;
const COMMAND_SUBMIT: u32 = 1;
const COMMAND_UNLINK: u32 = 2;
const ANSWER_SUBMIT: u32 = 3;
const ANSWER_UNLINK: u32 = 4;
const DIRECTION_IN: u32 = 1;
/// Largest length of a write; no client of the camera sends more.
const WRITE_MOST: usize = 1 << 20;

/// A command of the host.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Command {
    /// Starts a transfer.
    Submit(Submission),
    /// Cancels the transfer of this number.
    Unlink { number: u32, victim: u32 },
}

/// A transfer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Submission {
    pub(super) number: u32,
    /// Address of the endpoint with its direction, such as 0x82.
    pub(super) endpoint: u8,
    /// Bytes to be written, or largest number of bytes to be read.
    pub(super) length: usize,
    /// Setup packet of a control transfer.
    pub(super) setup: [u8; 8],
    /// Bytes to be written.
    pub(super) data: Vec<u8>,
}

fn number(header: &[u8; HEADER_BYTES], at: usize) -> u32 {
    header.get(at..).and_then(<[u8]>::first_chunk).copied().map_or(0, u32::from_be_bytes)
}

/// Reads the next command.
pub(super) fn read_command(input: &mut impl Read) -> io::Result<Command> {
    let invalid = |text: String| io::Error::new(io::ErrorKind::InvalidData, text);
    let mut header = [0; HEADER_BYTES];
    input.read_exact(&mut header)?;
    let (command, sequence) = (number(&header, 0), number(&header, 4));
    match command {
        COMMAND_UNLINK => Ok(Command::Unlink { number: sequence, victim: number(&header, 20) }),
        COMMAND_SUBMIT => {
            let reads = number(&header, 12) == DIRECTION_IN;
            let endpoint = (number(&header, 16) & 0x0F) as u8 | if reads { 0x80 } else { 0 };
            let length = usize::try_from(number(&header, 24)).unwrap_or(usize::MAX);
            let setup = header.last_chunk().copied().unwrap_or_default();
            let mut data = Vec::new();
            if !reads {
                if length > WRITE_MOST {
                    return Err(invalid(format!("a write of {length} bytes")));
                }
                data.resize(length, 0);
                input.read_exact(&mut data)?;
            }
            Ok(Command::Submit(Submission { number: sequence, endpoint, length, setup, data }))
        }
        other => Err(invalid(format!("USB/IP command {other}"))),
    }
}

fn answer(kind: u32, sequence: u32, status: i32, actual: usize, data: &[u8]) -> Vec<u8> {
    let mut message = Vec::with_capacity(HEADER_BYTES + data.len());
    // Device, direction and endpoint are zero in answers.
    for number in [kind, sequence, 0, 0, 0, status as u32, actual as u32] {
        message.extend(number.to_be_bytes());
    }
    message.resize(HEADER_BYTES, 0);
    message.extend_from_slice(data);
    message
}

/// Returns the answer that ends a read.
pub(super) fn read_done(sequence: u32, status: i32, data: &[u8]) -> Vec<u8> {
    answer(ANSWER_SUBMIT, sequence, status, data.len(), data)
}

/// Returns the answer that ends a write.
pub(super) fn write_done(sequence: u32, status: i32, written: usize) -> Vec<u8> {
    answer(ANSWER_SUBMIT, sequence, status, written, &[])
}

/// Returns the answer that ends an unlink: `status` is −ECONNRESET if the transfer was still queued, 0 if it had ended.
pub(super) fn unlink_done(sequence: u32, status: i32) -> Vec<u8> {
    answer(ANSWER_UNLINK, sequence, status, 0, &[])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a header as the kernel's documentation lays it out.
    fn header(words: [u32; 10], setup: [u8; 8]) -> Vec<u8> {
        words.into_iter().flat_map(u32::to_be_bytes).chain(setup).collect()
    }

    #[test]
    fn commands_are_read_and_the_connection_stays_synchronised() {
        let setup = [0x40, 0xBF, 5, 0, 10, 0, 4, 0];
        let mut bytes = header([1, 7, 0x0002_0003, 0, 0, 0, 4, 0, 0, 0], setup);
        bytes.extend([1, 2, 3, 4]);
        bytes.extend(header([1, 8, 0x0002_0003, 1, 2, 0, 131_072, 0, u32::MAX, 0], [0; 8]));
        bytes.extend(header([2, 9, 0x0002_0003, 0, 0, 8, 0, 0, 0, 0], [0; 8]));
        let mut input = bytes.as_slice();
        let write = Submission { number: 7, endpoint: 0, length: 4, setup, data: vec![1, 2, 3, 4] };
        let read = Submission { number: 8, endpoint: 0x82, length: 131_072, setup: [0; 8], data: Vec::new() };
        assert_eq!(read_command(&mut input).expect("a command"), Command::Submit(write));
        assert_eq!(read_command(&mut input).expect("a command"), Command::Submit(read));
        assert_eq!(read_command(&mut input).expect("a command"), Command::Unlink { number: 9, victim: 8 });
        assert_eq!(read_command(&mut input).map_err(|error| error.kind()), Err(io::ErrorKind::UnexpectedEof));
    }

    #[test]
    fn unknown_commands_are_rejected() {
        let huge = header([1, 1, 0, 0, 1, 0, u32::MAX, 0, 0, 0], [0; 8]);
        for bytes in [header([5, 1, 0, 0, 0, 0, 0, 0, 0, 0], [0; 8]), huge] {
            let kind = read_command(&mut bytes.as_slice()).map_err(|error| error.kind());
            assert_eq!(kind, Err(io::ErrorKind::InvalidData));
        }
    }

    #[test]
    fn answers_have_the_layout_of_the_protocol() {
        let answer = read_done(8, 0, &[9; 5]);
        assert_eq!(answer[..28], header([3, 8, 0, 0, 0, 0, 5, 0, 0, 0], [0; 8])[..28]);
        assert_eq!((answer.len(), &answer[48..]), (53, &[9; 5][..]));
        assert_eq!(write_done(8, -32, 0)[20..24], (-32i32).to_be_bytes());
        assert_eq!(unlink_done(9, -104), header([4, 9, 0, 0, 0, (-104i32) as u32, 0, 0, 0, 0], [0; 8]));
    }
}
