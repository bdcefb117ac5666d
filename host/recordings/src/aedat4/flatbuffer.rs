//! Bounds-checked access to the few FlatBuffers tables that AEDAT4 uses.
//!
//! A FlatBuffer starts with the position of its root table and a four-character identifier. A table
//! starts with the distance back to its vtable. The vtable contains its own length, the length of the
//! table and, for each field, the offset within the table (0 means absent: the default applies). Strings
//! and vectors are located by another relative offset and start with their length. All numbers are little-endian.
//! Every access checks its bounds: any input gives a value or [`Malformed`].

/// Smallest size in bytes of a table with a time: its offset in the vector, the distance to its vtable, and an i64.
const LEAST_TABLE: usize = 16;

/// The bytes are not a valid FlatBuffer of the expected type. Contains a description.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Malformed(pub &'static str);

/// A table inside a buffer.
#[derive(Clone, Copy)]
pub struct Table<'a> {
    bytes: &'a [u8],
    position: usize,
    vtable: usize,
    vtable_length: usize,
}

/// A vector inside a buffer.
#[derive(Clone, Copy)]
pub struct Vector<'a> {
    /// Number of elements according to the vector, which may exceed the buffer.
    pub length: usize,
    bytes: &'a [u8],
    start: usize,
}

fn array<const N: usize>(bytes: &[u8], position: usize) -> Option<[u8; N]> {
    bytes.get(position..)?.first_chunk().copied()
}

fn unsigned(bytes: &[u8], position: usize) -> Option<usize> {
    usize::try_from(u32::from_le_bytes(array(bytes, position)?)).ok()
}

/// Returns the root table of a FlatBuffer without size prefix, and checks its `identifier`.
pub fn root<'a>(bytes: &'a [u8], identifier: &[u8; 4]) -> Result<Table<'a>, Malformed> {
    if array::<4>(bytes, 4).as_ref() != Some(identifier) {
        return Err(Malformed("its identifier does not match its stream"));
    }
    table(bytes, 0).ok_or(Malformed("its root table is out of bounds"))
}

/// Returns the root table of a FlatBuffer that may lack the `identifier`.
pub fn root_of_any<'a>(bytes: &'a [u8], identifier: &[u8; 4]) -> Result<Table<'a>, Malformed> {
    root(bytes, identifier).or_else(|error| table(bytes, 0).ok_or(error))
}

/// Returns the table at the end of the relative offset at `position`.
fn table(bytes: &[u8], position: usize) -> Option<Table<'_>> {
    let position = position.checked_add(unsigned(bytes, position)?)?;
    let distance = i64::from(i32::from_le_bytes(array(bytes, position)?));
    let vtable = usize::try_from(i64::try_from(position).ok()?.checked_sub(distance)?).ok()?;
    let vtable_length = usize::from(u16::from_le_bytes(array(bytes, vtable)?));
    Some(Table { bytes, position, vtable, vtable_length })
}

impl<'a> Table<'a> {
    /// Position of field number `index`; `None` if the field is absent.
    fn field(&self, index: usize) -> Result<Option<usize>, Malformed> {
        let entry = 4 + 2 * index;
        if entry + 2 > self.vtable_length {
            return Ok(None);
        }
        let offset = array(self.bytes, self.vtable + entry).map(u16::from_le_bytes);
        match offset.ok_or(Malformed("a vtable is out of bounds"))? {
            0 => Ok(None),
            offset => Ok(Some(self.position + usize::from(offset))),
        }
    }

    fn scalar<const N: usize>(&self, index: usize) -> Result<Option<[u8; N]>, Malformed> {
        self.field(index)?
            .map(|position| array(self.bytes, position).ok_or(Malformed("a field is out of bounds")))
            .transpose()
    }

    /// Field `index` as i8.
    pub fn i8(&self, index: usize, default: i8) -> Result<i8, Malformed> {
        Ok(self.scalar(index)?.map_or(default, i8::from_le_bytes))
    }

