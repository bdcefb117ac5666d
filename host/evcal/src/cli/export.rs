//! `evcal export`.

use std::path::{Path, PathBuf};

use clap::builder::PossibleValuesParser;
use evcal_calibrate::export;
use evcal_calibrate::export::content::Exported;
use evcal_calibrate::export::undistortion_table::{ExportedTable, fit_table, ideal_of, table};
use evcal_calibrate::export::{FORMATS, read_rig_files};
use evcal_calibrate::result::calibrated_camera::{CalibratedCamera, ROS_TOPIC, plain};
use evcal_core::undistortion::IdealCamera;
use evcal_files::folder::OutputFolder;
use evcal_files::visible;
use evcal_geometry::lens::camera_file::camera_path;
use evcal_geometry::lens::nearest::Replacement;

use super::output_arguments::OutputArguments;
use super::{Failure, UsageError, print, value};

/// Name for all formats.
const ALL: &str = "all";

/// Writes a table as source code.
type Writer = fn(&ExportedTable) -> String;

/// Arguments of `evcal export`.
#[derive(clap::Args)]
#[command(group = clap::ArgGroup::new("outputs").required(true).multiple(true))]
#[command(group = clap::ArgGroup::new("tables").multiple(true))]
pub struct Arguments {
    /// The calibration: its folder or calibration.json, or truth.json of a simulation
    #[arg(value_name = "FILE|DIR")]
    calibration: PathBuf,
    /// Write the camera in the format of another program
    #[arg(long, value_name = "NAME", group = "outputs", value_parser = format_names())]
    format: Option<String>,
    /// File for --format, or the folder for --format all [default: standard output]
    #[arg(short, long, value_name = "FILE", requires = "format", value_parser = value::output_file())]
    output: Option<PathBuf>,
    #[command(flatten)]
    results: OutputArguments,
    /// Name of the camera in the file, such as DAVIS346_00000001 [default: the name in the calibration]
    #[arg(long, value_name = "NAME", requires = "format")]
    camera_name: Option<String>,
    /// Topic of the camera's images, for Kalibr
    #[arg(long, value_name = "TOPIC", requires = "format", default_value = ROS_TOPIC)]
    ros_topic: String,
    #[command(flatten)]
    table: TableArguments,
    /// Print the written files as JSON
    #[arg(long)]
    json: bool,
}

/// Options of undistortion look-up tables for devices.
#[derive(clap::Args)]
struct TableArguments {
    /// Write an undistortion look-up table for events as a Rust module that depends only on `core`
    #[arg(long, value_name = "FILE", groups = ["outputs", "tables"], value_parser = value::output_file())]
    rust_table: Option<PathBuf>,
    /// Write an undistortion look-up table for events as a C99 header
    #[arg(long, value_name = "FILE", groups = ["outputs", "tables"], value_parser = value::output_file())]
    c_header: Option<PathBuf>,
    /// Largest error of the look-up table in pixels; sets the node spacing (64, 32, … 1 px)
    #[arg(
        long,
        value_name = "PIXELS",
        default_value = "0.05",
        requires = "tables",
        value_parser = value::number(1e-6..=100.0, " pixels")
    )]
    max_error: f64,
    /// Number of nodes of the look-up table, instead of --max-error
    #[arg(long, value_name = "COLUMNSxROWS", value_parser = nodes, conflicts_with = "max_error", requires = "tables")]
    nodes: Option<[u16; 2]>,
    /// Ideal camera of the undistorted pixels: fx,fy,cx,cy in pixels; 1,1,0,0 for X/Z and Y/Z
    /// [default: as in the calibration]
    #[arg(long, value_name = "NUMBERS", allow_hyphen_values = true, value_parser = ideal_camera, requires = "tables")]
    ideal: Option<IdealCamera<f64>>,
}

/// Returns a parser for the names of the formats, and `all`.
fn format_names() -> PossibleValuesParser {
    PossibleValuesParser::new(FORMATS.iter().map(|format| format.name).chain([ALL]))
}

