//! The header of an npy array: a magic number, a version, a length, and a Python dictionary with `descr`,
//! `fortran_order` and `shape`.

use super::literal::{self, Literal};
use crate::columns;
use crate::numbers::{NumberKind, NumberType};
use crate::options::Column;

/// First bytes of an npy array.
pub const MAGIC: &[u8] = b"\x93NUMPY";
/// Length limit of the dictionary in bytes.
const LONGEST: usize = 65_536;

/// Layout of an array.
#[derive(Clone, Debug, PartialEq)]
pub struct Header {
    /// Number of bytes before the first element.
    pub length: u64,
    /// Type of the elements.
    pub element: Element,
    /// Unit of the elements, if they are times or durations: `s`, `ms`, `us` or `ns`.
    pub unit: Option<String>,
    /// `true` if the first index varies fastest.
    pub fortran_order: bool,
    /// Number of elements along each index.
    pub shape: Vec<u64>,
}

/// Type of an element.
#[derive(Clone, Debug, PartialEq)]
pub enum Element {
    /// A number.
    Number(NumberType),
    /// Consecutive named fields; and the size of the record in bytes.
    Record(Vec<Field>, usize),
}

/// A field of a structured array.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// Name of the field; empty for padding.
    pub name: String,
    /// Offset of the field in the record, in bytes.
    pub offset: usize,
    /// Type of the field; `None` if it is not a supported number.
    pub number: Option<NumberType>,
}

/// Reason why an array cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HeadError {
    /// The header is invalid.
    Damaged(&'static str),
    /// The elements, described here, are not supported.
    Elements(&'static str),
}

impl From<&'static str> for HeadError {
    fn from(what: &'static str) -> Self {
        Self::Damaged(what)
    }
}

/// Largest number of bytes before the elements of an array.
pub const fn longest() -> u64 {
    LONGEST as u64 + 12
}

impl Header {
    /// Parses the header of an array that begins with `bytes`.
    pub fn parse(bytes: &[u8]) -> Result<Self, HeadError> {
        const CUT: &str = "the header of the array is incomplete";
        let rest = bytes.strip_prefix(MAGIC).ok_or("there is no NumPy array")?;
        let (&[major, _], rest) = rest.split_first_chunk().ok_or(CUT)?;
        let (size, rest) = if major == 1 {
            rest.split_first_chunk().map(|(size, rest)| (usize::from(u16::from_le_bytes(*size)), rest)).ok_or(CUT)?
        } else {
            let (size, rest) = rest.split_first_chunk().ok_or(CUT)?;
            (u32::from_le_bytes(*size) as usize, rest)
        };
        if size > LONGEST {
            return Err("the header of the array is too long".into());
        }
        let text = rest.get(..size).ok_or(CUT)?;
        let length = (bytes.len() - rest.len() + size) as u64;
        let dictionary = std::str::from_utf8(text).ok().and_then(literal::parse);
        let dictionary = dictionary.ok_or("the header of the array is invalid")?;
        let key = |name: &str| dictionary.key(name).ok_or("the header of the array states no type, order or shape");
        let descr = key("descr")?;
        let element = element(descr).ok_or(HeadError::Elements(match descr {
            Literal::Text(text) if text.trim_start_matches(['<', '>', '=']) == "f2" => HALF,
            _ => "elements that are not numbers",
        }))?;
        let unit = descr.text().and_then(unit_of_time).map(str::to_owned);
        let fortran_order = matches!(key("fortran_order")?, Literal::Word("True"));
        let shape =
            key("shape")?.items().and_then(|items| items.iter().map(Literal::whole).collect::<Option<Vec<_>>>());
        let shape = shape.ok_or("the shape of the array is invalid")?;
        let size = match &element {
            Element::Number(number) => number.size,
            Element::Record(_, size) => *size,
        };
        let bytes = shape.iter().try_fold(size as u64, |product, side| product.checked_mul(*side));
        bytes.filter(|bytes| *bytes < 1 << 62).ok_or("the shape of the array is too large")?;
        Ok(Self { length, element, unit, fortran_order, shape })
    }

    /// Number of elements.
    pub fn count(&self) -> u64 {
        self.shape.iter().product()
    }
}

/// Description of a rarely used type with too few digits for a time.
const HALF: &str = "floating-point numbers of 16 bits";

fn element(descr: &Literal) -> Option<Element> {
    if let Literal::Text(text) = descr {
        return number_type(text)?.0.map(Element::Number);
    }
    let mut offset = 0_usize;
    let mut fields = Vec::new();
    for field in descr.items()? {
        let parts = field.items()?;
        // A field may have a title before its name. Either of them may name the column.
        let names: Vec<&str> = match parts.first()? {
            Literal::Text(name) => vec![name],
            titled => titled.items()?.iter().filter_map(Literal::text).collect(),
        };
        let name = names.iter().find(|name| columns::of_name(name).0 != Column::Ignored);
        let unit = parts.get(1)?.text().and_then(unit_of_time);
        let name = with_unit(name.or(names.last())?, unit);
        let (number, size) = match parts.get(1)? {
            Literal::Text(text) => number_type(text)?,
            nested => match element(nested)? {
                Element::Record(_, size) => (None, size),
                Element::Number(number) => (Some(number), number.size),
            },
        };
        let number = number.filter(|_| parts.len() == 2);
        let repeated = parts.get(2).map_or(Some(1), |shape| match shape.items() {
            Some(items) => items.iter().try_fold(1_u64, |product, side| product.checked_mul(side.whole()?)),
            None => shape.whole(),
        });
        let size = size.checked_mul(usize::try_from(repeated?).ok()?)?;
        fields.push(Field { name, offset, number });
        offset = offset.checked_add(size).filter(|offset| *offset <= LONGEST)?;
    }
    (offset > 0).then_some(Element::Record(fields, offset))
}

