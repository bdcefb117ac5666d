//! Where in a file events are.

use evcal_core::sensor::Sensor;
use hdf5_reader::error::Error;
use hdf5_reader::{Dataset, Hdf5File};

use super::table::{self, Table};
use crate::columns;
use crate::numbers::Number;
use crate::options::Column;

/// Groups deeper than this are not looked into.
const DEEPEST: usize = 6;
/// More groups than this are not looked into.
const MOST_GROUPS: usize = 512;

/// Poses and projections, which lie beside events, have four columns, too.
const MOST_ROWS_OF_A_MATRIX: u64 = 4;

/// What a file holds.
pub struct Contents {
    /// Streams of events, in the order of the file; those of a group before those of the groups in it.
    pub streams: Vec<Found>,
    /// An array that would be a column of a stream if its elements could be read, and what they are.
    pub unread: Option<(String, &'static str)>,
}

/// A stream of events.
pub struct Found {
    /// Path of the dataset, or of the group of columns; the file's root has no name.
    pub name: String,
    /// Whether names say that it holds events. Of other arrays of four columns only their values can.
    pub is_named: bool,
    /// Its events.
    pub table: Table,
    /// Size of the sensor, where something beside them tells it.
    pub sensor: Option<Sensor>,
    /// What has to be added to all times, in their unit.
    pub offset: Option<Number>,
    /// Pictures beside them, and their times.
    pub frames: Option<TimedDataset>,
    /// Inertial samples beside them, and their times.
    pub samples: Option<TimedDataset>,
}

/// A group with its path, and that of the group above it.
struct Place {
    path: String,
    group: hdf5_reader::group::Group,
    above: Option<usize>,
}

/// What the file holds.
pub fn find(file: &Hdf5File) -> Result<Contents, Error> {
    let mut places = vec![Place { path: String::new(), group: file.root_group()?, above: None }];
    let mut contents = Contents { streams: Vec::new(), unread: None };
    let mut next = 0;
    while let Some(Place { path, group, above }) = places.get(next) {
        let (path, group, above) = (path.clone(), group.clone(), *above);
        let (groups, datasets) = group.members()?;
        let upper = above.and_then(|above| places.get(above)).map(|place| &place.group);
        let (tables, unread) = tables(&path, &datasets);
        contents.unread = contents.unread.or(unread);
        for (name, table) in tables {
            let is_named = !matches!(table, Table::Rows(..)) || name_of(&name).to_lowercase().starts_with("event");
            if !is_named && table.count() <= MOST_ROWS_OF_A_MATRIX {
                continue;
            }
            let sensor = sensor(&group, &datasets).or_else(|| upper.and_then(geometry));
            let sensor = sensor.or_else(|| places.first().and_then(|root| geometry(&root.group)));
            let beside = group.dataset(OFFSET).or_else(|error| upper.map_or(Err(error), |upper| upper.dataset(OFFSET)));
            let offset = beside.ok().as_ref().and_then(table::single);
            let [frames, samples] = [(FRAMES, 3), (SAMPLES, 2)].map(|(name, sides)| timed(&datasets, name, sides));
            contents.streams.push(Found { name, is_named, table, sensor, offset, frames, samples });
        }
        if path.matches('/').count() + 1 < DEEPEST {
            let below = groups.into_iter().take(MOST_GROUPS.saturating_sub(places.len()));
            let below: Vec<Place> =
                below.map(|group| Place { path: join(&path, group.name()), group, above: Some(next) }).collect();
            places.extend(below);
        }
        next += 1;
    }
    Ok(contents)
}

/// Time of the first event in DSEC's files, beside the group of events.
const OFFSET: &str = "t_offset";
/// Pictures and inertial samples beside the events, as in MVSEC's files. Their times have the same name with `_ts` behind it.
const FRAMES: &str = "image_raw";
const SAMPLES: &str = "imu";

/// A dataset and that of its times.
#[derive(Clone)]
pub struct TimedDataset {
    pub data: Dataset,
    pub times: Dataset,
}

/// The dataset of this name that has so many sides, and that of its times.
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

/// Tables by their names, and an array that would belong to one but cannot be read, with what it holds.
type Tables = (Vec<(String, Table)>, Option<(String, &'static str)>);

/// The tables of one group.
fn tables(path: &str, datasets: &[Dataset]) -> Tables {
    let columns = [Column::T, Column::X, Column::Y, Column::P].map(|column| {
        let named = datasets.iter().filter(|dataset| columns::of_name(last(dataset)).0 == column);
        // `t` rather than `t_offset`, and what can be read rather than what cannot.
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

/// The size of the sensor, as datasets or attributes of a group give it.
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
    by_datasets().or_else(by_calibration).or_else(by_pictures).or_else(|| geometry(group))
}

/// The size of the sensor, as attributes of a group give it: `geometry`, `width` and `height`, or one of both numbers.
fn geometry(group: &hdf5_reader::group::Group) -> Option<Sensor> {
    let sides = |text: String| {
        let (width, height) = text.split_once('x')?;
        Some(Sensor::new(width.trim().parse().ok()?, height.trim().parse().ok()?))
    };
    let numbers = |name: &str| table::of_attribute(&group.attribute(name).ok()?);
    let side = |name: &str| match numbers(name)?.as_slice() {
        [side] => side.pixel().filter(|side| *side > 0),
        _ => None,
    };
    // Some write the height first, others the width: no sensor is higher than wide.
    let both = |name: &str| match numbers(name)?.as_slice() {
        [a, b] => {
            let (a, b) = (a.pixel()?, b.pixel()?);
            (a > 0 && b > 0).then(|| Sensor::new(a.max(b), a.min(b)))
        }
        _ => None,
    };
    let geometry = || sides(group.attribute("geometry").ok()?.read_string().ok()?);
    let by_sides = || Some(Sensor::new(side("width")?, side("height")?));
    geometry()
        .or_else(by_sides)
        .or_else(|| ["sensor_resolution", "resolution", "sensor_size"].into_iter().find_map(both))
}
