//! A calibrated IMU as stored in `calibration.json`, and as text.

use nalgebra::{Matrix3, Matrix4, Vector3};
use serde::{Deserialize, Serialize};

use crate::inertial::calibration::InertialCalibration;
use crate::inertial::findings::{DELAY_LIMIT, LINEARITY};
use crate::inertial::joint::Noise;
use crate::inertial::parameters::{
    ACCELEROMETER_BIAS, ACCELEROMETER_DELAY, ACCELEROMETER_MATRIX, BOARD_SCALE, CLOCK_DRIFT, GRAVITY, GYROSCOPE_BIAS,
    GYROSCOPE_DELAY, GYROSCOPE_MATRIX, GYROSCOPE_TURN, POSITION, ROTATION, TRIANGLE,
};
use crate::inertial::stream::StreamReport;
use crate::quality::verdict::{Cause, Grade};
use crate::result::correlated::{POSE_NAMES, correlated};
use crate::result::device_description::{DeviceDescription, Quantity, Uncertain, Unit};
use evcal_geometry::lens::camera_file::CameraDescription;
use evcal_geometry::numerics::gravity::STANDARD_GRAVITY;
use evcal_geometry::numerics::rigid::pose_of_rows;

/// Names of the parameters whose correlations are reported, in their order, after [`POSE_NAMES`].
const NAMES: [&str; GYROSCOPE_TURN - POSE_NAMES.len()] = [
    "delay of the gyroscope",
    "delay of the accelerometer",
    "bias of the gyroscope along x",
    "bias of the gyroscope along y",
    "bias of the gyroscope along z",
    "bias of the accelerometer along x",
    "bias of the accelerometer along y",
    "bias of the accelerometer along z",
    "first angle of gravity",
    "second angle of gravity",
    "scale of the accelerometer along x",
    "misalignment of the accelerometer (y by x)",
    "scale of the accelerometer along y",
    "misalignment of the accelerometer (z by x)",
    "misalignment of the accelerometer (z by y)",
    "scale of the accelerometer along z",
    "scale of the gyroscope along x",
    "misalignment of the gyroscope (y by x)",
    "scale of the gyroscope along y",
    "misalignment of the gyroscope (z by x)",
    "misalignment of the gyroscope (z by y)",
    "scale of the gyroscope along z",
];

/// One of the two sensors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SensorResult {
    /// Time by which its timestamps are later than events of the same moment (s).
    pub delay: Uncertain<f64>,
    /// Reading minus truth: m/s² or rad/s.
    pub bias: Uncertain<[f64; 3]>,
    /// M, row by row: the reading is M times the truth, plus the bias.
    pub matrix: [[f64; 3]; 3],
    /// σ of the lower triangle of M, row by row: three rows of three with zeros above the diagonal.
    pub matrix_sigma: [[f64; 3]; 3],
    /// `true` if the motion determined the delay.
    #[serde(default = "measured")]
    pub delay_measured: bool,
    /// `true` if the motion determined the matrix. Otherwise it is a typical value, and not separated from bias and gravity.
    #[serde(default = "measured")]
    pub matrix_measured: bool,
    /// White noise of each axis: m/s²/√Hz or rad/s/√Hz. A sample's standard deviation is this times the square root of the rate.
    pub noise_density: [f64; 3],
    /// `true` if the noise was measured; otherwise it is twice the value of a typical data sheet.
    pub noise_measured: bool,
    /// Root mean square of the residuals, m/s² or rad/s.
    pub residual_rms: f64,
}

/// Returns the value for files without such a field.
fn measured() -> bool {
    true
}

