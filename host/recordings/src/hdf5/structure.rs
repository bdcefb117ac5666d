//! Writer of the structure of an HDF5 file, as far as arrays in groups require it.
//!
//! Superblock of version 2, object headers of version 2 with compact links, contiguous data: sections II to IV of the
//! HDF5 File Format Specification, version 3.0. All numbers are little-endian.

#[cfg(test)]
pub mod tests;

use hdf5_core::jenkins_lookup3;

/// Address that means "undefined".
const UNDEFINED: u64 = u64::MAX;
/// Length of the superblock in bytes.
pub const SUPERBLOCK: u64 = 48;
/// Types of object header messages.
const DATASPACE: u8 = 0x01;
const LINK_INFO: u8 = 0x02;
const DATATYPE: u8 = 0x03;
const FILL_VALUE: u8 = 0x05;
const LINK: u8 = 0x06;
const DATA_LAYOUT: u8 = 0x08;
const GROUP_INFO: u8 = 0x0a;
const ATTRIBUTE: u8 = 0x0c;

/// A type of numbers.
#[derive(Clone, Copy, Debug)]
pub enum Number {
    /// Integers.
    Integer {
        /// Size in bytes.
        size: u8,
        /// `true` if numbers may be negative.
        is_signed: bool,
    },
    /// Floating-point numbers of eight bytes (IEEE 754).
    Double,
}

impl Number {
    /// Returns the size of a number in bytes.
    pub fn size(self) -> u8 {
        match self {
            Self::Integer { size, .. } => size,
            Self::Double => 8,
        }
    }

    /// Version 1 and class; three bytes of properties; size; offset and number of bits (section IV.A.2.d of the specification).
    fn message(self) -> Vec<u8> {
        match self {
            Self::Integer { size, is_signed } => {
                let signed = if is_signed { 0x08 } else { 0 };
                let head = [0x10, signed, 0, 0, size, 0, 0, 0, 0, 0];
                [&head[..], &(u16::from(size) * 8).to_le_bytes()].concat()
            }
            // The leading 1 of the mantissa is implied; sign at bit 63; exponent of 11 bits from 52 on, mantissa of 52 from 0 on; bias 1023.
            Self::Double => vec![0x11, 0x20, 63, 0, 8, 0, 0, 0, 0, 0, 64, 0, 52, 11, 0, 52, 0xff, 0x03, 0, 0],
        }
    }
}

/// Returns the dataspace of a single number, or of an array of `count` numbers.
fn dataspace(count: Option<u64>) -> Vec<u8> {
    match count {
        None => vec![2, 0, 0, 0],
        Some(count) => [&[2, 1, 0, 1][..], &count.to_le_bytes()].concat(),
    }
}

/// Returns a message of an object header. Its content must be short, as all messages here are.
fn message(kind: u8, content: &[u8]) -> Vec<u8> {
    let length = (content.len() as u16).to_le_bytes();
    [&[kind, length[0], length[1], 0], content].concat()
}

/// Appends the checksum.
fn checked(mut bytes: Vec<u8>) -> Vec<u8> {
    let checksum = jenkins_lookup3(&bytes);
    bytes.extend(checksum.to_le_bytes());
    bytes
}

fn object_header(messages: &[Vec<u8>]) -> Vec<u8> {
    let messages = messages.concat();
    // The flags state that the size of the messages has four bytes.
    let head = [&b"OHDR\x02\x02"[..], &(messages.len() as u32).to_le_bytes()].concat();
    checked([head, messages].concat())
}

/// Returns the header of a one-dimensional array whose numbers are at `address`; of a single number if there is no
/// count.
pub fn dataset(numbers: Number, count: Option<u64>, address: u64) -> Vec<u8> {
    let length = count.unwrap_or(1).saturating_mul(numbers.size().into());
    let address = if length == 0 { UNDEFINED } else { address };
    let layout = [&[3, 1][..], &address.to_le_bytes(), &length.to_le_bytes()].concat();
    object_header(&[
        message(DATASPACE, &dataspace(count)),
        message(DATATYPE, &numbers.message()),
        // Allocated late, without a fill value.
        message(FILL_VALUE, &[3, 0x0a]),
        message(DATA_LAYOUT, &layout),
    ])
}

/// Returns the header of a group, with the names and addresses of its objects, and the name and number of each
/// attribute.
pub fn group(objects: &[(&str, u64)], attributes: &[(&str, u16)]) -> Vec<u8> {
    let undefined = UNDEFINED.to_le_bytes();
    let mut messages =
        vec![message(LINK_INFO, &[&[0, 0][..], &undefined, &undefined].concat()), message(GROUP_INFO, &[0, 0])];
    for (name, address) in objects {
        let content = [&[1, 0, name.len() as u8][..], name.as_bytes(), &address.to_le_bytes()].concat();
        messages.push(message(LINK, &content));
    }
    for (name, value) in attributes {
        let numbers = Number::Integer { size: 2, is_signed: false }.message();
        let space = dataspace(None);
        let sizes = [name.len() + 1, numbers.len(), space.len()].map(|size| (size as u16).to_le_bytes());
        let head = [&[3, 0][..], sizes.as_flattened(), &[0]].concat();
        messages
            .push(message(ATTRIBUTE, &[&head, name.as_bytes(), &[0], &numbers, &space, &value.to_le_bytes()].concat()));
    }
    object_header(&messages)
}

/// Returns the superblock of a file of `length` bytes, with the root group at `root`.
pub fn superblock(root: u64, length: u64) -> Vec<u8> {
    let addresses = [0, UNDEFINED, length, root].map(u64::to_le_bytes);
    checked([&b"\x89HDF\r\n\x1a\n\x02\x08\x08\x00"[..], addresses.as_flattened()].concat())
}
