//! The header lines.

use evcal_core::sensor::Sensor;
use evcal_files::text::excerpt;

/// Length limit of a line in bytes.
const LONGEST_LINE: usize = 1024;

/// Sensors by the system numbers of cameras, for files that do not contain the size.
const SYSTEMS: &[(&[u32], Sensor)] = &[
    (&[0x15, 0x1c, 0x21, 0x22, 0x23, 0x28, 0x29], Sensor::new(640, 480)),
    (&[0x1e, 0x1f, 0x20, 0x27, 0x2e, 0x30, 0x31, 0x32, 0x35, 0x3a, 0x42], Sensor::new(1280, 720)),
    (&[0x3b, 0x40], Sensor::new(320, 320)),
];

/// Keys and values of the header.
pub struct Header {
    fields: Vec<(String, String)>,
    /// Number of bytes before the data.
    pub length: usize,
}

impl Header {
    /// Parses the header of a file that begins with `bytes`; `None` if there is none or its end is not in `bytes`.
    pub fn parse(bytes: &[u8]) -> Option<Self> {
        let mut fields = Vec::new();
        let mut length = 0;
        while let Some(line) = bytes.get(length..).filter(|rest| rest.starts_with(b"% ")) {
            let end = line.iter().take(LONGEST_LINE).position(|&byte| byte == b'\n')?;
            length += end + 1;
            let text = String::from_utf8_lossy(line.get(1..end)?);
            let text = text.trim();
            if text == "end" {
                break;
            }
            let (key, value) = text.split_once(' ').unwrap_or((text, ""));
            fields.push((key.to_owned(), value.trim().to_owned()));
        }
        (!fields.is_empty()).then_some(Self { fields, length })
    }

    /// Returns the value of the first line with this key.
    pub fn get(&self, key: &str) -> Option<&str> {
        self.fields.iter().find(|(name, _)| name == key).map(|(_, value)| value.as_str())
    }

    /// Returns an option of the format, as in `% format EVT3;height=720;width=1280`.
    pub fn format_option(&self, key: &str) -> Option<&str> {
        let options = self.get("format")?.split(';').skip(1);
        options.filter_map(|option| option.split_once('=')).find(|(name, _)| *name == key).map(|(_, value)| value)
    }

    /// Returns width and height in pixels, if the header contains them or the camera is known.
    pub fn sensor(&self) -> Option<Sensor> {
        let number = |text: &str| text.trim().parse::<u16>().ok();
        let pair = |width: Option<&str>, height: Option<&str>| Some(Sensor::new(number(width?)?, number(height?)?));
        let geometry = self.get("geometry").and_then(|text| text.split_once('x'));
        pair(self.format_option("width"), self.format_option("height"))
            .or_else(|| geometry.and_then(|(width, height)| pair(Some(width), Some(height))))
            .or_else(|| pair(self.get("Width"), self.get("Height")))
            .or_else(|| {
                let system: u32 = self.get("system_ID")?.parse().ok()?;
                SYSTEMS.iter().find(|(numbers, _)| numbers.contains(&system)).map(|&(_, sensor)| sensor)
            })
    }

    /// Returns the time in µs from which the times count, with a note about it. faery writes it as `t0` (RAW) or `T0`
    /// (DAT).
    pub fn zero(&self) -> (i64, Vec<String>) {
        let Some(stated) = self.get("t0").or_else(|| self.get("T0")) else { return (0, Vec::new()) };
        match stated.parse() {
            Ok(0) => (0, Vec::new()),
            Ok(zero) => (zero, vec![format!("the header states that times count from {zero} µs: this is added")]),
            Err(_) => (
                0,
                vec![format!(
                    "the header states that times count from \"{}\", which is no number: nothing is added",
                    excerpt(stated)
                )],
            ),
        }
    }

    /// Returns the date of the recording, as in the header.
    pub fn date(&self) -> Option<String> {
        self.get("date").or_else(|| self.get("Date")).map(str::to_owned)
    }

    /// Returns manufacturer and serial number of the camera.
    pub fn camera_name(&self) -> Option<String> {
        let maker = self.get("camera_integrator_name").or_else(|| self.get("integrator_name"));
        let words: Vec<&str> = maker.into_iter().chain(self.get("serial_number")).collect();
        (!words.is_empty()).then(|| words.join(" "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_and_names_are_found_in_every_form() {
        for (text, sensor, name, data) in [
            ("% evt 3.0\n% geometry 1280x720\n% serial_number 7\nX", Some((1280, 720)), Some("7"), 'X'),
            (
                "% camera_integrator_name A\n% format EVT21;height=320;width=300\n% end\n% ",
                Some((300, 320)),
                Some("A"),
                '%',
            ),
            ("% Version 2\n% Height 240\n% Width 304\n\0", Some((304, 240)), None, '\0'),
            ("% system_ID 49\n% evt 2.0\n.", Some((1280, 720)), None, '.'),
            ("% system_ID 999\n.", None, None, '.'),
        ] {
            let header = Header::parse(text.as_bytes()).unwrap();
            assert_eq!(header.sensor(), sensor.map(Sensor::from), "{text}");
            assert_eq!((header.camera_name().as_deref(), text.as_bytes()[header.length]), (name, data as u8));
        }
        let zero = |text: &str| Header::parse(text.as_bytes()).unwrap().zero();
        assert_eq!(
            zero("% T0 7\n."),
            (7, vec!["the header states that times count from 7 µs: this is added".to_owned()])
        );
        assert_eq!(zero("% t0 0\n."), (0, Vec::new()));
        assert!(matches!(zero("% t0 nan\n."), (0, notes) if notes[0].contains("is no number")));
        for text in ["", "no header", "% never ends", "%\n"] {
            assert!(Header::parse(text.as_bytes()).is_none(), "{text}");
        }
    }
}
