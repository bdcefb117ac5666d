//! What is expected of a distortion before anything is seen: weakly, that no term bends the image more than lenses do.

use evcal_core::camera::{Camera, MAX_PARAMETERS, ModelKind};
use evcal_core::sensor::Sensor;
use nalgebra::SVector;

/// Part of the radius that one distortion term is expected to change at the furthest corner.
const PRIOR_CHANGE: f64 = 0.3;

/// Pixel noise for which the prior has its nominal weight.
const PRIOR_NOISE: f64 = 0.1;

/// What is expected of the distortion before anything is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DistortionPrior {
    /// Weight in px² of the squared deviation of each parameter; zero for those without a prior.
    pub weights: [f64; MAX_PARAMETERS],
    /// Expected value of each parameter.
    pub expected: [f64; MAX_PARAMETERS],
}

/// What a coefficient does.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Coefficient {
    /// Adds this power of the squared radius to the radius, as a part of it.
    Radial(i32),
    /// Is determined by few views.
    Free,
    /// Is about so large, give or take 1: the shape of a wide model, which a narrow view leaves open.
    Shape(f64),
}

/// The prior of a camera's model.
///
/// Radial terms are expected to change the radius at the corner furthest from the principal point by
/// `PRIOR_CHANGE` of itself, more or less.
pub fn distortion_prior(camera: &Camera<f64>, sensor: Sensor) -> DistortionPrior {
    use Coefficient::{Free, Radial, Shape};
    let mut prior = DistortionPrior { weights: [0.0; MAX_PARAMETERS], expected: [0.0; MAX_PARAMETERS] };
    let &[fx, fy, cx, cy, ..] = camera.parameters().as_slice() else { return prior };
    let (right, bottom) = (f64::from(sensor.width) - 1.0, f64::from(sensor.height) - 1.0);
    let corner = (cx.max(right - cx) / fx).powi(2) + (cy.max(bottom - cy) / fy).powi(2);
    let coefficients: &[Coefficient] = match camera.kind() {
        ModelKind::Radtan4 => &[Radial(1), Radial(2), Free, Free],
        ModelKind::Radtan => &[Radial(1), Radial(2), Free, Free, Radial(3)],
        ModelKind::Radtan8 => &[Radial(1), Radial(2), Free, Free, Radial(3), Radial(1), Radial(2), Radial(3)],
        ModelKind::KannalaBrandt => &[Radial(1), Radial(2), Radial(3), Radial(4)],
        ModelKind::InverseRadial => &[Radial(1), Radial(2), Radial(3), Radial(4), Radial(5)],
        ModelKind::Ucm | ModelKind::Fov => &[Free],
        ModelKind::Eucm => &[Free, Shape(1.0)],
        ModelKind::DoubleSphere => &[Shape(0.0), Free],
        ModelKind::Omni => &[Shape(1.0), Radial(1), Radial(2), Free, Free],
    };
    let slots = prior.weights.iter_mut().zip(&mut prior.expected).skip(4);
    for ((weight, expected), coefficient) in slots.zip(coefficients) {
        match *coefficient {
            Free => {}
            Radial(power) => *weight = (PRIOR_NOISE * corner.powi(power) / PRIOR_CHANGE).powi(2),
            Shape(value) => (*weight, *expected) = (PRIOR_NOISE * PRIOR_NOISE, value),
        }
    }
    prior
}

/// What a prior adds to the normal equations of the camera's parameters.
pub struct PriorEquations {
    /// Added to the diagonal.
    pub weights: SVector<f64, MAX_PARAMETERS>,
    /// Added to the gradient.
    pub gradient: SVector<f64, MAX_PARAMETERS>,
}

impl DistortionPrior {
    /// What the prior adds to the cost of `camera`.
    pub fn cost(&self, camera: &Camera<f64>) -> f64 {
        let parameters = camera.parameters();
        let expected = self.weights.iter().zip(&self.expected);
        parameters.iter().zip(expected).map(|(value, (weight, expected))| weight * (value - expected).powi(2)).sum()
    }

    /// What the prior adds to the normal equations at `camera`, of which the `free` parameters may change.
    pub fn equations(&self, camera: &Camera<f64>, free: &[bool]) -> PriorEquations {
        let mut equations = PriorEquations { weights: SVector::zeros(), gradient: SVector::zeros() };
        let expected = self.weights.iter().zip(&self.expected);
        let values = camera.parameters();
        for (index, ((value, (weight, expected)), _)) in
            values.iter().zip(expected).zip(free).enumerate().filter(|(_, (_, free))| **free)
        {
            equations.weights[index] = *weight;
            equations.gradient[index] = weight * (value - expected);
        }
        equations
    }
}
