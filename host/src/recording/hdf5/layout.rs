//! Where in a file events are.

use evcal_core::sensor::Sensor;
use hdf5_reader::error::Error;
use hdf5_reader::{Dataset, Hdf5File};

use super::table::{self, Table};
use crate::recording::numbers::Number;
use crate::recording::{Column, columns};

/// Groups deeper than this are not looked into.
const DEEPEST: usize = 6;
/// More groups than this are not looked into.
const MOST_GROUPS: usize = 512;

/// A stream of events.
pub struct Found {
    /// Path of the dataset, or of the group of columns; the file's root has no name.
    pub name: String,
    /// Its events.
    pub table: Table,
    /// Size of the sensor, where something beside them tells it.
    pub sensor: Option<Sensor>,
    /// What has to be added to all times, in their unit.
    pub offset: Option<Number>,
}

/// A group with its path, and that of the group above it.
struct Place {
    path: String,
    group: hdf5_reader::group::Group,
    above: Option<usize>,
}

/// All streams of events, in the order of the file; those of a group before those of the groups in it.
pub fn find(file: &Hdf5File) -> Result<Vec<Found>, Error> {
    let mut places = vec![Place { path: String::new(), group: file.root_group()?, above: None }];
    let mut found = Vec::new();
    let mut next = 0;
    while let Some(Place { path, group, above }) = places.get(next) {
        let (path, group, above) = (path.clone(), group.clone(), *above);
        let (groups, datasets) = group.members()?;
        let upper = above.and_then(|above| places.get(above)).map(|place| &place.group);
        for (name, table) in tables(&path, &datasets) {
            let sensor = sensor(&group, &datasets).or_else(|| upper.and_then(geometry));
            let sensor = sensor.or_else(|| places.first().and_then(|root| geometry(&root.group)));
            let beside = group.dataset(OFFSET).or_else(|error| upper.map_or(Err(error), |upper| upper.dataset(OFFSET)));
            let offset = beside.ok().as_ref().and_then(table::single);
            found.push(Found { name, table, sensor, offset });
        }
        if path.matches('/').count() + 1 < DEEPEST {
            let below = groups.into_iter().take(MOST_GROUPS.saturating_sub(places.len()));
            let below: Vec<Place> =
                below.map(|group| Place { path: join(&path, group.name()), group, above: Some(next) }).collect();
            places.extend(below);
        }
        next += 1;
    }
    Ok(found)
}

/// Time of the first event in DSEC's files, beside the group of events.
const OFFSET: &str = "t_offset";

fn join(path: &str, name: &str) -> String {
    let name = name.rsplit('/').next().unwrap_or(name);
    if path.is_empty() { name.to_owned() } else { format!("{path}/{name}") }
}

/// The tables of one group.
fn tables(path: &str, datasets: &[Dataset]) -> Vec<(String, Table)> {
    let columns = [Column::T, Column::X, Column::Y, Column::P].map(|column| {
        let named = datasets.iter().filter(|dataset| columns::of_name(last(dataset)).0 == column);
        // `t` rather than `t_offset`.
        let shortest = named.filter(|dataset| table::is_column(dataset)).min_by_key(|dataset| last(dataset).len());
        Some((column, shortest?.clone()))
    });
    if let [Some(t), Some(x), Some(y), Some(p)] = columns {
        let name = if path.is_empty() { "events".to_owned() } else { path.to_owned() };
        return vec![(name, Table::Columns(vec![t, x, y, p]))];
    }
    datasets.iter().filter_map(|dataset| Some((join(path, last(dataset)), Table::of(dataset)?))).collect()
}

fn last(dataset: &Dataset) -> &str {
    dataset.name().rsplit('/').next().unwrap_or_default()
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

/// The size of the sensor, as attributes of a group give it: `geometry`, or `width` and `height`.
fn geometry(group: &hdf5_reader::group::Group) -> Option<Sensor> {
    let sides = |text: String| {
        let (width, height) = text.split_once('x')?;
        Some(Sensor::new(width.trim().parse().ok()?, height.trim().parse().ok()?))
    };
    let geometry = || sides(group.attribute("geometry").ok()?.read_string().ok()?);
    let side = |name: &str| {
        let value = group.attribute(name).ok()?.read_as_f64().ok()?;
        (value.fract() == 0.0 && (1.0..=65_535.0).contains(&value)).then_some(value as u16)
    };
    geometry().or_else(|| Some(Sensor::new(side("width")?, side("height")?)))
}
