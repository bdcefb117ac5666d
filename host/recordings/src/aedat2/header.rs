//! The lines at the top.
//!
//! The first is `#!AER-DAT2.0`. jAER writes the settings of the camera into them, thousands of lines of hundreds of kilobytes, one byte a
//! letter. Newer files end them with `#End Of ASCII Header`.

use crate::bytes::ByteReader;
use crate::error::RecordingError;

/// No line is longer: Java's preferences have values of up to 8192 letters.
const LONGEST_LINE: u64 = 1 << 16;
/// The last line, in the files that have it.
const END: &[u8] = b"#End Of ASCII Header";

/// What the lines tell.
#[derive(Debug, Default, PartialEq)]
pub struct Header {
    /// Name of the class of the camera, in capitals, from the line `# AEChip:`.
    pub chip: Option<String>,
    /// When the recording was made, as jAER writes it: `# created Thu Dec 03 14:55:00 CET 2015`.
    pub created: Option<String>,
    /// Ranges of the inertial unit, from the settings of the camera.
    pub ranges: Ranges,
}

/// Ranges of the inertial unit, to both sides of zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ranges {
    /// In g.
    pub acceleration: f32,
    /// In °/s.
    pub angular_velocity: f32,
}

impl Default for Ranges {
    /// Those that jAER sets where nobody chose others (`ImuControl`).
    fn default() -> Self {
        Self { acceleration: 8.0, angular_velocity: 1000.0 }
    }
}

/// Reads the lines at the beginning of `file`, and leaves it at the first record.
///
/// # Errors
/// When the file cannot be read, or a line has no end.
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
    /// Takes the whole lines at the beginning of `bytes`; gives their length, and whether they were the last ones.
    fn read_lines(&mut self, bytes: &[u8]) -> (usize, bool) {
        let mut rest = bytes;
        loop {
            let end = rest.iter().position(|&byte| byte == b'\n');
            let line = rest.get(..end.unwrap_or(rest.len())).unwrap_or_default().trim_ascii_end();
            let length = bytes.len() - rest.len();
            // A record may begin with a `#` as well, but the last byte of an event's address is no letter: it is 0, or the number of a
            // camera.
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

    /// Takes what a line tells.
    fn take(&mut self, line: &str) {
        if let Some((_, chip)) = line.split_once("AEChip:") {
            self.chip.get_or_insert_with(|| chip.trim().to_uppercase());
        } else if let Some(created) = line.trim_start_matches('#').trim().strip_prefix("created ") {
            self.created.get_or_insert_with(|| created.to_owned());
        } else if let Some(range) = number_behind(line, "ImuAccelScaleG") {
            self.ranges.acceleration = range;
        } else if let Some(range) = number_behind(line, "GyroFullScaleDegPerSec") {
            self.ranges.angular_velocity = range;
        }
    }
}

/// The number behind `name` in a line of settings; `None` where there is none.
fn number_behind(line: &str, name: &str) -> Option<f32> {
    let (_, rest) = line.split_once(name)?;
    rest.split(|character: char| !character.is_ascii_digit()).next()?.parse().ok().filter(|range| *range > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The header of a file with these bytes, and how many of them it has.
    fn header(content: &[u8]) -> Result<(Header, u64), String> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), content).unwrap();
        let mut file = ByteReader::open(file.path()).unwrap();
        let header = read(&mut file).map_err(|error| error.to_string())?;
        Ok((header, file.position()))
    }

    #[test]
    fn settings_of_the_camera_of_any_length_are_passed_over() {
        let setting = format!("#   <entry key=\"DAVIS240C.bytes\" value=\"{}\"/>\r\n", "aced0005".repeat(1000));
        let mut content = b"#!AER-DAT2.0\r\n# created Do M\xe4r 03 2016\r\n".to_vec();
        content.extend(setting.repeat(50).bytes());
        content.extend(b"# AEChip: eu.seebetter.ini.chips.davis.DAVIS240C\r\n");
        content.extend(b"#  <entry key=\"DAVIS240C.IMU.AccelScale\" value=\"ImuAccelScaleG4\"/>\r\n");
        content.extend(b"#  <entry key=\"DAVIS240C.IMU.GyroScale\" value=\"GyroFullScaleDegPerSec500\"/>\r\n");
        let length = content.len() as u64;
        // A record, of the row 140 from below.
        content.extend([0x23, 0x15, 0x08, 0, 0x0a, 0x0a, 0x0a, 0x0a]);
        let expected = Header {
            chip: Some("EU.SEEBETTER.INI.CHIPS.DAVIS.DAVIS240C".to_owned()),
            created: Some("Do Mär 03 2016".to_owned()),
            ranges: Ranges { acceleration: 4.0, angular_velocity: 500.0 },
        };
        assert_eq!(header(&content), Ok((expected, length)));
    }

    #[test]
    fn nothing_behind_the_last_line_is_a_line() {
        let content = b"#!AER-DAT2.0\r\n#End Of ASCII Header\r\n##\n#\n0123";
        assert_eq!(header(content), Ok((Header::default(), 36)));
    }

    #[test]
    fn a_line_without_an_end_is_an_error() {
        let error = header(&[b"#!AER-DAT2.0\r\n", [b'#'; 1 << 17].as_slice()].concat()).unwrap_err();
        assert!(error.contains("byte 14: a line of the header does not end"), "{error}");
        // A file that was cut off within its header.
        assert!(header(b"#!AER-DAT2.0\r\n# AEChip: eu.see").is_err());
    }
}
