//! Writer of HDF5 in the layout of DSEC: `events/{t, x, y, p}`, `t_offset` and `ms_to_idx`. The size of the sensor is
//! added as attributes `width` and `height`, which DSEC does not have.
//!
//! Each array is contiguous in the file, so it is kept in a temporary file until the recording ends.

use std::fs::File;
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;

use super::structure::{Number, SUPERBLOCK, dataset, group, superblock};
use crate::encode::{Encode, OutputFormat, WriteError};

/// HDF5 in the layout of DSEC.
pub const OUTPUT: OutputFormat = OutputFormat {
    title: Some("HDF5 in the layout of DSEC"),
    ..OutputFormat::of_events("hdf5", &["h5", "hdf5"], |file, description| {
        let pixel = Number::Integer { size: 2, is_signed: false };
        Ok(Box::new(Encoder::new(file()?, description.sensor, pixel)?))
    })
};

/// Length in milliseconds above which a recording gets no index (one day), and the length up to which it gets one however
/// few events it has. A damaged time would otherwise fill the disk.
const LONGEST_INDEX: u64 = 86_400_000;
const LENGTH_FOR_ANY: u64 = 600_000;
/// Largest number of milliseconds in the index per event beyond [`LENGTH_FOR_ANY`].
const MILLISECONDS_PER_EVENT: u64 = 16;

const TIME: usize = 0;
const INDEX: usize = 4;

struct Encoder {
    file: File,
    sensor: Sensor,
    /// t (after `zero`, µs), x, y, p, and the index of the first event of each millisecond.
    columns: [Column; 5],
    count: u64,
    /// Time that is zero in the file, known from the first event on. Some readers ignore it, so it is 0 if possible.
    zero: Option<i64>,
    /// Latest time after `zero` in µs.
    latest: u64,
    /// Number of milliseconds in the index; more than [`LONGEST_INDEX`] if the index was abandoned.
    milliseconds: u64,
}

/// An array under construction.
struct Column {
    name: &'static str,
    numbers: Number,
    file: BufWriter<File>,
}

impl Column {
    fn new(name: &'static str, numbers: Number) -> io::Result<Self> {
        Ok(Self { name, numbers, file: BufWriter::new(evcal_files::nameless()?) })
    }

    /// Returns the temporary file, at its beginning.
    fn read(&mut self) -> io::Result<&mut File> {
        self.file.flush()?;
        let file = self.file.get_mut();
        file.seek(SeekFrom::Start(0))?;
        Ok(file)
    }
}

impl Encoder {
    /// Begins `file`; x and y are written as numbers of type `pixel`.
    fn new(file: File, sensor: Sensor, pixel: Number) -> io::Result<Self> {
        let whole = |size| Number::Integer { size, is_signed: false };
        let [t, x, y, p, index] =
            [("t", whole(8)), ("x", pixel), ("y", pixel), ("p", whole(1)), ("ms_to_idx", whole(8))]
                .map(|(name, numbers)| Column::new(name, numbers));
        let columns = [t?, x?, y?, p?, index?];
        Ok(Self { file, sensor, columns, count: 0, zero: None, latest: 0, milliseconds: 0 })
    }

    /// Extends the index up to the millisecond of `t` (µs), the time of the next event. Each added millisecond refers
    /// to this event.
    fn index(&mut self, t: u64) -> io::Result<()> {
        let wanted = t / 1000 + 1;
        if wanted > LONGEST_INDEX || wanted > LENGTH_FOR_ANY + MILLISECONDS_PER_EVENT * self.count {
            self.milliseconds = u64::MAX;
        }
        // A millisecond refers to the first event that is not before its beginning.
        while self.milliseconds < wanted {
            self.columns[INDEX].file.write_all(&self.count.to_le_bytes())?;
            self.milliseconds += 1;
        }
        Ok(())
    }

    fn has_index(&self) -> bool {
        self.milliseconds <= LONGEST_INDEX
    }

    /// Converts the times to four bytes each, as in DSEC, if they fit.
    fn narrow_times(&mut self) -> io::Result<()> {
        if self.latest > u32::MAX.into() {
            return Ok(());
        }
        let mut narrow = Column::new("t", Number::Integer { size: 4, is_signed: false })?;
        let mut wide = io::BufReader::new(self.columns[TIME].read()?);
        let mut bytes = [0; 8];
        for _ in 0..self.count {
            wide.read_exact(&mut bytes)?;
            let [a, b, c, d, ..] = bytes;
            narrow.file.write_all(&[a, b, c, d])?;
        }
        self.columns[TIME] = narrow;
        Ok(())
    }
}

