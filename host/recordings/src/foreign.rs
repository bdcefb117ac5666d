//! Formats of others that are recognised only to say what to do about them.

const JSON: &str = "a calibration is read by evcal export, evaluate, compare and undistort -c";

const VIDEO: &str = "name the events that the camera recorded, not a video of them";
const PAGE: &str = "a web page was saved in place of the recording: download it again";
const COLUMNS: &str = "save its columns t, x, y and p with numpy.savez, or as CSV";

/// What the report of a calibration has near its beginning.
const REPORT: &[u8] = b"name=\"generator\" content=\"evcal ";

/// How a file begins, the name of its format, and advice.
const FOREIGN: &[(&[u8], &str, &str)] = &[
    (b"#!AER-DAT1", "AEDAT 1", "open it in jAER and save it as AEDAT 2"),
    (b"#ROSBAG V1", "ROS bag of version 1", "bring it to version 2 with rosbag fix"),
    #[cfg(not(feature = "hdf5"))]
    (
        b"\x89HDF",
        "HDF5",
        "build evcal with --features hdf5, or save its arrays t, x, y and p with h5py and numpy.savez",
    ),
    (b"\x1f\x8b", "gzip", "unpack it with gunzip first"),
    (b"\xfd7zXZ", "xz", "unpack it with unxz first"),
    (b"\x28\xb5\x2f\xfd", "Zstandard", "unpack it with unzstd first"),
    (b"BZh", "bzip2", "unpack it with bunzip2 first"),
    (
        b"{\n  \"format\": \"evcal-calibration\"",
        "calibration",
        "evcal export, evaluate, compare and undistort -c read it; name the recording here",
    ),
    (b"{\n  \"", "JSON", JSON),
    (b"{\"camera\"", "JSON", JSON),
    (b"{\"sensor\"", "JSON", JSON),
    (
        b"%YAML",
        "YAML",
        "a camera.yaml is a camera for OpenCV, and calibration.json beside it is read by evcal; name the recording here",
    ),
    (b"%PDF", "PDF", "name the recording of the board, not the board"),
    (b"\x89PNG", "PNG", "evcal undistort takes pictures, and takes their distortion out"),
    (b"7z\xbc\xaf\x27\x1c", "7z", "unpack it first"),
    (b"Rar!\x1a\x07", "RAR", "unpack it first"),
    (b"PAR1", "Parquet", COLUMNS),
    (b"MATLAB 5.0 MAT-file", "MATLAB", "save it in MATLAB with the option -v7.3, or its events as text"),
    (b"\x80\x04\x95", "Python pickle", COLUMNS),
    (b"\x1aE\xdf\xa3", "video", VIDEO),
    (b"<!DOCTYPE", "downloaded HTML", PAGE),
    (b"<!doctype", "downloaded HTML", PAGE),
    (b"<html", "downloaded HTML", PAGE),
    (b"version https://git-lfs", "Git LFS pointer", "the recording itself was not fetched: run git lfs pull"),
];

/// The same of formats whose mark stands later: at which byte.
const FOREIGN_LATER: &[(usize, &[u8], &str, &str)] = &[
    (4, b"ftyp", "video", VIDEO),
    (8, b"AVI ", "video", VIDEO),
    (257, b"ustar", "tar", "unpack it with tar -xf first"),
];

/// Name of the format and advice, if `bytes` begin like a format that is known but not read.
pub fn recognise(bytes: &[u8]) -> Option<(&'static str, &'static str)> {
    let beginning = bytes.get(..1024).unwrap_or(bytes);
    if bytes.starts_with(b"<!DOCTYPE") && beginning.windows(REPORT.len()).any(|part| part == REPORT) {
        return Some(("calibration report", "browsers show it; name the recording here"));
    }
    let first = FOREIGN.iter().find(|(magic, ..)| bytes.starts_with(magic)).map(|&(_, name, advice)| (name, advice));
    let later = || FOREIGN_LATER.iter().find(|(at, magic, ..)| bytes.get(*at..).is_some_and(|b| b.starts_with(magic)));
    let utf_16 =
        is_utf_16(bytes).then_some(("UTF-16 text", "save it as UTF-8, or convert it with iconv -f UTF-16 -t UTF-8"));
    let latin_1 = || {
        is_latin_1(bytes).then_some(("Latin-1 text", "save it as UTF-8, or convert it with iconv -f LATIN1 -t UTF-8"))
    };
    first.or_else(|| later().map(|&(_, _, name, advice)| (name, advice))).or(utf_16).or_else(latin_1)
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
        let name = |bytes| recognise(bytes).map(|(name, _)| name);
        assert_eq!(name(b"{\n  \"format\": \"evcal-calibration\",\n"), Some("calibration"));
        assert_eq!((name(b"{\n  \"other\": 1}"), name(b"1,2,3\n")), (Some("JSON"), None));
    }

    #[test]
    fn text_with_single_letters_of_another_alphabet_is_told_from_other_bytes() {
        let name = |bytes: &[u8]| recognise(bytes).map(|(name, _)| name);
        let text = "t [us],x,y,p\n".to_owned() + &"5,1,2,1\n".repeat(20);
        let bytes: Vec<u8> = text.bytes().map(|byte| if byte == b'u' { 0xb5 } else { byte }).collect();
        assert_eq!((name(&bytes), name(text.as_bytes())), (Some("Latin-1 text"), None));
        assert_eq!(name(text.replace('u', "µ").as_bytes()), None);
        // A letter of two bytes that was cut, and words of a camera.
        assert_eq!(
            (name(&text.replace('u', "µ").as_bytes()[..4]), name(&[0x80, 0x0a, 0xb5, 0x20].repeat(40))),
            (None, None)
        );
    }

    #[test]
    fn text_of_two_bytes_a_letter_is_told_from_other_bytes() {
        let name = |bytes: &[u8]| recognise(bytes).map(|(name, _)| name);
        let text = "t,x,y,p\n0,1,2,1\n";
        let little: Vec<u8> = std::iter::once(0xfeff).chain(text.encode_utf16()).flat_map(u16::to_le_bytes).collect();
        let big: Vec<u8> = std::iter::once(0xfeff).chain(text.encode_utf16()).flat_map(u16::to_be_bytes).collect();
        assert_eq!((name(&little), name(&big)), (Some("UTF-16 text"), Some("UTF-16 text")));
        // A stream of words of which the first happens to be the mark.
        assert_eq!(
            name(&[0xff, 0xfe, 0x12, 0x80, 0, 0x90, 0x34, 0x21, 0, 0x80, 1, 0x80, 2, 0x80, 3, 0x80, 4, 0x80]),
            None
        );
        assert_eq!((name(&little[..6]), name(&[0xff])), (None, None));
    }
}
