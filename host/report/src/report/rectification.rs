//! The ideal camera that shows pictures without the distortion of the lens.

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use evcal_core::undistortion::IdealCamera;
use nalgebra::{Point3, Vector2, Vector3};

/// Largest angle from the optical axis in a rectified picture (rad).
const WIDEST: f64 = 1.2;

/// Returns an ideal camera with as many pixels as the sensor. Its image contains the midpoints of the sensor's sides.
pub fn ideal_camera(camera: &Camera<f64>, Sensor { width, height }: Sensor) -> IdealCamera<f64> {
    let (right, bottom) = (f64::from(width) - 1.0, f64::from(height) - 1.0);
    let (cx, cy) = (0.5 * right, 0.5 * bottom);
    let tangent = |pixel: [f64; 2]| {
        let angle = camera.unproject(&Vector2::from(pixel)).map_or(WIDEST, |bearing| bearing.angle(&Vector3::z()));
        libm::tan(angle.min(WIDEST)).max(1e-3)
    };
    let across = tangent([0.0, cy]).max(tangent([right, cy]));
    let down = tangent([cx, 0.0]).max(tangent([cx, bottom]));
    let focal = (cx / across).min(cy / down).max(1.0);
    IdealCamera { fx: focal, fy: focal, cx, cy }
}

/// Returns the pixel of `camera` that shows the same direction as `pixel` of `ideal`.
pub fn distorted(camera: &Camera<f64>, ideal: &IdealCamera<f64>, pixel: Vector2<f64>) -> Option<Vector2<f64>> {
    camera.project(&Vector3::new((pixel.x - ideal.cx) / ideal.fx, (pixel.y - ideal.cy) / ideal.fy, 1.0))
}

/// Projects a point in camera coordinates with the ideal camera.
pub fn projected(ideal: &IdealCamera<f64>, point: &Point3<f64>) -> Option<Vector2<f64>> {
    (point.z > 0.0)
        .then(|| Vector2::new(ideal.fx * point.x / point.z + ideal.cx, ideal.fy * point.y / point.z + ideal.cy))
}

#[cfg(test)]
mod tests {
    use super::*;
    use evcal_core::camera::ModelKind;

    #[test]
    fn the_ideal_camera_shows_the_midpoints_of_all_sides() {
        let camera =
            Camera::from_parameters(ModelKind::Radtan4, &[330.0, 331.0, 172.0, 130.0, -0.35, 0.12, 0.0, 0.0]).unwrap();
        let ideal = ideal_camera(&camera, Sensor::new(346, 260));
        let mut nearest = f64::INFINITY;
        for side in [[0.0, 129.5], [345.0, 129.5], [172.5, 0.0], [172.5, 259.0]] {
            let seen = projected(&ideal, &Point3::from(camera.unproject(&Vector2::from(side)).unwrap())).unwrap();
            assert!((-1.0..=346.0).contains(&seen.x) && (-1.0..=260.0).contains(&seen.y), "{side:?}: {seen}");
            let back = distorted(&camera, &ideal, seen).unwrap();
            assert!((back - Vector2::from(side)).norm() < 1e-6);
            nearest = nearest.min(seen.x.min(345.0 - seen.x)).min(seen.y.min(259.0 - seen.y));
        }
        // A larger focal length would cut off a midpoint.
        assert!(nearest < 2.0, "{nearest}");
    }
}
