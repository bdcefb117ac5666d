//! Writer of npz files: the arrays `t` (µs), `x`, `y`, `p`, and `width` and `height` of the sensor.
//!
//! These are the types of eventcv, which accepts no others. An array begins with its length, so each array is kept in a temporary file until the recording ends.

use std::fs::File;
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;
use flate2::Compression;
use flate2::write::DeflateEncoder;
use rawzip::{CompressionMethod, ZipArchiveWriter};

use super::header::MAGIC;
use crate::encode::{Encode, OutputFormat, WriteError};

/// Compressed npz.
pub const OUTPUT: OutputFormat = OutputFormat {
    title: Some("NumPy"),
    ..OutputFormat::of_events("npz", &["npz"], |file, it| Ok(Box::new(Encoder::new(file()?, it.sensor)?)))
};

/// The header of an array is padded to a multiple of this number of bytes.
const ALIGNMENT: usize = 64;

struct Encoder {
    file: File,
    sensor: Sensor,
    columns: [Column; 4],
    count: u64,
}

/// An array under construction.
struct Column {
    name: &'static str,
    descr: &'static str,
    file: BufWriter<File>,
}

impl Column {
    fn new(name: &'static str, descr: &'static str) -> io::Result<Self> {
        Ok(Self { name, descr, file: BufWriter::new(evcal_files::nameless()?) })
    }
}

impl Encoder {
    fn new(file: File, sensor: Sensor) -> io::Result<Self> {
        let columns =
            [("t", "<i8"), ("x", "<u2"), ("y", "<u2"), ("p", "|u1")].map(|(name, descr)| Column::new(name, descr));
        let [t, x, y, p] = columns;
        Ok(Self { file, sensor, columns: [t?, x?, y?, p?], count: 0 })
    }
}

/// Returns the bytes before the numbers of an array of this type and shape.
fn head(descr: &str, shape: &str) -> Vec<u8> {
    let mut text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
    let before = MAGIC.len() + 4;
    while !(before + text.len() + 1).is_multiple_of(ALIGNMENT) {
        text.push(' ');
    }
    text.push('\n');
    // The text is far shorter than 64 KiB.
    let length = (text.len() as u16).to_le_bytes();
    [MAGIC, &[1, 0], &length, text.as_bytes()].concat()
}

fn write_array(
    archive: &mut ZipArchiveWriter<BufWriter<&File>>,
    name: &str,
    head: &[u8],
    mut content: impl Read,
) -> Result<(), WriteError> {
    let zip = |error: rawzip::Error| WriteError::Io(io::Error::other(error));
    let name = format!("{name}.npy");
    let file = archive.new_file(&name).compression_method(CompressionMethod::DEFLATE);
    let (mut entry, config) = file.start().map_err(zip)?;
    let mut writer = config.wrap(DeflateEncoder::new(&mut entry, Compression::fast()));
    writer.write_all(head)?;
    io::copy(&mut content, &mut writer)?;
    let (encoder, descriptor) = writer.finish().map_err(zip)?;
    encoder.finish()?;
    entry.finish(descriptor).map_err(zip)?;
    Ok(())
}

impl Encode for Encoder {
    fn write(&mut self, events: &[Event]) -> Result<(), WriteError> {
        let [t, x, y, p] = &mut self.columns;
        for event in events {
            t.file.write_all(&event.t.to_le_bytes())?;
            x.file.write_all(&event.x.to_le_bytes())?;
            y.file.write_all(&event.y.to_le_bytes())?;
            p.file.write_all(&[event.polarity.index() as u8])?;
        }
        self.count += events.len() as u64;
        Ok(())
    }

    fn finish(&mut self) -> Result<(), WriteError> {
        let mut archive = ZipArchiveWriter::new(BufWriter::with_capacity(1 << 18, &self.file));
        for column in &mut self.columns {
            column.file.flush()?;
            let file = column.file.get_mut();
            file.seek(SeekFrom::Start(0))?;
            write_array(&mut archive, column.name, &head(column.descr, &format!("({},)", self.count)), file)?;
        }
        for (name, side) in [("width", self.sensor.width), ("height", self.sensor.height)] {
            write_array(&mut archive, name, &head("<u8", "()"), u64::from(side).to_le_bytes().as_slice())?;
        }
        let mut file = archive.finish().map_err(io::Error::other)?;
        Ok(file.flush()?)
    }
}
