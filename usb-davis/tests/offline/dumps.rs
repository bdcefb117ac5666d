//! `.dvraw` files: round trip, crash, damage, seeking.

use std::cell::Cell;
use std::fs::{self, File};
use std::io::{self, BufReader, Cursor, Read, Seek, SeekFrom};
use std::rc::Rc;
use std::thread;

use proptest::prelude::*;
use usb_davis::dump::{
    Compression, Damage, DumpError, DumpHeader, DumpReader, DumpWriter, Growth, Identity, Record, Transfer,
    TransferStatus,
};
use usb_davis::registers::{Register, RegisterSnapshot, mux, sysinfo};

fn header() -> DumpHeader {
    let identity = Identity { vendor_id: 0x152A, product_id: 0x841A, device_version: 6, serial: "00000042".to_owned() };
    let registers = RegisterSnapshot::from_iter([(sysinfo::LOGIC_VERSION, 18), (Register::new(5, 12), 0xFFFF_FFFF)]);
    DumpHeader::new(Some(identity), registers)
}

/// (host time, gap, status, payload)
type Owned = (u64, bool, TransferStatus, Vec<u8>);

fn write(transfers: &[Owned], compression: Compression, finish: bool) -> Vec<u8> {
    let mut file = Vec::new();
    let mut writer = DumpWriter::new(&mut file, &header(), compression).expect("a vector takes it");
    for (host_ns, gap_before, status, payload) in transfers {
        let transfer = Transfer { host_ns: Some(*host_ns), gap_before: *gap_before, status: *status, payload };
        writer.transfer(&transfer).expect("a vector takes it");
    }
    if finish {
        writer.finish().expect("a vector takes it");
    }
    file
}

fn read(file: &[u8]) -> (Vec<Owned>, Damage) {
    let mut reader = DumpReader::new(Cursor::new(file)).expect("the header is whole");
    let mut transfers = Vec::new();
    while let Some(record) = reader.next_record().expect("damage is not an error") {
        let Record::Transfer(transfer) = record else { continue };
        let host_ns = transfer.host_ns.expect("always written");
        transfers.push((host_ns, transfer.gap_before, transfer.status, transfer.payload.to_vec()));
    }
    (transfers, reader.damage())
}

/// A few kilobytes must not take as long as gigabytes.
#[test]
fn compressed_records_have_a_common_limit() {
    let (mut file, payload) = (Vec::new(), vec![0; (1 << 24) - 64]);
    let mut writer = DumpWriter::new(&mut file, &header(), Compression::Zstd(1)).expect("a vector takes it");
    for host_ns in 0..20 {
        let transfer = Transfer {
            host_ns: Some(host_ns),
            gap_before: false,
            status: TransferStatus::Completed,
            payload: &payload,
        };
        writer.transfer(&transfer).expect("a vector takes it");
    }
    writer.finish().expect("a vector takes it");
    let most = (1 << 28) + 256 * file.len();
    let mut reader = DumpReader::new(Cursor::new(&file)).expect("the header is whole");
    let mut read = 0;
    while let Some(record) = reader.next_record().expect("damage is not an error") {
        read += usize::from(matches!(record, Record::Transfer(_)));
    }
    assert_eq!(read, most / payload.len());
    assert_ne!(reader.damage(), Damage::default());
}

fn transfers(count: usize) -> Vec<Owned> {
    (0..count)
        .map(|index| {
            let payload = (0..1000 + index).map(|byte| (byte * index) as u8).collect();
            (1_000_000 * index as u64, index % 7 == 3, TransferStatus::Completed, payload)
        })
        .collect()
}

#[test]
fn header_and_registers_survive_a_round_trip() {
    let mut file = Vec::new();
    let header = header();
    let mut writer = DumpWriter::new(&mut file, &header, Compression::None).expect("a vector takes it");
    writer.registers([(mux::DVS_DROPPED, 1), (mux::DVS_DROPPED.next(), 2)]).expect("a vector takes it");
    writer.finish().expect("a vector takes it");
    let mut reader = DumpReader::new(Cursor::new(&file)).expect("it is whole");
    assert_eq!(reader.header(), &header);
    assert_eq!(reader.header().camera_name(), "DAVIS346_00000042");
    let Some(Record::Registers(registers)) = reader.next_record().expect("it is whole") else {
        panic!("registers were written")
    };
    assert_eq!(RegisterSnapshot::from_iter(registers).counter(mux::DVS_DROPPED), Some(1 << 32 | 2));
    assert_eq!(reader.next_record().expect("it is whole"), None);
    assert_eq!(reader.damage(), Damage::default());
}

