//! `evcal undistort`.

use std::path::{Path, PathBuf};

use evcal_calibrate::undistort::picture::{PictureError, is_picture, is_single, picture_outputs, undistort_pictures};
use evcal_calibrate::undistort::recording::{
    FRAMES_CAMERA, Maps, UndistortError, UndistortionReport, WrittenFrames, check_recording, contains_camera,
    is_frame_file, open_recording, undistort_frames, undistort_recording, undistort_sub_pixel, undistorted_camera_path,
    write_camera,
};
use evcal_calibrate::undistort::sub_pixel::SubPixelFormat;
use evcal_calibrate::undistort::target::{TargetProjection, target_camera};
use evcal_calibrate::undistort::{PixelMap, check_size};
use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use evcal_files::folder::OutputFolder;
use evcal_files::visible;
use evcal_geometry::lens::camera_file::{self, CameraDescription};
use event_recordings::convert::{ConversionProgress, output_of};
use event_recordings::encode::OutputFormat;

use super::convert::BrokenOff;
use super::output_arguments::OutputArguments;
use super::progress::{Waiting, short_name};
use super::source_arguments::SourceArguments;
use super::{Failure, UsageError, print, value};

/// Arguments of `evcal undistort`.
#[derive(clap::Args)]
pub struct Arguments {
    /// A recording, or pictures of the calibrated sensor (PNG or JPEG)
    #[arg(required = true, value_name = "IN")]
    inputs: Vec<PathBuf>,
    /// The calibration: its folder or calibration.json, or truth.json of a simulation
    #[arg(short, long, value_name = "FILE|DIR")]
    calibration: PathBuf,
    /// Recording or PNG to write; for several pictures, a folder
    #[arg(short, long, value_name = "OUT", required_unless_present = "frames", value_parser = value::output_file())]
    output: Option<PathBuf>,
    #[command(flatten)]
    results: OutputArguments,
    /// Projection of the camera without distortion: pinhole, or equidistant for wide-angle lenses
    #[arg(
        long,
        default_value = TargetProjection::Pinhole.name(),
        value_parser = value::named(TargetProjection::ALL, TargetProjection::name, TargetProjection::description)
    )]
    model: TargetProjection,
    /// Part of the image to keep, from 0 (no black corners) to 1 (the whole image), as in OpenCV's
    /// getOptimalNewCameraMatrix [default: keep the camera matrix]
    #[arg(long, value_name = "0..1", value_parser = value::number(0.0..=1.0, ""))]
    alpha: Option<f64>,
    /// Write fractions of pixels; OUT must be .csv, .txt, .h5 or .bin (EventCalib)
    #[arg(long)]
    subpixel: bool,
    /// Format of the recording to write, such as aedat4, npz, hdf5 or csv; an unknown name prints the list
    /// [default: by the extension of OUT]
    #[arg(long, value_name = "FORMAT", conflicts_with = "subpixel")]
    to: Option<OutputFormat>,
    /// Write the frames of the recording as PNG into this folder
    #[arg(long, value_name = "DIR")]
    frames: Option<PathBuf>,
    #[command(flatten)]
    source: SourceArguments,
    /// Print the statistics as JSON
    #[arg(long)]
    json: bool,
}

/// Runs `evcal undistort`.
pub fn run(arguments: &Arguments) -> super::Outcome {
    let (camera, sensor) = camera_file::read(&arguments.calibration)?;
    let new = target_camera(&camera, arguments.model, sensor, arguments.alpha)?;
    let pictures = arguments.inputs.iter().filter(|path| is_picture(path)).count();
    match (arguments.inputs.as_slice(), pictures) {
        ([recording], 0) => undistort_one(arguments, recording, &camera, &new, sensor),
        (inputs, count) if inputs.len() == count => undistort_several(arguments, &camera, &new, sensor),
        _ => Err(UsageError("give one recording, or pictures only".to_owned()).into()),
    }
}

