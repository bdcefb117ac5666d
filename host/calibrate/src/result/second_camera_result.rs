//! A second camera as stored in `calibration.json`, and as text.

use evcal_core::sensor::Sensor;
use nalgebra::{Isometry3, RowDVector, SVector, Vector3};
use serde::{Deserialize, Serialize};

use crate::calibrate::mounted::{SecondCamera, SecondFrames};
use crate::quality::verdict::{Cause, Grade};
use crate::result::correlated::{POSE_NAMES, correlated};
use crate::result::device_description::{DeviceDescription, Quantity, Uncertain, Unit};
use crate::second_camera::calibration::SecondCalibration;
use crate::second_camera::mount::{COUNT, LINE_DELAY, OFFSET, RATE, ROTATION, TRANSLATION};
use evcal_geometry::lens::camera_file::CameraDescription;
use evcal_geometry::numerics::rigid::pose_of_rows;
use event_recordings::image_folder::Stamps;

/// Seconds with the board in view of both cameras from which the rates of the clocks are reported even if they do not differ.
const LONG_ENOUGH_FOR_RATE: f64 = 20.0;
/// Names of the parameters of the mount, in their order, after [`POSE_NAMES`].
const NAMES: [&str; COUNT - POSE_NAMES.len()] = ["offset", "rate"];

/// A camera with its sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SolvedCamera {
    /// Size of the sensor.
    pub sensor: Sensor,
    /// The lens.
    pub camera: CameraDescription,
}

/// 99 % quantile of the squared distance from the identity, in its covariance: χ² with 6 degrees of freedom.
const RARELY: f64 = 16.81;

/// Distance of a transform from the identity, which is its expected value.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FromIdentity {
    /// Squared distance in units of its covariance; the expected value is 6.
    pub chi_squared: f64,
    /// `true` if the transform is the identity within its uncertainty; chance alone exceeds the limit in 1 % of the cases.
    pub agrees: bool,
}

impl FromIdentity {
    fn new(calibration: &SecondCalibration) -> Self {
        let Isometry3 { rotation, translation } = calibration.mount.second_first;
        let turn = rotation.scaled_axis();
        let off = SVector::<f64, 6>::from_fn(|row, _| if row < 3 { turn[row] } else { translation.vector[row - 3] });
        let covariance = calibration.covariance.fixed_view::<6, 6>(ROTATION, ROTATION).into_owned();
        let chi_squared = covariance.cholesky().map_or(f64::INFINITY, |factor| off.dot(&factor.solve(&off)));
        Self { chi_squared, agrees: chi_squared < RARELY }
    }
}

/// The frames of a second camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FramesOfSecond {
    /// Number of frames that show the board and were used.
    pub used: usize,
    /// Meaning of their timestamps, as given.
    pub stamps: Stamps,
    /// `true` if they have exposure times; otherwise the offset of the clocks refers to the moment at which a frame was stamped.
    pub exposure_known: bool,
    /// Delay of the exposure of each row after the one above it (s). Offset and transform apply to the middle row.
    pub line_delay: Uncertain<f64>,
    /// `true` if a rolling shutter was requested.
    pub rolling_shutter: bool,
}

impl FramesOfSecond {
    fn new(frames: &SecondFrames, calibration: &SecondCalibration) -> Option<Self> {
        Some(Self {
            used: frames.used,
            stamps: frames.stamps,
            exposure_known: frames.exposure_known,
            line_delay: Uncertain { value: calibration.mount.line_delay?, sigma: calibration.sigma(LINE_DELAY) },
            rolling_shutter: calibration.rolling_shutter,
        })
    }
}

