//! Headers of arrays that evcal does not write, for tests of reading them.

use super::*;

/// Returns the header of a one-dimensional array with chunks of `side` numbers each, which are in a tree at `address`.
/// `filters` is the message with their compressions.
pub fn chunked(numbers: Number, count: u64, side: u32, address: u64, filters: &[u8]) -> Vec<u8> {
    let sides = [side, numbers.size().into()].map(u32::to_le_bytes);
    let layout = [&[3, 2, 2][..], &address.to_le_bytes(), sides.as_flattened()].concat();
    object_header(&[
        message(DATASPACE, &dataspace(Some(count))),
        message(DATATYPE, &numbers.message()),
        message(FILL_VALUE, &[3, 0x0a]),
        message(0x0b, filters),
        message(DATA_LAYOUT, &layout),
    ])
}

/// Returns the header of an array without data, all of whose `count` numbers are the fill value.
pub fn filled(numbers: Number, count: u64, value: u64) -> Vec<u8> {
    let value = value.to_le_bytes();
    let value = value.get(..numbers.size().into()).unwrap_or_default();
    // Allocated late; the value is user-defined.
    let fill = [&[3, 0x2a][..], &u32::from(numbers.size()).to_le_bytes(), value].concat();
    object_header(&[
        message(DATASPACE, &dataspace(Some(count))),
        message(DATATYPE, &numbers.message()),
        message(FILL_VALUE, &fill),
        message(
            DATA_LAYOUT,
            &[
                &[3, 2, 2][..],
                &UNDEFINED.to_le_bytes(),
                &65_536_u32.to_le_bytes(),
                &u32::from(numbers.size()).to_le_bytes(),
            ]
            .concat(),
        ),
    ])
}

/// Returns the header of a multidimensional array whose numbers are at `address`.
pub fn shaped(numbers: Number, sides: &[u64], address: u64) -> Vec<u8> {
    let length = sides.iter().product::<u64>() * u64::from(numbers.size());
    let space = [2, sides.len() as u8, 0, 1].into_iter().chain(sides.iter().flat_map(|side| side.to_le_bytes()));
    let layout = [&[3, 1][..], &address.to_le_bytes(), &length.to_le_bytes()].concat();
    object_header(&[
        message(DATASPACE, &space.collect::<Vec<_>>()),
        message(DATATYPE, &numbers.message()),
        message(FILL_VALUE, &[3, 0x0a]),
        message(DATA_LAYOUT, &layout),
    ])
}

/// Returns the header of a virtual array without sources.
pub fn virtual_array(numbers: Number, count: u64) -> Vec<u8> {
    let layout = [&[4, 3][..], &UNDEFINED.to_le_bytes(), &[0; 4]].concat();
    object_header(&[
        message(DATASPACE, &dataspace(Some(count))),
        message(DATATYPE, &numbers.message()),
        message(FILL_VALUE, &[3, 0x0a]),
        message(DATA_LAYOUT, &layout),
    ])
}
