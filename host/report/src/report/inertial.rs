//! The IMU: its parameters, its position on the mount, and the residuals of its samples.

use maud::{Markup, html};

use super::chart::{Chart, Color, Series, range_of};
use super::device;
use super::page::Section;
use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_calibrate::inertial::calibration::InertialCalibration;
use evcal_calibrate::inertial::joint::Residual;
use evcal_calibrate::inertial::noise::Line;
use evcal_calibrate::result::inertial_result::InertialResult;
use evcal_geometry::numerics::gravity::STANDARD_GRAVITY;

/// Number of points of a curve.
const POINTS: usize = 300;
const AXES: [&str; 3] = ["x", "y", "z"];
const DEGREES: f64 = 180.0 / std::f64::consts::PI;
/// Thousandths of standard gravity per m/s².
const MILLI_G: f64 = 1e3 / STANDARD_GRAVITY;

/// Returns the parameters as a table next to a drawing, and the residuals of both sensors, folded.
pub fn section(calibrated: &Calibrated) -> Option<Section> {
    let inertial = calibrated.inertial.as_ref()?;
    let content = html! {
        (device::description(
            &InertialResult::new(inertial).description(),
            "IMU",
            ["camera", "IMU"],
            &inertial.parameters.imu_from_camera(),
        ))
        (residuals(inertial))
    };
    Some(Section { id: "imu", title: "IMU", folded: false, content })
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