/// A calibrated IMU.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InertialResult {
    /// The grade.
    pub grade: Grade,
    /// The verdict in words, with the uncertainty.
    pub verdict: String,
    /// Transform from camera coordinates to IMU coordinates, row by row; `None` if rotation or position was not measured.
    #[serde(rename = "T_imu_camera")]
    pub imu_from_camera: Option<[[f64; 4]; 4]>,
    /// σ of the rotation about the axes of the camera (rad).
    pub rotation_sigma: [f64; 3],
    /// Position of the IMU in the camera frame (m); `None` along axes along which it was not measured.
    pub position_in_camera: Uncertain<[Option<f64>; 3]>,
    /// The gyroscope.
    pub gyroscope: SensorResult,
    /// The rotation C from the IMU's axes, which are the accelerometer's, to the gyroscope's, row by row.
    #[serde(rename = "C_gyroscope_imu")]
    pub gyroscope_from_imu: [[f64; 3]; 3],
    /// The accelerometer.
    pub accelerometer: SensorResult,
    /// Gravity in the frame of the board (m/s²), downwards.
    pub gravity: [f64; 3],
    /// σ of its direction (rad).
    pub gravity_sigma: f64,
    /// True size of the board divided by its stated size; σ includes 0.3 % for the nonlinearity of accelerometers.
    pub board_scale: Uncertain<f64>,
    /// Seconds that the IMU's clock gains per second.
    pub clock_drift: Uncertain<f64>,
    /// Seconds that were subtracted from the IMU's timestamps before everything else, for a clock with another origin.
    pub clock_origin: f64,
    /// Timestamp of the IMU at which the delays apply, if its clock drifts (s).
    #[serde(default)]
    pub delays_at: f64,
    /// Correlation of the rotation rates of camera and IMU at the start.
    pub correlation: f64,
    /// Number of samples used.
    pub used: usize,
    /// Reports, one per recording.
    pub streams: Vec<StreamReport>,
    /// Largest difference between an intrinsic parameter and its value in the calibration of the camera alone, in σ of the
    /// difference; `None` if the intrinsics were fixed at the intrinsics of another model.
    pub camera_moved: Option<f64>,
    /// The camera at which intrinsics were fixed; absent if they were estimated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fixed_camera: Option<CameraDescription>,
    /// The camera from this solve, or the fixed one: the intrinsics that match the IMU's parameters best.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub solved_together: Option<CameraDescription>,
    /// Ratio of the scatter of blocks of time to the formal variance.
    pub block_scatter: f64,
    /// Correlation of rotation, position, delays, biases (gyroscope, accelerometer), the two angles of gravity, and the lower
    /// triangles of the matrices (accelerometer, gyroscope), in this order.
    pub correlations: Vec<Vec<f64>>,
    /// Findings, as sentences.
    pub findings: Vec<String>,
}

