//! First estimate of the camera by OpenCV's calibration.

use evcal_core::camera::conversion::inverse_radial_from_radtan;
use evcal_core::camera::refit::refit_where;
use evcal_core::camera::{Camera, ModelKind};
use evcal_core::sensor::Sensor;
use nalgebra::Vector2;

use evcal_geometry::numerics::statistics::median;
use evcal_solve::initial::{BoardPoint, InitialSettings, MAX_START_RMS, OpencvStart};

use crate::{
    Intrinsics, OpencvCalibration, OpencvError, PinholeDistortion, View, calibrate_fisheye, calibrate_pinhole,
};

/// Largest number of times that the worst views are excluded.
const RETRIES: usize = 3;

fn view_of(points: &[BoardPoint]) -> View {
    View {
        object: points.iter().map(|point| [point.object.x, point.object.y]).collect(),
        image: points.iter().map(|point| [point.image.x, point.image.y]).collect(),
    }
}

/// A camera model that OpenCV calibrates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum OpencvModel {
    Pinhole(PinholeDistortion),
    Fisheye,
}

/// Returns the calibrations of OpenCV that can start a camera of model `kind`. If there are several, [`opencv_start`]
/// uses the one with the smallest error.
///
/// The rational model starts from the plain one with five coefficients, because its eight coefficients are strongly
/// correlated. A model that OpenCV does not support starts from a similar one: the inverse radial model from a radial
/// one, the wide models from a fisheye camera (which fits wide lenses) or a pinhole camera (which fits narrow ones).
fn opencv_models(kind: ModelKind) -> &'static [OpencvModel] {
    use OpencvModel::{Fisheye, Pinhole};
    match kind {
        ModelKind::Radtan4 => &[Pinhole(PinholeDistortion::RadialTangential4)],
        ModelKind::Radtan | ModelKind::Radtan8 => &[Pinhole(PinholeDistortion::RadialTangential5)],
        ModelKind::InverseRadial => &[Pinhole(PinholeDistortion::Radial3)],
        ModelKind::KannalaBrandt => &[Fisheye],
        _ => &[Fisheye, Pinhole(PinholeDistortion::RadialTangential4)],
    }
}

/// Converts the result of OpenCV's `model` to a camera of model `kind`; `covered` is the distance from the principal
/// point up to which the views reach (px).
fn camera_of(
    kind: ModelKind,
    model: OpencvModel,
    calibration: &OpencvCalibration,
    sensor: Sensor,
    covered: f64,
) -> Option<Camera<f64>> {
    let intrinsics = &calibration.intrinsics;
    let mut parameters = [intrinsics.focal, intrinsics.center].concat();
    parameters.extend_from_slice(&intrinsics.distortion);
    match kind {
        ModelKind::InverseRadial => match Camera::from_parameters(ModelKind::Radtan, &parameters)? {
            Camera::Radtan(radtan) => inverse_radial_from_radtan(&radtan, sensor).map(Camera::InverseRadial),
            _ => None,
        },
        ModelKind::Radtan4 | ModelKind::Radtan | ModelKind::Radtan8 | ModelKind::KannalaBrandt => {
            parameters.resize(kind.parameter_names().len(), 0.0);
            Camera::from_parameters(kind, &parameters)
        }
        _ => {
            let near = match model {
                OpencvModel::Pinhole(_) => ModelKind::Radtan4,
                OpencvModel::Fisheye => ModelKind::KannalaBrandt,
            };
            let near = Camera::from_parameters(near, &parameters).filter(|near| plausible(near, sensor))?;
            let center = Vector2::from(intrinsics.center);
            refit_where(kind, &near, sensor, |pixel| (pixel - center).norm() <= covered)
        }
    }
}

fn calibrate(model: OpencvModel, views: &[View], sensor: Sensor) -> Result<OpencvCalibration, OpencvError> {
    match model {
        OpencvModel::Pinhole(distortion) => calibrate_pinhole(views, sensor, distortion, None),
        OpencvModel::Fisheye => calibrate_fisheye(views, sensor),
    }
}

