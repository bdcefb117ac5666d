//! Events as structured arrays, whatever their fields are called.

use evcal_calibrate::undistort::PixelMap;
use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;
use event_recordings::columns::{self, Cell, PolarityCode, SAMPLE};
use event_recordings::{Columns, LayoutError, OptionError, TimeUnit};
use numpy::{
    PyArray1, PyArrayDescr, PyArrayDescrMethods, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyUntypedArrayMethods,
};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

/// Names of the fields in other libraries, in the order t, x, y, p.
const NAMES: [&[&str]; 4] = [&["t", "ts", "timestamp", "time"], &["x"], &["y"], &["p", "on", "polarity", "pol"]];

/// Bytes of an event of evcal's own arrays, and of [`Event`]; the last three are padding.
pub const EVENT_BYTES: usize = 16;

/// A kind of whole number, lowest byte first.
#[derive(Clone, Copy, PartialEq)]
struct Integer {
    bytes: usize,
    signed: bool,
}

/// Position and type of a field in a record.
#[derive(Clone, Copy)]
struct Field {
    offset: usize,
    integer: Integer,
}

impl Field {
    /// Returns the number in this field of a record.
    fn get(&self, record: &[u8]) -> i64 {
        let bytes = record.get(self.offset..self.offset + self.integer.bytes).unwrap_or_default();
        let mut value = [0; 8];
        let negative = self.integer.signed && bytes.last().is_some_and(|byte| *byte >= 0x80);
        if negative {
            value = [0xff; 8];
        }
        for (to, from) in value.iter_mut().zip(bytes) {
            *to = *from;
        }
        i64::from_le_bytes(value)
    }

    /// Returns the column or row in this field of a record. A number that is not a valid column or row becomes one
    /// outside every sensor.
    #[inline]
    fn pixel(&self, record: &[u8]) -> u16 {
        match self.integer.bytes {
            // A negative number becomes a number outside every sensor.
            2 => {
                record.get(self.offset..).and_then(<[u8]>::first_chunk).map_or(u16::MAX, |two| u16::from_le_bytes(*two))
            }
            _ => u16::try_from(self.get(record)).unwrap_or(u16::MAX),
        }
    }

    /// Writes a column or row, which must fit, into this field of a record.
    #[inline]
    fn set_pixel(&self, record: &mut [u8], value: u16) {
        let Some(field) = record.get_mut(self.offset..self.offset + self.integer.bytes) else { return };
        match field.first_chunk_mut::<2>() {
            Some(two) => {
                *two = value.to_le_bytes();
                field.iter_mut().skip(2).for_each(|byte| *byte = 0);
            }
            None => field.iter_mut().for_each(|byte| *byte = value as u8),
        }
    }

    /// Returns the largest number that fits.
    fn largest(&self) -> u64 {
        u64::MAX >> (64 - 8 * self.integer.bytes + usize::from(self.integer.signed))
    }
}

/// The four fields of an event.
#[derive(Clone, Copy)]
pub struct Fields {
    t: Field,
    x: Field,
    y: Field,
    p: Field,
}

/// A structured array of events: its records as bytes.
pub struct EventArray<'py> {
    bytes: PyReadonlyArray1<'py, u8>,
    dtype: Bound<'py, PyArrayDescr>,
    record: usize,
    fields: Fields,
}

fn field(dtype: &Bound<'_, PyArrayDescr>, names: &[&str]) -> PyResult<Field> {
    let known = dtype.names().unwrap_or_default();
    let name = names.iter().find(|name| known.iter().any(|known| known == *name)).ok_or_else(|| {
        PyTypeError::new_err(format!(
            "events are a structured array with the fields t (or ts, timestamp), x, y and p (or on, polarity); \
             this one has {}",
            if known.is_empty() { "none".to_owned() } else { known.join(", ") }
        ))
    })?;
    let (descriptor, offset) = dtype.get_field(name)?;
    let bytes = descriptor.itemsize();
    let signed = match descriptor.kind() {
        b'i' => true,
        b'u' | b'b' => false,
        _ => {
            return Err(PyTypeError::new_err(format!(
                "field {name} is of type {descriptor}: events have whole numbers, times in microseconds"
            )));
        }
    };
    if descriptor.byteorder() == b'>' {
        return Err(PyTypeError::new_err(format!("field {name} is big-endian: use astype to change that")));
    }
    if bytes > 8 || bytes == 0 {
        return Err(PyTypeError::new_err(format!("field {name} is of type {descriptor}, which is too wide")));
    }
    Ok(Field { offset, integer: Integer { bytes, signed } })
}

