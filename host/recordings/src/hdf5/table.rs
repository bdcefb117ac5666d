//! Tables of events in datasets, and reading of their numbers.

use hdf5_reader::error::Error;
use hdf5_reader::{Attribute, ByteOrder, CompoundField, Dataset, Datatype, H5Type, SliceInfo, SliceInfoElem};

use super::filters::Limits;
use crate::columns;
use crate::numbers::{Number, NumberKind, NumberType};
use crate::options::{Column, Columns, TimeUnit};

/// The numbers of one event, each with its column.
pub type Row = [(Column, Number); 4];

/// A table with one event per row.
#[derive(Clone)]
pub enum Table {
    /// One dataset per column.
    Columns(Vec<(Column, Dataset)>),
    /// One dataset of N x 4, or of 4 x N (MATLAB writes an N x 4 array like that).
    Rows(Dataset, Columns),
    /// One dataset of records with the fields t, x, y and p.
    Records(Dataset),
}

/// `true` if a dataset is a list: N, N x 1 or 1 x N elements.
pub fn is_list(dataset: &Dataset) -> bool {
    matches!(dataset.shape(), [_] | [_, 1] | [1, _])
}

/// Describes the elements of a dataset if they are not supported.
pub fn unread(dataset: &Dataset) -> Option<&'static str> {
    match dataset.dtype() {
        dtype if number_type(dtype).is_some() => None,
        Datatype::FloatingPoint { size: 2, .. } => Some("floating-point numbers of 16 bits"),
        _ => Some("elements that are not numbers"),
    }
}

/// Returns the index of the axis along the rows of a dataset.
fn axis(dataset: &Dataset) -> usize {
    match dataset.shape() {
        [1, columns] if *columns != 1 => 1,
        [4, columns] if *columns != 4 && *columns != 1 => 1,
        _ => 0,
    }
}

/// Returns the number of rows of a dataset.
fn rows(dataset: &Dataset) -> u64 {
    dataset.shape().get(axis(dataset)).copied().unwrap_or(0)
}

impl Table {
    /// Returns the table of one dataset, if it can contain events.
    pub fn of(dataset: &Dataset) -> Option<Self> {
        let unknown = || Columns::new(vec![Column::T, Column::X, Column::Y, Column::P]);
        match (dataset.dtype(), dataset.shape()) {
            (Datatype::Compound { .. }, [_]) => record_fields(dataset.dtype()).map(|_| Self::Records(dataset.clone())),
            (dtype, [_, 4] | [4, _]) if number_type(dtype).is_some() => Some(Self::Rows(dataset.clone(), unknown()?)),
            _ => None,
        }
    }

    /// Returns the arrays with the events.
    pub fn datasets(&self) -> Vec<&Dataset> {
        match self {
            Self::Columns(columns) => columns.iter().map(|(_, dataset)| dataset).collect(),
            Self::Rows(dataset, _) | Self::Records(dataset) => vec![dataset],
        }
    }

    /// Number of events: of the shortest column.
    pub fn count(&self) -> u64 {
        self.datasets().into_iter().map(rows).min().unwrap_or(0)
    }

    /// Describes the lengths of the columns, if they differ.
    pub fn unequal(&self) -> Option<String> {
        let datasets = self.datasets();
        let lengths: Vec<u64> = datasets.iter().map(|dataset| rows(dataset)).collect();
        let name = |dataset: &Dataset| dataset.name().rsplit('/').next().unwrap_or_default().to_owned();
        let list = || datasets.iter().zip(&lengths).map(|(dataset, length)| format!("{} {length}", name(dataset)));
        let is_unequal = lengths.windows(2).any(|pair| pair[0] != pair[1]);
        is_unequal.then(|| list().collect::<Vec<_>>().join(", "))
    }

    /// Returns the sizes of its chunks.
    pub fn limits(&self) -> Limits {
        let mut limits = Limits::default();
        for dataset in self.datasets() {
            let rows = dataset.chunks().unwrap_or_default();
            let size = dataset.raw_element_size().unwrap_or(0);
            limits.hold(rows.iter().fold(size, |bytes, side| bytes.saturating_mul(*side as usize)));
        }
        limits
    }

    /// Returns the first row after `row` at which a chunk of any dataset begins; the number of rows if there is none.
    pub fn next_chunk(&self, row: u64) -> u64 {
        let next = |dataset: &Dataset| {
            let side = u64::from(*dataset.chunks()?.get(axis(dataset))?).max(1);
            Some((row / side + 1).saturating_mul(side))
        };
        self.datasets().into_iter().filter_map(next).min().map_or(self.count(), |next| next.min(self.count()))
    }