/// A second camera on the mount of the first.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SecondCameraResult {
    /// Its recording.
    pub recording: String,
    /// Size of its sensor.
    pub sensor: Sensor,
    /// Its lens, calibrated separately.
    pub camera: CameraDescription,
    /// Standard deviation of each lens parameter.
    pub sigma: CameraDescription,
    /// Corners (px) of the convex region of its sensor in which the board was seen.
    pub covered_region: Vec<[f64; 2]>,
    /// Grade of the separate calibration of its lens. `None` if it does not matter: for the first camera's own frames, with fixed
    /// intrinsics, and with a rolling shutter, because no lens model explains its frames before the delay of the rows
    /// is known.
    #[serde(default)]
    pub lens_grade: Option<Grade>,
    /// The verdict on the lens in words.
    pub lens_verdict: String,
    /// Grade of the transform and the clocks.
    pub grade: Grade,
    /// The verdict in words, with the uncertainty.
    pub verdict: String,
    /// Transform from coordinates of the first camera to coordinates of the second, row by row.
    #[serde(rename = "T_second_first")]
    pub second_from_first: [[f64; 4]; 4],
    /// σ of its rotation about the axes of the first camera (rad).
    pub rotation_sigma: [f64; 3],
    /// σ of its translation along the axes of the second camera (m).
    pub translation_sigma: [f64; 3],
    /// Distance of the cameras (m).
    pub baseline: Uncertain<f64>,
    /// t_second = t_first + offset, on the clocks of the recordings (s).
    pub time_offset: Uncertain<f64>,
    /// Time on the clock of the second recording at which the offset applies, if the clocks run at different rates (s).
    pub time_offset_at: f64,
    /// Relative rate by which the second clock is faster; `None` if both cameras saw the board for 20 s or less.
    pub clock_rate: Option<Uncertain<f64>>,
    /// Correlation of rotation, translation, offset and rate, in this order.
    pub correlations: [[f64; COUNT]; COUNT],
    /// Both cameras from the solve of all events: the intrinsics that match the transform best.
    pub solved_together: [SolvedCamera; 2],
    /// Largest difference between an intrinsic parameter of each camera and its value in the separate calibration, in its σ;
    /// `None` if the intrinsics were fixed at the intrinsics of another model.
    pub cameras_moved: [Option<f64>; 2],
    /// `true` for each camera whose intrinsics were fixed; otherwise they were estimated.
    #[serde(default)]
    pub fixed: [bool; 2],
    /// Seconds with the board in view of both cameras.
    pub seconds: f64,
    /// Events, or centres of dots, of the second camera that were used.
    pub used: usize,
    /// Share of its events that were excluded because the first camera has no trajectory at their times.
    pub left_out: f64,
    /// Correlation of the rotation rates of both cameras at the start; `None` for the first camera's own frames.
    pub correlation: Option<f64>,
    /// Ratio of the covariance to that with independent events.
    pub inflation: f64,
    /// Ratio of the residuals of the second camera's events on the first camera's trajectory to those on its own.
    pub looseness: Option<f64>,
    /// For the first camera's own frames, which have the same lens: distance of the transform from the identity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from_identity: Option<FromIdentity>,
    /// Its frames and their shutter, if it is a frame camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frames: Option<FramesOfSecond>,
    /// Findings, as sentences.
    pub findings: Vec<String>,
}

impl SecondCameraResult {
    /// Returns the result of `second`.
    pub fn new(second: &SecondCamera) -> Self {
        let SecondCamera { calibration, starts, .. } = second;
        let mount = &calibration.mount;
        let sigma = |index: usize| calibration.sigma(index);
        let three = |first: usize| std::array::from_fn(|axis| sigma(first + axis));
        let between = starts[1] - starts[0];
        let solved = |index: usize| SolvedCamera {
            sensor: calibration.sensors[index],
            camera: CameraDescription::new(&calibration.cameras[index]),
        };
        let mut result = Self {
            recording: second.file.clone(),
            sensor: second.sensor,
            camera: second.camera.clone(),
            sigma: second.sigma.clone(),
            covered_region: second.covered.corners().iter().map(|&corner| corner.into()).collect(),
            lens_grade: second.lens_grade,
            lens_verdict: second.lens_verdict.clone(),
            grade: Grade::of(calibration.findings.iter().map(|finding| finding.severity)),
            verdict: String::new(),
            second_from_first: mount.second_first.to_homogeneous().transpose().into(),
            rotation_sigma: three(ROTATION),
            translation_sigma: three(TRANSLATION),
            baseline: baseline(calibration),
            time_offset: Uncertain { value: mount.offset + between, sigma: sigma(OFFSET) },
            time_offset_at: mount.middle + starts[1],
            clock_rate: (calibration.seconds > LONG_ENOUGH_FOR_RATE
                || calibration.findings.iter().any(|finding| finding.cause == Cause::ClockRate))
            .then(|| Uncertain { value: mount.rate, sigma: sigma(RATE) }),
            correlations: std::array::from_fn(|row| {
                std::array::from_fn(|column| calibration.covariance[(row, column)] / (sigma(row) * sigma(column)))
            }),
            solved_together: [0, 1].map(solved),
            cameras_moved: calibration.cameras_moved,
            fixed: calibration.fixed,
            seconds: calibration.seconds,
            used: calibration.used,
            left_out: calibration.left_out,
            correlation: calibration.correlation,
            inflation: calibration.inflation,
            looseness: calibration.looseness,
            from_identity: calibration.correlation.is_none().then(|| FromIdentity::new(calibration)),
            frames: second.frames.as_ref().and_then(|frames| FramesOfSecond::new(frames, calibration)),
            findings: calibration.findings.iter().map(ToString::to_string).collect(),
        };
        result.verdict = result.sentence();
        result
    }

    /// Returns `T_second_first`.
    pub fn pose(&self) -> Isometry3<f64> {
        pose_of_rows(&self.second_from_first)
    }

    fn sentence(&self) -> String {
        let largest = |sigma: [f64; 3]| sigma.into_iter().fold(0.0, f64::max);
        format!(
            "{}: the transform is known to {:.4}° and {:.3} mm (σ of the worst axis), the offset of the clocks to {:.1} µs.",
            self.grade.opening(),
            largest(self.rotation_sigma).to_degrees(),
            1e3 * largest(self.translation_sigma),
            1e6 * self.time_offset.sigma
        )
    }