/// Returns the distance from `center` up to which the views reach (px).
fn covered_radius(views: &[View], center: [f64; 2]) -> f64 {
    let points = views.iter().flat_map(|view| &view.image);
    points.map(|[x, y]| (x - center[0]).hypot(y - center[1])).fold(0.0, f64::max)
}

/// Returns `false` for an implausible camera: a field of view below 6° or far above 180°, very different focal lengths
/// along x and y, or a principal point outside the sensor.
fn plausible(camera: &Camera<f64>, sensor: Sensor) -> bool {
    let (width, height) = (f64::from(sensor.width), f64::from(sensor.height));
    let diagonal = width.hypot(height);
    match (camera.axial_focal_lengths(), camera.parameters().as_slice()) {
        (Some([fx, fy]), &[_, _, cx, cy, ..]) => {
            let focal = (0.15 * diagonal..=10.0 * diagonal).contains(&fx) && (0.8..=1.25).contains(&(fx / fy));
            focal && (0.0..=width).contains(&cx) && (0.0..=height).contains(&cy)
        }
        _ => false,
    }
}

/// Calibrates from `views` with OpenCV, and returns the result as a camera of model `kind`.
pub fn opencv_start(
    kind: ModelKind,
    views: &[&[BoardPoint]],
    sensor: Sensor,
    settings: &InitialSettings,
) -> (Option<Camera<f64>>, OpencvStart) {
    let views: Vec<View> = views.iter().map(|points| view_of(points)).collect();
    let mut best: Option<(Option<Camera<f64>>, OpencvStart)> = None;
    for &model in opencv_models(kind) {
        let start = start_from(kind, model, views.clone(), sensor, settings);
        let error = |start: &OpencvStart| start.rms.unwrap_or(f64::INFINITY);
        if best.as_ref().is_none_or(|best| error(&start.1) < error(&best.1)) {
            best = Some(start);
        }
    }
    best.unwrap_or((None, OpencvStart { views: (views.len(), 0), rms: None, failure: None }))
}

/// Calibrates with OpenCV's `model`, and returns the result as a camera of model `kind`. While its error exceeds the
/// limit in the settings, the worst views are excluded and the calibration is repeated.
fn start_from(
    kind: ModelKind,
    model: OpencvModel,
    mut views: Vec<View>,
    sensor: Sensor,
    settings: &InitialSettings,
) -> (Option<Camera<f64>>, OpencvStart) {
    let mut start = OpencvStart { views: (views.len(), views.len()), rms: None, failure: None };
    let mut best: Option<(Camera<f64>, f64)> = None;
    for _ in 0..=RETRIES {
        let calibration = match calibrate(model, &views, sensor) {
            Ok(calibration) => calibration,
            Err(error) => {
                start.failure = Some(error.to_string());
                break;
            }
        };
        let covered = covered_radius(&views, calibration.intrinsics.center);
        let camera = camera_of(kind, model, &calibration, sensor, covered);
        match camera.filter(|camera| plausible(camera, sensor)) {
            Some(camera) if best.is_none_or(|(_, rms)| calibration.rms < rms) => {
                best = Some((camera, calibration.rms));
                start.views.1 = calibration.views.len();
                start.rms = Some(calibration.rms);
                start.failure = None;
            }
            Some(_) => {}
            None => {
                let Intrinsics { focal: [fx, fy], center: [cx, cy], .. } = calibration.intrinsics;
                start.failure = Some(format!(
                    "the result is not a plausible lens (focal lengths {fx:.0} and {fy:.0} px, principal point {cx:.0}, {cy:.0})"
                ));
            }
        }
        if calibration.rms <= MAX_START_RMS {
            break;
        }
        // At least half of the views are always kept, because a wrong calibration would otherwise select the views that
        // confirm it.
        let bound = median(&mut calibration.view_rms.clone(), f64::total_cmp).unwrap_or(0.0) * 1.5;
        let kept: Vec<View> = calibration
            .views
            .iter()
            .zip(&calibration.view_rms)
            .filter(|(_, rms)| **rms <= bound)
            .filter_map(|(&view, _)| views.get(view).cloned())
            .collect();
        if kept.len() < settings.min_frames || kept.len() == views.len() {
            break;
        }
        views = kept;
    }
    (best.map(|(camera, _)| camera), start)
}
