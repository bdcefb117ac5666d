//! Blosc 1, as h5py's plugins write it, and the block format of the LZ4 filter.
//!
//! ```text
//! u8 version, u8 version of the codec, u8 flags, u8 size of an element, u32 uncompressed size, u32 size of a block,
//! u32 compressed size
//! u32 offset of each block
//! block: u32 compressed size and compressed bytes, either of the whole block or of each byte of an element
//! ```
//!
//! Flags: bit 0 bytes are shuffled, bit 1 not compressed, bit 2 bits are shuffled, bit 4 blocks are not split, bits 5
//! to 7 the codec (0 BloscLZ, 1 LZ4, 3 zlib, 4 Zstandard).

use std::io::Read;

/// Fault of a chunk.
#[derive(Debug, thiserror::Error)]
pub enum BloscError {
    /// The chunk ends too early.
    #[error("the chunk ends too early")]
    End,
    /// The stated size exceeds the space for the chunk.
    #[error("the chunk states a size of {0} bytes, which is too much")]
    Size(usize),
    /// The codec is Snappy or unknown.
    #[error("Blosc with {}", if *.0 == 2 { "Snappy".to_owned() } else { format!("codec {}", .0) })]
    Codec(u8),
    /// Compressed data are invalid.
    #[error("a block is damaged")]
    Block,
}

const HEAD: usize = 16;
/// Blocks are not split if elements exceed this many bytes, or if there are fewer elements than `LEAST_ELEMENTS`.
const LARGEST_SPLIT: usize = 16;
const LEAST_ELEMENTS: usize = 128;

fn u32_at(data: &[u8], at: usize) -> Result<usize, BloscError> {
    let bytes = data.get(at..).and_then(|rest| rest.first_chunk()).ok_or(BloscError::End)?;
    Ok(u32::from_le_bytes(*bytes) as usize)
}

/// Decompresses a chunk to at most `most` bytes.
pub fn decompress(data: &[u8], most: usize) -> Result<Vec<u8>, BloscError> {
    let &[_, _, flags, size, ..] = data else { return Err(BloscError::End) };
    let (total, block) = (u32_at(data, 4)?, u32_at(data, 8)?);
    if total > most {
        return Err(BloscError::Size(total));
    }
    if flags & 2 != 0 {
        return data.get(HEAD..HEAD + total).map(<[u8]>::to_vec).ok_or(BloscError::End);
    }
    if total > 0 && block == 0 {
        return Err(BloscError::Block);
    }
    let size = usize::from(size).max(1);
    let mut output = Vec::with_capacity(total);
    let mut scratch = Vec::new();
    for (index, start) in (0..total).step_by(block.max(1)).enumerate() {
        let length = block.min(total - start);
        let whole = length == block;
        let split = flags & 0x10 == 0 && whole && size <= LARGEST_SPLIT && length / size >= LEAST_ELEMENTS;
        let streams = if split { size } else { 1 };
        let mut at = u32_at(data, HEAD + 4 * index)?;
        scratch.clear();
        for _ in 0..streams {
            let packed = u32_at(data, at)?;
            let bytes = data.get(at + 4..).and_then(|rest| rest.get(..packed)).ok_or(BloscError::End)?;
            unpack(flags >> 5, bytes, length / streams, &mut scratch)?;
            at += 4 + packed;
        }
        if scratch.len() != length {
            return Err(BloscError::Block);
        }
        match (flags & 1 != 0 && size > 1, flags & 4 != 0) {
            (true, _) => unshuffle(&scratch, size, &mut output),
            (false, true) => unshuffle_bits(&scratch, size, &mut output),
            (false, false) => output.extend_from_slice(&scratch),
        }
    }
    Ok(output)
}

/// Appends the `length` bytes that `bytes` decompress to.
fn unpack(codec: u8, bytes: &[u8], length: usize, output: &mut Vec<u8>) -> Result<(), BloscError> {
    let start = output.len();
    if bytes.len() == length {
        output.extend_from_slice(bytes);
        return Ok(());
    }
    match codec {
        0 => blosclz(bytes, start + length, output)?,
        1 => {
            output.resize(start + length, 0);
            let target = output.get_mut(start..).ok_or(BloscError::Block)?;
            lz4_flex::block::decompress_into(bytes, target).map_err(|_| BloscError::Block)?;
        }
        3 => {
            let read = flate2::read::ZlibDecoder::new(bytes).take(length as u64).read_to_end(output);
            read.map_err(|_| BloscError::Block)?;
        }
        4 => {
            let unpacked = zstd::bulk::decompress(bytes, length).map_err(|_| BloscError::Block)?;
            output.extend_from_slice(&unpacked);
        }
        other => return Err(BloscError::Codec(other)),
    }
    if output.len() == start + length { Ok(()) } else { Err(BloscError::Block) }
}