    /// Returns the order of the columns for correction, if it must be determined from the values.
    pub fn order_to_find(&mut self) -> Option<&mut Columns> {
        match self {
            Self::Rows(_, order) => Some(order),
            Self::Columns(_) | Self::Records(_) => None,
        }
    }

    /// Returns the unit that the name of the times contains, if any.
    pub fn unit_of_name(&self) -> Option<TimeUnit> {
        let name = match self {
            Self::Columns(columns) => columns.iter().find(|(column, _)| *column == Column::T)?.1.name(),
            Self::Records(dataset) => &field(dataset.dtype(), Column::T)?.name,
            Self::Rows(..) => return None,
        };
        columns::of_name(name.rsplit('/').next()?).1
    }

    /// Returns the columns in the order of the numbers of a [`Row`].
    pub fn order(&self) -> Vec<Column> {
        match self {
            Self::Columns(columns) => columns.iter().map(|(column, _)| *column).collect(),
            Self::Rows(_, order) => order.as_slice().to_vec(),
            Self::Records(_) => RECORD.to_vec(),
        }
    }

    /// Returns the first rows, at most `most`. There are fewer if later ones cannot be read.
    pub fn cells(&self, most: u64) -> Result<Vec<Vec<columns::Cell>>, Error> {
        let rows = self.readable(0, most)?;
        Ok(rows.iter().map(|row| row.iter().map(|(_, number)| number.cell()).collect()).collect())
    }

    /// Reads up to `most` rows from `start` on. If that fails, reads fewer, down to one.
    ///
    /// # Errors
    /// If the row `start` cannot be read.
    pub fn readable(&self, start: u64, most: u64) -> Result<Vec<Row>, Error> {
        let mut count = most.min(self.count().saturating_sub(start));
        loop {
            match self.rows(start, start + count) {
                Err(_) if count > 1 => count /= 2,
                rows => return rows,
            }
        }
    }

    /// Reads the rows from `start` to `end`, exclusive.
    pub fn rows(&self, start: u64, end: u64) -> Result<Vec<Row>, Error> {
        let count = end.saturating_sub(start) as usize;
        let mut found = vec![[(Column::Ignored, Number::Whole(0)); 4]; count];
        if count == 0 {
            return Ok(found);
        }
        let rows = SliceInfoElem::Slice { start, end, step: 1 };
        let selection = |dataset: &Dataset, other: SliceInfoElem| {
            let mut selections = vec![other; dataset.shape().len()];
            if let Some(selection) = selections.get_mut(axis(dataset)) {
                *selection = rows.clone();
            }
            SliceInfo { selections }
        };
        match self {
            Self::Columns(columns) => {
                for (index, (column, dataset)) in columns.iter().enumerate() {
                    let numbers = dataset.read_slice::<Cell>(&selection(dataset, SliceInfoElem::Index(0)))?;
                    for (row, Cell(number)) in found.iter_mut().zip(&numbers) {
                        if let Some(slot) = row.get_mut(index) {
                            *slot = (*column, *number);
                        }
                    }
                }
            }
            Self::Rows(dataset, order) => {
                let all = SliceInfoElem::Slice { start: 0, end: 4, step: 1 };
                let numbers = dataset.read_slice::<Cell>(&selection(dataset, all))?;
                let by_column = axis(dataset) == 1;
                for (index, Cell(number)) in numbers.iter().enumerate() {
                    let (row, column) = if by_column { (index % count, index / count) } else { (index / 4, index % 4) };
                    let slot = found.get_mut(row).and_then(|row| row.get_mut(column));
                    if let (Some(slot), Some(column)) = (slot, order.as_slice().get(column)) {
                        *slot = (*column, *number);
                    }
                }
            }
            Self::Records(dataset) => {
                let records = dataset.read_slice::<Record>(&SliceInfo { selections: vec![rows] })?;
                for (row, Record(numbers)) in found.iter_mut().zip(&records) {
                    for ((slot, column), number) in row.iter_mut().zip(RECORD).zip(numbers) {
                        *slot = (column, *number);
                    }
                }
            }
        }
        Ok(found)
    }
}

/// Reads the number of a dataset with a single element.
pub fn single(dataset: &Dataset) -> Option<Number> {
    numbers(dataset, 1)?.first().copied()
}

/// Reads the numbers of a dataset with at most `most` elements.
pub fn numbers(dataset: &Dataset, most: u64) -> Option<Vec<Number>> {
    let few = dataset.num_elements().ok()? <= most && number_type(dataset.dtype()).is_some();
    let numbers = few.then(|| dataset.read_array::<Cell>().ok())??;
    Some(numbers.iter().map(|Cell(number)| *number).collect())
}

