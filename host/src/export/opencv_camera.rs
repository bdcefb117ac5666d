//! The camera as OpenCV can hold it.

use std::fmt;

use evcal_core::camera::refit::{Difference, difference_where, refit_where};
use evcal_core::camera::{Camera, ModelKind};
use nalgebra::Vector2;

/// A camera of a model that OpenCV has.
#[derive(Clone, Debug)]
pub struct OpencvCamera {
    /// The camera.
    pub camera: Camera<f64>,
    /// What it cost to get it, where the calibrated model is another one.
    pub refit: Option<Refit>,
}

/// How a camera was replaced by the nearest one of another model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Refit {
    /// The calibrated model.
    pub from: ModelKind,
    /// The model that replaces it.
    pub to: ModelKind,
    /// Distance from the principal point up to which the cameras were brought together (px).
    pub radius: f64,
    /// How far they are apart there.
    pub difference: Difference<f64>,
}

impl fmt::Display for Refit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "OpenCV has no model {}: {} fitted to it within {:.0} px of the principal point, {:.4} px rms and {:.4} px \
             at most away from it there",
            self.from, self.to, self.radius, self.difference.root_mean_square, self.difference.largest
        )
    }
}

/// The camera that OpenCV gets for a calibrated `camera` on a `sensor` (width, height) on which the
/// board was seen up to `covered` pixels from the principal point.
///
/// A model that OpenCV lacks is replaced by the nearest `radtan` over the covered region: no
/// coefficient is dropped. `None` if there is none.
pub fn opencv_camera(camera: &Camera<f64>, sensor: (u16, u16), covered: f64) -> Option<OpencvCamera> {
    let from = camera.kind();
    match from {
        ModelKind::Radtan4 | ModelKind::Radtan | ModelKind::Radtan8 | ModelKind::KannalaBrandt => {
            Some(OpencvCamera { camera: *camera, refit: None })
        }
        ModelKind::InverseRadial => {
            let to = ModelKind::Radtan;
            let parameters = camera.parameters();
            let (&[_, _, cx, cy], _) = parameters.split_first_chunk::<4>()?;
            let inside = |pixel: &Vector2<f64>| (pixel - Vector2::new(cx, cy)).norm() <= covered;
            let near = refit_where(to, camera, sensor.0, sensor.1, inside)?;
            let difference = difference_where(camera, &near, sensor.0, sensor.1, inside);
            Some(OpencvCamera { camera: near, refit: Some(Refit { from, to, radius: covered, difference }) })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SENSOR: (u16, u16) = (346, 260);

    fn inverse_radial() -> Camera<f64> {
        let parameters = [335.3, 334.9, 171.2, 128.8, 0.33, 0.16, 0.09, 0.04, 0.02];
        Camera::from_parameters(ModelKind::InverseRadial, &parameters).unwrap()
    }

    #[test]
    fn an_inverse_radial_camera_becomes_radtan_and_says_what_that_costs() {
        let camera = inverse_radial();
        let OpencvCamera { camera: near, refit } = opencv_camera(&camera, SENSOR, 190.0).unwrap();
        let refit = refit.unwrap();
        assert_eq!((near.kind(), refit.from), (ModelKind::Radtan, ModelKind::InverseRadial));
        let mut largest: f64 = 0.0;
        for step in 0..360 {
            let angle = f64::from(step).to_radians();
            let pixel = Vector2::new(171.2, 128.8) + Vector2::new(angle.cos(), angle.sin()) * 120.0;
            let bearing = camera.unproject(&pixel).unwrap();
            largest = largest.max((near.project(&bearing).unwrap() - pixel).norm());
        }
        assert!(largest <= refit.difference.largest * 1.01 && refit.difference.largest < 0.05, "{largest}: {refit}");
        assert!(refit.to_string().contains("inverse-radial: radtan fitted to it within 190 px"), "{refit}");
    }

    #[test]
    fn what_was_never_seen_has_no_twin() {
        assert!(opencv_camera(&inverse_radial(), SENSOR, 0.0).is_none());
    }

    #[test]
    fn models_of_opencv_stay_as_they_are() {
        let parameters = [300.0, 300.0, 172.5, 129.5, -0.3, 0.1, 0.0, 0.0];
        let camera = Camera::from_parameters(ModelKind::Radtan4, &parameters).unwrap();
        let kept = opencv_camera(&camera, SENSOR, 10.0).unwrap();
        assert!(kept.camera == camera && kept.refit.is_none());
    }
}