#[test]
fn a_truncated_dump_is_readable_to_its_last_whole_record() {
    let expected = transfers(4);
    let file = write(&expected, Compression::None, false);
    let sizes = expected.iter().map(|(.., payload)| 28 + payload.len());
    let start = file.len() - sizes.clone().sum::<usize>();
    for length in start..=file.len() {
        let mut whole = 0;
        let mut end = start;
        for size in sizes.clone() {
            end += size;
            whole += usize::from(end <= length);
        }
        let (transfers, damage) = read(&file[..length]);
        assert_eq!(transfers, expected[..whole], "cut at {length}");
        assert_eq!(damage.bytes, 0);
        let read: usize = sizes.clone().take(whole).sum();
        assert_eq!(damage.unfinished, (length - start - read) as u64, "cut at {length}");
    }
    for length in 0..start {
        assert!(DumpReader::new(Cursor::new(&file[..length])).is_err(), "cut at {length}");
    }
}

#[test]
fn damage_loses_only_the_damaged_record() {
    let expected = transfers(5);
    for finish in [false, true] {
        for compression in [Compression::None, Compression::Zstd(1)] {
            let file = write(&expected, compression, finish);
            let marks: Vec<usize> =
                file.windows(4).enumerate().filter(|(_, at)| at == b"DVSR").map(|(at, _)| at).collect();
            for byte in [0, 4, 5, 9, 17, 22, 25, 30] {
                let mut file = file.clone();
                // The fourth marker: the first is part of the magic of the file.
                file[marks[3] + byte] ^= 0x41;
                let (transfers, damage) = read(&file);
                let mut rest = [&expected[..2], &expected[3..]].concat();
                rest[2].1 = true;
                assert_eq!(transfers, rest, "byte {byte}");
                assert_eq!(damage, Damage { bytes: (marks[4] - marks[3]) as u64, places: 1, unfinished: 0 });
            }
        }
    }
}

/// A reader that counts the bytes read.
struct Counting(Cursor<Vec<u8>>, Rc<Cell<usize>>);

impl Read for Counting {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let got = self.0.read(buffer)?;
        self.1.set(self.1.get() + got);
        Ok(got)
    }
}

impl Seek for Counting {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.0.seek(to)
    }
}

/// Reading the length that each head claims would read 12 GB of a file of 1 MB.
#[test]
fn heads_without_records_are_not_read_repeatedly() {
    let mut expected = transfers(50);
    let mut file = write(&[], Compression::None, false);
    let start = file.len();
    let length = (1_u32 << 19).to_le_bytes();
    let head = [&b"DVSR"[..], &[0; 12], &length, &length, &[0; 4]].concat();
    let heads = head.repeat(40_000);
    file.extend(&heads);
    file.extend(&write(&expected, Compression::None, false)[start..]);
    let read = Rc::new(Cell::new(0));
    let mut reader = DumpReader::new(Counting(Cursor::new(file), Rc::clone(&read))).expect("the header is whole");
    // The first good record comes after a gap.
    expected[0].1 = true;
    for (_, gap_before, _, payload) in &expected {
        let Some(Record::Transfer(transfer)) = reader.next_record().expect("damage is not an error") else {
            panic!("a transfer")
        };
        assert_eq!((transfer.gap_before, transfer.payload), (*gap_before, payload.as_slice()));
    }
    assert_eq!(reader.damage(), Damage { bytes: heads.len() as u64, places: 1, unfinished: 0 });
    assert!(read.get() < 300 << 20, "{} bytes", read.get());
}

/// Without a short first search, 64 kB would be read for each byte between two records.
#[test]
fn the_search_for_a_record_begins_nearby() {
    let mut file = write(&[], Compression::None, false);
    let start = file.len();
    let record = write(&transfers(1), Compression::None, false).split_off(start);
    (0..500).for_each(|_| file.extend([&record[..], &[0]].concat()));
    let length = file.len();
    let read = Rc::new(Cell::new(0));
    let mut reader = DumpReader::new(Counting(Cursor::new(file), Rc::clone(&read))).expect("the header is whole");
    let mut count = 0;
    while reader.next_record().expect("damage is not an error").is_some() {
        count += 1;
    }
    assert_eq!((count, reader.damage()), (500, Damage { bytes: 499, places: 499, unfinished: 1 }));
    assert!(read.get() < 5 * length, "{} of {length} bytes", read.get());
}

#[test]
fn other_files_are_rejected() {
    assert!(matches!(DumpReader::new(Cursor::new(b"#!AER-DAT4.0\r\n")), Err(DumpError::Magic)));
    let mut file = write(&[], Compression::None, true);
    file[20] ^= 1;
    assert!(matches!(DumpReader::new(Cursor::new(&file)), Err(DumpError::Header(_))));
}

#[test]
fn seeking_with_and_without_index() {
    // Larger than the distance of entries in the index.
    let expected: Vec<Owned> =
        (0..300).map(|index| (1000 * index, false, TransferStatus::Completed, vec![index as u8; 60_000])).collect();
    for finish in [true, false] {
        let file = write(&expected, Compression::None, finish);
        let mut reader = DumpReader::new(Cursor::new(&file)).expect("it is whole");
        for target in [0, 999, 1000, 150_500, 299_000, u64::MAX] {
            reader.seek(target).expect("seeking works");
            let Some(Record::Transfer(transfer)) = reader.next_record().expect("it is whole") else {
                panic!("a transfer lies before {target}")
            };
            let found = transfer.host_ns.expect("always written");
            // 4 MiB of 60 kB transfers that are 1000 ns apart.
            let nearest = if finish { 72_000 } else { 999 };
            assert!(found <= target && target.min(299_000) - found <= nearest, "{target}: {found}");
            assert_eq!(transfer.gap_before, found != 0);
        }
    }
}

