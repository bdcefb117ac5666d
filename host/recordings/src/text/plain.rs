//! Fast parser of the usual lines: digits, at most one point in the time, and one separator between fields. Other lines
//! return `None` and go to the general parser. If this parser returns an event, the general one returns the same.

use evcal_core::event::{Event, Polarity};

use super::layout::Layout;
use crate::options::Column;

/// An event parsed from a plain line.
pub struct PlainLine {
    /// The event.
    pub event: Event,
    /// Length of the line, including its end.
    pub length: usize,
    /// Length of the last field in bytes.
    pub last_field: usize,
}

/// Parses the first line of `bytes`, if it is plain and complete.
pub fn event(bytes: &[u8], layout: &Layout) -> Option<PlainLine> {
    let places = usize::try_from(layout.time_unit.decimal_exponent()).ok()?;
    let mut event = Event { t: 0, x: 0, y: 0, polarity: Polarity::Off };
    let mut rest = bytes;
    let mut last_field = 0;
    for (index, column) in layout.columns.as_slice().iter().enumerate() {
        if index > 0 {
            let (b' ' | b',' | b'\t' | b';', after) = rest.split_first()? else {
                return None;
            };
            rest = after;
        }
        let before = rest.len();
        match column {
            Column::T => event.t = time(&mut rest, places)?,
            Column::X => event.x = u16::try_from(digits(&mut rest, 4)?).ok()?,
            Column::Y => event.y = u16::try_from(digits(&mut rest, 4)?).ok()?,
            Column::P => {
                event.polarity = match digits(&mut rest, 1)? {
                    0 => Polarity::Off,
                    1 => Polarity::On,
                    _ => return None,
                }
            }
            Column::Ignored => return None,
        }
        last_field = before - rest.len();
    }
    let rest = rest.strip_prefix(b"\r").unwrap_or(rest).strip_prefix(b"\n")?;
    Some(PlainLine { event, length: bytes.len() - rest.len(), last_field })
}

/// Parses 1 to `most` digits at the front, and removes them.
fn digits(rest: &mut &[u8], most: usize) -> Option<i64> {
    let (value, count) = leading(rest, most);
    *rest = rest.get(count..)?;
    (count > 0 && !rest.first().is_some_and(u8::is_ascii_digit)).then_some(value)
}

/// Parses up to `most` digits at the front. Returns the number and the count of digits.
fn leading(bytes: &[u8], most: usize) -> (i64, usize) {
    let mut value = 0;
    let mut count = 0;
    while count < most
        && let Some(digit @ 0..=9) = bytes.get(count).map(|byte| byte.wrapping_sub(b'0'))
    {
        value = 10 * value + i64::from(digit);
        count += 1;
    }
    (value, count)
}

/// Parses a time at the front, and removes it: at most 12 digits, then for units longer than 1 µs a fraction, whose
/// first `places` digits are microseconds and whose next digit rounds.
fn time(rest: &mut &[u8], places: usize) -> Option<i64> {
    // 10¹² s in microseconds fit in an i64, and so do 10¹⁸ µs.
    let mut value = digits(rest, if places == 0 { 18 } else { 12 })?;
    let mut missing = places;
    let mut up = false;
    if let Some((b'.', fraction)) = rest.split_first() {
        let (fraction_value, count) = leading(fraction, places);
        let after = fraction.get(count..)?;
        missing = places - count;
        value = value * 10i64.pow(count as u32) + fraction_value;
        up = matches!(after.first(), Some(b'5'..=b'9'));
        let unused = after.iter().take_while(|byte| byte.is_ascii_digit()).count();
        *rest = after.get(unused..)?;
    }
    Some(value * 10i64.pow(missing as u32) + i64::from(up))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::{LineError, event as general};
    use super::*;
    use crate::TimeUnit;
    use crate::columns::PolarityCode;

    fn both(line: &str, columns: &str, time_unit: TimeUnit) -> (Option<PlainLine>, Result<Event, LineError>) {
        let columns = columns.parse().unwrap();
        let layout = Layout {
            columns,
            time_unit,
            is_unit_doubtful: false,
            code: PolarityCode::USUAL,
            first_line: 0,
            sensor: None,
            notes: Vec::new(),
        };
        (event(format!("{line}\nnext").as_bytes(), &layout), general(line.as_bytes(), &layout))
    }

    proptest! {
        #[test]
        fn agrees_with_the_general_parser(
            line in prop_oneof![
                "[0-9]{1,13}(\\.[0-9]{0,9})? [0-9]{1,5},[0-9]{1,4};[01](\r)?",
                "[0-9]{1,3},[0-9]{1,3}\t[01] [0-9]{1,13}(\\.[0-9]{0,9})?",
                "[-+0-9., e]{0,20}",
            ],
            unit in 0usize..4,
        ) {
            let unit = [TimeUnit::Seconds, TimeUnit::Milliseconds, TimeUnit::Microseconds, TimeUnit::Nanoseconds][unit];
            for columns in ["t,x,y,p", "x,y,p,t", "-,t,x,y,p"] {
                if let (Some(plain), slow) = both(&line, columns, unit) {
                    prop_assert_eq!(Ok(plain.event), slow);
                    prop_assert_eq!(plain.length, line.len() + 1);
                    let last = line.trim_end().rsplit([' ', ',', ';', '\t']).next().map(str::len);
                    prop_assert_eq!(Some(plain.last_field), last);
                }
            }
        }
    }

    #[test]
    fn plain_lines_are_parsed() {
        for (line, columns, unit) in [
            ("0.003811000 96 133 0", "t,x,y,p", TimeUnit::Seconds),
            ("1468939993.067416 96 133 1", "t,x,y,p", TimeUnit::Seconds),
            ("1643243628737093,96,133,1", "t,x,y,p", TimeUnit::Microseconds),
            ("96;133;1;1643243628737093\r", "x,y,p,t", TimeUnit::Microseconds),
        ] {
            let (fast, slow) = both(line, columns, unit);
            assert_eq!(fast.unwrap().event, slow.unwrap(), "{line}");
        }
    }

    #[test]
    fn a_line_without_end_is_left_to_the_general_parser() {
        let layout = Layout {
            is_unit_doubtful: false,
            code: PolarityCode::USUAL,
            columns: "t,x,y,p".parse().unwrap(),
            time_unit: TimeUnit::Microseconds,
            first_line: 0,
            sensor: None,
            notes: Vec::new(),
        };
        let whole = b"12,34,56,1\r\n";
        assert!(event(whole, &layout).is_some());
        for length in 0..whole.len() {
            assert!(event(&whole[..length], &layout).is_none());
        }
    }
}
