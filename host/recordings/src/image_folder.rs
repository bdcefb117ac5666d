//! A folder of images with timestamps, as in EuRoC data sets: `data.csv`, and a folder `data` with the images next to
//! it. A folder of images without timestamps is enough where each image is a view of its own.
//!
//! `data.csv` has a header line `#timestamp [ns],filename`, then one line per image. An optional third column,
//! `exposure [ns]` (or us, ms, s), contains the exposure time of each image. Images are PNG or JPEG, all of one size,
//! and are read one at a time.

use std::ffi::OsStr;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use evcal_core::sensor::Sensor;
use serde::{Deserialize, Serialize};

use super::extras::Frame;
use super::image_file::{self, ImageFile, ImageFileError};
use super::pictures::{NoImage, TimedImage};

/// Name of the table of an image folder.
pub const TABLE: &str = "data.csv";
/// Name of the folder of its images.
pub const IMAGES: &str = "data";
/// Header line of the table.
pub const HEADER: &str = "#timestamp [ns],filename";

/// Moment of the exposure that an image's timestamp refers to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Stamps {
    /// The start of its exposure.
    Start,
    /// The middle of its exposure.
    #[default]
    Middle,
    /// The end of its exposure.
    End,
}

impl Stamps {
    /// All variants.
    pub const ALL: &[Self] = &[Self::Start, Self::Middle, Self::End];

    /// Name of the variant.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Start => "start",
            Self::Middle => "middle",
            Self::End => "end",
        }
    }

    /// Meaning of the variant, as a short sentence.
    pub const fn description(self) -> &'static str {
        match self {
            Self::Start => "A timestamp is the start of the exposure",
            Self::Middle => "A timestamp is the middle of the exposure",
            Self::End => "A timestamp is the end of the exposure",
        }
    }

    /// Returns start and end of an exposure of this length with this `stamp` (all in ns).
    const fn exposure(self, stamp: i64, length: i64) -> (i64, i64) {
        let before = match self {
            Self::Start => 0,
            Self::Middle => length / 2,
            Self::End => length,
        };
        let start = stamp.saturating_sub(before);
        (start, start.saturating_add(length))
    }
}

/// Error while reading a folder of images.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImageFolderError {
    /// The operating system reported an error.
    #[error("{}: cannot be read: {error}", path.display())]
    Io {
        /// Path of the file.
        path: PathBuf,
        /// Cause.
        error: io::Error,
    },
    /// The table is missing.
    #[error("{} holds no data.csv: name a folder with data.csv (timestamp [ns], filename) and a folder data with its images", .0.display())]
    NoTable(PathBuf),
    /// The folder contains the images of several cameras.
    #[error("{} holds the images of several cameras ({names}): name the folder of one", path.display())]
    SeveralCameras {
        /// Path of the folder.
        path: PathBuf,
        /// Names of the cameras' folders.
        names: String,
    },
    /// There is neither a table nor an image.
    #[error("{} holds no PNG or JPEG", .0.display())]
    Empty(PathBuf),
    /// A line of the table is invalid.
    #[error("{}: line {line}: {what}", path.display())]
    Line {
        /// Path of the table.
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        /// Fault of the line, with advice.
        what: LineError,
    },
    /// The table names no image.
    #[error("{} names no image: one line TIMESTAMP_NS,FILENAME per image is needed", .0.display())]
    NoImages(PathBuf),
    /// An image cannot be read.
    #[error("{}: {error}: copy it again, or take its line out of data.csv", path.display())]
    Image {
        /// Path of the image.
        path: PathBuf,
        /// Cause.
        error: ImageFileError,
    },
    /// The image has a side of 0 or above 65535 pixels.
    #[error("{} has {} x {} pixels: an image needs 1 to 65535 columns and rows", path.display(), size.0, size.1)]
    Sides {
        /// Path of the image.
        path: PathBuf,
        /// Width and height of the image in pixels.
        size: (u32, u32),
    },
    /// The size of the images changes.
    #[error(
        "{} has {} x {} pixels, the images before it {} x {}: give the images of one camera, in one size",
        path.display(), size.0, size.1, before.width, before.height
    )]
    Size {
        /// Path of the image.
        path: PathBuf,
        /// Width and height of the image in pixels.
        size: (u32, u32),
        /// Width and height of the first image.
        before: Sensor,
    },
}

