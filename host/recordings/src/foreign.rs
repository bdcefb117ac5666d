//! Formats of others, which are known by how they begin and are not read.

use std::fmt;

/// A format that is known and not read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ForeignFormat {
    /// AEDAT 1 of jAER.
    Aedat1,
    /// AEDAT 3 whose packets are compressed.
    Aedat3Compressed,
    /// A bag of ROS 1 as it was before version 2.
    Rosbag1,
    /// HDF5, where this library was built without it.
    Hdf5,
    /// HDF5 whose arrays are views of other arrays (virtual datasets).
    VirtualHdf5,
    /// Prophesee RAW in another encoding than EVT 2.0, 2.1 or 3.0.
    PropheseeEncoding,
    /// Event Stream of another version than 2.
    EventStreamVersion,
    /// Event Stream of neither a DVS nor an ATIS: colours, or generic bytes.
    EventStreamKind,
    /// gzip.
    Gzip,
    /// xz.
    Xz,
    /// Zstandard.
    Zstandard,
    /// bzip2.
    Bzip2,
    /// tar.
    Tar,
    /// 7z.
    SevenZip,
    /// RAR.
    Rar,
    /// ZIP without an array of NumPy in it.
    Zip,
    /// ZIP whose arrays are packed in a way that NumPy does not pack them.
    ZipCompression,
    /// A spreadsheet, as Excel writes it.
    Spreadsheet,
    /// A calibration that evcal wrote.
    Calibration,
    /// The report of a calibration that evcal wrote.
    CalibrationReport,
    /// JSON.
    Json,
    /// YAML.
    Yaml,
    /// PDF.
    Pdf,
    /// PNG.
    Png,
    /// Apache Parquet.
    Parquet,
    /// MATLAB before version 7.3, which is HDF5.
    Matlab,
    /// A pickle of Python.
    Pickle,
    /// A video.
    Video,
    /// A web page.
    Html,
    /// What Git keeps in place of a large file.
    GitLfsPointer,
    /// Text of two bytes a letter.
    Utf16,
    /// Text of one byte a letter, with letters that are not ASCII.
    Latin1,
}

impl fmt::Display for ForeignFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Aedat1 => "AEDAT 1",
            Self::Aedat3Compressed => "AEDAT 3 with compressed packets",
            Self::Rosbag1 => "ROS bag of version 1",
            Self::Hdf5 => "HDF5",
            Self::VirtualHdf5 => "virtual HDF5",
            Self::PropheseeEncoding => "Prophesee RAW with another encoding than EVT 2.0, 2.1 or 3.0",
            Self::EventStreamVersion => "Event Stream (of another version than 2)",
            Self::EventStreamKind => "Event Stream (of neither a DVS nor an ATIS)",
            Self::Gzip => "gzip",
            Self::Xz => "xz",
            Self::Zstandard => "Zstandard",
            Self::Bzip2 => "bzip2",
            Self::Tar => "tar",
            Self::SevenZip => "7z",
            Self::Rar => "RAR",
            Self::Zip | Self::ZipCompression => "ZIP",
            Self::Spreadsheet => "spreadsheet",
            Self::Calibration => "calibration",
            Self::CalibrationReport => "calibration report",
            Self::Json => "JSON",
            Self::Yaml => "YAML",
            Self::Pdf => "PDF",
            Self::Png => "PNG",
            Self::Parquet => "Parquet",
            Self::Matlab => "MATLAB",
            Self::Pickle => "Python pickle",
            Self::Video => "video",
            Self::Html => "downloaded HTML",
            Self::GitLfsPointer => "Git LFS pointer",
            Self::Utf16 => "UTF-16 text",
            Self::Latin1 => "Latin-1 text",
        })
    }
}

/// What a report of a calibration has near its beginning.
const REPORT: &[u8] = b"name=\"generator\" content=\"evcal ";

/// Bytes that a format has at one place.
struct Mark {
    at: usize,
    bytes: &'static [u8],
    format: ForeignFormat,
}

const fn mark(at: usize, bytes: &'static [u8], format: ForeignFormat) -> Mark {
    Mark { at, bytes, format }
}

/// In the order in which they are tried.
const MARKS: &[Mark] = &[
    mark(0, b"#!AER-DAT1", ForeignFormat::Aedat1),
    mark(0, b"#ROSBAG V1", ForeignFormat::Rosbag1),
    #[cfg(not(feature = "hdf5"))]
    mark(0, b"\x89HDF", ForeignFormat::Hdf5),
    mark(0, b"\x1f\x8b", ForeignFormat::Gzip),
    mark(0, b"\xfd7zXZ", ForeignFormat::Xz),
    mark(0, b"\x28\xb5\x2f\xfd", ForeignFormat::Zstandard),
    mark(0, b"BZh", ForeignFormat::Bzip2),
    mark(0, b"{\n  \"format\": \"evcal-calibration\"", ForeignFormat::Calibration),
    mark(0, b"{\n  \"", ForeignFormat::Json),
    mark(0, b"{\"camera\"", ForeignFormat::Json),
    mark(0, b"{\"sensor\"", ForeignFormat::Json),
    mark(0, b"%YAML", ForeignFormat::Yaml),
    mark(0, b"%PDF", ForeignFormat::Pdf),
    mark(0, b"\x89PNG", ForeignFormat::Png),
    mark(0, b"7z\xbc\xaf\x27\x1c", ForeignFormat::SevenZip),
    mark(0, b"Rar!\x1a\x07", ForeignFormat::Rar),
    mark(0, b"PAR1", ForeignFormat::Parquet),
    mark(0, b"MATLAB 5.0 MAT-file", ForeignFormat::Matlab),
    mark(0, b"\x80\x04\x95", ForeignFormat::Pickle),
    mark(0, b"\x1aE\xdf\xa3", ForeignFormat::Video),
    mark(0, b"<!DOCTYPE", ForeignFormat::Html),
    mark(0, b"<!doctype", ForeignFormat::Html),
    mark(0, b"<html", ForeignFormat::Html),
    mark(0, b"version https://git-lfs", ForeignFormat::GitLfsPointer),
    mark(4, b"ftyp", ForeignFormat::Video),
    mark(8, b"AVI ", ForeignFormat::Video),
    mark(257, b"ustar", ForeignFormat::Tar),
];

