//! Formats that are recognised by their first bytes but not supported.

use evcal_files::remedies;

/// A format that is recognised but not supported.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum UnsupportedFormat {
    /// AEDAT 1 of jAER.
    #[error("AEDAT 1")]
    Aedat1,
    /// AEDAT 3 with compressed packets.
    #[error("AEDAT 3 with compressed packets")]
    Aedat3Compressed,
    /// A bag of ROS 1 before version 2.
    #[error("ROS bag of version 1")]
    Rosbag1,
    /// HDF5, if this library was built without support for it.
    #[error("HDF5")]
    Hdf5,
    /// HDF5 whose arrays are views of other arrays (virtual datasets).
    #[error("virtual HDF5")]
    VirtualHdf5,
    /// Prophesee RAW in an encoding other than EVT 2.0, 2.1, 3.0 and 4.0.
    #[error("Prophesee RAW with an encoding other than EVT 2.0, 2.1, 3.0 or 4.0")]
    PropheseeEncoding,
    /// Event Stream of a version other than 2.
    #[error("Event Stream (of a version other than 2)")]
    EventStreamVersion,
    /// Event Stream that is neither from a DVS nor from an ATIS (colours, or generic bytes).
    #[error("Event Stream (from neither a DVS nor an ATIS)")]
    EventStreamKind,
    /// gzip.
    #[error("gzip")]
    Gzip,
    /// xz.
    #[error("xz")]
    Xz,
    /// Zstandard.
    #[error("Zstandard")]
    Zstandard,
    /// bzip2.
    #[error("bzip2")]
    Bzip2,
    /// LZ4.
    #[error("LZ4")]
    Lz4,
    /// tar.
    #[error("tar")]
    Tar,
    /// 7z.
    #[error("7z")]
    SevenZip,
    /// RAR.
    #[error("RAR")]
    Rar,
    /// ZIP without NumPy arrays.
    #[error("ZIP")]
    Zip,
    /// ZIP whose arrays have a compression that NumPy does not use.
    #[error("ZIP")]
    ZipCompression,
    /// A spreadsheet of Excel.
    #[error("spreadsheet")]
    Spreadsheet,
    /// A calibration written by evcal.
    #[error("calibration")]
    Calibration,
    /// A calibration report written by evcal.
    #[error("calibration report")]
    CalibrationReport,
    /// JSON.
    #[error("JSON")]
    Json,
    /// YAML.
    #[error("YAML")]
    Yaml,
    /// PDF.
    #[error("PDF")]
    Pdf,
    /// PNG.
    #[error("PNG")]
    Png,
    /// Apache Parquet.
    #[error("Parquet")]
    Parquet,
    /// Apache Arrow.
    #[error("Feather (Apache Arrow)")]
    Arrow,
    /// A pcap with the fields of a modified libpcap of 1998.
    #[error("modified pcap")]
    ModifiedPcap,
    /// MATLAB before version 7.3 (later versions are HDF5).
    #[error("MATLAB")]
    Matlab,
    /// A Python pickle.
    #[error("Python pickle")]
    Pickle,
    /// A video.
    #[error("video")]
    Video,
    /// A web page.
    #[error("downloaded HTML")]
    Html,
    /// The pointer file of Git LFS for a large file.
    #[error("Git LFS pointer")]
    GitLfsPointer,
    /// Text with two bytes per character.
    #[error("UTF-16 text")]
    Utf16,
    /// Text with one byte per character, some of them not ASCII.
    #[error("Latin-1 text")]
    Latin1,
}