/// Fault of a line of the table.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LineError {
    /// The line has too few columns.
    #[error("{0:?} is not a line TIMESTAMP_NS,FILENAME")]
    Columns(String),
    /// The time is not a whole number.
    #[error("{0:?} is not a whole number of nanoseconds")]
    Time(String),
    /// The exposure is not a valid number.
    #[error("{0:?} is not an exposure time, which is a number from 0 on")]
    Exposure(String),
    /// The time does not increase.
    #[error(
        "{time} ns is not after {before} ns, the timestamp before it: sort the lines by time, and remove duplicates"
    )]
    Back {
        /// Time of the line in ns.
        time: i64,
        /// Time of the previous line in ns.
        before: i64,
    },
    /// The image file does not exist.
    #[error("there is no file {}: copy it there, or take out the line", .0.display())]
    Missing(PathBuf),
}

/// A line of the table.
#[derive(Clone, Debug, PartialEq)]
struct Entry {
    /// Timestamp in ns.
    stamp: i64,
    /// Exposure time in ns, if the table contains it.
    exposure: Option<i64>,
    path: PathBuf,
}

/// A folder of images of one camera.
#[derive(Clone, Debug)]
pub struct ImageFolder {
    path: PathBuf,
    entries: Vec<Entry>,
    sensor: Sensor,
    stamps: Stamps,
}

impl ImageFolder {
    /// Opens the folder at `path`: reads its table and the size of its first image. The folder of a data set may be
    /// given if it contains a single camera, for example `mav0/cam0`. `stamps` is the moment of the exposure that the
    /// timestamps refer to.
    ///
    /// # Errors
    /// [`ImageFolderError`] names the invalid line or file.
    pub fn open(path: &Path, stamps: Stamps) -> Result<Self, ImageFolderError> {
        let folder = camera_folder(path)?;
        let table = folder.join(TABLE);
        let io = |error| ImageFolderError::Io { path: table.clone(), error };
        let text = evcal_files::text::table(&table).map_err(io)?;
        let entries = entries(&text, &folder.join(IMAGES)).map_err(|(line, what)| ImageFolderError::Line {
            path: table.clone(),
            line,
            what,
        })?;
        Self::of(path, entries, stamps, || ImageFolderError::NoImages(table.clone()))
    }

    /// Returns `true` if the folder at `path`, or folders of cameras in it, have a table.
    pub fn has_table(path: &Path) -> bool {
        !matches!(camera_folder(path), Err(ImageFolderError::NoTable(_)))
    }

    /// Opens the PNG and JPEG files of the folder at `path` in the order of their names, one second apart.
    ///
    /// # Errors
    /// [`ImageFolderError`] if there is none, or the first one cannot be read.
    pub fn by_name(path: &Path) -> Result<Self, ImageFolderError> {
        let io = |error| ImageFolderError::Io { path: path.to_owned(), error };
        let files = fs::read_dir(path).map_err(io)?.map(|entry| Ok(entry.map_err(io)?.path()));
        let mut files = files.collect::<Result<Vec<PathBuf>, ImageFolderError>>()?;
        files.retain(|file| file.is_file() && is_image(file));
        files.sort();
        let entry = |(second, path): (i64, PathBuf)| Entry { stamp: second * 1_000_000_000, exposure: None, path };
        Self::of(path, (0..).zip(files).map(entry).collect(), Stamps::default(), || {
            ImageFolderError::Empty(path.to_owned())
        })
    }

    /// Reads the size of the first image; `empty` is the error if there is none.
    fn of(
        path: &Path,
        entries: Vec<Entry>,
        stamps: Stamps,
        empty: impl FnOnce() -> ImageFolderError,
    ) -> Result<Self, ImageFolderError> {
        let first = entries.first().ok_or_else(empty)?;
        let size = read(&first.path)?.size;
        let sensor = sensor_of(size).ok_or_else(|| ImageFolderError::Sides { path: first.path.clone(), size })?;
        Ok(Self { path: path.to_owned(), entries, sensor, stamps })
    }

    /// Path of the folder, as given.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the images and their table.
    pub fn files(&self) -> Vec<PathBuf> {
        let table = camera_folder(&self.path).map(|folder| folder.join(TABLE)).ok();
        table.into_iter().chain(self.entries.iter().map(|entry| entry.path.clone())).collect()
    }

    /// Width and height of the images in pixels.
    pub fn sensor(&self) -> Sensor {
        self.sensor
    }

    /// `true` if the table contains exposure times.
    pub fn exposure_known(&self) -> bool {
        self.entries.iter().all(|entry| entry.exposure.is_some())
    }