    /// Field `index` as i16.
    pub fn i16(&self, index: usize, default: i16) -> Result<i16, Malformed> {
        Ok(self.scalar(index)?.map_or(default, i16::from_le_bytes))
    }

    /// Field `index` as i32.
    pub fn i32(&self, index: usize, default: i32) -> Result<i32, Malformed> {
        Ok(self.scalar(index)?.map_or(default, i32::from_le_bytes))
    }

    /// Field `index` as f32.
    pub fn f32(&self, index: usize, default: f32) -> Result<f32, Malformed> {
        Ok(self.scalar(index)?.map_or(default, f32::from_le_bytes))
    }

    /// Field `index` as i64.
    pub fn i64(&self, index: usize, default: i64) -> Result<i64, Malformed> {
        Ok(self.scalar(index)?.map_or(default, i64::from_le_bytes))
    }

    /// The vector of field `index`; empty if absent.
    pub fn vector(&self, index: usize) -> Result<Vector<'a>, Malformed> {
        let Some(field) = self.field(index)? else {
            return Ok(Vector { length: 0, bytes: self.bytes, start: 0 });
        };
        let vector = || {
            let position = field.checked_add(unsigned(self.bytes, field)?)?;
            Some(Vector { length: unsigned(self.bytes, position)?, bytes: self.bytes, start: position + 4 })
        };
        vector().ok_or(Malformed("a vector is out of bounds"))
    }

    /// The string of field `index`; empty if absent.
    pub fn string(&self, index: usize) -> Result<&'a str, Malformed> {
        let bytes = self.vector(index)?.elements::<1>()?.as_flattened();
        std::str::from_utf8(bytes).map_err(|_| Malformed("a string is not UTF-8"))
    }
}

impl<'a> Vector<'a> {
    /// The elements, `N` bytes each.
    pub fn elements<const N: usize>(&self) -> Result<&'a [[u8; N]], Malformed> {
        self.first_elements().get(..self.length).ok_or(Malformed("a vector is longer than its packet"))
    }

    /// The elements that the buffer contains, at most `length`. There are fewer if the packet was cut off.
    pub fn first_elements<const N: usize>(&self) -> &'a [[u8; N]] {
        let (elements, _) = self.bytes.get(self.start..).unwrap_or_default().as_chunks();
        elements.get(..self.length).unwrap_or(elements)
    }

    /// Checks that the buffer is large enough for `length` tables with times. The check is needed because any bytes are
    /// valid as tables without fields, and tables may overlap.
    pub fn of_tables(self) -> Result<Self, Malformed> {
        if self.length > self.bytes.len() / LEAST_TABLE {
            return Err(Malformed("a vector has more tables than its packet can hold"));
        }
        Ok(self)
    }

    /// Table number `index` of a vector of tables.
    pub fn table(&self, index: usize) -> Result<Table<'a>, Malformed> {
        let position = index.checked_mul(4).and_then(|offset| self.start.checked_add(offset));
        position
            .filter(|_| index < self.length)
            .and_then(|position| table(self.bytes, position))
            .ok_or(Malformed("a table is out of bounds"))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn arbitrary_bytes_do_not_panic(mut bytes in prop::collection::vec(any::<u8>(), 0..200), position in 0u32..60) {
            // A plausible root position and the right identifier, so that more than the first check runs.
            if bytes.len() >= 8 {
                bytes[..4].copy_from_slice(&position.to_le_bytes());
                bytes[4..8].copy_from_slice(b"TEST");
            }
            if let Ok(table) = root(&bytes, b"TEST") {
                for index in 0..8 {
                    let _ = (table.i8(index, 0), table.i16(index, 0), table.i32(index, 0), table.i64(index, 0));
                    let _ = table.string(index);
                    if let Ok(vector) = table.vector(index) {
                        let _ = vector.elements::<16>();
                        prop_assert!(vector.first_elements::<16>().len() * 16 <= bytes.len());
                        if let Ok(inner) = vector.table(1) {
                            let _ = inner.i64(1, 0);
                        }
                    }
                }
            }
        }
    }
}