remedies! { UnsupportedFormat, say;
    Self::Aedat1 => "open it in jAER and save it as AEDAT 2";
    Self::Aedat3Compressed => "convert it to AEDAT4 with DV";
    Self::Rosbag1 => "convert it to version 2.0 with rosbag fix";
    Self::Hdf5 => "build evcal with --features hdf5, or save its arrays t, x, y and p with h5py and numpy.savez";
    Self::VirtualHdf5 =>
        "one of its datasets is virtual (a view of other arrays): copy the numbers into ordinary datasets with h5py or \
         h5repack -l CONTI IN OUT";
    Self::Lz4 => "unpack it with unlz4 first";
    Self::ModifiedPcap => "rewrite it with editcap -F pcap IN OUT";
    Self::PropheseeEncoding => "convert it with metavision_file_to_csv";
    Self::EventStreamVersion => "convert it with the program that wrote it";
    Self::EventStreamKind => "give a file with events of a DVS or an ATIS, not colours or generic data";
    Self::Gzip => "unpack it with gunzip first";
    Self::Xz => "unpack it with unxz first";
    Self::Zstandard => "unpack it with unzstd first";
    Self::Bzip2 => "unpack it with bunzip2 first";
    Self::Tar => "unpack it with tar -xf first";
    Self::SevenZip | Self::Rar | Self::Zip => "unpack it first";
    Self::ZipCompression => "pack it again with numpy.savez_compressed";
    Self::Spreadsheet => "save its events as CSV";
    Self::Calibration => "it is for {}; give the recording here", say.of_calibrations?;
    Self::CalibrationReport => "open it in a browser; give the recording here";
    Self::Json => "a calibration is for {}", say.of_calibrations?;
    Self::Yaml =>
        "a camera.yaml is for OpenCV, evcal reads the calibration.json next to it; give the recording here";
    Self::Pdf => "give the recording, not the printed board";
    Self::Png => "{} removes the distortion of pictures", say.undistort?;
    Self::Parquet | Self::Arrow | Self::Pickle => "save its columns t, x, y and p with numpy.savez, or as CSV";
    Self::Matlab => "save it in MATLAB with the option -v7.3, or its events as text";
    Self::Video => "give the events of the camera, not a video of them";
    Self::Html => "this is a web page instead of the recording: download the recording again";
    Self::GitLfsPointer => "the file is only a pointer: run git lfs pull to fetch the recording";
    Self::Utf16 => "save it as UTF-8, or convert it with iconv -f UTF-16 -t UTF-8";
    Self::Latin1 => "save it as UTF-8, or convert it with iconv -f LATIN1 -t UTF-8";
}

/// Text near the beginning of a calibration report.
const REPORT: &[u8] = b"name=\"generator\" content=\"evcal ";

/// Bytes at a fixed offset by which a format is recognised.
struct Mark {
    at: usize,
    bytes: &'static [u8],
    format: UnsupportedFormat,
}

const fn mark(at: usize, bytes: &'static [u8], format: UnsupportedFormat) -> Mark {
    Mark { at, bytes, format }
}

/// Marks in the order in which they are tried.
const MARKS: &[Mark] = &[
    mark(0, b"#!AER-DAT1", UnsupportedFormat::Aedat1),
    mark(0, b"#ROSBAG V1", UnsupportedFormat::Rosbag1),
    #[cfg(not(feature = "hdf5"))]
    mark(0, b"\x89HDF", UnsupportedFormat::Hdf5),
    mark(0, b"\x1f\x8b", UnsupportedFormat::Gzip),
    mark(0, b"\xfd7zXZ", UnsupportedFormat::Xz),
    mark(0, b"\x28\xb5\x2f\xfd", UnsupportedFormat::Zstandard),
    mark(0, b"BZh", UnsupportedFormat::Bzip2),
    mark(0, b"\x04\x22\x4d\x18", UnsupportedFormat::Lz4),
    mark(0, b"\x34\xcd\xb2\xa1", UnsupportedFormat::ModifiedPcap),
    mark(0, b"\xa1\xb2\xcd\x34", UnsupportedFormat::ModifiedPcap),
    mark(0, b"ARROW1", UnsupportedFormat::Arrow),
    mark(0, b"FEA1", UnsupportedFormat::Arrow),
    mark(0, b"{\n  \"format\": \"evcal-calibration\"", UnsupportedFormat::Calibration),
    mark(0, b"{\n  \"", UnsupportedFormat::Json),
    mark(0, b"{\"camera\"", UnsupportedFormat::Json),
    mark(0, b"{\"sensor\"", UnsupportedFormat::Json),
    mark(0, b"%YAML", UnsupportedFormat::Yaml),
    mark(0, b"%PDF", UnsupportedFormat::Pdf),
    mark(0, b"\x89PNG", UnsupportedFormat::Png),
    mark(0, b"7z\xbc\xaf\x27\x1c", UnsupportedFormat::SevenZip),
    mark(0, b"Rar!\x1a\x07", UnsupportedFormat::Rar),
    mark(0, b"PAR1", UnsupportedFormat::Parquet),
    mark(0, b"MATLAB 5.0 MAT-file", UnsupportedFormat::Matlab),
    mark(0, b"\x80\x04\x95", UnsupportedFormat::Pickle),
    mark(0, b"\x1aE\xdf\xa3", UnsupportedFormat::Video),
    mark(0, b"<!DOCTYPE", UnsupportedFormat::Html),
    mark(0, b"<!doctype", UnsupportedFormat::Html),
    mark(0, b"<html", UnsupportedFormat::Html),
    mark(0, b"version https://git-lfs", UnsupportedFormat::GitLfsPointer),
    mark(4, b"ftyp", UnsupportedFormat::Video),
    mark(8, b"AVI ", UnsupportedFormat::Video),
    mark(257, b"ustar", UnsupportedFormat::Tar),
];

