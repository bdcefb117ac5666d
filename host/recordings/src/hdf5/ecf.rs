//! ECF, the compression of events in Prophesee's HDF5 files.
//!
//! ```text
//! u32 count << 2 | all << 1 | pairs   packing of x, y and polarity
//! u64 time of the first event
//! times    u8 step << 4 | events at the new time; 15 events: u16 with their number follows;
//!          15 steps: the other four bits are part of a longer step, lowest first, one byte after the other
//! all:     4 events in three u32: 24 bits each, y << 12 | x << 1 | polarity
//! else:    rows      u16 y << 5 | number of events; 31 events: u16 follows
//!   pairs: 4 events in three u16: 12 bits each, x << 1 | polarity
//!   else:  columns   u16 x << 5 | one bit for each of x + 1 to x + 5, the nearest in the highest bit
//!          polarity  u8 p << 7 | number of events; 127 events: u16 follows
//! ```
//!
//! Of 4 events, the first is in the highest bits of the first word, and the last in the lowest bits of the last word.
//! The other two are split: their lower bits are at the end of a word and their higher bits at the beginning of the
//! next.

/// Size of a record in Prophesee's files: u16 x, u16 y, i16 polarity, two unused bytes, i64 time.
const RECORD: usize = 16;
/// Largest number of events in a chunk.
const MOST_EVENTS: usize = 65_535;

/// Fault of a chunk.
#[derive(Debug, thiserror::Error)]
pub enum EcfError {
    /// The chunk ends before its last event.
    #[error("the chunk ends too early")]
    End,
    /// The head states too many events.
    #[error("the chunk states {0} events, more than the limit of 65535")]
    Count(usize),
    /// A run is longer than the chunk.
    #[error("a run of events is longer than the chunk")]
    Run,
}

struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], EcfError> {
        let (first, rest) = self.0.split_first_chunk().ok_or(EcfError::End)?;
        self.0 = rest;
        Ok(*first)
    }

    fn u8(&mut self) -> Result<u8, EcfError> {
        self.take().map(u8::from_le_bytes)
    }

    fn u16(&mut self) -> Result<u16, EcfError> {
        self.take().map(u16::from_le_bytes)
    }
}

/// Decompresses a chunk into records.
pub fn decompress(data: &[u8]) -> Result<Vec<u8>, EcfError> {
    let mut bytes = Bytes(data);
    let head = u32::from_le_bytes(bytes.take()?);
    let count = (head >> 2) as usize;
    if count > MOST_EVENTS {
        return Err(EcfError::Count(count));
    }
    let times = times(&mut bytes, count)?;
    let pixels = match (head & 2 != 0, head & 1 != 0) {
        (true, _) => packed_events(&mut bytes, count)?,
        (false, pairs) => {
            let rows = rows(&mut bytes, count)?;
            let columns = if pairs { packed_columns(&mut bytes, count)? } else { columns(&mut bytes, count)? };
            rows.into_iter().zip(columns).map(|(y, (x, p))| (x, y, p)).collect()
        }
    };
    let mut records = Vec::with_capacity(count * RECORD);
    for (t, (x, y, p)) in times.into_iter().zip(pixels) {
        records.extend_from_slice(&x.to_le_bytes());
        records.extend_from_slice(&y.to_le_bytes());
        records.extend_from_slice(&[p, 0, 0, 0]);
        records.extend_from_slice(&t.to_le_bytes());
    }
    Ok(records)
}

/// Appends `value` `run` times. The total must not exceed `count`.
fn repeat<T: Copy>(values: &mut Vec<T>, value: T, run: usize, count: usize) -> Result<(), EcfError> {
    if run > count - values.len() {
        return Err(EcfError::Run);
    }
    values.resize(values.len() + run, value);
    Ok(())
}

fn times(bytes: &mut Bytes, count: usize) -> Result<Vec<u64>, EcfError> {
    let mut time = u64::from_le_bytes(bytes.take()?);
    let mut times = Vec::with_capacity(count);
    // The longer step being read, and the number of its bits read so far.
    let (mut step, mut known) = (0u64, 0u32);
    while times.len() < count {
        let byte = bytes.u8()?;
        let (short, run) = (byte >> 4, byte & 15);
        if short == 15 {
            step |= u64::from(run).checked_shl(known).unwrap_or(0);
            known += 4;
            continue;
        }
        time = time.wrapping_add(step).wrapping_add(short.into());
        (step, known) = (0, 0);
        let run = if run == 15 { bytes.u16()? } else { run.into() };
        repeat(&mut times, time, run.into(), count)?;
    }
    Ok(times)
}

fn rows(bytes: &mut Bytes, count: usize) -> Result<Vec<u16>, EcfError> {
    let mut rows = Vec::with_capacity(count);
    while rows.len() < count {
        let word = bytes.u16()?;
        let run = if word & 31 == 31 { bytes.u16()? } else { word & 31 };
        repeat(&mut rows, word >> 5, run.into(), count)?;
    }
    Ok(rows)
}

fn columns(bytes: &mut Bytes, count: usize) -> Result<Vec<(u16, u8)>, EcfError> {
    let mut columns = Vec::with_capacity(count + 5);
    while columns.len() < count {
        let word = bytes.u16()?;
        let x = word >> 5;
        columns.push(x);
        columns.extend((0..5u16).filter(|next| word >> (4 - next) & 1 != 0).map(|next| x + next + 1));
    }
    let mut polarities = Vec::with_capacity(count);
    while polarities.len() < count {
        let byte = bytes.u8()?;
        let run = if byte & 127 == 127 { bytes.u16()? } else { (byte & 127).into() };
        repeat(&mut polarities, byte >> 7, run.into(), count)?;
    }
    Ok(columns.into_iter().zip(polarities).collect())
}

fn packed_columns(bytes: &mut Bytes, count: usize) -> Result<Vec<(u16, u8)>, EcfError> {
    let mut columns = Vec::with_capacity(count + 3);
    while columns.len() < count {
        let [a, b, c] = [bytes.u16()?, bytes.u16()?, bytes.u16()?];
        let four = [a >> 4, (b >> 8 << 4) | (a & 0xF), (c >> 12 << 8) | (b & 0xFF), c & 0xFFF];
        columns.extend(four.map(|bits| (bits >> 1, (bits & 1) as u8)));
    }
    Ok(columns)
}

fn packed_events(bytes: &mut Bytes, count: usize) -> Result<Vec<(u16, u16, u8)>, EcfError> {
    let mut word = || bytes.take().map(u32::from_le_bytes);
    let mut events = Vec::with_capacity(count + 3);
    while events.len() < count {
        let [a, b, c] = [word()?, word()?, word()?];
        let four = [a >> 8, (b >> 16 << 8) | (a & 0xFF), (c >> 24 << 16) | (b & 0xFFFF), c & 0xFF_FFFF];
        events.extend(four.map(|bits| ((bits >> 1 & 0x7FF) as u16, (bits >> 12 & 0x7FF) as u16, (bits & 1) as u8)));
    }
    Ok(events)
}
