//! A second camera, for events or frames, that is rigidly fixed to the simulated one, with its own lens, noise and
//! clock.

use std::path::{Path, PathBuf};

use evcal_core::camera::Camera;
use evcal_core::event::Event;
use evcal_core::sensor::Sensor;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::frame_camera::{self, FrameCameraSettings};
use super::rays::Rays;
use super::recording::{self, RecordingFormat};
use super::{EventCounts, Simulation, SimulationError};
use evcal_files::FileError;
use evcal_geometry::lens::camera_file::CameraDescription;
use event_recordings::encode::WriteError;

/// The default lens of a second camera: ratio of its focal lengths to the first camera's, and offset of its principal
/// point from the first camera's as a fraction of the sensor's width.
const FOCAL_RATIO: f64 = 1.02;
const ASIDE: [f64; 2] = [0.012, -0.008];

/// Settings of a second camera: pose, lens and clock.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SecondCameraSettings {
    /// Position of the first camera in the frame of the second, in metres: the translation of `T_second_first`.
    pub position: [f64; 3],
    /// Rotation of the first camera, as a rotation vector in degrees: the rotation of `T_second_first`.
    pub rotation: [f64; 3],
    /// The lens; by default one with a slightly longer focal length than the first.
    pub camera: Option<CameraDescription>,
    /// Difference of its seed to the seed of the first camera.
    pub seed_above: u64,
    /// Delay of the start of its recording, in seconds.
    pub begins_later: f64,
    /// t_second − t_first at the start of the first recording, in seconds.
    pub clock_offset: f64,
    /// Amount by which its clock is faster, in parts per million.
    pub clock_drift: f64,
    /// Sensor and shutter, for a camera that takes frames instead of events.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames: Option<FrameCameraSettings>,
}

impl Default for SecondCameraSettings {
    /// A camera a hand's breadth to the right, rotated slightly inwards.
    fn default() -> Self {
        Self {
            position: [-0.1, 0.004, 0.007],
            rotation: [1.5, 6.0, -2.0],
            camera: None,
            seed_above: 1_000_003,
            begins_later: 0.4,
            clock_offset: 3.214_17,
            clock_drift: 35.0,
            frames: None,
        }
    }
}

/// A second camera, ready for simulation.
#[derive(Clone, Debug)]
pub struct SecondCamera {
    settings: SecondCameraSettings,
    camera: Camera<f64>,
    sensor: Sensor,
    seed: u64,
}

impl SecondCamera {
    /// Creates a second camera with these `settings`, for a `first` camera with a sensor of this size and this `seed`.
    ///
    /// # Errors
    /// [`SimulationError::Setting`] names a setting that is out of range, [`SimulationError::SecondLens`] reports an
    /// invalid lens.
    pub fn new(
        settings: SecondCameraSettings,
        first: &Camera<f64>,
        sensor: Sensor,
        seed: u64,
    ) -> Result<Self, SimulationError> {
        let SecondCameraSettings { position, rotation, begins_later, clock_offset, clock_drift, .. } = settings;
        let numbers = [position, rotation].concat();
        let wild = numbers.iter().copied().find(|value| !value.is_finite());
        let checks = [
            ("second_camera.begins_later", begins_later, (0.0..=1e4).contains(&begins_later), "0 to 10000 s"),
            ("second_camera.clock_offset", clock_offset, (0.0..=1e9).contains(&clock_offset), "0 to 1e9 s"),
            ("second_camera.clock_drift", clock_drift, clock_drift.abs() <= 1e4, "-10000 to 10000 ppm"),
            ("second_camera", wild.unwrap_or(0.0), wild.is_none(), "numbers"),
        ];
        if let Some((name, value, _, range)) = checks.into_iter().find(|(.., right, _)| !right) {
            return Err(SimulationError::Setting { name, value, range });
        }
        settings.frames.map_or(Ok(()), |frames| frames.check())?;
        let of_first = sensor;
        let sensor = settings.frames.map_or(sensor, |frames| frames.sensor);
        let camera = match &settings.camera {
            Some(description) => description.camera().ok(),
            None => similar_lens(first, of_first, sensor),
        };
        let camera = camera.ok_or(SimulationError::SecondLens)?;
        let seed = seed.wrapping_add(settings.seed_above);
        Ok(Self { settings, camera, sensor, seed })
    }

    /// Returns `T_second_first`.
    pub fn second_first(&self) -> Isometry3<f64> {
        let SecondCameraSettings { position, rotation, .. } = self.settings;
        let rotation = UnitQuaternion::new(Vector3::from(rotation).map(f64::to_radians));
        Isometry3::from_parts(Translation3::from(Vector3::from(position)), rotation)
    }

    /// Returns the frame settings, if it takes frames instead of events.
    pub fn frames(&self) -> Option<&FrameCameraSettings> {
        self.settings.frames.as_ref()
    }