fn nodes(text: &str) -> Result<[u16; 2], String> {
    let number = |part: &str| part.parse().ok().filter(|count| (2..=4096).contains(count));
    text.split_once('x')
        .and_then(|(columns, rows)| Some([number(columns)?, number(rows)?]))
        .ok_or_else(|| "write COLUMNSxROWS, 2 to 4096 each, for example 44x33".to_owned())
}

/// Runs `evcal export`.
pub fn run(arguments: &Arguments) -> super::Outcome {
    let calibrated = CalibratedCamera::read(&arguments.calibration)?;
    let calibrated = CalibratedCamera {
        name: plain(arguments.camera_name.as_deref()).unwrap_or(calibrated.name),
        ros_topic: arguments.ros_topic.clone(),
        ..calibrated
    };
    let calibration = camera_path(&arguments.calibration);
    let others = match arguments.format.as_deref() {
        Some(ALL) => read_rig_files(&calibrated, &calibration)?,
        _ => Vec::new(),
    };
    arguments.results.check(outputs(arguments, &others).iter().map(PathBuf::as_path), &[&calibration])?;
    let mut report = serde_json::Map::new();
    let mut written = Vec::new();
    if let Some(name) = arguments.format.as_deref() {
        let refits = write_formats(arguments, name, &calibrated, &others, &mut written)?;
        report.insert("refits".to_owned(), serde_json::to_value(refits).map_err(Failure::plain)?);
    }
    if arguments.table.rust_table.is_some() || arguments.table.c_header.is_some() {
        write_tables(arguments, &calibrated, &mut report, &mut written)?;
    }
    if arguments.json {
        report.insert("written".to_owned(), serde_json::to_value(written).map_err(Failure::plain)?);
        return print::json(&report);
    }
    Ok(())
}

/// Returns the files that the export will write, including `others`. Files in a folder that does not exist yet are
/// omitted.
fn outputs(arguments: &Arguments, others: &[(String, String)]) -> Vec<PathBuf> {
    let tables = arguments.table.rust_table.iter().chain(&arguments.table.c_header).cloned();
    let formats = match (&arguments.output, arguments.format.as_deref().and_then(export::from_name)) {
        (Some(file), Some(_)) => vec![file.clone()],
        (Some(folder), None) if folder.is_dir() => {
            let names = FORMATS.iter().map(|format| format.file).chain(others.iter().map(|(name, _)| name.as_str()));
            names.map(|name| folder.join(name)).collect()
        }
        _ => Vec::new(),
    };
    formats.into_iter().chain(tables).collect()
}

/// Error of a replacement by another model, for the JSON report.
#[derive(serde::Serialize)]
struct RefitReport {
    format: &'static str,
    model: &'static str,
    rms_px: f64,
    max_px: f64,
    sensor_max_px: f64,
}

/// Writes the format with this name, or all formats.
fn write_formats(
    arguments: &Arguments,
    name: &str,
    calibrated: &CalibratedCamera,
    others: &[(String, String)],
    written: &mut Vec<PathBuf>,
) -> Result<Vec<RefitReport>, Failure> {
    let mut refits = Vec::new();
    let mut refit_report = |format: &'static str, refit: Option<Replacement>| {
        refits.extend(refit.map(|refit| RefitReport {
            format,
            model: refit.to.name(),
            rms_px: refit.covered.rms,
            max_px: refit.covered.largest,
            sensor_max_px: refit.sensor.largest,
        }));
    };
    let Some(format) = export::from_name(name) else {
        let folder = arguments.output.as_deref();
        let folder = folder.ok_or_else(|| UsageError("--format all takes a folder: add -o DIR".to_owned()))?;
        let folder = OutputFolder::open(folder)?;
        let mut files = Vec::new();
        for format in FORMATS {
            match format.export(calibrated) {
                Ok(Exported { text, note, refit, .. }) => {
                    files.push((format.file.to_owned(), text, note));
                    refit_report(format.name, refit);
                }
                Err(error) => print::aside(format!("not written: {error}")),
            }
        }
        files.extend(others.iter().map(|(name, text)| (name.clone(), text.clone(), None)));
        // All files of an earlier export are replaced, also those that this camera does not have.
        folder.replace(export::is_file, |new| {
            files.iter().try_for_each(|(name, text, _)| evcal_files::write(&new.join(name), text.as_bytes()))
        })?;
        for (name, _, note) in files {
            announce(arguments, &folder.path().join(name), note.as_deref(), written)?;
        }
        return Ok(refits);
    };
    let exported = format.export(calibrated)?;
    match arguments.output.as_deref() {
        Some(path) => {
            evcal_files::write(path, exported.text.as_bytes())?;
            announce(arguments, path, exported.note.as_deref(), written)?;
        }
        None if arguments.json => {
            return Err(UsageError("--json needs a file for the format: add -o FILE".to_owned()).into());
        }
        None => {
            print::text(&exported.text)?;
            if let Some(note) = exported.note {
                print::aside(format!("note: {note}"));
            }
        }
    }
    refit_report(format.name, exported.refit);
    Ok(refits)
}

