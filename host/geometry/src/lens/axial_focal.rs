//! Derivatives of the focal lengths at the optical axis with respect to a camera's parameters.

use evcal_core::camera::{Camera, MAX_PARAMETERS};

/// Returns the derivatives of the focal lengths at the optical axis (fx, fy) with respect to each of the camera's
/// parameters.
pub fn axial_focal_gradients(camera: &Camera<f64>) -> Option<[[f64; MAX_PARAMETERS]; 2]> {
    const STEP: f64 = 1e-6;
    let parameters = camera.parameters();
    let here = camera.axial_focal_lengths()?;
    let mut gradients = [[0.0; MAX_PARAMETERS]; 2];
    for index in 0..parameters.len() {
        let mut moved = parameters.clone();
        let value = moved.get_mut(index)?;
        let step = STEP * (1.0 + value.abs());
        *value += step;
        let there = Camera::from_parameters(camera.kind(), &moved)?.axial_focal_lengths()?;
        for (gradient, (there, here)) in gradients.iter_mut().zip(there.iter().zip(&here)) {
            if let Some(slot) = gradient.get_mut(index) {
                *slot = (there - here) / step;
            }
        }
    }
    Some(gradients)
}
