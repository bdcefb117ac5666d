//! Other cameras on the mount: their poses, and the residuals of their events along the trajectory of the first camera.

use maud::{Markup, html};
use nalgebra::Isometry3;

use super::chart::{Chart, Color, Series, range_of};
use super::device;
use super::numbers::parameters;
use super::page::{Section, scrolling};
use super::to_copy::python;
use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_calibrate::calibrate::mounted::SecondCamera;
use evcal_calibrate::result::second_camera_result::SecondCameraResult;
use evcal_calibrate::second_camera::joint::Misfit;

/// Number of points of the curve.
const POINTS: usize = 300;

/// Returns for each other camera the result in words, a drawing, and the residuals over time.
pub fn section(calibrated: &Calibrated) -> Option<Section> {
    let cameras = &calibrated.events()?.second_cameras;
    let title = if cameras.len() > 1 { "Other cameras" } else { "Second camera" };
    let content = html! { @for second in cameras { (one(second)) } };
    (!cameras.is_empty()).then_some(Section { id: "second-camera", title, folded: false, content })
}

fn one(second: &SecondCamera) -> Markup {
    let description = SecondCameraResult::new(second).description();
    let seen = if second.frames.is_some() { Seen::POINTS } else { Seen::EVENTS };
    let result = &second.calibration.mount.second_first;
    html! {
        (device::description(&description, "second camera", ["first", "second"], result))
        div.pair {
            @if let Ok(camera) = second.camera.camera() {
                @let sigma: Vec<f64> = camera.kind().parameter_names().iter().map(|name| second.sigma.parameters.get(name).unwrap_or(0.0)).collect();
                div {
                    (scrolling("Lens of the second camera", &parameters(&camera, &sigma, None)))
                    details.screen { summary { "To copy: OpenCV, in Python" } pre { (python(&camera)) (transform(result)) } }
                }
            }
            figure {
                (over_time(&second.calibration.misfit, &seen))
                figcaption {
                    (seen.distance) ", in units of their "
                    "typical spread. It should be constant over time: a rise means that the mount moved or that a trajectory is uncertain."
                }
            }
        }
    }
}

/// Returns `T_second_first` as a NumPy array.
fn transform(second_first: &Isometry3<f64>) -> String {
    let rows = second_first.to_homogeneous();
    let rows = rows.row_iter().map(|row| {
        let row: Vec<String> = row.iter().map(|value| format!("{value:.9}")).collect();
        format!("[{}]", row.join(", "))
    });
    format!(
        "# coordinates of the second camera from those of the first, in metres\nT_second_first = np.array([{}])\n",
        rows.collect::<Vec<_>>().join(",\n    ")
    )
}

/// Names of the observations of a second camera.
struct Seen {
    name: &'static str,
    distance: &'static str,
    unit: &'static str,
}

impl Seen {
    const EVENTS: Self = Self {
        name: "events",
        distance: "Distance of the second camera's events from the edges predicted by the trajectory of the first camera",
        unit: "rms (σ of an event)",
    };
    const POINTS: Self = Self {
        name: "points",
        distance: "Distance of the points in the second camera's frames from their positions predicted by the trajectory of the first camera",
        unit: "rms (σ of a point)",
    };
}

fn over_time(misfit: &[Misfit], seen: &Seen) -> Markup {
    let piece = misfit.len().div_ceil(POINTS).max(1);
    let mean = |piece: &[Misfit]| {
        let squares: f64 = piece.iter().map(|one| one.rms * one.rms).sum();
        (piece.first().map_or(0.0, |one| one.t), (squares / piece.len().max(1) as f64).sqrt())
    };
    let curve: Vec<(f64, f64)> = misfit.chunks(piece).map(mean).collect();
    let x = range_of(curve.iter().map(|point| point.0), 1.0);
    let top = range_of(curve.iter().map(|point| point.1).chain([0.0]), 1e-6).end;
    let series =
        vec![Series { name: seen.name.to_owned(), color: Color::First, curves: vec![curve], points: Vec::new() }];
    let description = "Residuals of the second camera over time.".to_owned();
    Chart { description, x_label: "time of the first camera (s)", y_label: seen.unit, x, y: 0.0..top, series }.render()
}