    /// Simulates the events that it sends while `first` runs, into the file at `path`; formats without support for a
    /// second clock, such as dumps of a DAVIS346, are replaced by AEDAT4. `progress` is called with the number of
    /// finished slices.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(
        &self,
        first: &Simulation,
        path: &Path,
        format: RecordingFormat,
        progress: impl FnMut(usize),
    ) -> Result<EventCounts, WriteError> {
        let begin = self.begin();
        let stamped = |events: &[Event]| {
            let seen = events.iter().filter(|event| event.t >= begin);
            seen.map(|event| Event { t: self.stamp(event.t), ..*event }).collect()
        };
        recording::write_events(&self.simulation(first), path, format.of_second_camera(), stamped, progress)
    }

    /// Simulates the frames that it takes according to `settings` while `first` runs, as a folder of images at `path`.
    /// Returns the names of the files in it. `progress` is called with the number of finished slices.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write_frames(
        &self,
        first: &Simulation,
        settings: &FrameCameraSettings,
        path: &Path,
        progress: impl FnMut(usize),
    ) -> Result<Vec<PathBuf>, FileError> {
        let stamp = |t: f64| (1e3 * self.own_time(t)).round() as i64;
        frame_camera::write(&self.simulation(first), settings, self.begin(), &stamp, path, progress)
    }

    fn simulation(&self, first: &Simulation) -> Simulation {
        first.second(Rays::new(&self.camera, self.sensor), self.second_first().inverse(), self.seed)
    }

    /// Returns the start of its recording (µs of the first clock).
    fn begin(&self) -> i64 {
        (1e6 * self.settings.begins_later) as i64
    }

    /// Converts microseconds `t` of the first clock to microseconds of its own clock.
    fn stamp(&self, t: i64) -> i64 {
        self.own_time(t as f64).round() as i64
    }

    /// Converts like [`SecondCamera::stamp`], without rounding.
    fn own_time(&self, t: f64) -> f64 {
        let SecondCameraSettings { clock_offset, clock_drift, .. } = self.settings;
        1e6 * clock_offset + t * (1.0 + 1e-6 * clock_drift)
    }
}

/// Returns the name of the recording of a second camera in the folder of a simulation.
pub(super) fn recording_name(format: RecordingFormat) -> String {
    format!("second.{}", format.of_second_camera().name())
}

/// Returns a lens with a slightly longer focal length than `first`, converted from the sensor `of_first` to `sensor`.
fn similar_lens(first: &Camera<f64>, of_first: Sensor, sensor: Sensor) -> Option<Camera<f64>> {
    let mut parameters = first.parameters();
    let wider = f64::from(sensor.width) / f64::from(of_first.width.max(1));
    let higher = f64::from(sensor.height) / f64::from(of_first.height.max(1));
    let aside = ASIDE.map(|aside| aside * f64::from(sensor.width));
    // Pixel coordinates refer to pixel centres.
    let middle = |scale: f64| 0.5 * (scale - 1.0);
    let focal = FOCAL_RATIO * wider;
    let changes = [(focal, 0.0), (focal, 0.0), (wider, middle(wider) + aside[0]), (higher, middle(higher) + aside[1])];
    for (parameter, (factor, more)) in parameters.iter_mut().zip(changes) {
        *parameter = factor * *parameter + more;
    }
    Camera::from_parameters(first.kind(), &parameters)
}

/// Description of a second camera in `truth.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SecondCameraDescription {
    /// The settings.
    pub settings: SecondCameraSettings,
    /// Size of the sensor.
    pub sensor: Sensor,
    /// The lens.
    pub camera: CameraDescription,
    /// Seed of its noise.
    pub seed: u64,
    /// `T_second_first`, row by row.
    #[serde(rename = "T_second_first")]
    pub second_first: [[f64; 4]; 4],
    /// Number of OFF events.
    pub off_events: u64,
    /// Number of ON events.
    pub on_events: u64,
    /// Number of frames, if it takes frames.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame_count: Option<usize>,
}

