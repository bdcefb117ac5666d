//! Weak prior on the distortion: a distortion term is expected to be no larger than in real lenses.

use evcal_core::camera::expectation::CoefficientEffect;
use evcal_core::camera::{Camera, MAX_PARAMETERS};
use evcal_core::sensor::Sensor;
use nalgebra::SVector;

/// Fraction of the radius that one distortion term is expected to change at the farthest corner.
const PRIOR_CHANGE: f64 = 0.3;

/// Pixel noise for which [`distortion_prior`] weighs the prior against residuals in pixels.
const PRIOR_NOISE: f64 = 0.1;

/// Gaussian prior of the distortion coefficients.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DistortionPrior {
    /// Weight in px² of the squared deviation of each parameter; zero for parameters without a prior.
    pub weights: [f64; MAX_PARAMETERS],
    /// Expected value of each parameter.
    pub expected: [f64; MAX_PARAMETERS],
}

/// Returns the prior for a camera's model.
///
/// A radial term is expected to change the radius at the corner farthest from the principal point by a fraction of
/// about `PRIOR_CHANGE`. Its weights are for residuals with a noise of 0.1 px.
pub fn distortion_prior(camera: &Camera<f64>, sensor: Sensor) -> DistortionPrior {
    let mut prior = DistortionPrior { weights: [0.0; MAX_PARAMETERS], expected: [0.0; MAX_PARAMETERS] };
    let &[fx, fy, cx, cy, ..] = camera.parameters().as_slice() else { return prior };
    let (right, bottom) = (f64::from(sensor.width) - 1.0, f64::from(sensor.height) - 1.0);
    let corner = (cx.max(right - cx) / fx).powi(2) + (cy.max(bottom - cy) / fy).powi(2);
    let slots = prior.weights.iter_mut().zip(&mut prior.expected).skip(4);
    for ((weight, expected), effect) in slots.zip(camera.kind().expectation().effects) {
        match *effect {
            CoefficientEffect::Free => {}
            CoefficientEffect::Radial(power) => *weight = (PRIOR_NOISE * corner.powi(power) / PRIOR_CHANGE).powi(2),
            CoefficientEffect::Shape(value) => (*weight, *expected) = (PRIOR_NOISE * PRIOR_NOISE, value),
        }
    }
    prior
}

/// Contribution of a prior to the normal equations of the camera's parameters.
pub struct PriorEquations {
    /// Added to the diagonal.
    pub weights: SVector<f64, MAX_PARAMETERS>,
    /// Added to the gradient.
    pub gradient: SVector<f64, MAX_PARAMETERS>,
}

impl DistortionPrior {
    /// Returns the same prior, weighed against residuals whose standard deviation along one axis is `noise` (px).
    pub fn against(mut self, noise: f64) -> Self {
        for weight in &mut self.weights {
            *weight *= (noise / PRIOR_NOISE).powi(2);
        }
        self
    }

    /// Returns the standard deviation of parameter `index` around its expected value; `None` if it has no prior.
    pub fn sigma(&self, index: usize) -> Option<f64> {
        self.weights.get(index).filter(|weight| **weight > 0.0).map(|weight| PRIOR_NOISE / weight.sqrt())
    }

    /// Returns the contribution of the prior to the cost of `camera`.
    pub fn cost(&self, camera: &Camera<f64>) -> f64 {
        let parameters = camera.parameters();
        let expected = self.weights.iter().zip(&self.expected);
        parameters.iter().zip(expected).map(|(value, (weight, expected))| weight * (value - expected).powi(2)).sum()
    }

    /// Returns the contribution of the prior to the normal equations at `camera`; only the `free` parameters are
    /// estimated.
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