impl<'py> EventArray<'py> {
    /// Reads the events in `array`, which may have any of the accepted forms. A structured array of whole numbers is copied only if it
    /// has gaps between its records. `columns` and `time_unit` describe its columns, if given.
    pub fn new(array: &Bound<'py, PyAny>, columns: Option<&str>, time_unit: Option<&str>) -> PyResult<Self> {
        let py = array.py();
        let numpy = py.import("numpy")?;
        let array = py.import("evcal._arrays")?.call_method1("structured", (array, columns, time_unit))?;
        let array = numpy.call_method1("ascontiguousarray", (array,))?;
        let dtype = array.getattr("dtype")?.cast_into::<PyArrayDescr>()?;
        let [t, x, y, p] = NAMES;
        let fields = Fields { t: field(&dtype, t)?, x: field(&dtype, x)?, y: field(&dtype, y)?, p: field(&dtype, p)? };
        let record = dtype.itemsize();
        let bytes = array.call_method1("reshape", (-1,))?.call_method1("view", (numpy.getattr("uint8")?,))?;
        let bytes = bytes.cast_into::<PyArray1<u8>>()?.try_readonly()?;
        Ok(Self { bytes, dtype, record, fields })
    }

    /// Returns its type, for a similar array.
    pub fn dtype(&self) -> &Bound<'py, PyArrayDescr> {
        &self.dtype
    }

    /// Number of events.
    pub fn len(&self) -> usize {
        self.bytes.len() / self.record.max(1)
    }

    /// Returns the records, which can be read without Python.
    pub fn records(&self) -> PyResult<Records<'_>> {
        Ok(Records { bytes: self.bytes.as_slice()?, record: self.record.max(1), fields: self.fields })
    }
}

/// The records of an array.
#[derive(Clone, Copy)]
pub struct Records<'a> {
    bytes: &'a [u8],
    record: usize,
    fields: Fields,
}

impl Records<'_> {
    /// Returns all events, with times in microseconds.
    pub fn to_events(self) -> Result<Vec<Event>, String> {
        let Fields { t, x, y, p } = self.fields;
        let code = self.polarity_code();
        let event = |(index, record): (usize, &[u8])| {
            let pixel = |field: &Field, name: &str| {
                u16::try_from(field.get(record))
                    .map_err(|_| format!("event {index}: {name} = {} is on no sensor", field.get(record)))
            };
            let wrong = || format!("event {index}: p = {} is not a polarity ({code})", p.get(record));
            let polarity = code.polarity(p.get(record) as f64).ok_or_else(wrong)?;
            Ok(Event { t: t.get(record), x: pixel(&x, "x")?, y: pixel(&y, "y")?, polarity })
        };
        self.bytes.chunks_exact(self.record).enumerate().map(event).collect()
    }

    /// Returns the numbers for ON and OFF.
    fn polarity_code(self) -> PolarityCode {
        let p = self.fields.p;
        let first = self.bytes.chunks_exact(self.record).take(SAMPLE).map(|record| p.get(record) as f64);
        polarity_code(first, (!p.integer.signed).then(|| p.largest() as f64))
    }

    /// Appends the events that remain on the sensor after a map to `bytes`, as bytes of an array of [`sub_pixel_dtype`].
    pub fn between_pixels(self, bytes: &mut Vec<u8>, map: &PixelMap) {
        let Fields { t, x, y, p } = self.fields;
        let code = self.polarity_code();
        for record in self.bytes.chunks_exact(self.record) {
            let Some([column, row]) = map.get_on_sensor(x.pixel(record), y.pixel(record)) else { continue };
            bytes.extend_from_slice(&t.get(record).to_le_bytes());
            bytes.extend_from_slice(&column.to_le_bytes());
            bytes.extend_from_slice(&row.to_le_bytes());
            bytes.push(u8::from(code.polarity(p.get(record) as f64) == Some(Polarity::On)));
        }
    }

    /// Copies the records whose pixels have a new position in `places` to `output`, with that position. Returns their number.
    pub fn moved(self, output: &mut [u8], places: &NewPlaces) -> usize {
        match self.record {
            // The lengths of records in known libraries: copies of constant length are several times as fast.
            16 => self.moved_of::<16>(output, places),
            13 => self.moved_of::<13>(output, places),
            24 => self.moved_of::<24>(output, places),
            length => {
                let records = self.bytes.chunks_exact(length);
                self.move_each(records, output.chunks_exact_mut(length), places, |to, from| to.copy_from_slice(from))
            }
        }
    }

    fn moved_of<const N: usize>(self, output: &mut [u8], places: &NewPlaces) -> usize {
        let (records, _) = self.bytes.as_chunks::<N>();
        let (rooms, _) = output.as_chunks_mut::<N>();
        self.move_each(records.iter(), rooms.iter_mut(), places, |to, from| *to = *from)
    }

    #[inline]
    fn move_each<'r, 'o, R, O>(
        self,
        records: impl Iterator<Item = &'r R>,
        mut rooms: impl Iterator<Item = &'o mut O>,
        places: &NewPlaces,
        copy: impl Fn(&mut O, &R),
    ) -> usize
    where
        R: AsRef<[u8]> + ?Sized + 'r,
        O: AsMut<[u8]> + ?Sized + 'o,
    {
        let Fields { x, y, .. } = self.fields;
        let mut count = 0;
        for record in records {
            let Some([column, row]) = places.get(x.pixel(record.as_ref()), y.pixel(record.as_ref())) else { continue };
            let Some(room) = rooms.next() else { break };
            copy(room, record);
            x.set_pixel(room.as_mut(), column);
            y.set_pixel(room.as_mut(), row);
            count += 1;
        }
        count
    }

    /// `true` if every pixel of a sensor fits into the fields.
    pub fn hold(&self, width: u16, height: u16) -> bool {
        self.fields.x.largest() >= u64::from(width) && self.fields.y.largest() >= u64::from(height)
    }
}

