//! A circle stream from a serial port: `serial:/dev/ttyACM0?baud=921600&seconds=10&save=FILE`.

pub mod save;

use std::fmt;
use std::io::{self, Read, Write};
use std::path::Path;
use std::str::FromStr;
use std::time::{Duration, Instant};

use self::save::{SaveError, SaveTo};
use crate::circles::stream::{CircleStream, Receiver};

const PREFIX: &str = "serial:";
const DEFAULT_BAUD: u32 = 921_600;
const DEFAULT_SECONDS: f64 = 10.0;
/// If this number of bytes contains no circle, none is expected any more, and the reception ends.
const MOST_WITHOUT_CIRCLE: u64 = 4 << 20;
/// Longest wait of a read before the time is checked.
const POLL: Duration = Duration::from_millis(50);

/// Serial port and duration of the reception.
#[derive(Clone, Debug, PartialEq)]
pub struct SerialAddress {
    /// Path or name of the port.
    pub port: String,
    /// Bits per second; without effect on a port that is USB throughout.
    pub baud: u32,
    /// Duration of the reception, in seconds.
    pub seconds: f64,
    /// File for the received bytes, from the first one on.
    pub save: Option<SaveTo>,
}

/// Reasons why nothing was received from a serial port.
#[derive(Debug, thiserror::Error)]
pub enum SerialError {
    /// The address is invalid.
    #[error("{address}: {what}; write serial:PORT?baud=921600&seconds=10&save=FILE, all but the port optional")]
    Address {
        /// The address.
        address: String,
        /// The problem.
        what: String,
    },
    /// The port cannot be opened.
    #[error("{port} cannot be opened: {error}; is the device plugged in, and may you use it (group dialout)?")]
    Open {
        /// The port.
        port: String,
        /// The error of the system.
        error: serialport::Error,
    },
    /// The received bytes cannot be saved.
    #[error("{0}")]
    Save(#[from] SaveError),
    /// No circle arrived.
    #[error("{port}: no circle in {bytes} bytes ({frames} messages); {advice}")]
    Nothing {
        /// The port.
        port: String,
        /// Number of received bytes.
        bytes: u64,
        /// Number of received messages.
        frames: u32,
        /// Remedy.
        advice: &'static str,
    },
}

impl evcal_files::remedy::Remedy for SerialError {}

impl SerialAddress {
    /// Returns `true` if a file name is an address of a serial port instead.
    pub fn is_address(path: &Path) -> bool {
        path.to_str().is_some_and(|text| text.starts_with(PREFIX))
    }

    /// Saves the received bytes in `folder`, as `PORT.circles` or with the next free number, unless the address names a file.
    pub fn save_into(&mut self, folder: &Path) {
        let port = self.port.rsplit(['/', '\\']).next().unwrap_or_default();
        self.save.get_or_insert_with(|| SaveTo::NextIn { folder: folder.to_owned(), name: port.to_owned() });
    }

    /// Receives until the time is over or the device is gone; `progress` gets a text on what was received.
    ///
    /// # Errors
    /// [`SerialError`] if the port cannot be opened, the bytes cannot be saved, or no circle is received.
    pub fn receive(&self, mut progress: impl FnMut(&str)) -> Result<CircleStream, SerialError> {
        self.save.as_ref().map_or(Ok(()), SaveTo::check)?;
        let mut notes = Vec::new();
        let mut port = serialport::new(&self.port, self.baud)
            .timeout(POLL)
            .open()
            .map_err(|error| SerialError::Open { port: self.port.clone(), error })?;
        // A port without data leaves no empty file.
        let mut unmade = self.save.as_ref();
        let mut file = None;
        let start = Instant::now();
        let mut receiver = Receiver::new();
        let mut buffer = [0; 4096];
        let mut bytes = 0_u64;
        while start.elapsed().as_secs_f64() < self.seconds {
            match port.read(&mut buffer) {
                Ok(0) => {
                    notes.push(self.ended(start, "it was closed"));
                    break;
                }
                Ok(count) => {
                    let new = buffer.get(..count).unwrap_or_default();
                    if let Some(save) = unmade.take() {
                        file = Some(save.create()?);
                    }
                    // A full disk ends the saving, not the reception.
                    if let Some(Err(error)) = file.as_mut().map(|file| file.write_all(new)) {
                        notes.push(format!("the stream could not be saved to its end: {error}"));
                        file = None;
                    }
                    receiver.push(new);
                    bytes += count as u64;
                    if bytes > MOST_WITHOUT_CIRCLE && !receiver.has_circle() {
                        break;
                    }
                }
                Err(error) if matches!(error.kind(), io::ErrorKind::TimedOut | io::ErrorKind::Interrupted) => {}
                Err(error) => {
                    notes.push(self.ended(start, &error.to_string()));
                    break;
                }
            }
            let (windows, circles) = receiver.progress();
            let elapsed = start.elapsed().as_secs_f64();
            progress(&format!(
                "{}: {elapsed:.0} of {} s, {windows} windows, {circles} circles",
                self.port, self.seconds
            ));
        }
        let frames = receiver.frames();
        let stream = receiver.finish();
        let mut stream = stream.ok_or_else(|| SerialError::Nothing {
            port: self.port.clone(),
            bytes,
            frames,
            advice: match (bytes, frames) {
                (0, _) => "is it the right port, and is the firmware running?",
                (bytes, _) if bytes > MOST_WITHOUT_CIRCLE => {
                    "listening ends after 4 MB without a circle: is the baud rate right, and does the sensor see the moving board?"
                }
                (_, 0) => "is the baud rate right, and does the firmware send a circle stream?",
                _ => "does the sensor see the moving board?",
            },
        })?;
        stream.track.notes.extend(notes);
        Ok(stream)
    }

