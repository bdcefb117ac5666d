//! Removes the distortion from the events of a recording, and counts the events that stay on the sensor.
//!
//!     cargo run --release --example undistort -- fixtures/board/events.dvraw fixtures/board/truth.json

use std::error::Error;
use std::path::Path;

use evcal::RecordingOptions;
use evcal_calibrate::undistort::recording::{Maps, open_recording};
use evcal_calibrate::undistort::target::{TargetProjection, target_camera};
use evcal_geometry::lens::camera_file;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [recording, calibration] = arguments.as_slice() else { return Err("give RECORDING CALIBRATION".into()) };
    let (camera, sensor) = camera_file::read(Path::new(calibration))?;
    // None keeps the camera matrix; Some(alpha) would choose one as OpenCV's getOptimalNewCameraMatrix does.
    let ideal = target_camera(&camera, TargetProjection::Pinhole, sensor, None)?;
    let maps = Maps::new(&camera, &ideal, sensor);
    let mut reader = open_recording(Path::new(recording), RecordingOptions::default(), sensor)?.open()?;
    let (mut events, mut all, mut kept) = (Vec::new(), 0_u64, 0_u64);
    while reader.next_batch(&mut events)? {
        all += events.len() as u64;
        // `get` returns fractions of pixels.
        kept += events.iter().filter(|event| maps.forth.nearest_pixel(event.x, event.y).is_some()).count() as u64;
    }
    println!("{kept} of {all} events stay on the sensor");
    Ok(())
}