impl Encoder {
    /// Writes `event`; `column` and `row` are the bytes of its x and y.
    fn put(&mut self, event: &Event, [column, row]: [&[u8]; 2]) -> io::Result<()> {
        let is_soon = (0..LENGTH_FOR_ANY.cast_signed() * 1000).contains(&event.t);
        let zero = *self.zero.get_or_insert(if is_soon { 0 } else { event.t });
        let t = event.t.saturating_sub(zero).max(0).cast_unsigned();
        self.index(t)?;
        self.latest = self.latest.max(t);
        let [time, x, y, p, _] = &mut self.columns;
        time.file.write_all(&t.to_le_bytes())?;
        x.file.write_all(column)?;
        y.file.write_all(row)?;
        p.file.write_all(&[event.polarity.index() as u8])?;
        self.count += 1;
        Ok(())
    }
}

/// Encoder of events with fractions of pixels: x and y are floating-point numbers.
pub struct SubPixelEncoder(Encoder);

impl SubPixelEncoder {
    /// Begins `file`, for a `sensor`.
    ///
    /// # Errors
    /// The error of the operating system, if the file cannot be written.
    pub fn new(file: File, sensor: Sensor) -> io::Result<Self> {
        Encoder::new(file, sensor, Number::Double).map(Self)
    }

    /// Writes `event` with the position `place` (x, y in px).
    ///
    /// # Errors
    /// The error of the operating system, if the file cannot be written.
    pub fn write(&mut self, event: &Event, place: [f64; 2]) -> io::Result<()> {
        let [x, y] = place.map(f64::to_le_bytes);
        self.0.put(event, [&x, &y])
    }

    /// Writes the arrays that are complete only at the end of the recording.
    ///
    /// # Errors
    /// [`WriteError`].
    pub fn finish(&mut self) -> Result<(), WriteError> {
        self.0.finish()
    }
}

impl Encode for Encoder {
    fn write(&mut self, events: &[Event]) -> Result<(), WriteError> {
        for event in events {
            self.put(event, [&event.x.to_le_bytes(), &event.y.to_le_bytes()])?;
        }
        Ok(())
    }

    fn finish(&mut self) -> Result<(), WriteError> {
        self.narrow_times()?;
        let (count, has_index, milliseconds) = (self.count, self.has_index(), self.milliseconds);
        let mut output = BufWriter::with_capacity(1 << 18, &self.file);
        // Reserves the space of the superblock, which contains the length of the file.
        output.write_all(&[0; SUPERBLOCK as usize])?;
        let mut position = SUPERBLOCK;
        let mut put = |output: &mut BufWriter<&File>, bytes: &[u8]| -> io::Result<u64> {
            let address = position;
            output.write_all(bytes)?;
            position += bytes.len() as u64;
            Ok(address)
        };
        let offset = put(&mut output, &self.zero.unwrap_or(0).to_le_bytes())?;
        let offset = put(&mut output, &dataset(Number::Integer { size: 8, is_signed: true }, None, offset))?;
        let mut placed = Vec::new();
        for (number, column) in self.columns.iter_mut().enumerate() {
            let length = match number {
                INDEX if has_index => milliseconds,
                INDEX => continue,
                _ => count,
            };
            let address = put(&mut output, &[])?;
            let (name, numbers) = (column.name, column.numbers);
            let mut content = column.read()?.take(length * u64::from(numbers.size()));
            let mut block = vec![0; 1 << 16];
            loop {
                let read = content.read(&mut block)?;
                let Some(part) = block.get(..read).filter(|part| !part.is_empty()) else { break };
                put(&mut output, part)?;
            }
            placed.push((name, put(&mut output, &dataset(numbers, Some(length), address))?));
        }
        let (index, columns): (Vec<_>, Vec<_>) = placed.into_iter().partition(|(name, _)| *name == "ms_to_idx");
        let events = put(&mut output, &group(&columns, &[]))?;
        let objects = [vec![("events", events), ("t_offset", offset)], index].concat();
        let attributes = [("width", self.sensor.width), ("height", self.sensor.height)];
        let root = put(&mut output, &group(&objects, &attributes))?;
        let length = put(&mut output, &[])?;
        output.seek(SeekFrom::Start(0))?;
        output.write_all(&superblock(root, length))?;
        Ok(output.flush()?)
    }

    fn lost(&self) -> Vec<String> {
        if self.has_index() {
            Vec::new()
        } else {
            vec!["ms_to_idx: the recording is longer than a day, or has few events for its length".to_owned()]
        }
    }
}

#[cfg(test)]
mod tests {
    use evcal_core::event::Polarity;
    use hdf5_reader::Hdf5File;

    use super::*;
    use crate::write::EventWriter;
    use crate::{Recording, RecordingOptions, TimeUnit};

