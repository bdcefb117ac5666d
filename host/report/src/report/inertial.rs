//! The IMU: its parameters, its position on the mount, and the residuals of its samples.

use maud::{Markup, html};
use nalgebra::Vector3;

use super::chart::{Chart, Color, Series, range_of};
use super::mount_axes::drawing;
use super::number::{count, signed, with_sigma};
use super::overview::capital;
use super::page::{Section, scrolling};
use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_calibrate::inertial::calibration::InertialCalibration;
use evcal_calibrate::inertial::joint::Residual;
use evcal_calibrate::inertial::noise::Line;
use evcal_calibrate::result::inertial_result::{InertialResult, SensorResult, Uncertain};
use evcal_geometry::numerics::gravity::STANDARD_GRAVITY;
use evcal_geometry::numerics::rigid::pose_of_rows;

/// Number of points of a curve.
const POINTS: usize = 300;
const AXES: [&str; 3] = ["x", "y", "z"];
const DEGREES: f64 = 180.0 / std::f64::consts::PI;
/// Thousandths of standard gravity per m/s².
const MILLI_G: f64 = 1e3 / STANDARD_GRAVITY;

/// Returns the parameters as a table next to a drawing, and the residuals of both sensors, folded.
pub fn section(calibrated: &Calibrated) -> Option<Section> {
    let inertial = calibrated.inertial.as_ref()?;
    let result = InertialResult::new(inertial);
    let content = html! {
        p {
            (capital(&result.verdict)) " From " (count(result.used as u64)) " samples."
            @if result.fixed_camera.is_some() { " The intrinsics of the camera were fixed." }
        }
        @if !result.findings.is_empty() { ul { @for finding in &result.findings { li { (capital(finding)) } } } }
        div.trio {
            div.wide {
                (scrolling("Parameters of the IMU along its axes", &vectors(&result)))
                (scrolling("Other parameters of the IMU", &scalars(&result)))
                p.faint {
                    "Delays include the latency of the pixels (about 0.1 ms in good light, more in dim light); their σ does not. Biases are reading minus "
                    "true value. Random walks are not measured."
                }
            }
            figure {
                (drawing("IMU", ["camera", "IMU"], &inertial.parameters.imu_from_camera()))
                figcaption {
                    "Axes of the camera (x right, y down, z along the line of sight, away from you) and of the IMU; the distance between them is not "
                    "to scale."
                }
            }
        }
        (residuals(inertial))
    };
    Some(Section { id: "imu", title: "IMU", folded: false, content })
}

/// A row of three values, each with its standard deviation; `None` if it was not measured.
struct Row {
    name: &'static str,
    unit: &'static str,
    values: [Option<(f64, f64)>; 3],
}

impl Row {
    fn new(name: &'static str, unit: &'static str, factor: f64, value: [f64; 3], sigma: [f64; 3]) -> Self {
        let values = std::array::from_fn(|axis| Some((factor * value[axis], factor * sigma[axis])));
        Self { name, unit, values }
    }

    fn known_if(self, is_known: bool) -> Self {
        if is_known { self } else { Self { values: [None; 3], ..self } }
    }
}

fn diagonal(matrix: &[[f64; 3]; 3]) -> [f64; 3] {
    std::array::from_fn(|axis| matrix[axis][axis])
}

fn vectors(result: &InertialResult) -> Markup {
    let rotation = result.imu_from_camera.as_ref().map(|rows| pose_of_rows(rows).rotation.scaled_axis());
    let position = &result.position_in_camera;
    let of_sensor = |name: [&'static str; 2], unit, factor, sensor: &SensorResult| {
        [
            Row::new(name[0], unit, factor, sensor.bias.value, sensor.bias.sigma),
            Row::new(name[1], "", 1.0, diagonal(&sensor.matrix), diagonal(&sensor.matrix_sigma))
                .known_if(sensor.matrix_measured),
        ]
    };
    let pose = [
        Row {
            name: "position in the camera frame",
            unit: "mm",
            values: std::array::from_fn(|axis| Some((1e3 * position.value[axis]?, 1e3 * position.sigma[axis]?))),
        },
        Row::new(
            "rotation vector of R_imu_camera",
            "°",
            DEGREES,
            rotation.unwrap_or_default().into(),
            result.rotation_sigma,
        )
        .known_if(rotation.is_some()),
    ];
    let gyroscope = of_sensor(["bias of the gyroscope", "scale of the gyroscope"], "°/s", DEGREES, &result.gyroscope);
    let accelerometer =
        of_sensor(["bias of the accelerometer", "scale of the accelerometer"], "mg", MILLI_G, &result.accelerometer);
    let rows = pose.into_iter().chain(gyroscope).chain(accelerometer);
    html! {
        table.short.axes-table {
            thead { tr { td {} @for axis in AXES { th.number scope="col" { (axis) } } } }
            tbody {
                @for Row { name, unit, values } in rows {
                    tr {
                        th scope="row" { (name) @if !unit.is_empty() { " (" (unit) ")" } }
                        @for value in values {
                            td.number {
                                @if let Some((value, sigma)) = value {
                                    @let (value, sigma) = with_sigma(value, sigma);
                                    (value) br; span.faint { "± " (sigma) }
                                } @else { "not measured" }
                            }
                        }
                    }
                }
                tr {
                    th scope="row" { "direction of gravity in the board frame" }
                    @for part in Vector3::from(result.gravity).normalize().iter() { td.number { (signed(*part, 4)) } }
                }
            }
        }
    }
}

