//! Reads a dump, even if it is incomplete or damaged.

use std::io::{self, Read, Seek, SeekFrom};

use super::record::{HEAD, Head, Kind, MARKER, Transfer, checksum};
use super::{DumpError, DumpHeader, Growth, INDEX_MAGIC, LENGTH_MOST, MAGIC};
use crate::registers::Register;

/// Bytes read at once when searching for a record: a few at first, because a good record may follow closely.
const SEARCH: [usize; 2] = [1 << 10, 1 << 16];
/// Limit for the bytes that are read for damaged records: this constant, plus [`MOST_WASTED_FACTOR`] times the position in
/// the file. Without a limit, a file full of heads that each claim the longest record would take forever to read.
const MOST_WASTED: u64 = 4 * LENGTH_MOST as u64;
/// See [`MOST_WASTED`].
const MOST_WASTED_FACTOR: u64 = 4;
/// Limit for the bytes of all records that were compressed: this constant, plus [`MOST_UNPACKED_FACTOR`] times the length of the file.
/// Records beyond it count as damaged.
const MOST_UNPACKED: u64 = 1 << 28;
/// See [`MOST_UNPACKED`].
const MOST_UNPACKED_FACTOR: u64 = 256;
/// Number of bytes as which a shorter damaged record counts, because each attempt also costs a seek.
const LEAST_COST: u32 = 4096;

/// A record of a dump.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Record<'a> {
    /// A transfer from the data endpoint.
    Transfer(Transfer<'a>),
    /// Registers read or written while recording.
    Registers(Vec<(Register, u32)>),
}

/// A record whose payload is still in the reader's buffer.
pub(crate) enum Advanced {
    Transfer(Transfer<'static>),
    Registers(Vec<(Register, u32)>),
}

/// Parts of a dump that could not be read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Damage {
    /// Bytes skipped between good records.
    pub bytes: u64,
    /// Number of places at which bytes were skipped.
    pub places: u64,
    /// Bytes of an unfinished record at the end of the file.
    pub unfinished: u64,
}

/// Reads the records of a dump in order.
pub struct DumpReader<R> {
    input: R,
    /// Current position of `input`; an unnecessary seek would discard its buffer.
    position: u64,
    header: DumpHeader,
    /// Offset of the first record.
    start: u64,
    /// Offset of the next record.
    offset: u64,
    /// Offset of the end of the file.
    length: u64,
    stored: Vec<u8>,
    contents: Vec<u8>,
    damage: Damage,
    gap: bool,
    /// Bytes read for records that were not good.
    wasted: u64,
    /// Bytes of the records that were compressed, so far.
    unpacked: u64,
    /// Progress of the writer, if the dump is still being written.
    growth: Option<Growth>,
}

impl<R: Read + Seek> DumpReader<R> {
    /// Reads the header of `input`.
    pub fn new(mut input: R) -> Result<Self, DumpError> {
        let length = input.seek(SeekFrom::End(0))?;
        input.seek(SeekFrom::Start(0))?;
        let mut head = [0; 12];
        let got = fill(&mut input, &mut head)?;
        let [magic @ .., n0, n1, n2, n3] = head;
        if magic != *MAGIC {
            return Err(DumpError::Magic);
        }
        let json_length = u32::from_le_bytes([n0, n1, n2, n3]);
        if got < head.len() || json_length > LENGTH_MOST || length < 16 + u64::from(json_length) {
            return Err(DumpError::Header(format!("{json_length} bytes announced, the file has {length}")));
        }
        let mut json = vec![0; json_length as usize];
        input.read_exact(&mut json)?;
        let mut claimed = [0; 4];
        input.read_exact(&mut claimed)?;
        if checksum(&head, &json) != u32::from_le_bytes(claimed) {
            return Err(DumpError::Header("its checksum is wrong".to_owned()));
        }
        let header = serde_json::from_slice(&json).map_err(|error| DumpError::Header(error.to_string()))?;
        let start = 16 + u64::from(json_length);
        Ok(Self {
            input,
            position: start,
            header,
            start,
            offset: start,
            length,
            stored: Vec::new(),
            contents: Vec::new(),
            damage: Damage::default(),
            gap: false,
            wasted: 0,
            unpacked: 0,
            growth: None,
        })
    }

    /// Reads a dump while it is being written: at its current end, [`DumpReader::next_record`] waits for more.
    pub fn following(self, growth: Growth) -> Self {
        Self { growth: Some(growth), ..self }
    }

    /// Waits for the whole next record of a dump that is still being written.
    fn follow(&mut self) -> Result<(), DumpError> {
        let contents = self.offset + HEAD as u64;
        if self.grows_beyond(contents - 1)? {
            let mut bytes = [0; HEAD];
            self.read_bytes(self.offset, &mut bytes)?;
            if let Some((head, _)) = Head::parse(&bytes) {
                self.grows_beyond((contents + u64::from(head.stored)).saturating_sub(1))?;
            }
        }
        Ok(())
    }

