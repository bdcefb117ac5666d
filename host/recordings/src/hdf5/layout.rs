//! Search for streams of events in a file.

use evcal_core::sensor::Sensor;
use hdf5_reader::error::Error;
use hdf5_reader::{Attribute, Dataset, Hdf5File};

use super::table::{self, Table};
use crate::columns;
use crate::numbers::Number;
use crate::options::Column;

/// Depth to which groups are searched.
const DEEPEST: usize = 6;
/// Largest number of groups that are searched.
const MOST_GROUPS: usize = 512;

/// Number of streams up to which those whose names do not mean events are examined.
const MOST_UNNAMED: usize = 256;

/// Number of rows up to which an array of four columns is taken for a matrix, such as a pose or projection stored with
/// the events.
const MOST_ROWS_OF_A_MATRIX: u64 = 4;

/// Content of a file.
pub struct Contents {
    /// Streams of events in file order; the streams of a group precede the streams of its subgroups.
    pub streams: Vec<Found>,
    /// Name of an array that would be a column of a stream if its elements were supported, with a description of the
    /// elements.
    pub unread: Option<(String, &'static str)>,
}

/// A stream of events.
pub struct Found {
    /// Path of the dataset, or of the group of columns; `events` for columns at the root.
    pub name: String,
    /// `true` if the names show that it contains events. For other arrays of four columns, only the values can.
    pub is_named: bool,
    /// The events.
    pub table: Table,
    /// Size of the sensor, if the file contains it near the events.
    pub sensor: Option<Sensor>,
    /// Offset of all times, in their unit.
    pub offset: Option<Number>,
    /// Frames in the same group, with their times.
    pub frames: Option<TimedDataset>,
    /// IMU samples in the same group, with their times.
    pub samples: Option<TimedDataset>,
}

/// A group with its path, and the index of its parent in the list of groups.
struct Node {
    path: String,
    group: hdf5_reader::group::Group,
    above: Option<usize>,
}

/// Searches the file for streams of events.
pub fn find(file: &Hdf5File) -> Result<Contents, Error> {
    let mut nodes = vec![Node { path: String::new(), group: file.root_group()?, above: None }];
    let mut contents = Contents { streams: Vec::new(), unread: None };
    let mut next = 0;
    while let Some(Node { path, group, above }) = nodes.get(next) {
        let (path, group, above) = (path.clone(), group.clone(), *above);
        let (groups, datasets) = group.members()?;
        let upper = above.and_then(|above| nodes.get(above)).map(|node| &node.group);
        let (tables, unread) = tables(&path, &datasets);
        contents.unread = contents.unread.or(unread);
        let is_named = |(name, table): &Stream| {
            !matches!(table, Table::Rows(..)) || name_of(name).to_lowercase().starts_with("event")
        };
        let mut tables = tables;
        let mut room = MOST_UNNAMED.saturating_sub(contents.streams.len());
        tables.retain(|stream| {
            let is_examined = stream.1.count() > MOST_ROWS_OF_A_MATRIX && room > 0;
            room -= usize::from(is_examined);
            is_named(stream) || is_examined
        });
        if !tables.is_empty() {
            // These take as long as the group is large, so they are determined once.
            let of_group_or_root = || upper.and_then(of_group).or_else(|| of_group(&nodes.first()?.group));
            let (own, outer) = (sensor(&group, &datasets), of_group_or_root());
            let start = group.dataset(OFFSET).or_else(|error| upper.map_or(Err(error), |upper| upper.dataset(OFFSET)));
            let offset = start.ok().as_ref().and_then(table::single);
            let [frames, samples] = [(FRAMES, 3), (SAMPLES, 2)].map(|(name, sides)| timed(&datasets, name, sides));
            for stream in tables {
                let is_named = is_named(&stream);
                let (name, table) = stream;
                let of_table = || table.datasets().into_iter().find_map(|data| geometry(&data.attributes()));
                let sensor = own.or_else(of_table).or(outer);
                let (frames, samples) = (frames.clone(), samples.clone());
                contents.streams.push(Found { name, is_named, table, sensor, offset, frames, samples });
            }
        }
        if path.matches('/').count() + 1 < DEEPEST {
            let below = groups.into_iter().take(MOST_GROUPS.saturating_sub(nodes.len()));
            let below: Vec<Node> =
                below.map(|group| Node { path: join(&path, group.name()), group, above: Some(next) }).collect();
            nodes.extend(below);
        }
        next += 1;
    }
    Ok(contents)
}

/// Dataset in DSEC's files with the time of the first event, next to the group of events.
const OFFSET: &str = "t_offset";
/// Datasets with frames and IMU samples in MVSEC's files. The datasets with their times have the suffix `_ts`.
const FRAMES: &str = "image_raw";
const SAMPLES: &str = "imu";

/// A dataset with the dataset of its times.
#[derive(Clone)]
pub struct TimedDataset {
    pub data: Dataset,
    pub times: Dataset,
}

/// Returns the dataset with this name and number of axes, and the dataset of its times.
fn timed(datasets: &[Dataset], name: &str, sides: usize) -> Option<TimedDataset> {
    let named = |name: &str| datasets.iter().find(|dataset| last(dataset) == name);
    let (data, times) = (named(name)?, named(&format!("{name}_ts"))?);
    let fits = data.shape().len() == sides && table::is_list(times) && table::unread(times).is_none();
    fits.then(|| TimedDataset { data: data.clone(), times: times.clone() })
}

fn join(path: &str, name: &str) -> String {
    let name = name_of(name);
    if path.is_empty() { name.to_owned() } else { format!("{path}/{name}") }
}

fn name_of(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

/// A table of events and its name.
type Stream = (String, Table);

/// Tables by name; and an array that would belong to one but is not supported, with a description of its elements.
type Tables = (Vec<Stream>, Option<(String, &'static str)>);

/// Returns the tables of one group.
fn tables(path: &str, datasets: &[Dataset]) -> Tables {
    let columns = [Column::T, Column::X, Column::Y, Column::P].map(|column| {
        let named = datasets.iter().filter(|dataset| columns::of_name(last(dataset)).0 == column);
        // Prefers supported elements to unsupported ones, and `t` to `t_offset`.
        let rank = |dataset: &&Dataset| (table::unread(dataset).is_some(), last(dataset).len());
        Some((column, named.filter(|dataset| table::is_list(dataset)).min_by_key(rank)?.clone()))
    });
    let mut unread = None;
    if let [Some(t), Some(x), Some(y), Some(p)] = columns {
        let columns = vec![t, x, y, p];
        let elements = |(_, dataset): &(Column, Dataset)| Some((join(path, last(dataset)), table::unread(dataset)?));
        unread = columns.iter().find_map(elements);
        if unread.is_none() {
            let name = if path.is_empty() { "events".to_owned() } else { path.to_owned() };
            return (vec![(name, Table::Columns(columns))], None);
        }
    }
    let table = |dataset: &Dataset| Some((join(path, last(dataset)), Table::of(dataset)?));
    (datasets.iter().filter_map(table).collect(), unread)
}

fn last(dataset: &Dataset) -> &str {
    name_of(dataset.name())
}

/// Returns the size of the sensor from datasets or attributes of a group.
fn sensor(group: &hdf5_reader::group::Group, datasets: &[Dataset]) -> Option<Sensor> {
    let side = |name: &str| table::single(datasets.iter().find(|dataset| last(dataset) == name)?)?.pixel();
    let by_datasets = || Some(Sensor::new(side("width")?, side("height")?));
    let by_pictures = || match datasets.iter().find(|dataset| last(dataset) == "image_raw")?.shape() {
        &[_, height, width] => Some(Sensor::new(width.try_into().ok()?, height.try_into().ok()?)),
        _ => None,
    };
    let by_calibration = || {
        let resolution = group.group("calib").ok()?.dataset("resolution").ok()?;
        match table::numbers(&resolution, 2)?.as_slice() {
            [width, height] => Some(Sensor::new(width.pixel()?, height.pixel()?)),
            _ => None,
        }
    };
    by_datasets().or_else(by_calibration).or_else(by_pictures).or_else(|| of_group(group))
}

fn of_group(group: &hdf5_reader::group::Group) -> Option<Sensor> {
    geometry(&group.attributes().ok()?)
}

/// Returns the size of the sensor from attributes: `geometry`, `width` and `height`, or one with both numbers.
fn geometry(attributes: &[Attribute]) -> Option<Sensor> {
    let attribute = |name: &str| attributes.iter().find(|attribute| attribute.name == name);
    let sides = |text: String| {
        let (width, height) = text.split_once('x')?;
        Some(Sensor::new(width.trim().parse().ok()?, height.trim().parse().ok()?))
    };
    let numbers = |name: &str| table::of_attribute(attribute(name)?);
    let side = |name: &str| match numbers(name)?.as_slice() {
        [side] => side.pixel().filter(|side| *side > 0),
        _ => None,
    };
    // Some programs write the height first. The larger number is the width, because no sensor is higher than wide.
    let both = |name: &str| match numbers(name)?.as_slice() {
        [a, b] => {
            let (a, b) = (a.pixel()?, b.pixel()?);
            (a > 0 && b > 0).then(|| Sensor::new(a.max(b), a.min(b)))
        }
        _ => None,
    };
    let geometry = || sides(attribute("geometry")?.read_string().ok()?);
    let by_sides = || Some(Sensor::new(side("width")?, side("height")?));
    geometry()
        .or_else(by_sides)
        .or_else(|| ["sensor_resolution", "resolution", "sensor_size", "sensor_shape"].into_iter().find_map(both))
}
