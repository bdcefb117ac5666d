//! CSV of OptiTrack Motive: a line of names and values, then rows that describe every column (`Type`, `Name`, `ID`, rotation or
//! position, axis), then one frame per line. If a body was not tracked, its fields are empty.

use nalgebra::Vector3;

use super::{CaptureError, number, push};
use evcal_geometry::timed_pose::TimedPose;

/// Type of the columns of a rigid body.
const RIGID_BODY: &str = "Rigid Body";

/// The columns of a body: time, position x y z, quaternion w x y z.
struct Columns {
    time: usize,
    position: [usize; 3],
    rotation: [usize; 4],
}

/// Parses the poses of `body`, or of the only one.
pub fn parse(text: &str, body: Option<&str>) -> Result<Vec<TimedPose>, CaptureError> {
    let mut lines = text.lines().enumerate();
    let about = lines.next().map_or("", |(_, line)| line);
    let unit = length_unit(about)?;
    let mut head: Vec<Vec<&str>> = Vec::new();
    for (_, line) in lines.by_ref() {
        let fields: Vec<&str> = line.split(',').map(|field| field.trim().trim_matches('"')).collect();
        let last = fields.first().is_some_and(|first| *first == "Frame");
        head.push(fields);
        if last {
            break;
        }
    }
    let columns = columns(&head, body)?;
    let mut poses = Vec::new();
    for (index, content) in lines {
        let line = index + 1;
        let fields: Vec<&str> = content.split(',').collect();
        let is_empty = |column: &usize| fields.get(*column).is_none_or(|field| field.trim().is_empty());
        if columns.position.iter().chain(&columns.rotation).any(is_empty) {
            continue;
        }
        let at = |column: usize| number(fields.get(column), line);
        let [x, y, z] = columns.position;
        let position = Vector3::new(at(x)?, at(y)?, at(z)?) * unit;
        let [w, i, j, k] = columns.rotation;
        push(&mut poses, line, at(columns.time)?, position, [at(w)?, at(i)?, at(j)?, at(k)?])?;
    }
    Ok(poses)
}

/// Returns the metres per unit of the file.
fn length_unit(about: &str) -> Result<f64, CaptureError> {
    let fields: Vec<&str> = about.split(',').map(str::trim).collect();
    let value_of =
        |name: &str| fields.iter().position(|field| *field == name).and_then(|at| fields.get(at + 1).copied());
    let other = |found: Option<&str>, wanted: &str| {
        found.filter(|found| !found.eq_ignore_ascii_case(wanted)).map(str::to_owned)
    };
    if let Some(found) = other(value_of("Rotation Type"), "Quaternion") {
        return Err(CaptureError::RotationType { found });
    }
    if let Some(found) = other(value_of("Coordinate Space"), "Global") {
        return Err(CaptureError::CoordinateSpace { found });
    }
    match value_of("Length Units") {
        None | Some("Meters") => Ok(1.0),
        Some("Centimeters") => Ok(1e-2),
        Some("Millimeters") => Ok(1e-3),
        Some(found) => Err(CaptureError::LengthUnits { found: found.to_owned() }),
    }
}

fn columns(head: &[Vec<&str>], body: Option<&str>) -> Result<Columns, CaptureError> {
    let titled = |title: &str| head.iter().find(|row| row.get(1) == Some(&title));
    // Old versions have no titles of the rows.
    let types = head.iter().find(|row| row.contains(&RIGID_BODY)).ok_or(CaptureError::NoBody)?;
    let below =
        |row: &Vec<&str>| head.iter().position(|other| std::ptr::eq(other, row)).and_then(|at| head.get(at + 1));
    let names = titled("Name").or_else(|| below(types)).ok_or(CaptureError::NoBody)?;
    let axes = head.last().ok_or(CaptureError::NoBody)?;
    let kinds = head.len().checked_sub(2).and_then(|at| head.get(at)).ok_or(CaptureError::NoBody)?;
    let is_body = |column: &usize| types.get(*column) == Some(&RIGID_BODY);
    let mut bodies: Vec<&str> = (0..types.len()).filter(is_body).filter_map(|at| names.get(at).copied()).collect();
    bodies.dedup();
    let listed = || bodies.iter().map(|name| format!("{name:?}")).collect::<Vec<_>>().join(", ");
    let name = match (body, bodies.as_slice()) {
        (Some(wanted), bodies) => *bodies
            .iter()
            .find(|name| **name == wanted)
            .ok_or_else(|| CaptureError::OtherBodies { wanted: wanted.to_owned(), names: listed() })?,
        (None, [only]) => only,
        (None, _) => return Err(CaptureError::SeveralBodies { names: listed() }),
    };
    let find = |kind: &str, axis: &str| {
        let is_it = |at: &usize| {
            is_body(at)
                && names.get(*at) == Some(&name)
                && kinds.get(*at) == Some(&kind)
                && axes.get(*at) == Some(&axis)
        };
        (0..axes.len()).find(is_it).ok_or(CaptureError::NoBody)
    };
    let time = axes.iter().position(|axis| axis.starts_with("Time")).ok_or(CaptureError::NoBody)?;
    Ok(Columns {
        time,
        position: [find("Position", "X")?, find("Position", "Y")?, find("Position", "Z")?],
        rotation: [find("Rotation", "W")?, find("Rotation", "X")?, find("Rotation", "Y")?, find("Rotation", "Z")?],
    })
}