#[test]
fn a_compressed_dump_is_smaller_and_equal() {
    let expected: Vec<Owned> =
        (0..20).map(|index| (index, false, TransferStatus::Completed, vec![index as u8; 8192])).collect();
    let plain = write(&expected, Compression::None, true);
    let small = write(&expected, Compression::Zstd(1), true);
    assert!(small.len() * 20 < plain.len());
    assert_eq!(read(&small), read(&plain));
    let directory = tempfile::tempdir().expect("a directory can be made");
    let path = directory.path().join("dump");
    fs::write(&path, &small).expect("it can be written");
    let mut capture = usb_davis::capture::Capture::open(&path).expect("it is a dump");
    let mut count = 0;
    while capture.next_transfer().expect("it is whole").is_some() {
        count += 1;
    }
    assert_eq!(count, 20);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_bytes_after_the_header_are_accepted(
        before in 0..3usize,
        junk in proptest::collection::vec(any::<u8>(), 0..300),
        marks in proptest::collection::vec(0..300usize, 0..3),
        after in 1..3usize,
    ) {
        let expected = transfers(before + after);
        let first = write(&expected[..before], Compression::None, false);
        let empty = write(&[], Compression::None, false).len();
        let mut file = first;
        let mut junk = junk;
        for mark in marks {
            if let Some(at) = junk.get_mut(mark..mark + 4) {
                at.copy_from_slice(b"DVSR");
            }
        }
        let mut rest = expected[before..].to_vec();
        rest[0].1 |= !junk.is_empty();
        let lost = junk.len() as u64;
        file.extend(junk);
        file.extend(&write(&expected[before..], Compression::None, false)[empty..]);
        let (read, damage) = read(&file);
        prop_assert_eq!(&read[..before], &expected[..before]);
        prop_assert_eq!(&read[before..], &rest[..]);
        prop_assert_eq!(damage.bytes, lost);
    }
}

/// Returns the transfers that a reader receives while it follows the file, and the damage.
fn follow(path: &std::path::Path, growth: Growth) -> (Vec<Owned>, Damage) {
    let input = BufReader::new(File::open(path).expect("it is there"));
    let mut reader = DumpReader::new(input).expect("the header is whole").following(growth);
    let mut transfers = Vec::new();
    while let Some(record) = reader.next_record().expect("damage is not an error") {
        let Record::Transfer(transfer) = record else { continue };
        let host_ns = transfer.host_ns.expect("always written");
        transfers.push((host_ns, transfer.gap_before, transfer.status, transfer.payload.to_vec()));
    }
    (transfers, reader.damage())
}

#[test]
fn a_following_reader_receives_all_transfers_however_the_recording_ends() {
    let expected = transfers(60);
    let directory = tempfile::tempdir().expect("a directory can be made");
    for (number, (finish, torn)) in [(true, false), (false, false), (false, true)].into_iter().enumerate() {
        let path = directory.path().join(format!("{number}.dvraw"));
        let growth = Growth::default();
        let writer = DumpWriter::new(File::create_new(&path).expect("it is new"), &header(), Compression::None);
        let mut writer = writer.expect("the file takes it").with_growth(growth.clone());
        let read = thread::scope(|scope| {
            let reader = scope.spawn(|| follow(&path, growth.clone()));
            for (index, (host_ns, gap_before, status, payload)) in expected.iter().enumerate() {
                let transfer = Transfer { host_ns: Some(*host_ns), gap_before: *gap_before, status: *status, payload };
                writer.transfer(&transfer).expect("the file takes it");
                if index % 20 == 19 {
                    // Lets the reader reach the current end.
                    thread::sleep(std::time::Duration::from_millis(5));
                }
            }
            if finish {
                writer.finish().expect("the file takes it");
            }
            if torn {
                let mut bytes = fs::read(&path).expect("it is there");
                bytes.extend(b"DVSR and no more");
                fs::write(&path, bytes).expect("it can be written");
            }
            growth.end();
            reader.join().expect("it does not panic")
        });
        assert_eq!(read.0, expected, "{finish} {torn}");
        assert_eq!(read.1.unfinished, if torn { 16 } else { 0 });
        // A later reader finds the same.
        assert_eq!(follow(&path, growth), read);
    }
}

#[test]
fn readers_do_not_wait_for_a_recording_that_never_began() {
    let growth = Growth::default();
    thread::scope(|scope| {
        let waiting = scope.spawn(|| growth.wait_beyond(0));
        growth.end();
        assert_eq!(waiting.join().expect("it does not panic"), None);
    });
}
