//! Options for reading a recording: properties that its file may lack or state wrongly.

use evcal_core::sensor::Sensor;
use evcal_files::remedy::{Word, Words};
use std::fmt;
use std::str::FromStr;

use usb_davis::capture::DeviceAddress;
use usb_davis::dump::Growth;

/// Options for reading a recording. By default everything is taken from the file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RecordingOptions {
    /// Name or number of the event stream to read; the first stream if not given.
    pub stream: Option<String>,
    /// Width and height of the sensor in pixels; overrides the file.
    pub sensor: Option<Sensor>,
    /// Columns of a table of events (a text file, or an array without names).
    pub columns: Option<Columns>,
    /// Unit of the times in such a table.
    pub time_unit: Option<TimeUnit>,
    /// Address of the camera in a USB capture, if there are several candidates.
    pub device: Option<DeviceAddress>,
    /// Treatment of damaged packets.
    pub damage: Damage,
    /// Progress of the writing, if the file is still being written (see [`Recording::growing`](crate::Recording::growing)). At the end of
    /// what is written, its first pass waits for more.
    pub growth: Option<Growth>,
}

/// Treatment of a part of a recording that cannot be decoded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Damage {
    /// Stop with an error.
    #[default]
    Refuse,
    /// Skip it, count it, and continue.
    Skip,
}

/// One of the [`RecordingOptions`] that apply only to some formats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FormatOption {
    /// [`RecordingOptions::stream`].
    Stream,
    /// [`RecordingOptions::columns`].
    Columns,
    /// [`RecordingOptions::time_unit`].
    TimeUnit,
    /// [`RecordingOptions::device`].
    Device,
    /// [`RecordingOptions::growth`].
    Growth,
}

impl FormatOption {
    /// Returns its name in a program; `None` if the program lacks it.
    pub fn word(self, say: &Words) -> Option<Word> {
        match self {
            Self::Stream => say.stream,
            Self::Columns => Some(say.columns),
            Self::TimeUnit => Some(say.time_unit),
            Self::Device => say.device,
            Self::Growth => say.follow,
        }
    }
}

impl fmt::Display for FormatOption {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Stream => "the choice of a stream",
            Self::Columns => "the order of columns",
            Self::TimeUnit => "the unit of times",
            Self::Device => "the choice of a device",
            Self::Growth => "reading while it is written",
        })
    }
}

/// An option value that could not be parsed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{text:?} is not a valid {wanted}")]
pub struct OptionError {
    text: String,
    wanted: &'static str,
}

/// Unit of a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeUnit {
    /// 1 s
    Seconds,
    /// 10⁻³ s
    Milliseconds,
    /// 10⁻⁶ s
    Microseconds,
    /// 10⁻⁹ s
    Nanoseconds,
}

impl TimeUnit {
    /// Returns the symbol, as options and arguments name it.
    pub const fn symbol(self) -> &'static str {
        match self {
            Self::Seconds => "s",
            Self::Milliseconds => "ms",
            Self::Microseconds => "us",
            Self::Nanoseconds => "ns",
        }
    }

    /// Returns n such that the unit is 10ⁿ µs.
    pub const fn decimal_exponent(self) -> i32 {
        match self {
            Self::Seconds => 6,
            Self::Milliseconds => 3,
            Self::Microseconds => 0,
            Self::Nanoseconds => -3,
        }
    }
}

impl fmt::Display for TimeUnit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Seconds => "seconds",
            Self::Milliseconds => "milliseconds",
            Self::Microseconds => "microseconds",
            Self::Nanoseconds => "nanoseconds",
        })
    }
}

impl FromStr for TimeUnit {
    type Err = OptionError;

    fn from_str(text: &str) -> Result<Self, OptionError> {
        match text.to_lowercase().as_str() {
            "s" | "sec" | "seconds" => Ok(Self::Seconds),
            "ms" | "milliseconds" => Ok(Self::Milliseconds),
            "us" | "µs" | "μs" | "microseconds" => Ok(Self::Microseconds),
            "ns" | "nanoseconds" => Ok(Self::Nanoseconds),
            _ => Err(OptionError { text: text.to_owned(), wanted: "time unit: write s, ms, us or ns" }),
        }
    }
}

/// Content of a column of a text file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Column {
    /// Time.
    T,
    /// Sensor column in pixels.
    X,
    /// Sensor row in pixels.
    Y,
    /// Polarity.
    P,
    /// Any other content.
    Ignored,
}

/// Columns of a text file from left to right: t, x, y and p once each.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Columns(Vec<Column>);

impl Columns {
    /// Checks that t, x, y and p occur once each in `columns`; `None` otherwise.
    pub fn new(columns: Vec<Column>) -> Option<Self> {
        let once = |wanted| columns.iter().filter(|&&column| column == wanted).count() == 1;
        (once(Column::T) && once(Column::X) && once(Column::Y) && once(Column::P)).then_some(Self(columns))
    }

    /// The columns from left to right.
    pub fn as_slice(&self) -> &[Column] {
        &self.0
    }
}

impl fmt::Display for Columns {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, column) in self.0.iter().enumerate() {
            let separator = if index == 0 { "" } else { "," };
            let name = match column {
                Column::T => "t",
                Column::X => "x",
                Column::Y => "y",
                Column::P => "p",
                Column::Ignored => "-",
            };
            write!(f, "{separator}{name}")?;
        }
        Ok(())
    }
}

impl FromStr for Columns {
    type Err = OptionError;

    fn from_str(text: &str) -> Result<Self, OptionError> {
        text.split([',', ' '])
            .map(|name| match name.trim() {
                "t" => Some(Column::T),
                "x" => Some(Column::X),
                "y" => Some(Column::Y),
                "p" => Some(Column::P),
                "-" => Some(Column::Ignored),
                _ => None,
            })
            .collect::<Option<Vec<_>>>()
            .and_then(Self::new)
            .ok_or_else(|| OptionError {
                text: text.to_owned(),
                wanted: "column order: write t, x, y and p in the order of the file, - for a column to leave out, \
                         for example x,y,p,t or -,t,x,y,p",
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_read_and_written_back() {
        for text in ["t,x,y,p", "x,y,p,t", "-,t,x,y,p,-"] {
            assert_eq!(text.parse::<Columns>().unwrap().to_string(), text);
        }
        for text in ["", "t,x,y", "t,x,y,p,p", "t,x,y,q", "txyp"] {
            assert!(text.parse::<Columns>().unwrap_err().to_string().contains("x,y,p,t"), "{text}");
        }
    }

    #[test]
    fn units_are_powers_of_ten() {
        for (text, exponent) in [("s", 6), ("ms", 3), ("us", 0), ("µs", 0), ("NS", -3)] {
            assert_eq!(text.parse::<TimeUnit>().unwrap().decimal_exponent(), exponent);
        }
        assert!("minutes".parse::<TimeUnit>().is_err());
    }
}
