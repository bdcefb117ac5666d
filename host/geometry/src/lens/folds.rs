//! Detection of distortion that folds over inside the image: beyond the fold, a pixel has no bearing.

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use nalgebra::{Vector2, Vector3};

/// Step between the pixels examined, along rows and columns.
const STEP: usize = 4;

/// Returns the fraction of the sensor's pixels, 0 to 1, that have no bearing.
pub fn folded_share(camera: &Camera<f64>, Sensor { width, height }: Sensor) -> f64 {
    let pixels = (0..height).step_by(STEP).flat_map(|y| (0..width).step_by(STEP).map(move |x| (x, y)));
    let (right, bottom) = (width.saturating_sub(1), height.saturating_sub(1));
    let corners = [(0, 0), (right, 0), (0, bottom), (right, bottom)];
    let (mut count, mut folded) = (0_usize, 0_usize);
    for (x, y) in pixels.chain(corners) {
        count += 1;
        folded += usize::from(camera.unproject(&Vector2::new(f64::from(x), f64::from(y))).is_none());
    }
    folded as f64 / count as f64
}

/// Number of directions from the optical axis, and step between angles to the axis (rad).
const DIRECTIONS: usize = 48;
const ANGLE_STEP: f64 = 0.005;
/// Number of steps, from the axis to 114°.
const STEPS: usize = 400;
/// A step in the image that is this many times as long as the previous one is a jump.
const JUMP: f64 = 4.0;

/// Returns `true` if some pixels have no bearing, or if the distortion [`jumps`].
pub fn folds(camera: &Camera<f64>, sensor: Sensor) -> bool {
    folded_share(camera, sensor) > 0.0 || jumps(camera, sensor)
}

/// Returns `true` if the distortion turns back or jumps inside the image, as in `radtan8` at a pole.
pub fn jumps(camera: &Camera<f64>, sensor: Sensor) -> bool {
    (0..DIRECTIONS).any(|direction| breaks_off(camera, sensor, direction))
}

/// Returns `true` if bearings with increasing angle to the axis do not move steadily outwards until they leave the
/// image.
fn breaks_off(camera: &Camera<f64>, Sensor { width, height }: Sensor, direction: usize) -> bool {
    let (sin, cos) = (std::f64::consts::TAU * direction as f64 / DIRECTIONS as f64).sin_cos();
    let Some(center) = camera.project(&Vector3::z()) else { return true };
    let (right, bottom) = (f64::from(width) - 1.0, f64::from(height) - 1.0);
    let (mut farthest, mut last) = (0.0, f64::INFINITY);
    for step in 1..STEPS {
        let (across, along) = (ANGLE_STEP * step as f64).sin_cos();
        let Some(pixel) = camera.project(&Vector3::new(across * cos, across * sin, along)) else { return true };
        let distance = (pixel - center).norm();
        let growth = distance - farthest;
        if growth <= 0.0 || growth > JUMP * last {
            return true;
        }
        if !(0.0..=right).contains(&pixel.x) || !(0.0..=bottom).contains(&pixel.y) {
            return false;
        }
        (farthest, last) = (distance, growth);
    }
    false
}

#[cfg(test)]
mod tests {
    use evcal_core::camera::ModelKind;

    use super::*;

    /// r (1 − 0.35 r²) turns back at r = 1 / √1.05 = 0.976, where it is 0.651 of a focal length.
    #[test]
    fn the_corners_beyond_the_turning_point_are_folded() {
        let camera = |focal: f64| {
            let parameters = [focal, focal, 99.5, 99.5, -0.35, 0.0, 0.0, 0.0];
            Camera::from_parameters(ModelKind::Radtan4, &parameters).unwrap()
        };
        let sensor = Sensor::new(200, 200);
        assert_eq!(folded_share(&camera(300.0), sensor), 0.0);
        // The corners are 141 px from the middle, but only pixels within 120 px have a bearing. The folded share is the
        // part of a square of 200 px that lies outside a circle of 120 px radius.
        let half = 99.5_f64;
        let radius = 0.651 * 120.0 / 0.651;
        let angle = (half / radius).acos();
        let inside = (std::f64::consts::FRAC_PI_4 - angle) * radius * radius + half * radius * angle.sin();
        let outside = 1.0 - inside / (half * half);
        let found = folded_share(&camera(120.0 / 0.651), sensor);
        assert!((found - outside).abs() < 0.01, "{found} {outside}");
    }

    /// r (1 − r² / zero²) / (1 − r² / pole²) is nearly r except close to the pole. Just before the pole it grows
    /// without limit, so every pixel farther out has a bearing there.
    #[test]
    fn a_jump_at_a_pole_is_a_fold() {
        let camera = |zero: f64, pole: f64| {
            let (k1, k4) = (-1.0 / zero.powi(2), -1.0 / pole.powi(2));
            let parameters = [100.0, 100.0, 159.5, 159.5, k1, 0.0, 0.0, 0.0, 0.0, k4, 0.0, 0.0];
            Camera::from_parameters(ModelKind::Radtan8, &parameters).unwrap()
        };
        // The pole is 199 px and the corners are 226 px from the middle of the image.
        let sensor = Sensor::new(320, 320);
        assert_eq!(folded_share(&camera(1.9901, 1.99), sensor), 0.0);
        assert!(folds(&camera(1.9901, 1.99), sensor));
        assert!(!folds(&camera(f64::INFINITY, f64::INFINITY), sensor));
        assert!(!folds(&camera(2.9901, 2.99), sensor), "outside the image");
    }
}
