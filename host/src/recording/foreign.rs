//! Formats of others that are recognised only to say what to do about them.

const JSON: &str = "a calibration is read by evcal export, evaluate, compare and undistort -c";

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
    (b"%YAML", "YAML", "cameras for other programs are written by evcal, not read; calibration.json is read"),
    (b"%PDF", "PDF", "name the recording of the board, not the board"),
    (b"\x89PNG", "PNG", "evcal undistort takes pictures, and takes their distortion out"),
];

/// Name of the format and advice, if `bytes` begin like a format that is known but not read.
pub fn recognise(bytes: &[u8]) -> Option<(&'static str, &'static str)> {
    FOREIGN.iter().find(|(magic, ..)| bytes.starts_with(magic)).map(|&(_, name, advice)| (name, advice))
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
}