/// Decompresses BloscLZ: literals and matches, as in FastLZ level 2.
fn blosclz(bytes: &[u8], end: usize, output: &mut Vec<u8>) -> Result<(), BloscError> {
    /// Longer distances than 13 bits can express have two additional bytes.
    const FARTHEST_SHORT: usize = 8191;
    let begin = output.len();
    let mut input = bytes.iter().copied();
    let mut next = || input.next().map(usize::from);
    let mut control = next().ok_or(BloscError::End)? & 31;
    loop {
        if control < 32 {
            for _ in 0..=control {
                output.push(next().ok_or(BloscError::End)? as u8);
            }
        } else {
            let mut length = (control >> 5) + 2;
            let high = (control & 31) << 8;
            if control >> 5 == 7 {
                loop {
                    let more = next().ok_or(BloscError::End)?;
                    length += more;
                    if more != 255 {
                        break;
                    }
                }
            }
            let low = next().ok_or(BloscError::End)?;
            let distance = match (low, high) {
                (255, 0x1F00) => {
                    let [far, near] = [next().ok_or(BloscError::End)?, next().ok_or(BloscError::End)?];
                    FARTHEST_SHORT + (far << 8) + near + 1
                }
                _ => high + low + 1,
            };
            if distance > output.len() - begin || length > end - output.len().min(end) {
                return Err(BloscError::Block);
            }
            for _ in 0..length {
                let byte = output.get(output.len() - distance).copied().ok_or(BloscError::Block)?;
                output.push(byte);
            }
        }
        if output.len() > end {
            return Err(BloscError::Block);
        }
        match next() {
            Some(byte) => control = byte,
            None => return Ok(()),
        }
    }
}

/// Appends elements that are stored as planes: the first bytes of all elements, then the second bytes, and so on.
fn unshuffle(bytes: &[u8], size: usize, output: &mut Vec<u8>) {
    let elements = bytes.len() / size;
    let start = output.len();
    output.extend_from_slice(bytes);
    let Some(target) = output.get_mut(start..) else { return };
    for (lane, plane) in bytes.chunks_exact(elements.max(1)).take(size).enumerate() {
        target.iter_mut().skip(lane).step_by(size).zip(plane).for_each(|(slot, byte)| *slot = *byte);
    }
}

/// Appends elements that are stored as bit planes: the lowest bits of all elements, then the second bits, and so on. If
/// the number of elements is not a multiple of eight, they are stored unchanged.
fn unshuffle_bits(bytes: &[u8], size: usize, output: &mut Vec<u8>) {
    let elements = bytes.len() / size;
    let start = output.len();
    output.extend_from_slice(bytes);
    if !elements.is_multiple_of(8) {
        return;
    }
    let (Some(target), row) = (output.get_mut(start..start + elements * size), elements / 8) else { return };
    target.fill(0);
    for (bit, plane) in bytes.chunks_exact(row.max(1)).take(8 * size).enumerate() {
        for element in 0..elements {
            let value = plane.get(element / 8).map_or(0, |byte| byte >> (element % 8) & 1);
            if let Some(slot) = target.get_mut(element * size + bit / 8) {
                *slot |= value << (bit % 8);
            }
        }
    }
}

/// Decompresses HDF5's LZ4 filter: u64 uncompressed size, u32 size of a block, then for each block u32 compressed size
/// and compressed bytes; all numbers are big-endian.
pub fn lz4_blocks(data: &[u8], most: usize) -> Result<Vec<u8>, BloscError> {
    let (total, rest) = data.split_first_chunk().ok_or(BloscError::End)?;
    let (block, mut rest) = rest.split_first_chunk().ok_or(BloscError::End)?;
    let total = usize::try_from(u64::from_be_bytes(*total)).unwrap_or(usize::MAX);
    if total > most {
        return Err(BloscError::Size(total));
    }
    let block = (u32::from_be_bytes(*block) as usize).clamp(1, total.max(1));
    let mut output = Vec::with_capacity(total);
    while output.len() < total {
        let length = block.min(total - output.len());
        let (packed, after) = rest.split_first_chunk().ok_or(BloscError::End)?;
        let (packed, after) = after.split_at_checked(u32::from_be_bytes(*packed) as usize).ok_or(BloscError::End)?;
        unpack(1, packed, length, &mut output)?;
        rest = after;
    }
    Ok(output)
}