/// The format that is known but not read, if `bytes` begin like one.
pub fn recognise(bytes: &[u8]) -> Option<ForeignFormat> {
    let beginning = bytes.get(..1024).unwrap_or(bytes);
    if bytes.starts_with(b"<!DOCTYPE") && beginning.windows(REPORT.len()).any(|part| part == REPORT) {
        return Some(ForeignFormat::CalibrationReport);
    }
    let is_marked = |mark: &&Mark| bytes.get(mark.at..).is_some_and(|rest| rest.starts_with(mark.bytes));
    MARKS
        .iter()
        .find(is_marked)
        .map(|mark| mark.format)
        .or_else(|| is_utf_16(bytes).then_some(ForeignFormat::Utf16))
        .or_else(|| is_latin_1(bytes).then_some(ForeignFormat::Latin1))
}

/// Whether `bytes` begin as lines of text with single letters that are not ASCII, in one byte each, as programs of Windows write a µ.
fn is_latin_1(bytes: &[u8]) -> bool {
    let is_utf_8 = std::str::from_utf8(bytes).map_or_else(|error| error.error_len().is_none(), |_| true);
    let is_text = |byte: &u8| !byte.is_ascii_control() || matches!(byte, b'\t' | b'\r' | b'\n');
    let letters = bytes.iter().filter(|byte| !byte.is_ascii()).count();
    !is_utf_8 && bytes.contains(&b'\n') && bytes.iter().all(is_text) && letters < bytes.len() / 10
}

/// Whether `bytes` begin as text that Windows calls Unicode: a mark of the order of bytes, then letters of two bytes of which one is
/// zero.
fn is_utf_16(bytes: &[u8]) -> bool {
    let Some((mark, letters)) = bytes.split_first_chunk::<2>() else { return false };
    let zero = match mark {
        b"\xff\xfe" => 1,
        b"\xfe\xff" => 0,
        _ => return false,
    };
    let (pairs, _) = letters.as_chunks::<2>();
    pairs.len() >= 8 && pairs.iter().take(8).all(|pair| pair[zero] == 0 && pair[1 - zero] != 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_calibration_is_told_from_other_json() {
        assert_eq!(recognise(b"{\n  \"format\": \"evcal-calibration\",\n"), Some(ForeignFormat::Calibration));
        assert_eq!((recognise(b"{\n  \"other\": 1}"), recognise(b"1,2,3\n")), (Some(ForeignFormat::Json), None));
    }

    #[test]
    fn text_with_single_letters_of_another_alphabet_is_told_from_other_bytes() {
        let text = "t [us],x,y,p\n".to_owned() + &"5,1,2,1\n".repeat(20);
        let bytes: Vec<u8> = text.bytes().map(|byte| if byte == b'u' { 0xb5 } else { byte }).collect();
        assert_eq!((recognise(&bytes), recognise(text.as_bytes())), (Some(ForeignFormat::Latin1), None));
        assert_eq!(recognise(text.replace('u', "µ").as_bytes()), None);
        // A letter of two bytes that was cut, and words of a camera.
        assert_eq!(
            (recognise(&text.replace('u', "µ").as_bytes()[..4]), recognise(&[0x80, 0x0a, 0xb5, 0x20].repeat(40))),
            (None, None)
        );
    }

    #[test]
    fn text_of_two_bytes_a_letter_is_told_from_other_bytes() {
        let text = "t,x,y,p\n0,1,2,1\n";
        let little: Vec<u8> = std::iter::once(0xfeff).chain(text.encode_utf16()).flat_map(u16::to_le_bytes).collect();
        let big: Vec<u8> = std::iter::once(0xfeff).chain(text.encode_utf16()).flat_map(u16::to_be_bytes).collect();
        assert_eq!((recognise(&little), recognise(&big)), (Some(ForeignFormat::Utf16), Some(ForeignFormat::Utf16)));
        // A stream of words of which the first happens to be the mark.
        assert_eq!(
            recognise(&[0xff, 0xfe, 0x12, 0x80, 0, 0x90, 0x34, 0x21, 0, 0x80, 1, 0x80, 2, 0x80, 3, 0x80, 4, 0x80]),
            None
        );
        assert_eq!((recognise(&little[..6]), recognise(&[0xff])), (None, None));
    }
}