impl InertialResult {
    /// Returns the result of `calibration`.
    pub fn new(calibration: &InertialCalibration) -> Self {
        let parameters = &calibration.parameters;
        let sigma = |index: usize| calibration.sigma(index);
        let three = |first: usize| std::array::from_fn(|axis| sigma(first + axis));
        let unmeasured = crate::inertial::findings::unmeasured_axes(calibration);
        let aligned = |axis: usize| sigma(POSITION + axis) <= 0.01 && unmeasured.iter().all(|(one, _)| *one != axis);
        let rotation_lost = calibration.findings.iter().any(|finding| finding.cause == Cause::RotationNotMeasured);
        let rms = calibration.residual_rms();
        let sensor =
            |index: usize, delay: (f64, usize), bias: (&Vector3<f64>, usize), matrix: (&Matrix3<f64>, usize)| {
                let Noise { density, measured } = calibration.noise[index];
                let mut matrix_sigma = [[0.0; 3]; 3];
                for (place, (row, column)) in TRIANGLE.into_iter().enumerate() {
                    matrix_sigma[row][column] = sigma(matrix.1 + place);
                }
                SensorResult {
                    delay: Uncertain { value: delay.0, sigma: sigma(delay.1) },
                    bias: Uncertain { value: (*bias.0).into(), sigma: three(bias.1) },
                    matrix: rows(matrix.0),
                    delay_measured: sigma(delay.1) <= DELAY_LIMIT,
                    matrix_measured: calibration.is_measured(matrix.1..matrix.1 + TRIANGLE.len()),
                    matrix_sigma,
                    noise_density: density,
                    noise_measured: measured,
                    residual_rms: rms[index],
                }
            };
        let whole: Matrix4<f64> = parameters.imu_from_camera().to_homogeneous();
        let mut result = Self {
            grade: Grade::of(calibration.findings.iter().map(|finding| finding.severity)),
            verdict: String::new(),
            imu_from_camera: (unmeasured.is_empty() && !rotation_lost).then(|| whole.transpose().into()),
            rotation_sigma: three(ROTATION),
            position_in_camera: Uncertain {
                value: std::array::from_fn(|axis| aligned(axis).then(|| parameters.position[axis])),
                sigma: std::array::from_fn(|axis| aligned(axis).then(|| sigma(POSITION + axis))),
            },
            gyroscope: sensor(
                0,
                (parameters.gyroscope_delay, GYROSCOPE_DELAY),
                (&parameters.gyroscope_bias, GYROSCOPE_BIAS),
                (&parameters.gyroscope_matrix, GYROSCOPE_MATRIX),
            ),
            gyroscope_from_imu: rows(&parameters.gyroscope_from_imu.to_rotation_matrix().into_inner()),
            accelerometer: sensor(
                1,
                (parameters.accelerometer_delay, ACCELEROMETER_DELAY),
                (&parameters.accelerometer_bias, ACCELEROMETER_BIAS),
                (&parameters.accelerometer_matrix, ACCELEROMETER_MATRIX),
            ),
            gravity: parameters.gravity.into(),
            gravity_sigma: sigma(GRAVITY).max(sigma(GRAVITY + 1)),
            board_scale: Uncertain { value: parameters.board_scale, sigma: sigma(BOARD_SCALE).hypot(LINEARITY) },
            clock_drift: Uncertain { value: parameters.clock_drift, sigma: sigma(CLOCK_DRIFT) },
            clock_origin: calibration.clock_origin,
            delays_at: calibration.delays_at,
            correlation: calibration.correlation,
            used: calibration.used,
            streams: calibration.streams.clone(),
            camera_moved: calibration.camera_moved,
            fixed_camera: calibration.fixed.as_ref().map(CameraDescription::new),
            solved_together: Some(CameraDescription::new(&calibration.camera)),
            block_scatter: calibration.block_scatter,
            correlations: correlations(calibration),
            findings: calibration.findings.iter().map(ToString::to_string).collect(),
        };
        result.verdict = result.sentence(calibration);
        result
    }

    fn sentence(&self, calibration: &InertialCalibration) -> String {
        let largest = |first: usize| (0..3).map(|axis| calibration.sigma(first + axis)).fold(0.0, f64::max);
        let delays = self.gyroscope.delay.sigma.max(self.accelerometer.delay.sigma);
        format!(
            "{}: the rotation is known to {:.3}°, the position to {:.2} mm (σ of the worst axis), the delays to {:.3} ms.",
            self.grade.opening(),
            largest(ROTATION).to_degrees(),
            1e3 * largest(POSITION),
            1e3 * delays
        )
    }

    /// Returns the result as terminal and report show it.
    pub fn description(&self) -> DeviceDescription {
        let fixed = if self.fixed_camera.is_some() { ", with fixed camera intrinsics" } else { "" };
        DeviceDescription {
            heading: format!("IMU, from {} samples{fixed}", self.used),
            verdict: self.verdict.clone(),
            quantities: self.quantities(),
            notes: self.notes(),
            findings: self.findings.clone(),
        }
    }