/// New position of each pixel, rounded to a pixel.
pub struct NewPlaces {
    width: u16,
    /// Row by row; [`NOWHERE`] where a pixel leaves the sensor.
    places: Vec<[u16; 2]>,
}

const NOWHERE: [u16; 2] = [u16::MAX; 2];

impl NewPlaces {
    /// Rounds the positions of a map.
    pub fn new(map: &PixelMap) -> Self {
        let Sensor { width, height } = map.sensor();
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        Self { width, places: pixels.map(|(x, y)| map.nearest_pixel(x, y).unwrap_or(NOWHERE)).collect() }
    }

    #[inline]
    fn get(&self, x: u16, y: u16) -> Option<[u16; 2]> {
        let place = *self.places.get(usize::from(y) * usize::from(self.width) + usize::from(x))?;
        (x < self.width && place != NOWHERE).then_some(place)
    }
}

/// Returns an array of records of `dtype`. `fill` writes the bytes of at most `count` records and returns the number of records
/// written, which becomes the length of the array.
pub fn filled<'py>(
    dtype: &Bound<'py, PyArrayDescr>,
    count: usize,
    fill: impl FnOnce(&mut [u8]) -> usize + Send,
) -> PyResult<Bound<'py, PyAny>> {
    let py = dtype.py();
    let numpy = py.import("numpy")?;
    let array = numpy.call_method1("empty", (count, dtype))?;
    let bytes = array.call_method1("view", (numpy.getattr("uint8")?,))?.cast_into::<PyArray1<u8>>()?;
    let used = {
        let mut bytes = bytes.try_readwrite()?;
        let slice = bytes.as_slice_mut()?;
        py.detach(|| fill(slice))
    };
    array.get_item(pyo3::types::PySlice::new(py, 0, used as isize, 1))
}