/// Returns the unsupported format that `bytes` begin like, if any.
pub fn recognise(bytes: &[u8]) -> Option<UnsupportedFormat> {
    let beginning = bytes.get(..1024).unwrap_or(bytes);
    if bytes.starts_with(b"<!DOCTYPE") && beginning.windows(REPORT.len()).any(|part| part == REPORT) {
        return Some(UnsupportedFormat::CalibrationReport);
    }
    let is_marked = |mark: &&Mark| bytes.get(mark.at..).is_some_and(|rest| rest.starts_with(mark.bytes));
    MARKS
        .iter()
        .find(is_marked)
        .map(|mark| mark.format)
        .or_else(|| is_utf_16(bytes).then_some(UnsupportedFormat::Utf16))
        .or_else(|| is_latin_1(bytes).then_some(UnsupportedFormat::Latin1))
}

/// `true` if `bytes` begin as lines of text with a few non-ASCII characters of one byte each, such as a µ from a
/// Windows program.
fn is_latin_1(bytes: &[u8]) -> bool {
    let is_utf_8 = std::str::from_utf8(bytes).map_or_else(|error| error.error_len().is_none(), |_| true);
    let is_text = |byte: &u8| !byte.is_ascii_control() || matches!(byte, b'\t' | b'\r' | b'\n');
    let letters = bytes.iter().filter(|byte| !byte.is_ascii()).count();
    !is_utf_8 && bytes.contains(&b'\n') && bytes.iter().all(is_text) && letters < bytes.len() / 10
}

/// `true` if `bytes` begin as UTF-16 text: a byte order mark, then pairs of bytes of which one is zero.
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
    fn a_calibration_is_distinguished_from_other_json() {
        assert_eq!(recognise(b"{\n  \"format\": \"evcal-calibration\",\n"), Some(UnsupportedFormat::Calibration));
        assert_eq!((recognise(b"{\n  \"other\": 1}"), recognise(b"1,2,3\n")), (Some(UnsupportedFormat::Json), None));
    }

    #[test]
    fn files_that_other_programs_write_are_named() {
        for (bytes, name) in [
            (&b"ARROW1\0\0\xff\xff\xff\xff"[..], "Feather (Apache Arrow)"),
            (b"\x04\x22\x4d\x18\x64\x40\xa7", "LZ4"),
            (b"\x34\xcd\xb2\xa1\x02\x00\x04\x00", "modified pcap"),
            (b"\xa1\xb2\xcd\x34\x00\x02\x00\x04", "modified pcap"),
        ] {
            assert_eq!(recognise(bytes).unwrap().to_string(), name);
        }
        // pcap of microseconds and of nanoseconds.
        assert_eq!((recognise(b"\xd4\xc3\xb2\xa1\x02\x00"), recognise(b"\x4d\x3c\xb2\xa1\x02\x00")), (None, None));
    }

    #[test]
    fn latin_1_text_is_distinguished_from_binary_data() {
        let text = "t [us],x,y,p\n".to_owned() + &"5,1,2,1\n".repeat(20);
        let bytes: Vec<u8> = text.bytes().map(|byte| if byte == b'u' { 0xb5 } else { byte }).collect();
        assert_eq!((recognise(&bytes), recognise(text.as_bytes())), (Some(UnsupportedFormat::Latin1), None));
        assert_eq!(recognise(text.replace('u', "µ").as_bytes()), None);
        // A UTF-8 character of two bytes that was cut, and words of a camera.
        assert_eq!(
            (recognise(&text.replace('u', "µ").as_bytes()[..4]), recognise(&[0x80, 0x0a, 0xb5, 0x20].repeat(40))),
            (None, None)
        );
    }

    #[test]
    fn utf_16_text_is_distinguished_from_binary_data() {
        let text = "t,x,y,p\n0,1,2,1\n";
        let little: Vec<u8> = std::iter::once(0xfeff).chain(text.encode_utf16()).flat_map(u16::to_le_bytes).collect();
        let big: Vec<u8> = std::iter::once(0xfeff).chain(text.encode_utf16()).flat_map(u16::to_be_bytes).collect();
        assert_eq!(
            (recognise(&little), recognise(&big)),
            (Some(UnsupportedFormat::Utf16), Some(UnsupportedFormat::Utf16))
        );
        // A stream of words whose first one happens to be the mark.
        assert_eq!(
            recognise(&[0xff, 0xfe, 0x12, 0x80, 0, 0x90, 0x34, 0x21, 0, 0x80, 1, 0x80, 2, 0x80, 3, 0x80, 4, 0x80]),
            None
        );
        assert_eq!((recognise(&little[..6]), recognise(&[0xff])), (None, None));
    }
}