    /// Waits until the dump has more than `bytes`, and updates its length. Returns `false` if nobody writes it, or not any more.
    fn grows_beyond(&mut self, bytes: u64) -> Result<bool, DumpError> {
        let Some(growth) = &self.growth else { return Ok(false) };
        let length = growth.wait_beyond(bytes);
        match length {
            Some(length) => self.length = length,
            None => {
                self.growth = None;
                self.length = self.input.seek(SeekFrom::End(0))?;
                self.position = self.length;
            }
        }
        Ok(length.is_some())
    }

    /// Returns the header.
    pub fn header(&self) -> &DumpHeader {
        &self.header
    }

    /// Returns the damage found so far.
    pub fn damage(&self) -> Damage {
        self.damage
    }

    /// Returns the next record; `None` at the end of the file or of its readable part.
    pub fn next_record(&mut self) -> Result<Option<Record<'_>>, DumpError> {
        Ok(match self.advance()? {
            None => None,
            Some(Advanced::Registers(registers)) => Some(Record::Registers(registers)),
            Some(Advanced::Transfer(head)) => Some(Record::Transfer(Transfer { payload: &self.contents, ..head })),
        })
    }

    /// Reads the next record; the payload of a transfer is then available from [`DumpReader::contents`].
    pub(crate) fn advance(&mut self) -> Result<Option<Advanced>, DumpError> {
        let head = loop {
            self.follow()?;
            let Some(head) = self.read()? else { return Ok(None) };
            if head.kind != Kind::Index {
                break head;
            }
        };
        if head.kind == Kind::Registers {
            let registers = self.contents.as_chunks::<6>().0.iter();
            let registers = registers.map(|&[module, parameter, v0, v1, v2, v3]| {
                (Register::new(module, parameter), u32::from_le_bytes([v0, v1, v2, v3]))
            });
            return Ok(Some(Advanced::Registers(registers.collect())));
        }
        let gap_before = head.gap_before | std::mem::take(&mut self.gap);
        let (host_ns, status) = (Some(head.host_ns), head.status);
        Ok(Some(Advanced::Transfer(Transfer { host_ns, gap_before, status, payload: &[] })))
    }

    /// Returns the contents of the latest record.
    pub(crate) fn contents(&self) -> &[u8] {
        &self.contents
    }

    /// Moves to a transfer at or shortly before `host_ns`. Use a new decoder from there: the times of the first events
    /// are unknown up to the next timestamp reset.
    pub fn seek(&mut self, host_ns: u64) -> Result<(), DumpError> {
        self.wasted = 0;
        let target = match self.index()? {
            Some(index) => index.iter().rev().find(|&&(_, at)| at <= host_ns).map(|&(offset, _)| offset),
            None => self.scan_for(host_ns)?,
        };
        self.offset = target.unwrap_or(self.start);
        self.gap = self.offset != self.start;
        self.wasted = 0;
        Ok(())
    }

    /// Returns offsets and host times of some transfers, if the dump was finished.
    fn index(&mut self) -> Result<Option<Vec<(u64, u64)>>, DumpError> {
        let mut trailer = [0; 16];
        if self.length < self.start + 16 {
            return Ok(None);
        }
        self.read_bytes(self.length - 16, &mut trailer)?;
        let (words, _) = trailer.as_chunks::<8>();
        let [offset, magic] = words else { return Ok(None) };
        let offset = u64::from_le_bytes(*offset);
        if magic != INDEX_MAGIC || offset < self.start || offset >= self.length {
            return Ok(None);
        }
        let before = (self.offset, self.damage);
        self.offset = offset;
        let head = self.read();
        (self.offset, self.damage) = before;
        if !head?.is_some_and(|head| head.kind == Kind::Index) {
            return Ok(None);
        }
        let (entries, _) = self.contents.as_chunks::<16>();
        let entries = entries.iter().map(|entry| {
            let (words, _) = entry.as_chunks::<8>();
            let number = |index: usize| words.get(index).copied().map_or(0, u64::from_le_bytes);
            (number(0), number(1))
        });
        Ok(Some(entries.collect()))
    }

    /// Finds the offset of the last transfer at or before `host_ns` by reading from the beginning.
    fn scan_for(&mut self, host_ns: u64) -> Result<Option<u64>, DumpError> {
        let before = self.damage;
        self.offset = self.start;
        let mut found = None;
        loop {
            let offset = self.offset;
            match self.read()? {
                Some(head) if head.kind != Kind::Transfer => {}
                Some(head) if head.host_ns <= host_ns => found = Some(offset),
                _ => break,
            }
        }
        self.damage = before;
        Ok(found)
    }

    /// Reads the record at `offset` or the next good one after it, with its contents into `contents`.
    fn read(&mut self) -> Result<Option<Head>, DumpError> {
        loop {
            // A finished file ends with the index and the trailer.
            if self.offset + HEAD as u64 > self.length {
                let rest = self.length.saturating_sub(self.offset);
                if rest > 0 && !self.trailer_at(self.offset, rest)? {
                    self.damage.unfinished += rest;
                }
                self.offset = self.length;
                return Ok(None);
            }
            if let Some(head) = self.read_at(self.offset)? {
                self.offset += HEAD as u64 + u64::from(head.stored);
                return Ok(Some(head));
            }
            let next = self.find_record(self.offset + 1)?;
            match next {
                Some(next) => {
                    self.damage.bytes += next - self.offset;
                    self.damage.places += 1;
                    self.offset = next;
                }
                None => {
                    self.damage.unfinished += self.length - self.offset;
                    self.offset = self.length;
                }
            }
            self.gap = true;
        }
    }

    fn trailer_at(&mut self, offset: u64, rest: u64) -> io::Result<bool> {
        let mut trailer = [0; 16];
        let got = self.read_bytes(offset, &mut trailer)?;
        Ok(rest == 16 && got == 16 && trailer.ends_with(INDEX_MAGIC))
    }

    /// Reads bytes at `offset` until `buffer` is full or the file ends.
    fn read_bytes(&mut self, offset: u64, buffer: &mut [u8]) -> io::Result<usize> {
        // A relative seek keeps the buffer if the target is in it.
        self.input.seek_relative(offset.wrapping_sub(self.position).cast_signed())?;
        self.position = offset;
        let got = fill(&mut self.input, buffer)?;
        self.position += got as u64;
        Ok(got)
    }

    /// Returns the good record at `offset`, or `None`.
    fn read_at(&mut self, offset: u64) -> Result<Option<Head>, DumpError> {
        let mut bytes = [0; HEAD];
        if self.read_bytes(offset, &mut bytes)? < HEAD {
            return Ok(None);
        }
        let Some((head, claimed)) = Head::parse(&bytes).filter(|(head, _)| self.may_be_at(offset, head)) else {
            return Ok(None);
        };
        let [covered @ .., _, _, _, _] = bytes;
        let good = self.read_contents(&head, |stored| checksum(&covered, stored) == claimed)?;
        if !good {
            self.wasted += cost_of_bad_record(&head);
        }
        Ok(good.then_some(head))
    }

    /// Returns `true` if the record of this head fits into the file and its bytes are within the limit of [`MOST_WASTED`].
    fn may_be_at(&self, offset: u64, head: &Head) -> bool {
        let most = offset.saturating_mul(MOST_WASTED_FACTOR).saturating_add(MOST_WASTED);
        offset + HEAD as u64 + u64::from(head.stored) <= self.length && self.wasted + cost_of_bad_record(head) <= most
    }

    /// Reads the contents after `head`; returns `false` if the record is not good.
    fn read_contents(&mut self, head: &Head, is_whole: impl Fn(&[u8]) -> bool) -> io::Result<bool> {
        self.stored.resize(head.stored as usize, 0);
        let got = fill(&mut self.input, &mut self.stored)?;
        self.position += got as u64;
        if got < self.stored.len() || !is_whole(&self.stored) {
            return Ok(false);
        }
        if head.compressed {
            self.unpacked = self.unpacked.saturating_add(u64::from(head.length));
            if self.unpacked > self.length.saturating_mul(MOST_UNPACKED_FACTOR).saturating_add(MOST_UNPACKED) {
                return Ok(false);
            }
            match zstd::bulk::decompress(&self.stored, head.length as usize) {
                Ok(contents) if contents.len() == head.length as usize => self.contents = contents,
                _ => return Ok(false),
            }
        } else {
            std::mem::swap(&mut self.stored, &mut self.contents);
        }
        Ok(true)
    }

    /// Returns the offset of the first good record at or after `from`.
    fn find_record(&mut self, mut from: u64) -> Result<Option<u64>, DumpError> {
        let [mut size, most] = SEARCH;
        let mut window = Vec::new();
        while from + HEAD as u64 <= self.length {
            window.resize(size, 0);
            size = (2 * size).min(most);
            let got = self.read_bytes(from, &mut window)?;
            let bytes = window.get(..got).unwrap_or(&[]);
            let heads = bytes.windows(HEAD).zip(from..).filter(|(at, _)| at.starts_with(MARKER));
            let candidates = heads.filter_map(|(at, offset)| Some((offset, Head::parse(at.first_chunk()?)?.0)));
            for (offset, head) in candidates {
                if self.may_be_at(offset, &head) && self.read_at(offset)?.is_some() {
                    return Ok(Some(offset));
                }
            }
            from += (got.max(HEAD) - HEAD + 1) as u64;
        }
        Ok(None)
    }
}

/// Returns the number of bytes that count for the limit of [`MOST_WASTED`] if the record of this head is damaged.
fn cost_of_bad_record(head: &Head) -> u64 {
    head.stored.max(head.length).max(LEAST_COST).into()
}

/// Reads until `buffer` is full or the input ends; returns the number of bytes read.
fn fill(input: &mut impl Read, buffer: &mut [u8]) -> io::Result<usize> {
    let mut got = 0;
    while let Some(rest) = buffer.get_mut(got..).filter(|rest| !rest.is_empty()) {
        match input.read(rest) {
            Ok(0) => break,
            Ok(count) => got += count,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(got)
}