/// Returns the unit of a type of times or durations, such as `<m8[us]`.
fn unit_of_time(text: &str) -> Option<&str> {
    let (_, unit) = text.trim_end_matches(']').split_once("8[")?;
    matches!(unit, "s" | "ms" | "us" | "ns").then_some(unit)
}

/// Returns the name of a column with its unit.
pub fn with_unit(name: &str, unit: Option<&str>) -> String {
    unit.map_or_else(|| name.to_owned(), |unit| format!("{name} [{unit}]"))
}

/// Parses a type such as `<i8`. Returns its size, and its number type if it is a supported number.
fn number_type(text: &str) -> Option<(Option<NumberType>, usize)> {
    let (order, rest) = text.split_at_checked(1)?;
    let (kind, size) = match order {
        "<" | ">" | "|" | "=" => rest.split_at_checked(1)?,
        _ => (order, rest),
    };
    let digits = size.split(|character: char| !character.is_ascii_digit()).next()?;
    let size: usize = digits.parse().ok()?;
    let kind = match kind {
        "i" => NumberKind::Signed,
        "m" | "M" if unit_of_time(text).is_some() => NumberKind::Signed,
        "u" | "b" => NumberKind::Unsigned,
        "f" => NumberKind::Float,
        "U" => return Some((None, size.checked_mul(4)?)),
        _ => return Some((None, size)),
    };
    Some((NumberType::new(kind, size, order == ">"), size))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn array(dictionary: &str) -> Vec<u8> {
        let length = dictionary.len() as u16;
        [MAGIC, &[1, 0], &length.to_le_bytes(), dictionary.as_bytes(), &[7; 9]].concat()
    }

    fn number(kind: NumberKind, size: usize) -> Option<NumberType> {
        NumberType::new(kind, size, false)
    }

    #[test]
    fn fields_have_the_offsets_of_numpy() {
        use NumberKind::{Signed, Unsigned};
        let descr = "[('timestamp', '<i8'), ('x', '<i2'), ('y', '<i2'), (('on', 'p'), '|b1'), ('', '|V3')]";
        let content = array(&format!("{{'descr': {descr}, 'fortran_order': False, 'shape': (5,), }} \n"));
        let header = Header::parse(&content).unwrap();
        assert_eq!((header.count(), header.length, header.fortran_order), (5, content.len() as u64 - 9, false));
        let field = |name: &str, offset, number| Field { name: name.to_owned(), offset, number };
        let fields = vec![
            field("timestamp", 0, number(Signed, 8)),
            field("x", 8, number(Signed, 2)),
            field("y", 10, number(Signed, 2)),
            field("on", 12, number(Unsigned, 1)),
            field("", 13, None),
        ];
        assert_eq!(header.element, Element::Record(fields, 16));
    }

    #[test]
    fn fields_that_are_not_numbers_are_skipped() {
        let descr = "[('a', '<f8', (2, 3)), ('b', [('c', '<u4'), ('d', '>f8')]), ('e', '<U4'), ('t', '>f4')]";
        let header = Header::parse(&array(&format!("{{'descr': {descr}, 'fortran_order': False, 'shape': ()}}")));
        let Element::Record(fields, size) = header.unwrap().element else { panic!("a record") };
        assert_eq!((size, fields.last().unwrap().offset), (48 + 12 + 16 + 4, 76));
        assert!(fields[..3].iter().all(|field| field.number.is_none()));
        assert_eq!(fields[3].number, NumberType::new(NumberKind::Float, 4, true));
    }

    #[test]
    fn invalid_headers_are_rejected() {
        for dictionary in [
            "",
            "{'descr': '<i8', 'shape': (1,)}",
            "{'descr': '<i8', 'fortran_order': False, 'shape': (18446744073709551615, 2)}",
            "{'descr': '<i8', 'fortran_order': False, 'shape': (-1,)}",
            "{'descr': '|O', 'fortran_order': False, 'shape': (1,)}",
            "{'descr': [('t', '<f8', 99999999999)], 'fortran_order': False, 'shape': (1,)}",
            "{'descr': [], 'fortran_order': False, 'shape': (1,)}",
        ] {
            assert!(Header::parse(&array(dictionary)).is_err(), "{dictionary}");
        }
        let nested = format!("{{'descr': {}", "[".repeat(60_000));
        assert!(Header::parse(&array(&nested)).is_err());
    }
}
