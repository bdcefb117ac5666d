//! Parses and emits single 16-bit words of the stream.
//!
//! ```text
//!  15  14 13 12  11 10  9  8   7 … 0
//! ┌──┬─────────────────────────────────┐
//! │ 1│ timestamp, µs, 15 bits          │
//! ├──┼────────┬────────────────────────┤
//! │ 0│ code   │ data, 12 bits          │
//! └──┴────────┴────────────────────────┘
//!
//! code  word                 data
//!  0    special              see `Special`
//!  1    row address          0 … rows − 1
//!  2    column address, OFF  0 … columns − 1
//!  3    column address, ON   0 … columns − 1
//!  4    ADC sample           10 bits
//!  5    miscellaneous        bits 11–8: 0 IMU byte, 1 ROI upper byte, 2 ROI lower byte, 3 IMU
//!                            contents and scale; bits 7–0: the byte
//!  6    miscellaneous        bits 11–10: 0 exposure time; bits 9–0: ten bits of it, lowest first
//!  7    timestamp wrap       number of times 2^15 µs passed
//! ```
//!
//! Parsing never fails: an undefined word is [`Word::Unknown`], and `Word::parse(word).emit() == word` for all 65,536
//! words.

use super::Polarity;

/// Words of code 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub enum Special {
    /// Time restarts at zero.
    TimestampReset = 1,
    /// The external input fell.
    ExternalInputFalling = 2,
    /// The external input rose.
    ExternalInputRising = 3,
    /// The external input pulsed.
    ExternalInputPulse = 4,
    /// An IMU sample begins.
    ImuStart = 5,
    /// The IMU sample ends; its time is the time of this word.
    ImuEnd = 7,
    /// A frame with global shutter begins.
    FrameStartGlobalShutter = 8,
    /// A frame with rolling shutter begins.
    FrameStartRollingShutter = 9,
    /// The frame is complete.
    FrameEnd = 10,
    /// A column of reset levels begins.
    ResetColumnStart = 11,
    /// A column of signal levels begins.
    SignalColumnStart = 12,
    /// The column ends.
    ColumnEnd = 13,
    /// The exposure begins.
    ExposureStart = 14,
    /// The exposure ends.
    ExposureEnd = 15,
    /// The generated signal fell.
    GeneratorFalling = 16,
    /// The generated signal rose.
    GeneratorRising = 17,
}

impl Special {
    /// Returns the special of this data, if it is defined.
    pub const fn parse(data: u16) -> Option<Self> {
        Some(match data {
            1 => Self::TimestampReset,
            2 => Self::ExternalInputFalling,
            3 => Self::ExternalInputRising,
            4 => Self::ExternalInputPulse,
            5 => Self::ImuStart,
            7 => Self::ImuEnd,
            8 => Self::FrameStartGlobalShutter,
            9 => Self::FrameStartRollingShutter,
            10 => Self::FrameEnd,
            11 => Self::ResetColumnStart,
            12 => Self::SignalColumnStart,
            13 => Self::ColumnEnd,
            14 => Self::ExposureStart,
            15 => Self::ExposureEnd,
            16 => Self::GeneratorFalling,
            17 => Self::GeneratorRising,
            _ => return None,
        })
    }
}

/// The meaning of one word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Word {
    /// Low 15 bits of the time in µs.
    Timestamp(u16),
    /// Code 0.
    Special(Special),
    /// Row of the column addresses that follow.
    Row(u16),
    /// An event in the latest row.
    Column(u16, Polarity),
    /// A reset or signal level, 10 bits.
    Sample(u16),
    /// A byte of an IMU sample.
    ImuByte(u8),
    /// Upper byte of a corner of the frame.
    RegionHigh(u8),
    /// Lower byte of a corner of the frame.
    RegionLow(u8),
    /// Contents and scales of an IMU sample.
    ImuScale(u8),
    /// Ten bits of the exposure time in cycles of the ADC clock.
    Exposure(u16),
    /// The upper part of the time grows by this many times 2^15 µs.
    Wrap(u16),
    /// An undefined word.
    Unknown(u16),
}

impl Word {
    /// Returns the meaning of `word`.
    pub const fn parse(word: u16) -> Self {
        if word & 0x8000 != 0 {
            return Self::Timestamp(word & 0x7FFF);
        }
        let data = word & 0x0FFF;
        let byte = (data & 0xFF) as u8;
        match (word >> 12, data >> 8) {
            (0, _) => match Special::parse(data) {
                Some(special) => Self::Special(special),
                None => Self::Unknown(word),
            },
            (1, _) => Self::Row(data),
            (2, _) => Self::Column(data, Polarity::Off),
            (3, _) => Self::Column(data, Polarity::On),
            (4, 0..4) => Self::Sample(data),
            (5, 0) => Self::ImuByte(byte),
            (5, 1) => Self::RegionHigh(byte),
            (5, 2) => Self::RegionLow(byte),
            (5, 3) => Self::ImuScale(byte),
            (6, 0..4) => Self::Exposure(data),
            (7, _) => Self::Wrap(data),
            _ => Self::Unknown(word),
        }
    }

    /// Returns the word with this meaning. Values wider than their field are truncated.
    pub const fn emit(self) -> u16 {
        match self {
            Self::Timestamp(time) => 0x8000 | time,
            Self::Special(special) => special as u16,
            Self::Row(row) => 0x1000 | (row & 0x0FFF),
            Self::Column(column, Polarity::Off) => 0x2000 | (column & 0x0FFF),
            Self::Column(column, Polarity::On) => 0x3000 | (column & 0x0FFF),
            Self::Sample(sample) => 0x4000 | (sample & 0x03FF),
            Self::ImuByte(byte) => 0x5000 | byte as u16,
            Self::RegionHigh(byte) => 0x5100 | byte as u16,
            Self::RegionLow(byte) => 0x5200 | byte as u16,
            Self::ImuScale(byte) => 0x5300 | byte as u16,
            Self::Exposure(bits) => 0x6000 | (bits & 0x03FF),
            Self::Wrap(times) => 0x7000 | (times & 0x0FFF),
            Self::Unknown(word) => word,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_word_survives_a_round_trip() {
        for word in 0..=u16::MAX {
            assert_eq!(Word::parse(word).emit(), word);
        }
    }

    #[test]
    fn words_agree_with_the_table() {
        assert_eq!(Word::parse(0xFFFF), Word::Timestamp(0x7FFF));
        assert_eq!(Word::parse(0x1159), Word::Row(345));
        assert_eq!(Word::parse(0x2103), Word::Column(259, Polarity::Off));
        assert_eq!(Word::parse(0x3000), Word::Column(0, Polarity::On));
        assert_eq!(Word::parse(0x43FF), Word::Sample(1023));
        assert_eq!(Word::parse(0x5F00), Word::Unknown(0x5F00));
        assert_eq!(Word::parse(0x6C01), Word::Unknown(0x6C01));
        assert_eq!(Word::parse(0x7003), Word::Wrap(3));
        assert_eq!(Word::parse(0x0000), Word::Unknown(0));
        assert_eq!(Word::parse(0x0006), Word::Unknown(6));
        assert_eq!(Word::parse(0x0012), Word::Unknown(18));
        assert_eq!(Word::parse(0x0002), Word::Special(Special::ExternalInputFalling));
    }
}
