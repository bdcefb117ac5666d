//! Compressions that HDF5 supports only by plugins.

use std::path::Path;

use hdf5_reader::error::Error;
use hdf5_reader::messages::filter_pipeline::FilterDescription;
use hdf5_reader::superblock::Superblock;
use hdf5_reader::{FilterRegistry, Hdf5File, OpenOptions, Storage};

use super::blosc::{self, BloscError};
use super::ecf;

/// Numbers of the filters, as registered with the HDF Group; the number of ECF was chosen by Prophesee.
const LZF: u16 = 32000;
const BLOSC: u16 = 32001;
const LZ4: u16 = 32004;
const ZSTD: u16 = 32015;
const ECF: u16 = 0x8ECF;

/// Numbers and names of filters that are not supported.
const NOT_READ: [(u16, &str); 8] = [
    (305, "LZO"),
    (307, "bzip2"),
    (32003, "Snappy"),
    (32008, "Bitshuffle"),
    (32013, "ZFP"),
    (32017, "SZ"),
    (32024, "SZ3"),
    (32026, "Blosc 2"),
];

/// Size limit of a chunk in bytes.
const LARGEST_CHUNK: usize = 64 << 20;

/// Sizes of a stream's chunks, which limit decompression and the cache.
#[derive(Clone, Copy, Debug, Default)]
pub struct Limits {
    /// Size of the largest chunk, uncompressed, in bytes.
    largest: usize,
    /// Sum of the chunk sizes of all columns, uncompressed, in bytes.
    together: usize,
}

impl Limits {
    /// Adds a column with chunks of `bytes`.
    pub fn hold(&mut self, bytes: usize) {
        self.largest = self.largest.max(bytes);
        self.together = self.together.saturating_add(bytes);
    }
}

/// Opens the file at `path` to read chunks of the stream with these `limits`.
pub fn open(path: &Path, limits: Limits) -> Result<Hdf5File, Error> {
    let most = if limits.largest == 0 { LARGEST_CHUNK } else { limits.largest.min(LARGEST_CHUNK) };
    let damaged = |name: &str, what: String| Error::InvalidData(format!("{name}: {what}"));
    let mut registry = FilterRegistry::new();
    registry.register(
        LZF,
        Box::new(move |filter, data, _| {
            let size = filter.client_data.get(2).map_or(most, |size| (*size as usize).min(most));
            lzf::decompress(data, size).map_err(|error| damaged("LZF", error.to_string()))
        }),
    );
    registry.register(
        BLOSC,
        Box::new(move |_, data, _| {
            blosc::decompress(data, most).map_err(|error| match error {
                BloscError::Codec(_) => Error::UnsupportedFilter(format!("{error} (filter {BLOSC})")),
                error => damaged("Blosc", error.to_string()),
            })
        }),
    );
    registry.register(
        LZ4,
        Box::new(move |_, data, _| blosc::lz4_blocks(data, most).map_err(|error| damaged("LZ4", error.to_string()))),
    );
    registry.register(
        ZSTD,
        Box::new(move |_, data, _| {
            zstd::bulk::decompress(data, most).map_err(|error| damaged("Zstandard", error.to_string()))
        }),
    );
    registry.register(
        ECF,
        Box::new(move |_, data, _| {
            let mut records = ecf::decompress(data).map_err(|error| damaged("ECF", error.to_string()))?;
            // The last chunk is stored short, but HDF5 requires its full size.
            if limits.largest > 0 {
                records.resize(limits.largest, 0);
            }
            Ok(records)
        }),
    );
    for (number, name) in NOT_READ {
        let refuse = move |_: &FilterDescription, _: &[u8], _: usize| {
            Err(Error::UnsupportedFilter(format!("{name} (filter {number})")))
        };
        registry.register(number, Box::new(refuse));
    }
    // While streams are searched, one large chunk may belong to hundreds of them.
    let cache = if limits.largest == 0 { LARGEST_CHUNK } else { limits.together.clamp(1 << 20, 4 * LARGEST_CHUNK) };
    let options = OpenOptions::default()
        .with_filter_registry(registry)
        .with_max_chunk_bytes(LARGEST_CHUNK)
        .with_chunk_cache_bytes(cache);
    let storage = hdf5_reader::FileStorage::open(path)?;
    Hdf5File::from_storage_with_options(std::sync::Arc::new(storage), options)
}

/// Returns the length of the file at `path` and the length that its superblock states, if it is cut off.
pub fn cut_off(path: &Path) -> Option<(u64, u64)> {
    let storage = hdf5_reader::FileStorage::open(path).ok()?;
    let length = storage.len();
    let promised = Superblock::parse_from_storage(&storage).ok()?.eof_address;
    (length < promised && promised < u64::MAX).then_some((length, promised))
}