fn scalars(result: &InertialResult) -> Markup {
    let uncertain = |value: &Uncertain<f64>, factor: f64| {
        let (value, sigma) = with_sigma(factor * value.value, factor * value.sigma);
        format!("{value} ± {sigma}")
    };
    let delay = |sensor: &SensorResult| match sensor.delay_measured {
        true => uncertain(&sensor.delay, 1e3),
        false => "not measured".to_owned(),
    };
    let noise = |sensor: &SensorResult, factor: f64, decimals: usize| {
        let mean = factor * sensor.noise_density.iter().sum::<f64>() / 3.0;
        format!(
            "{}{}",
            signed(mean, decimals),
            if sensor.noise_measured { "" } else { " (twice a typical data sheet)" }
        )
    };
    let rows = [
        ("delay of the gyroscope: t_gyroscope − t_events (ms)", delay(&result.gyroscope)),
        ("delay of the accelerometer: t_accelerometer − t_events (ms)", delay(&result.accelerometer)),
        ("noise of the gyroscope (°/s/√Hz)", noise(&result.gyroscope, DEGREES, 4)),
        ("noise of the accelerometer (µg/√Hz)", noise(&result.accelerometer, 1e3 * MILLI_G, 0)),
        ("σ of the direction of gravity (°)", signed(DEGREES * result.gravity_sigma, 3)),
        ("size of the board by the accelerometer / nominal size", uncertain(&result.board_scale, 1.0)),
    ];
    html! {
        table.short {
            tbody { @for (name, value) in rows { tr { th.wrapped scope="row" { (name) } td.number { (value) } } } }
        }
    }
}

fn residuals(inertial: &InertialCalibration) -> Markup {
    let names = ["Gyroscope", "Accelerometer"];
    let units = [("°/s", DEGREES), ("mg", MILLI_G)];
    html! {
        details {
            summary { "Residuals of the samples" }
            p {
                "A residual is the reading minus the predicted motion. Its root mean square should be constant over time, and its spectrum flat up to the "
                "cut-off frequency of the sensor's filter. Below " (format!("{:.0}", 0.5 / inertial.knot_spacing))
                " Hz the trajectory follows the sensors, so the residuals are small."
            }
            @for (index, (name, (unit, factor))) in names.iter().zip(units).enumerate() {
                div.pair {
                    figure { (over_time(&inertial.residuals[index], unit, factor)) figcaption { (name) ": root mean square of the residuals over time." } }
                    figure { (spectrum(inertial, index, unit, factor)) figcaption { (name) ": spectrum of the residuals." } }
                }
            }
        }
    }
}

fn over_time(residuals: &[Residual], unit: &str, factor: f64) -> Markup {
    let piece = residuals.len().div_ceil(POINTS).max(1);
    let curve = |axis: usize| -> Vec<(f64, f64)> {
        let spread = |piece: &[Residual]| {
            let squares: f64 = piece.iter().map(|residual| residual.value[axis] * residual.value[axis]).sum();
            let t = piece.first().map_or(0.0, |residual| residual.t);
            (t, factor * (squares / piece.len().max(1) as f64).sqrt())
        };
        residuals.chunks(piece).map(spread).collect()
    };
    chart("Residuals over time.", "time (s)", &format!("rms ({unit})"), &[0, 1, 2].map(curve))
}

fn spectrum(inertial: &InertialCalibration, sensor: usize, unit: &str, factor: f64) -> Markup {
    let curve = |axis: &Vec<Line>| axis.iter().map(|line| (line.frequency, factor * line.density)).collect();
    let curves: Vec<Vec<(f64, f64)>> = inertial.spectra[sensor].iter().map(curve).collect();
    chart("Spectrum of the residuals.", "frequency (Hz)", &format!("density ({unit}/√Hz)"), &curves)
}

fn chart(description: &str, x_label: &str, y_label: &str, curves: &[Vec<(f64, f64)>]) -> Markup {
    let all = || curves.iter().flatten();
    let x = range_of(all().map(|point| point.0), 1.0);
    let top = range_of(all().map(|point| point.1).chain([0.0]), 1e-6).end;
    let series = curves.iter().zip(AXES).zip(Color::ALL).map(|((curve, axis), color)| Series {
        name: axis.to_owned(),
        color,
        curves: vec![curve.clone()],
        points: Vec::new(),
    });
    let series = series.collect();
    Chart { description: description.to_owned(), x_label, y_label, x, y: 0.0..top, series }.render()
}