    fn ended(&self, start: Instant, reason: &str) -> String {
        format!("{} ended after {:.1} s: {reason}", self.port, start.elapsed().as_secs_f64())
    }
}

impl FromStr for SerialAddress {
    type Err = SerialError;

    fn from_str(text: &str) -> Result<Self, SerialError> {
        let wrong = |what: String| SerialError::Address { address: text.to_owned(), what };
        let address = text.strip_prefix(PREFIX).ok_or_else(|| wrong("does not begin with serial:".to_owned()))?;
        let (port, options) = address.split_once('?').unwrap_or((address, ""));
        if port.is_empty() {
            return Err(wrong("names no port".to_owned()));
        }
        let mut parsed = Self { port: port.to_owned(), baud: DEFAULT_BAUD, seconds: DEFAULT_SECONDS, save: None };
        for option in options.split('&').filter(|option| !option.is_empty()) {
            let (name, value) = option.split_once('=').ok_or_else(|| wrong(format!("{option:?} has no value")))?;
            let refuse = || wrong(format!("{value:?} is not a valid {name}"));
            match name {
                "baud" => parsed.baud = value.parse().ok().filter(|baud| *baud > 0).ok_or_else(refuse)?,
                "seconds" => {
                    let positive = |seconds: &f64| seconds.is_finite() && *seconds > 0.0;
                    parsed.seconds = value.parse().ok().filter(positive).ok_or_else(refuse)?;
                }
                "save" if !value.is_empty() => parsed.save = Some(SaveTo::File(value.into())),
                "save" => return Err(refuse()),
                _ => return Err(wrong(format!("there is no option {name:?}"))),
            }
        }
        Ok(parsed)
    }
}

impl fmt::Display for SerialAddress {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{PREFIX}{}", self.port)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_parsed_into_port_and_options() {
        let address = |port: &str| SerialAddress { port: port.into(), baud: 921_600, seconds: 10.0, save: None };
        let parse = |text: &str| text.parse::<SerialAddress>();
        assert_eq!(parse("serial:/dev/ttyACM0").unwrap(), address("/dev/ttyACM0"));
        assert_eq!(
            parse("serial:COM3?baud=115200&seconds=2.5&save=a b.bin").unwrap(),
            SerialAddress {
                baud: 115_200,
                seconds: 2.5,
                save: Some(SaveTo::File("a b.bin".into())),
                ..address("COM3")
            }
        );
        for (text, part) in [
            ("/dev/ttyACM0", "begin"),
            ("serial:", "no port"),
            ("serial:?baud=9600", "no port"),
            ("serial:p?baud=fast", "\"fast\" is not a valid baud"),
            ("serial:p?baud=0", "baud"),
            ("serial:p?seconds=-1", "seconds"),
            ("serial:p?seconds=nan", "seconds"),
            ("serial:p?save=", "save"),
            ("serial:p?parity=odd", "parity"),
            ("serial:p?baud", "no value"),
        ] {
            let error = parse(text).unwrap_err().to_string();
            assert!(error.contains(part) && error.contains("serial:PORT"), "{error}");
        }
    }

    #[test]
    fn a_missing_port_is_an_error_with_advice() {
        let address: SerialAddress = "serial:/dev/there-is-no-such-port".parse().unwrap();
        let error = address.receive(|_| {}).unwrap_err().to_string();
        assert!(error.contains("/dev/there-is-no-such-port") && error.contains("plugged in"), "{error}");
    }
}
