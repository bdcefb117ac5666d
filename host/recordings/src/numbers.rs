//! Numbers in arrays, and their conversion to events.

use evcal_core::event::Event;

use super::columns::{Cell, PolarityCode};
use crate::error::RecordingErrorKind;
use crate::options::{Column, TimeUnit};

/// Binary representation of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NumberType {
    /// Kind of the number.
    pub kind: NumberKind,
    /// Size in bytes: 1, 2, 4 or 8.
    pub size: usize,
    /// `true` if the highest byte comes first.
    pub big_endian: bool,
}

/// Kind of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NumberKind {
    /// Signed integer in two's complement.
    Signed,
    /// Unsigned integer.
    Unsigned,
    /// IEEE 754 of 4 or 8 bytes.
    Float,
}

/// A number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Number {
    /// An integer.
    Whole(i64),
    /// A floating-point number.
    Real(f64),
    /// An unsigned number of all ones. As a polarity it may be the -1 of OFF, which some programs store in an unsigned
    /// array.
    AllOnes(u64),
}

impl NumberType {
    /// Creates a supported type; `None` for others, such as floating-point numbers of 2 bytes.
    pub fn new(kind: NumberKind, size: usize, big_endian: bool) -> Option<Self> {
        let known = match kind {
            NumberKind::Signed | NumberKind::Unsigned => matches!(size, 1 | 2 | 4 | 8),
            NumberKind::Float => matches!(size, 4 | 8),
        };
        known.then_some(Self { kind, size, big_endian })
    }

    /// Reads the number at the front of `bytes`; `None` if there are too few bytes.
    pub fn read(self, bytes: &[u8]) -> Option<Number> {
        let mut little = [0; 8];
        let (slots, bytes) = (little.get_mut(..self.size)?, bytes.get(..self.size)?);
        slots.copy_from_slice(bytes);
        if self.big_endian {
            slots.reverse();
        }
        let value = u64::from_le_bytes(little);
        let unused = 64 - 8 * self.size as u32;
        Some(match (self.kind, self.size) {
            (NumberKind::Float, 4) => Number::Real(f32::from_bits(value as u32).into()),
            (NumberKind::Float, _) => Number::Real(f64::from_bits(value)),
            (NumberKind::Unsigned, _) if value == u64::MAX >> unused => Number::AllOnes(value),
            (NumberKind::Unsigned, _) => i64::try_from(value).map_or(Number::Real(value as f64), Number::Whole),
            (NumberKind::Signed, _) => Number::Whole(value.cast_signed() << unused >> unused),
        })
    }
}

impl Number {
    /// Value of the number, as accurately as f64 allows.
    pub fn value(self) -> f64 {
        match self {
            Self::Whole(value) => value as f64,
            Self::Real(value) => value,
            Self::AllOnes(value) => value as f64,
        }
    }

    /// Describes the number for the detection of columns.
    pub fn cell(self) -> Cell {
        let is_usual = PolarityCode::USUAL.polarity(self.value()).is_some();
        Cell { value: Some(self.value()), is_polarity: is_usual || matches!(self, Self::AllOnes(_)) }
    }

    /// Converts to a time, rounded to µs.
    pub fn microseconds(self, unit: TimeUnit) -> Option<i64> {
        let exponent = unit.decimal_exponent();
        match self.as_whole() {
            Self::Whole(value) => {
                let scale = 10_i64.checked_pow(exponent.unsigned_abs())?;
                if exponent >= 0 {
                    return value.checked_mul(scale);
                }
                // Rounds half away from zero.
                Some(value.checked_add(scale / 2 * value.signum())? / scale)
            }
            Self::Real(value) => {
                let microseconds = value * 10_f64.powi(exponent);
                (microseconds.abs() < 9e18).then(|| microseconds.round() as i64)
            }
            Self::AllOnes(_) => None,
        }
    }

    /// Converts a number of all ones to the integer with these bits, if i64 contains it.
    fn as_whole(self) -> Self {
        match self {
            Self::AllOnes(value) => i64::try_from(value).map_or(self, Self::Whole),
            Self::Whole(_) | Self::Real(_) => self,
        }
    }

    /// Converts to a pixel coordinate. Values out of range become the largest u16, which no sensor has. `None` if it is
    /// not a whole number.
    pub fn pixel(self) -> Option<u16> {
        match self {
            Self::Whole(value) => Some(u16::try_from(value).unwrap_or(u16::MAX)),
            Self::Real(value) if value.fract() != 0.0 => None,
            Self::Real(value) => Some(if value < 0.0 { u16::MAX } else { value as u16 }),
            Self::AllOnes(value) => Some(u16::try_from(value).unwrap_or(u16::MAX)),
        }
    }
}

/// Stores the number of a column in `event`. `index` is the number of the event, from 1.
pub fn put(
    event: &mut Event,
    index: u64,
    column: Column,
    number: Number,
    unit: TimeUnit,
    code: PolarityCode,
) -> Result<(), RecordingErrorKind> {
    let wrong = |what: String| RecordingErrorKind::Event { event: index, what };
    let value = number.value();
    let pixel = |axis: &str| {
        let what = || format!("its {axis}, {value}, is not a whole pixel; raw events are needed, not undistorted ones");
        number.pixel().ok_or_else(|| wrong(what()))
    };
    match column {
        Column::T => {
            let wrong = RecordingErrorKind::EventTime { event: index, value, unit };
            event.t = number.microseconds(unit).ok_or(wrong)?;
        }
        Column::X => event.x = pixel("x")?,
        Column::Y => event.y = pixel("y")?,
        Column::P => {
            let what = || format!("its polarity is {value}, not {code}; is this the polarity column?");
            event.polarity = code.polarity(value).ok_or_else(|| wrong(what()))?;
        }
        Column::Ignored => {}
    }
    Ok(())
}