/// Reads the numbers of row `row` of a dataset of rows.
pub fn row(dataset: &Dataset, row: u64) -> Result<Vec<Number>, Error> {
    let mut selections: Vec<_> =
        dataset.shape().iter().map(|side| SliceInfoElem::Slice { start: 0, end: *side, step: 1 }).collect();
    if let Some(first) = selections.first_mut() {
        *first = SliceInfoElem::Index(row);
    }
    let numbers = dataset.read_slice::<Cell>(&SliceInfo { selections })?;
    Ok(numbers.iter().map(|Cell(number)| *number).collect())
}

/// Reads the numbers of an attribute.
pub fn of_attribute(attribute: &Attribute) -> Option<Vec<Number>> {
    Some(attribute.read_1d::<Cell>().ok()?.into_iter().map(|Cell(number)| number).collect())
}

/// Returns the number type of a datatype; `None` if it is not a supported number.
fn number_type(dtype: &Datatype) -> Option<NumberType> {
    let big = |order| order == ByteOrder::BigEndian;
    match *dtype {
        Datatype::FixedPoint { size, signed, byte_order } => {
            let kind = if signed { NumberKind::Signed } else { NumberKind::Unsigned };
            NumberType::new(kind, size.into(), big(byte_order))
        }
        Datatype::FloatingPoint { size, byte_order } => {
            NumberType::new(NumberKind::Float, size.into(), big(byte_order))
        }
        // Booleans, as h5py writes them.
        Datatype::Enum { ref base, .. } => number_type(base),
        _ => None,
    }
}

fn no_number() -> Error {
    Error::InvalidData("a number of an unsupported type".to_owned())
}

/// A number of any supported type.
#[derive(Clone)]
struct Cell(Number);

impl H5Type for Cell {
    fn hdf5_type() -> Datatype {
        Datatype::FloatingPoint { size: 8, byte_order: ByteOrder::LittleEndian }
    }

    fn from_bytes(bytes: &[u8], dtype: &Datatype) -> Result<Self, Error> {
        number_type(dtype).and_then(|number| number.read(bytes)).map(Self).ok_or_else(no_number)
    }

    fn element_size(dtype: &Datatype) -> usize {
        number_type(dtype).map_or(0, |number| number.size)
    }

    fn decode_vec(raw: &[u8], dtype: &Datatype, _: usize) -> Option<Result<Vec<Self>, Error>> {
        let number = number_type(dtype)?;
        let cells = raw.chunks_exact(number.size).map(|bytes| number.read(bytes).map(Self).ok_or_else(no_number));
        Some(cells.collect())
    }
}

/// Order of the numbers in a [`Record`].
const RECORD: [Column; 4] = [Column::T, Column::X, Column::Y, Column::P];

/// The numbers of a record with the fields t, x, y and p.
#[derive(Clone)]
struct Record([Number; 4]);

/// Returns the field of a record for this column.
fn field(dtype: &Datatype, column: Column) -> Option<&CompoundField> {
    let Datatype::Compound { fields, .. } = dtype else { return None };
    let named = fields.iter().filter(|field| columns::of_name(&field.name).0 == column);
    named.min_by_key(|field| field.name.len())
}

/// Returns offsets and types of the fields of a record.
fn record_fields(dtype: &Datatype) -> Option<[(usize, NumberType); 4]> {
    let mut found = [None; 4];
    for (slot, column) in found.iter_mut().zip(RECORD) {
        let field = field(dtype, column)?;
        *slot = Some((usize::try_from(field.byte_offset).ok()?, number_type(&field.datatype)?));
    }
    let [t, x, y, p] = found;
    Some([t?, x?, y?, p?])
}

fn record(bytes: &[u8], fields: &[(usize, NumberType); 4]) -> Option<Record> {
    let mut numbers = [Number::Whole(0); 4];
    for (number, (offset, kind)) in numbers.iter_mut().zip(fields) {
        *number = kind.read(bytes.get(*offset..)?)?;
    }
    Some(Record(numbers))
}

impl H5Type for Record {
    fn hdf5_type() -> Datatype {
        Datatype::Compound { size: 0, fields: Vec::new() }
    }

    fn from_bytes(bytes: &[u8], dtype: &Datatype) -> Result<Self, Error> {
        record_fields(dtype).and_then(|fields| record(bytes, &fields)).ok_or_else(no_number)
    }

    fn element_size(dtype: &Datatype) -> usize {
        match dtype {
            Datatype::Compound { size, .. } => *size as usize,
            _ => 0,
        }
    }

    fn decode_vec(raw: &[u8], dtype: &Datatype, _: usize) -> Option<Result<Vec<Self>, Error>> {
        let (fields, size) = (record_fields(dtype)?, Self::element_size(dtype).max(1));
        Some(raw.chunks_exact(size).map(|bytes| record(bytes, &fields).ok_or_else(no_number)).collect())
    }
}