    /// Returns the result as terminal and report show it.
    pub fn description(&self) -> DeviceDescription {
        let what = match self.frames {
            Some(frames) => format!("{} points in {} frames", self.used, frames.used),
            None if self.from_identity.is_some() => format!("{} points", self.used),
            None => format!("{} events", self.used),
        };
        DeviceDescription {
            heading: format!(
                "second camera ({}), from {what} in {:.1} s with the board in view of both",
                self.recording, self.seconds
            ),
            verdict: self.verdict.clone(),
            quantities: self.quantities(),
            notes: self.notes(),
            findings: self.findings.clone(),
        }
    }

    fn quantities(&self) -> Vec<Quantity> {
        let Isometry3 { rotation, translation } = self.pose();
        let turn = rotation.scaled_axis();
        let axes = |name: &str, unit: Unit, value: Vector3<f64>, sigma: [f64; 3]| {
            Quantity::along_axes(name, unit, value.data.0[0].map(Some), sigma.map(Some))
        };
        const DEGREE: Unit = Unit { name: "°", factor: 180.0 / std::f64::consts::PI };
        const SECOND: Unit = Unit { name: "s", factor: 1.0 };
        const MILLIONTH: Unit = Unit { name: "ppm", factor: 1e6 };
        const MICROSECOND: Unit = Unit { name: "µs", factor: 1e6 };
        let mut quantities = vec![
            axes("rotation vector of R_second_first", DEGREE, turn, self.rotation_sigma),
            axes(
                "position of the first camera in the frame of the second (x right, y down, z forward)",
                Unit::MILLIMETRE,
                translation.vector,
                self.translation_sigma,
            ),
            Quantity::one("distance of the cameras", Unit::MILLIMETRE, self.baseline),
            Quantity::one("offset of the clocks, t_second − t_first", SECOND, self.time_offset),
        ];
        let rate = |rate| Quantity::one("rate of the second clock minus that of the first", MILLIONTH, rate);
        quantities.extend(self.clock_rate.map(rate));
        let row = |frames: FramesOfSecond| {
            Quantity::one("delay of each row of its frames after the one above it", MICROSECOND, frames.line_delay)
        };
        quantities.extend(self.frames.map(row));
        quantities
    }

    fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if self.lens_grade.is_some() {
            notes.push(format!("its lens: {}", self.lens_verdict));
        }
        let fixed = match self.fixed {
            [true, true] => Some("both cameras were"),
            [true, false] => Some("the first camera were"),
            [false, true] => Some("the second camera were"),
            [false, false] => None,
        };
        notes.extend(fixed.map(|whose| format!("the intrinsics of {whose} fixed; σ includes theirs, if it is known")));
        notes.push(match self.clock_rate {
            Some(_) => format!("the offset applies at {:.3} s of the second clock", self.time_offset_at),
            None => {
                "no difference between the rates of the clocks was found: a small one takes more than 20 s".to_owned()
            }
        });
        notes.extend(self.frames.iter().flat_map(|frames| self.exposures(frames)));
        notes.extend(self.from_identity.map(|FromIdentity { chi_squared, agrees }| {
            let verdict = if agrees {
                "it is the identity within its σ"
            } else {
                "it is not: the σ or one of the lenses is probably wrong"
            };
            format!(
                "frames and events come through the same lens, so the transform should be the identity: {verdict} (χ² {chi_squared:.1}, 6 expected, above {RARELY:.1} in 1 of 100 cases)"
            )
        }));
        let rows = self.correlations.iter().map(<[f64; COUNT]>::as_slice);
        notes.extend(correlated(rows, POSE_NAMES.into_iter().chain(NAMES)));
        notes
    }

    /// Describes exposure and shutter of the frames of the second camera.
    fn exposures(&self, frames: &FramesOfSecond) -> [String; 2] {
        let stamps = frames.stamps.name();
        let exposure = if frames.exposure_known {
            format!(
                "its timestamps are assumed to be the {stamps} of the exposures; the offset applies to their middle"
            )
        } else {
            let half = match frames.stamps {
                Stamps::Middle => String::new(),
                Stamps::Start | Stamps::End => {
                    format!(
                        ", and differs by half an exposure from the offset of the clocks, because timestamps are the {stamps} of an exposure"
                    )
                }
            };
            format!(
                "the exposure times are not known: the offset is the time between a timestamp and the middle of its exposure{half}"
            )
        };
        let shutter = if frames.rolling_shutter {
            format!(
                "rolling shutter: {:.2} ms from the first row to the last; the offset applies to the middle row",
                1e3 * frames.line_delay.value * f64::from(self.sensor.height)
            )
        } else {
            "the delay of rows is not significantly different from zero: a global shutter".to_owned()
        };
        [exposure, shutter]
    }
}

/// Returns the distance between the cameras.
fn baseline(calibration: &SecondCalibration) -> Uncertain<f64> {
    let place: Vector3<f64> = calibration.mount.second_first.translation.vector;
    let value = place.norm();
    let along = RowDVector::from_fn(3, |_, axis| if value > 0.0 { place[axis] / value } else { 0.0 });
    let covariance = calibration.covariance.view((TRANSLATION, TRANSLATION), (3, 3));
    let variance = (&along * covariance * along.transpose())[(0, 0)];
    Uncertain { value, sigma: variance.max(0.0).sqrt() }
}