/// `true` if a row with these values looks like reserved space that was never written: all values are 0, or all are -1.
pub fn is_filling(mut values: impl Iterator<Item = Option<f64>>) -> bool {
    let Some(first) = values.next() else { return false };
    [Some(0.0), Some(-1.0)].contains(&first) && values.all(|value| value == first)
}

/// Returns the number of `rows` without the unwritten ones at the end. A single last row that `is_filling` is kept,
/// because it may be an event; two or more are not, because one pixel does not send two events at the same time.
pub fn written<R: ExactSizeIterator + DoubleEndedIterator>(rows: R, is_filling: impl Fn(R::Item) -> bool) -> usize {
    let count = rows.len();
    match rows.rev().map(is_filling).take_while(|filling| *filling).count() {
        0 | 1 => count,
        filling => count - filling,
    }
}

/// Returns `rows` without the unwritten ones at the end (see [`written`]).
pub fn written_cells(mut rows: Vec<Vec<Cell>>) -> Vec<Vec<Cell>> {
    rows.truncate(written(rows.iter(), |row| is_filling(row.iter().map(|cell| cell.value))));
    rows
}

#[cfg(test)]
mod tests {
    use evcal_core::event::Polarity;

    use super::*;

    fn number(kind: NumberKind, size: usize, big_endian: bool, bytes: &[u8]) -> Option<Number> {
        NumberType::new(kind, size, big_endian)?.read(bytes)
    }

    #[test]
    fn numbers_are_read_as_written_by_rust() {
        use NumberKind::{Float, Signed, Unsigned};
        assert_eq!(number(Signed, 2, false, &(-7_i16).to_le_bytes()), Some(Number::Whole(-7)));
        assert_eq!(number(Signed, 8, true, &(-7_i64).to_be_bytes()), Some(Number::Whole(-7)));
        assert_eq!(number(Unsigned, 4, true, &70_000_u32.to_be_bytes()), Some(Number::Whole(70_000)));
        assert_eq!(number(Unsigned, 1, false, &[255]), Some(Number::AllOnes(255)));
        assert_eq!(number(Unsigned, 8, false, &[255; 8]), Some(Number::AllOnes(u64::MAX)));
        assert_eq!(number(Unsigned, 8, false, &(1_u64 << 63).to_le_bytes()), Some(Number::Real(2_f64.powi(63))));
        assert_eq!(number(Float, 4, false, &0.25_f32.to_le_bytes()), Some(Number::Real(0.25)));
        assert_eq!(number(Float, 8, true, &(-1e9_f64).to_be_bytes()), Some(Number::Real(-1e9)));
        assert_eq!(number(Float, 2, false, &[0; 2]), None);
        assert_eq!(number(Signed, 4, false, &[0; 3]), None);
    }

    #[test]
    fn all_ones_are_the_largest_pixel_or_time_or_a_polarity() {
        let number = number(NumberKind::Unsigned, 1, false, &[255]).unwrap();
        assert_eq!((number.pixel(), number.cell().is_polarity), (Some(255), true));
        assert_eq!(number.microseconds(TimeUnit::Milliseconds), Some(255_000));
        assert_eq!(Number::AllOnes(u64::MAX).microseconds(TimeUnit::Microseconds), None);
    }

    #[test]
    fn times_are_rounded_to_the_nearest_microsecond() {
        for (number, unit, microseconds) in [
            (Number::Whole(1499), TimeUnit::Nanoseconds, Some(1)),
            (Number::Whole(1500), TimeUnit::Nanoseconds, Some(2)),
            (Number::Whole(-1500), TimeUnit::Nanoseconds, Some(-2)),
            (Number::Whole(3), TimeUnit::Seconds, Some(3_000_000)),
            (Number::Whole(i64::MAX), TimeUnit::Milliseconds, None),
            (Number::Real(0.123_456_6), TimeUnit::Seconds, Some(123_457)),
            (Number::Real(f64::NAN), TimeUnit::Seconds, None),
        ] {
            assert_eq!(number.microseconds(unit), microseconds, "{number:?}");
        }
    }

    #[test]
    fn unwritten_rows_are_recognised() {
        for (row, filling) in [
            (&[0.0, 0.0, 0.0, 0.0][..], true),
            (&[-1.0; 4], true),
            (&[0.0, -1.0, 0.0, 0.0], false),
            (&[1.0; 4], false),
            (&[f64::NAN; 4], false),
            (&[], false),
        ] {
            assert_eq!(is_filling(row.iter().map(|value| Some(*value))), filling, "{row:?}");
        }
    }

    #[test]
    fn values_that_are_not_an_event_are_reported() {
        for (column, value, part) in [
            (Column::T, f64::INFINITY, "out of range (unit: seconds)"),
            (Column::X, 1.5, "its x, 1.5"),
            (Column::Y, f64::NAN, "its y, NaN"),
            (Column::P, 2.0, "polarity is 2"),
        ] {
            let mut event = Event { t: 0, x: 0, y: 0, polarity: Polarity::Off };
            let put = put(&mut event, 7, column, Number::Real(value), TimeUnit::Seconds, PolarityCode::USUAL);
            let error = put.unwrap_err().to_string();
            assert!(error.contains("event 7") && error.contains(part), "{error}");
        }
    }
}