    /// Writes and reads back events at these times. Returns the times and the file.
    fn round_trip(times: &[i64]) -> (Vec<i64>, Hdf5File, tempfile::TempDir) {
        let event = |(index, &t): (usize, &i64)| {
            let polarity = if index % 3 == 0 { Polarity::On } else { Polarity::Off };
            Event { t, x: (index * 37 % 1280) as u16, y: (index * 91 % 720) as u16, polarity }
        };
        let events: Vec<Event> = times.iter().enumerate().map(event).collect();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("events.h5");
        let mut writer = EventWriter::create(&path, OUTPUT, Sensor::new(1280, 720), "").unwrap();
        events.chunks(7).for_each(|part| writer.write(part).unwrap());
        writer.finish().unwrap();
        // A few times do not determine their unit.
        let options = RecordingOptions { time_unit: Some(TimeUnit::Microseconds), ..RecordingOptions::default() };
        let recording = Recording::new(&path, options).unwrap();
        let mut reader = recording.open().unwrap();
        assert_eq!(reader.information().sensor, Some(Sensor::new(1280, 720)));
        let (mut all, mut batch) = (Vec::new(), Vec::new());
        while reader.next_batch(&mut batch).unwrap() {
            all.append(&mut batch);
        }
        assert_eq!(all, events);
        (all.iter().map(|event| event.t).collect(), Hdf5File::open(&path).unwrap(), folder)
    }

    #[test]
    fn events_at_any_time_and_of_any_duration_are_read_back() {
        for times in
            [vec![0], vec![-5, -5, 7, 900_000], (0..1000).map(|index| 1_789_000_000_000_000 + 37 * index).collect()]
        {
            assert_eq!(round_trip(&times).0, times);
        }
        // Longer than 32 bits of microseconds.
        let times: Vec<i64> = (0..600_000).map(|index| 3 + 15_000 * index).collect();
        let (read, file, _folder) = round_trip(&times);
        assert_eq!(read, times);
        assert_eq!(file.dataset("ms_to_idx").unwrap().shape(), [599_999 * 15 + 1]);
    }

    /// With an index, these files would have 69, 690 and 800 MB.
    #[test]
    fn a_few_events_far_apart_get_no_index() {
        for last in [3 + (1 << 33), 86_399_000_000, 100_000_000_000] {
            let (_, file, folder) = round_trip(&[3, last]);
            assert!(file.dataset("ms_to_idx").is_err());
            assert!(std::fs::metadata(folder.path().join("events.h5")).unwrap().len() < 5_000_000);
        }
    }

    #[test]
    fn fractions_of_pixels_are_read_by_another_program() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("events.h5");
        let mut encoder = SubPixelEncoder::new(File::create(&path).unwrap(), Sensor::new(346, 260)).unwrap();
        let places = [[0.25, -0.5], [345.499_999, 1e-9], [173.0, 130.125]];
        for (t, place) in (5..).zip(places) {
            encoder.write(&Event { t, x: 0, y: 0, polarity: Polarity::On }, place).unwrap();
        }
        encoder.finish().unwrap();
        let file = Hdf5File::open(&path).unwrap();
        for (axis, name) in ["events/x", "events/y"].into_iter().enumerate() {
            let read = file.dataset(name).unwrap().read_array::<f64>().unwrap();
            assert_eq!(read.iter().copied().collect::<Vec<_>>(), places.map(|place| place[axis]));
        }
        let times = file.dataset("events/t").unwrap().read_array::<u32>().unwrap();
        assert_eq!(times.iter().copied().collect::<Vec<_>>(), [5, 6, 7]);
    }

    /// Readers that ignore `t_offset` get the right times, unless the times count from 1970.
    #[test]
    fn times_have_no_offset_if_possible() {
        for (first, expected) in [(0, 0), (1_000_003, 0), (599_000_000, 0), (-7, -7), (1 << 50, 1 << 50)] {
            let (_, file, _folder) = round_trip(&[first, first + 40_000]);
            let offset = file.dataset("t_offset").unwrap().read_array::<i64>().unwrap();
            assert_eq!(offset.iter().copied().collect::<Vec<_>>(), [expected]);
        }
    }

    #[test]
    fn the_index_contains_the_first_event_of_each_millisecond() {
        let (times, file, _folder) = round_trip(&[10, 1009, 1010, 1010, 1500, 4009, 4010, 4500]);
        let read = file.dataset("ms_to_idx").unwrap().read_array::<u64>().unwrap();
        let index: Vec<usize> = read.iter().map(|place| *place as usize).collect();
        let expected: Vec<usize> = (0..=4).map(|ms| times.iter().position(|t| *t >= ms * 1000).unwrap()).collect();
        assert_eq!(index, expected);
    }
}