/// Returns the type of evcal's own arrays: t (µs), x, y, p (0 or 1), 16 bytes.
pub fn own_dtype(py: Python<'_>) -> PyResult<Bound<'_, PyArrayDescr>> {
    let fields = pyo3::types::PyDict::new(py);
    fields.set_item("names", ["t", "x", "y", "p"])?;
    fields.set_item("formats", ["<i8", "<u2", "<u2", "u1"])?;
    fields.set_item("offsets", [0, 8, 10, 12])?;
    fields.set_item("itemsize", EVENT_BYTES)?;
    PyArrayDescr::new(py, fields)
}

/// Returns the type of events with fractions of pixels: t (µs), x, y (px), p (0 or 1), 25 bytes.
pub fn sub_pixel_dtype(py: Python<'_>) -> PyResult<Bound<'_, PyArrayDescr>> {
    PyArrayDescr::new(py, vec![("t", "<i8"), ("x", "<f8"), ("y", "<f8"), ("p", "u1")])
}

/// Appends events to `bytes`, as bytes of an array of evcal's own type.
pub fn append(bytes: &mut Vec<u8>, events: &[Event]) {
    bytes.reserve(events.len() * EVENT_BYTES);
    for event in events {
        bytes.extend_from_slice(&event.t.to_le_bytes());
        bytes.extend_from_slice(&event.x.to_le_bytes());
        bytes.extend_from_slice(&event.y.to_le_bytes());
        bytes.extend_from_slice(&[event.polarity.index() as u8, 0, 0, 0]);
    }
}

/// Returns an array of evcal's own type with these bytes, which are not copied.
pub fn to_array(py: Python<'_>, bytes: Vec<u8>) -> PyResult<Bound<'_, PyAny>> {
    viewed(&own_dtype(py)?, bytes)
}

/// Returns an array of `dtype` with these bytes, which are not copied.
pub fn viewed<'py>(dtype: &Bound<'py, PyArrayDescr>, bytes: Vec<u8>) -> PyResult<Bound<'py, PyAny>> {
    PyArray1::from_vec(dtype.py(), bytes).call_method1("view", (dtype,))
}

/// Determines the order of the columns of a table of events, such as "t,x,y,p", from their names, the arguments or the first rows, and the unit of
/// the times if a name contains it.
#[pyfunction]
#[pyo3(name = "_columns")]
pub fn columns_of(
    names: Option<Vec<String>>,
    rows: Option<PyReadonlyArray2<'_, f64>>,
    given: Option<&str>,
) -> PyResult<(String, Option<&'static str>)> {
    let unclear = |error: LayoutError| {
        PyValueError::new_err(format!("events: {error}; give columns=\"t,x,y,p\", in the order that is theirs"))
    };
    if let Some(names) = names {
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let (columns, unit) = columns::from_names(&names);
        let missing = || PyTypeError::new_err(LayoutError::Names(names.join(", ")).to_string());
        return Ok((columns.ok_or_else(missing)?.to_string(), unit.map(TimeUnit::symbol)));
    }
    if let Some(given) = given {
        let columns: Columns = given.parse().map_err(|error: OptionError| PyValueError::new_err(error.to_string()))?;
        return Ok((columns.to_string(), None));
    }
    let cell = |value: &f64| Cell { value: Some(*value), is_polarity: [-1.0, 0.0, 1.0].contains(value) };
    let Some(rows) = rows.filter(|rows| !rows.is_empty()) else { return Ok(("t,x,y,p".to_owned(), None)) };
    let rows: Vec<Vec<Cell>> = rows.as_array().outer_iter().map(|row| row.iter().map(cell).collect()).collect();
    let columns = columns::from_values(&rows, &mut Vec::new()).map_err(unclear)?;
    Ok((columns.to_string(), None))
}

/// Determines the numbers for ON and OFF from the first numbers of a column. `all_ones` is the largest number of its
/// type if the type is unsigned.
fn polarity_code(first: impl Iterator<Item = f64>, all_ones: Option<f64>) -> PolarityCode {
    let is_polarity = |value: f64| PolarityCode::USUAL.polarity(value).is_some() || all_ones == Some(value);
    let cell = |value: f64| Cell { value: Some(value), is_polarity: is_polarity(value) };
    PolarityCode::from_values(first.map(cell), &mut Vec::new())
}

/// Determines the numbers for ON and OFF from the first numbers of a column. all_ones: the largest number of its type
/// if the type is unsigned.
#[pyfunction]
#[pyo3(name = "_polarities")]
pub fn polarities_of(first: PyReadonlyArray1<'_, f64>, all_ones: Option<f64>) -> (f64, [f64; 2]) {
    let PolarityCode { on, off } = polarity_code(first.as_array().iter().copied(), all_ones);
    (on, off)
}

/// Returns a sensor of this width and height.
pub fn sensor(size: (u16, u16)) -> PyResult<Sensor> {
    let (width, height) = size;
    if width == 0 || height == 0 {
        return Err(PyValueError::new_err("sensor is (width, height) in pixels, both above 0"));
    }
    Ok(Sensor::new(width, height))
}