impl SecondCameraDescription {
    /// Describes `second`, which sent these `counts` of events or this number of frames.
    pub fn new(second: &SecondCamera, counts: EventCounts, frame_count: Option<usize>) -> Self {
        Self {
            settings: second.settings.clone(),
            sensor: second.sensor,
            camera: CameraDescription::new(&second.camera),
            seed: second.seed,
            second_first: second.second_first().to_homogeneous().transpose().into(),
            off_events: counts.off,
            on_events: counts.on,
            frame_count,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::MotionSettings;
    use crate::scene::SceneSettings;
    use crate::sensor::SensorModel;
    use crate::tests::{board, radtan};
    use crate::{SimulationSettings, settings};
    use event_recordings::image_folder::{ImageFolder, Stamps};

    const SENSOR: Sensor = Sensor::new(346, 260);

    fn simulation() -> Simulation {
        let settings = SimulationSettings {
            duration: 0.2,
            seed: 4,
            scene: SceneSettings::default(),
            sensor: SensorModel::default(),
            motion: MotionSettings::fast(),
        };
        Simulation::new(Rays::new(&radtan(), SENSOR), board(), settings).unwrap()
    }

    fn read(path: &Path) -> Vec<Event> {
        let recording = event_recordings::Recording::new(path, Default::default()).unwrap();
        let (mut reader, mut events, mut batch) = (recording.open().unwrap(), Vec::new(), Vec::new());
        while reader.next_batch(&mut batch).unwrap() {
            events.extend_from_slice(&batch);
        }
        events
    }

    #[test]
    fn a_point_of_the_board_is_where_the_transform_puts_it() {
        let second = SecondCamera::new(SecondCameraSettings::default(), &radtan(), SENSOR, 4).unwrap();
        let first = simulation();
        let carried = first.second(Rays::new(&radtan(), SENSOR), second.second_first().inverse(), 1);
        for t in [0.0, 0.07, 0.2] {
            let point = nalgebra::Point3::new(0.1, 0.2, 0.0);
            let seen_by_first = first.pose(t).inverse() * point;
            let seen_by_second = carried.pose(t).inverse() * point;
            assert!((second.second_first() * seen_by_first - seen_by_second).norm() < 1e-12);
        }
        assert!((second.second_first().translation.vector.norm() - 0.1).abs() < 1e-3);
    }

    /// At the pose of the first camera, with its lens and seed, it sees the same, on its own clock and from the start
    /// of its recording.
    #[test]
    fn events_of_the_second_camera_have_times_of_its_own_clock() {
        let settings = SecondCameraSettings {
            position: [0.0; 3],
            rotation: [0.0; 3],
            camera: Some(CameraDescription::new(&radtan())),
            seed_above: 0,
            begins_later: 0.05,
            clock_offset: 7.0,
            clock_drift: 1000.0,
            frames: None,
        };
        let second = SecondCamera::new(settings, &radtan(), SENSOR, 4).unwrap();
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("second.aedat4");
        let simulation = simulation();
        let counts = second.write(&simulation, &path, RecordingFormat::Davis346, |_| {}).unwrap();
        let mut expected = Vec::new();
        let Ok(_) = simulation.run(|events| {
            expected.extend_from_slice(events);
            Ok::<(), std::convert::Infallible>(())
        });
        expected.retain(|event| event.t >= 50_000);
        let found = read(&path);
        assert!(found.len() > 10_000 && found.len() == expected.len());
        for (found, expected) in found.iter().zip(&expected) {
            assert_eq!((found.x, found.y, found.polarity), (expected.x, expected.y, expected.polarity));
            let own = 7e6 + expected.t as f64 * 1.001;
            assert!((found.t as f64 - own).abs() < 0.51, "{} {own}", found.t);
        }
        assert_eq!(counts.on + counts.off, found.len() as u64);
    }

    #[test]
    fn frames_of_the_second_camera_have_times_of_its_own_clock() {
        let frames = FrameCameraSettings { sensor: Sensor::new(64, 48), stamps: Stamps::Start, ..Default::default() };
        let settings = SecondCameraSettings { begins_later: 0.05, frames: Some(frames), ..Default::default() };
        let SecondCameraSettings { clock_offset, clock_drift, .. } = settings;
        let second = SecondCamera::new(settings, &radtan(), SENSOR, 4).unwrap();
        let directory = tempfile::tempdir().unwrap();
        let written = second.write_frames(&simulation(), &frames, directory.path(), |_| {}).unwrap();
        let folder = ImageFolder::open(directory.path(), frames.stamps).unwrap();
        let mut images = Vec::new();
        folder.visit(|image| images.push(image)).unwrap();
        // At 66.7, 100, 133 and 167 ms; the frame at 33 ms is before the start, the one at 200 ms after the end.
        assert_eq!((images.len(), written.len(), folder.sensor()), (4, 5, Sensor::new(64, 48)));
        for (index, image) in images.iter().enumerate() {
            let time = 33_333.0 * (index + 2) as f64;
            let own = 1e6 * clock_offset + time * (1.0 + 1e-6 * clock_drift);
            assert!((image.exposure.0 as f64 - own).abs() <= 0.501, "{:?} {own}", image.exposure);
        }
        let levels = images[0].image.as_ref().unwrap();
        let (darkest, brightest) = (levels.pixels.iter().min().unwrap(), levels.pixels.iter().max().unwrap());
        assert!(*darkest < 60 && *brightest > 140, "{darkest} {brightest}");
    }

    #[test]
    fn settings_out_of_range_are_named() {
        let settings = SecondCameraSettings { clock_drift: f64::NAN, ..SecondCameraSettings::default() };
        let error = SecondCamera::new(settings, &radtan(), SENSOR, 4).unwrap_err();
        assert!(
            matches!(error, settings::SimulationError::Setting { name: "second_camera.clock_drift", .. }),
            "{error}"
        );
    }
}
