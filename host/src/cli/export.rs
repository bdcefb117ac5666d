//! `evcal export`.

use std::fs;
use std::path::{Path, PathBuf};

use evcal::camera_file;
use evcal::export::undistortion_table::{ExportedTable, fit_table, table};
use evcal_core::camera::Camera;
use evcal_core::undistortion::IdealCamera;

use super::{UsageError, print};

/// Turns a table into source code.
type Writer = fn(&ExportedTable) -> String;

/// Arguments of `evcal export`.
#[derive(clap::Args)]
#[command(group = clap::ArgGroup::new("outputs").required(true).multiple(true))]
pub struct Arguments {
    /// The calibration: calibration.json, or truth.json of a simulation
    calibration: PathBuf,
    /// Write the undistortion look-up for events as a Rust module that needs nothing but `core`
    #[arg(long, value_name = "FILE", group = "outputs")]
    rust_table: Option<PathBuf>,
    /// Write the undistortion look-up for events as a C99 header
    #[arg(long, value_name = "FILE", group = "outputs")]
    c_header: Option<PathBuf>,
    /// Largest error of the look-up in pixels; the coarsest table that keeps it is written
    #[arg(long, value_name = "PIXELS", default_value_t = 0.05)]
    max_error: f64,
    /// Number of nodes of the look-up, instead of an error to keep
    #[arg(long, value_name = "COLUMNSxROWS", value_parser = nodes, conflicts_with = "max_error")]
    nodes: Option<[u16; 2]>,
    /// Camera that undistorted pixels belong to: fx,fy,cx,cy in pixels; 1,1,0,0 gives X/Z and Y/Z
    /// [default: that of the calibration]
    #[arg(long, value_name = "NUMBERS", value_delimiter = ',', num_args = 1, allow_hyphen_values = true)]
    ideal: Option<Vec<f64>>,
    /// Print what was written as JSON
    #[arg(long)]
    json: bool,
}

fn nodes(text: &str) -> Result<[u16; 2], String> {
    let number = |part: &str| part.parse().ok().filter(|count| (2..=4096).contains(count));
    text.split_once('x')
        .and_then(|(columns, rows)| Some([number(columns)?, number(rows)?]))
        .ok_or_else(|| "write COLUMNSxROWS, 2 to 4096 each, for example 44x33".to_owned())
}

/// Runs `evcal export`.
pub fn run(arguments: &Arguments) -> super::Outcome {
    let (camera, sensor) = camera_file::read(&arguments.calibration)?;
    let sensor = (sensor.width, sensor.height);
    if !(arguments.max_error.is_finite() && arguments.max_error > 0.0) {
        return Err(UsageError("--max-error must be a number of pixels above 0".to_owned()).into());
    }
    let ideal = ideal_camera(arguments, &camera)?;
    let exported = match arguments.nodes {
        Some(size) => table(&camera, &ideal, sensor, size)?,
        None => fit_table(&camera, &ideal, sensor, arguments.max_error)?,
    };
    let outputs = [
        (&arguments.rust_table, ExportedTable::rust_module as Writer),
        (&arguments.c_header, ExportedTable::c_header as Writer),
    ];
    let mut written: Vec<&Path> = Vec::new();
    for (path, text) in outputs {
        if let Some(path) = path {
            fs::write(path, text(&exported)).map_err(|error| format!("{}: {error}", path.display()))?;
            written.push(path);
        }
    }
    let ([columns, rows], [x, y]) = (exported.table.size(), exported.at);
    if arguments.json {
        return print::json(&serde_json::json!({
            "written": written,
            "columns": columns,
            "rows": rows,
            "bytes": exported.bytes(),
            "largest_error_px": exported.largest_error,
            "at": exported.at,
            "pixels_without_value": exported.without_value,
        }));
    }
    for path in written {
        print::line(format!("written to {}", path.display()))?;
    }
    print::line(format!(
        "undistortion look-up of {columns} x {rows} nodes, {} bytes; largest error {:.4} px, at pixel ({x}, {y})",
        exported.bytes(),
        exported.largest_error
    ))?;
    if exported.without_value > 0 {
        print::line(format!("{} pixels at the edge of the lens model have no value", exported.without_value))?;
    }
    Ok(())
}

fn ideal_camera(arguments: &Arguments, camera: &Camera<f64>) -> Result<IdealCamera<f64>, UsageError> {
    let wrong = || UsageError("--ideal takes fx,fy,cx,cy, finite, with positive focal lengths".to_owned());
    let parameters = camera.parameters();
    let given = arguments.ideal.as_deref().unwrap_or(parameters.get(..4).unwrap_or_default());
    let &[fx, fy, cx, cy] = given else { return Err(wrong()) };
    let good = [fx, fy, cx, cy].iter().all(|value| value.is_finite()) && fx > 0.0 && fy > 0.0;
    good.then_some(IdealCamera { fx, fy, cx, cy }).ok_or_else(wrong)
}
