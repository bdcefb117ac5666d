//! Whether a distortion folds over inside the image: beyond the fold, a pixel belongs to no bearing.

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use nalgebra::Vector2;

/// Every so many pixels are looked at, along rows and columns.
const STEP: usize = 4;

/// Share of the sensor's pixels, 0 to 1, that belong to no bearing.
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
        // 120 px from the middle, of the 141 px to a corner: the share of a square of 200 px outside a circle of 120 px.
        let half = 99.5_f64;
        let radius = 0.651 * 120.0 / 0.651;
        let angle = (half / radius).acos();
        let inside = (std::f64::consts::FRAC_PI_4 - angle) * radius * radius + half * radius * angle.sin();
        let outside = 1.0 - inside / (half * half);
        let found = folded_share(&camera(120.0 / 0.651), sensor);
        assert!((found - outside).abs() < 0.01, "{found} {outside}");
    }
}