fn undistort_one(
    arguments: &Arguments,
    path: &Path,
    camera: &Camera<f64>,
    new: &Camera<f64>,
    sensor: Sensor,
) -> super::Outcome {
    if let Some(output) = &arguments.output {
        check_outputs(arguments, [output.as_path()], &undistorted_camera_path(output), new, sensor)?;
    }
    let folder = arguments.frames.as_deref();
    let folder = folder.map(|folder| arguments.results.open_folder(folder, is_frame_file, &[])).transpose()?;
    let recording = open_recording(path, arguments.source.options(), sensor)?;
    check_recording(&recording, sensor)?;
    let maps = &Maps::new(camera, new, sensor);
    let mut waiting = Waiting::new(arguments.json);
    let stage = format!("undistorting {}", short_name(path));
    waiting.stage(&stage, None);
    let mut show_progress = |at: ConversionProgress| {
        waiting.part(&stage, &format!("{stage}: {} events", at.events), at.done);
    };
    let mut report = None;
    if let Some(output) = &arguments.output {
        let done = if arguments.subpixel {
            undistort_sub_pixel(&recording, output, SubPixelFormat::from_extension(output)?, maps, &mut show_progress)?
        } else {
            let target = arguments.to.map_or_else(|| output_of(output), Ok)?;
            undistort_recording(&recording, output, target, maps, &mut show_progress)?
        };
        write_camera(&undistorted_camera_path(output), new, sensor)?;
        report = Some((output, done));
    }
    let mut frames = None;
    if let Some(folder) = &folder {
        let written = folder.replace(is_frame_file, |folder| -> Result<_, UndistortError> {
            let written = undistort_frames(&recording, folder, maps)?;
            write_camera(&folder.join(FRAMES_CAMERA), new, sensor)?;
            Ok(written)
        })?;
        frames = Some((folder.path(), written));
    }
    waiting.finish();
    if arguments.json {
        print::json(&serde_json::json!({
            "camera": CameraDescription::new(new),
            "recording": report.as_ref().map(|(_, report)| report),
            "pictures": frames.as_ref().map(|(_, frames)| frames.count),
        }))?;
    } else {
        print::line(describe(new))?;
        if let Some((output, UndistortionReport { events_outside, conversion })) = &report {
            print::line(format!("{}: {conversion}", visible::path(output)))?;
            print::line(format!("{events_outside} events outside the new image were left out"))?;
            print::line(format!("the camera is in {}", visible::path(undistorted_camera_path(output))))?;
        }
        if let Some((folder, WrittenFrames { count, .. })) = &frames {
            print::line(format!("{}: {count} pictures, and the camera in camera.json", visible::path(folder)))?;
        }
    }
    if let Some((folder, WrittenFrames { lost, .. })) = frames
        && !lost.is_empty()
    {
        return Err(Failure::plain(format!(
            "{}\nthe frames before the error are in {}",
            lost.join("\n"),
            visible::path(folder)
        )));
    }
    match report {
        Some((output, UndistortionReport { conversion, .. })) => match conversion.error {
            Some(error) => Err(BrokenOff { error, output: output.clone() }.into()),
            None => Ok(()),
        },
        None => Ok(()),
    }
}

fn undistort_several(arguments: &Arguments, camera: &Camera<f64>, new: &Camera<f64>, sensor: Sensor) -> super::Outcome {
    let for_recordings = arguments.subpixel || arguments.to.is_some() || arguments.frames.is_some();
    let Some(output) = arguments.output.as_ref().filter(|_| !for_recordings) else {
        return Err(
            UsageError("--subpixel, --to and --frames are for recordings; for pictures use -o".to_owned()).into()
        );
    };
    let written = picture_outputs(&arguments.inputs, output)?;
    let single = is_single(&arguments.inputs, output);
    let camera_file = if single { undistorted_camera_path(output) } else { output.join(FRAMES_CAMERA) };
    let folder = if single { None } else { Some(OutputFolder::open(output)?) };
    check_outputs(arguments, written.iter().map(PathBuf::as_path), &camera_file, new, sensor)?;
    check_size(sensor, 1)?;
    let back = PixelMap::new(new, camera, sensor);
    let write = |pictures: &[PathBuf], camera_file: &Path| -> Result<(), PictureError> {
        undistort_pictures(&arguments.inputs, pictures, &back)?;
        Ok(write_camera(camera_file, new, sensor)?)
    };
    match &folder {
        Some(folder) => folder.replace(
            |_| false,
            |folder| write(&picture_outputs(&arguments.inputs, folder)?, &folder.join(FRAMES_CAMERA)),
        )?,
        None => write(&written, &camera_file)?,
    }
    if arguments.json {
        return print::json(&serde_json::json!({ "camera": CameraDescription::new(new), "written": written }));
    }
    print::line(describe(new))?;
    for path in written {
        print::line(format!("written to {}", visible::path(path)))?;
    }
    print::line(format!("the camera is in {}", visible::path(camera_file)))
}

/// Refuses existing outputs, except for a camera file with the same camera.
fn check_outputs<'a>(
    arguments: &Arguments,
    outputs: impl IntoIterator<Item = &'a Path>,
    camera_file: &'a Path,
    camera: &Camera<f64>,
    sensor: Sensor,
) -> super::Outcome {
    let other = (!contains_camera(camera_file, camera, sensor)).then_some(camera_file);
    let calibration = camera_file::camera_path(&arguments.calibration);
    let inputs: Vec<&Path> = arguments.inputs.iter().chain([&calibration]).map(PathBuf::as_path).collect();
    Ok(arguments.results.check(outputs.into_iter().chain(other), &inputs)?)
}

fn describe(camera: &Camera<f64>) -> String {
    let parameters = camera.parameters();
    match parameters.first_chunk::<4>() {
        Some([fx, fy, cx, cy]) => format!("without distortion: fx {fx:.3}, fy {fy:.3}, cx {cx:.3}, cy {cy:.3}"),
        None => String::new(),
    }
}