    /// Passes the images to `visit`, in order of time, with times in µs.
    ///
    /// # Errors
    /// [`ImageFolderError`] names the image that cannot be read or has another size.
    pub fn visit(&self, mut visit: impl FnMut(TimedImage)) -> Result<(), ImageFolderError> {
        for entry in &self.entries {
            let image = read(&entry.path)?;
            if sensor_of(image.size) != Some(self.sensor) {
                let (path, size, before) = (entry.path.clone(), image.size, self.sensor);
                return Err(ImageFolderError::Size { path, size, before });
            }
            let (start, end) = self.stamps.exposure(entry.stamp, entry.exposure.unwrap_or(0));
            let micros = |time: i64| time.saturating_add(500).div_euclid(1000);
            visit(TimedImage {
                exposure: (micros(start), micros(end)),
                exposure_known: entry.exposure.is_some(),
                position: (0, 0),
                image: Frame::of_file(image, 0).map_or(Err(NoImage::NotGrey), |frame| TimedImage::from(frame).image),
            });
        }
        Ok(())
    }
}

/// Returns `true` if `path` has the extension of images that can be read.
pub fn is_image(path: &Path) -> bool {
    let has = |extension: &OsStr| ["png", "jpg", "jpeg"].iter().any(|known| extension.eq_ignore_ascii_case(known));
    path.extension().is_some_and(has)
}

/// Returns the folder with the table: `path` itself, or the only camera in it.
fn camera_folder(path: &Path) -> Result<PathBuf, ImageFolderError> {
    if path.join(TABLE).is_file() {
        return Ok(path.to_owned());
    }
    let of = |folder: PathBuf| fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let is_camera = |path: &PathBuf| {
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        name.starts_with("cam") && path.join(TABLE).is_file()
    };
    let mut cameras: Vec<PathBuf> = of(path.to_owned()).chain(of(path.join("mav0"))).filter(is_camera).collect();
    cameras.sort();
    match cameras.as_slice() {
        [] => Err(ImageFolderError::NoTable(path.to_owned())),
        [camera] => Ok(camera.clone()),
        cameras => {
            let name = |camera: &PathBuf| camera.strip_prefix(path).unwrap_or(camera).display().to_string();
            let names = cameras.iter().map(name).collect::<Vec<_>>().join(", ");
            Err(ImageFolderError::SeveralCameras { path: path.to_owned(), names })
        }
    }
}

/// Returns the unit in brackets at the end of `name`, in nanoseconds.
fn unit(name: &str) -> Option<f64> {
    [("[ns]", 1.0), ("[us]", 1e3), ("[µs]", 1e3), ("[ms]", 1e6), ("[s]", 1e9)]
        .into_iter()
        .find_map(|(unit, factor)| name.ends_with(unit).then_some(factor))
}

/// Parses the lines of a table with images in the folder `images`. An error contains the number of the line.
fn entries(text: &str, images: &Path) -> Result<Vec<Entry>, (usize, LineError)> {
    let mut entries: Vec<Entry> = Vec::new();
    // Index and unit of the exposure column.
    let mut exposure = None;
    for (number, line) in (1..).zip(text.trim_start_matches('\u{feff}').lines()) {
        let line = line.trim();
        if line.is_empty() {
            continue;
        }
        if let Some(names) = line.strip_prefix('#') {
            let mut names = names.split(',').map(str::trim).enumerate();
            exposure = exposure.or_else(|| {
                names.find_map(|(index, name)| Some((index, unit(name)?)).filter(|_| name.starts_with("exposure")))
            });
            continue;
        }
        let wrong = |what| (number, what);
        let columns: Vec<&str> = line.split(',').map(str::trim).collect();
        let [time, name, ..] = columns.as_slice() else { return Err(wrong(LineError::Columns(line.to_owned()))) };
        if name.is_empty() {
            return Err(wrong(LineError::Columns(line.to_owned())));
        }
        let stamp: i64 = time.parse().map_err(|_| wrong(LineError::Time((*time).to_owned())))?;
        if let Some(Entry { stamp: before, .. }) = entries.last().filter(|before| before.stamp >= stamp) {
            return Err(wrong(LineError::Back { time: stamp, before: *before }));
        }
        let exposure = exposure.map(|(index, unit)| {
            let text = columns.get(index).copied().unwrap_or_default();
            let length = text.parse::<f64>().ok().filter(|length| (0.0..1e18).contains(&(length * unit)));
            length
                .map(|length| (length * unit).round() as i64)
                .ok_or_else(|| wrong(LineError::Exposure(text.to_owned())))
        });
        let path = images.join(name);
        if !path.is_file() {
            return Err(wrong(LineError::Missing(path)));
        }
        entries.push(Entry { stamp, exposure: exposure.transpose()?, path });
    }
    Ok(entries)
}

fn read(path: &Path) -> Result<ImageFile, ImageFolderError> {
    image_file::read(path).map_err(|error| ImageFolderError::Image { path: path.to_owned(), error })
}

fn sensor_of(size: (u32, u32)) -> Option<Sensor> {
    let side = |side: u32| u16::try_from(side).ok().filter(|side| *side > 0);
    Some(Sensor::new(side(size.0)?, side(size.1)?))
}

#[cfg(test)]
mod tests;