/// Reports a file that was written.
fn announce(arguments: &Arguments, path: &Path, note: Option<&str>, written: &mut Vec<PathBuf>) -> super::Outcome {
    written.push(path.to_owned());
    if arguments.json {
        return Ok(());
    }
    let note = note.map(|note| format!(": {note}")).unwrap_or_default();
    print::line(format!("written to {}{note}", visible::path(path)))
}

/// Writes the requested look-up tables.
fn write_tables(
    arguments: &Arguments,
    calibrated: &CalibratedCamera,
    report: &mut serde_json::Map<String, serde_json::Value>,
    written: &mut Vec<PathBuf>,
) -> super::Outcome {
    let options = &arguments.table;
    let CalibratedCamera { camera, sensor, .. } = calibrated;
    let ideal = options.ideal.unwrap_or_else(|| ideal_of(camera));
    let exported = match options.nodes {
        Some(size) => table(camera, &ideal, *sensor, size)?,
        None => fit_table(camera, &ideal, *sensor, options.max_error)?,
    };
    let outputs = [
        (&options.rust_table, ExportedTable::rust_module as Writer),
        (&options.c_header, ExportedTable::c_header as Writer),
    ];
    let files: Vec<(&Path, String)> =
        outputs.iter().filter_map(|(path, text)| Some((path.as_deref()?, text(&exported)))).collect();
    let contents: Vec<(&Path, &[u8])> = files.iter().map(|(path, text)| (*path, text.as_bytes())).collect();
    evcal_files::write_all(&contents)?;
    for (path, _) in files {
        announce(arguments, path, None, written)?;
    }
    let ([columns, rows], [x, y]) = (exported.table.size(), exported.at);
    for (name, value) in [
        ("columns", columns.into()),
        ("rows", rows.into()),
        ("bytes", exported.bytes().into()),
        ("largest_error_px", exported.largest_error.into()),
        ("at", exported.at.as_slice().into()),
        ("pixels_without_value", exported.without_value.into()),
    ] {
        report.insert(name.to_owned(), value);
    }
    if arguments.json {
        return Ok(());
    }
    print::line(format!(
        "undistortion table of {columns} x {rows} nodes, {} bytes; largest error {:.4} px, at pixel ({x}, {y})",
        exported.bytes(),
        exported.largest_error
    ))?;
    if exported.without_value > 0 {
        print::line(format!("{} pixels at the edge of the lens model have no value", exported.without_value))?;
    }
    Ok(())
}

/// Reads fx,fy,cx,cy.
fn ideal_camera(text: &str) -> Result<IdealCamera<f64>, &'static str> {
    let wrong = "write fx,fy,cx,cy, finite, with positive focal lengths";
    let numbers: Vec<f64> =
        text.split(',').map(|number| number.trim().parse().map_err(|_| wrong)).collect::<Result<_, _>>()?;
    let &[fx, fy, cx, cy] = numbers.as_slice() else { return Err(wrong) };
    let good = numbers.iter().all(|value| value.is_finite()) && fx > 0.0 && fy > 0.0;
    good.then_some(IdealCamera { fx, fy, cx, cy }).ok_or(wrong)
}