    fn quantities(&self) -> Vec<Quantity> {
        const DEGREES: f64 = 180.0 / std::f64::consts::PI;
        const DEGREE: Unit = Unit { name: "°", factor: DEGREES };
        const PER_SECOND: Unit = Unit { name: "°/s", factor: DEGREES };
        const MILLI_G: Unit = Unit { name: "mg", factor: 1e3 / STANDARD_GRAVITY };
        let rotation = self.imu_from_camera.as_ref().map(|rows| pose_of_rows(rows).rotation.scaled_axis());
        let place = &self.position_in_camera;
        let axes = |name: &str, unit: Unit, value: [f64; 3], sigma: [f64; 3]| {
            Quantity::along_axes(name, unit, value.map(Some), sigma.map(Some))
        };
        let diagonal = |matrix: &[[f64; 3]; 3]| std::array::from_fn(|axis| matrix[axis][axis]);
        let mut quantities = vec![
            axes("rotation vector of R_imu_camera", DEGREE, rotation.unwrap_or_default().into(), self.rotation_sigma)
                .known_if(rotation.is_some()),
            Quantity::along_axes(
                "position of the IMU in the camera frame (x right, y down, z forward)",
                Unit::MILLIMETRE,
                place.value,
                place.sigma,
            ),
        ];
        let sensors = [("gyroscope", &self.gyroscope), ("accelerometer", &self.accelerometer)];
        for (name, sensor) in sensors {
            let delay = format!("delay of the {name}, t_{name} − t_events");
            quantities.push(
                Quantity::one(&delay, Unit { name: "ms", factor: 1e3 }, sensor.delay).known_if(sensor.delay_measured),
            );
        }
        for ((name, sensor), unit) in sensors.into_iter().zip([PER_SECOND, MILLI_G]) {
            let scale = (diagonal(&sensor.matrix), diagonal(&sensor.matrix_sigma));
            quantities.extend([
                axes(&format!("bias of the {name}"), unit, sensor.bias.value, sensor.bias.sigma),
                axes(&format!("scale of the {name}"), Unit::RATIO, scale.0, scale.1).known_if(sensor.matrix_measured),
            ]);
        }
        let gravity: [f64; 3] = Vector3::from(self.gravity).normalize().into();
        quantities.extend([
            Quantity::plain("direction of gravity in the axes of the board".to_owned(), "", &gravity, 5),
            Quantity::plain("σ of this direction".to_owned(), "°", &[self.gravity_sigma.to_degrees()], 3),
        ]);
        for ((name, sensor), (unit, factor, decimals)) in
            sensors.into_iter().zip([("°/s/√Hz", DEGREES, 4), ("µg/√Hz", 1e6 / STANDARD_GRAVITY, 0)])
        {
            let source =
                if sensor.noise_measured { "" } else { " (not measured: twice the value of a typical data sheet)" };
            let mean = factor * sensor.noise_density.iter().sum::<f64>() / 3.0;
            quantities.push(Quantity::plain(format!("noise of the {name}{source}"), unit, &[mean], decimals));
        }
        let size = "size of the board by the accelerometer / stated size";
        quantities.push(Quantity::one(size, Unit::RATIO, self.board_scale));
        quantities
    }

    fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if self.gyroscope.delay_measured || self.accelerometer.delay_measured {
            notes.push(
                "delays include the latency of the pixels (some 0.1 ms in good light, more in dim light); their σ does not"
                    .to_owned(),
            );
        }
        notes.push("biases are reading minus truth; random walks are not measured".to_owned());
        let rows = self.correlations.iter().map(Vec::as_slice);
        notes.extend(correlated(rows, POSE_NAMES.into_iter().chain(NAMES)));
        notes
    }
}

/// Returns the correlations of the named parameters.
fn correlations(calibration: &InertialCalibration) -> Vec<Vec<f64>> {
    let of = |row: usize, column: usize| {
        let size = calibration.sigma(row) * calibration.sigma(column);
        if size > 0.0 { calibration.covariance[(row, column)] / size } else { 0.0 }
    };
    (0..GYROSCOPE_TURN).map(|row| (0..GYROSCOPE_TURN).map(|column| of(row, column)).collect()).collect()
}

fn rows(matrix: &Matrix3<f64>) -> [[f64; 3]; 3] {
    matrix.transpose().into()
}
