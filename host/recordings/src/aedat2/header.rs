//! The header lines of AEDAT 2.0.
//!
//! The first line is `#!AER-DAT2.0`. jAER also writes the camera's settings into the header: thousands of lines,
//! hundreds of kilobytes, in Latin-1. Newer files end the header with `#End Of ASCII Header`.

use crate::bytes::ByteReader;
use crate::error::RecordingError;

/// Length limit of a line in bytes. Values of Java's preferences have up to 8192 characters.
const LONGEST_LINE: u64 = 1 << 16;
/// Last line of the header, in files that have it.
const END: &[u8] = b"#End Of ASCII Header";

/// Content of the header.
#[derive(Debug, Default, PartialEq)]
pub struct Header {
    /// Class name of the camera in upper case, from the line `# AEChip:`.
    pub chip: Option<String>,
    /// Date of the recording, as in jAER's line `# created Thu Dec 03 14:55:00 CET 2015`.
    pub created: Option<String>,
    /// Ranges of the IMU, from the camera's settings.
    pub ranges: Ranges,
}

/// Ranges of the IMU, on both sides of zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ranges {
    /// In g.
    pub acceleration: f32,
    /// In °/s.
    pub angular_velocity: f32,
}

impl Default for Ranges {
    /// Default settings of jAER (`ImuControl`).
    fn default() -> Self {
        Self { acceleration: 8.0, angular_velocity: 1000.0 }
    }
}

/// Reads the header lines and leaves `file` at the first record.
///
/// # Errors
/// If the file cannot be read, or a line is too long.
pub fn read(file: &mut ByteReader) -> Result<Header, RecordingError> {
    let mut header = Header::default();
    let mut block = Vec::new();
    loop {
        let start = file.position();
        file.read(&mut block, LONGEST_LINE)?;
        let (length, ended) = header.read_lines(&block);
        file.seek(start + length as u64)?;
        if ended {
            return Ok(header);
        }
        if length == 0 {
            return Err(file.damaged(start, "a line of the header does not end"));
        }
    }
}

impl Header {
    /// Reads the whole lines at the beginning of `bytes`. Returns their length, and `true` if the header ends
    /// there.
    fn read_lines(&mut self, bytes: &[u8]) -> (usize, bool) {
        let mut rest = bytes;
        loop {
            let end = rest.iter().position(|&byte| byte == b'\n');
            let line = rest.get(..end.unwrap_or(rest.len())).unwrap_or_default().trim_ascii_end();
            let length = bytes.len() - rest.len();
            // A record may begin with a `#` as well, but the last byte of an event's address is not printable: it is 0
            // or the number of a camera.
            if !line.starts_with(b"#") || line.iter().any(|byte| byte.is_ascii_control() && *byte != b'\t') {
                return (length, !rest.is_empty() || bytes.is_empty());
            }
            let Some(end) = end else { return (length, false) };
            rest = rest.get(end + 1..).unwrap_or_default();
            let of_single_bytes = || line.iter().copied().map(char::from).collect();
            self.take(&String::from_utf8(line.to_vec()).unwrap_or_else(|_| of_single_bytes()));
            if line == END {
                return (bytes.len() - rest.len(), true);
            }
        }
    }

    /// Stores the value of a line.
    fn take(&mut self, line: &str) {
        if let Some((_, chip)) = line.split_once("AEChip:") {
            self.chip.get_or_insert_with(|| chip.trim().to_uppercase());
        } else if let Some(created) = line.trim_start_matches('#').trim().strip_prefix("created ") {
            self.created.get_or_insert_with(|| created.to_owned());
        } else if let Some(range) = number_after(line, "ImuAccelScaleG") {
            self.ranges.acceleration = range;
        } else if let Some(range) = number_after(line, "GyroFullScaleDegPerSec") {
            self.ranges.angular_velocity = range;
        }
    }
}

/// Returns the number after `name` in a line of settings, if there is one.
fn number_after(line: &str, name: &str) -> Option<f32> {
    let (_, rest) = line.split_once(name)?;
    rest.split(|character: char| !character.is_ascii_digit()).next()?.parse().ok().filter(|range| *range > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reads the header of a file with these bytes. Returns it with its length.
    fn header(content: &[u8]) -> Result<(Header, u64), String> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), content).unwrap();
        let mut file = ByteReader::open(file.path()).unwrap();
        let header = read(&mut file).map_err(|error| error.to_string())?;
        Ok((header, file.position()))
    }

    #[test]
    fn camera_settings_of_any_length_are_skipped() {
        let setting = format!("#   <entry key=\"DAVIS240C.bytes\" value=\"{}\"/>\r\n", "aced0005".repeat(1000));
        let mut content = b"#!AER-DAT2.0\r\n# created Do M\xe4r 03 2016\r\n".to_vec();
        content.extend(setting.repeat(50).bytes());
        content.extend(b"# AEChip: eu.seebetter.ini.chips.davis.DAVIS240C\r\n");
        content.extend(b"#  <entry key=\"DAVIS240C.IMU.AccelScale\" value=\"ImuAccelScaleG4\"/>\r\n");
        content.extend(b"#  <entry key=\"DAVIS240C.IMU.GyroScale\" value=\"GyroFullScaleDegPerSec500\"/>\r\n");
        let length = content.len() as u64;
        // A record of row 140 from below.
        content.extend([0x23, 0x15, 0x08, 0, 0x0a, 0x0a, 0x0a, 0x0a]);
        let expected = Header {
            chip: Some("EU.SEEBETTER.INI.CHIPS.DAVIS.DAVIS240C".to_owned()),
            created: Some("Do Mär 03 2016".to_owned()),
            ranges: Ranges { acceleration: 4.0, angular_velocity: 500.0 },
        };
        assert_eq!(header(&content), Ok((expected, length)));
    }

    #[test]
    fn no_line_follows_the_last_line_of_the_header() {
        let content = b"#!AER-DAT2.0\r\n#End Of ASCII Header\r\n##\n#\n0123";
        assert_eq!(header(content), Ok((Header::default(), 36)));
    }

    #[test]
    fn a_line_without_an_end_is_an_error() {
        let error = header(&[b"#!AER-DAT2.0\r\n", [b'#'; 1 << 17].as_slice()].concat()).unwrap_err();
        assert!(error.contains("byte 14: a line of the header does not end"), "{error}");
        // A file that is cut off within its header.
        assert!(header(b"#!AER-DAT2.0\r\n# AEChip: eu.see").is_err());
    }
}
