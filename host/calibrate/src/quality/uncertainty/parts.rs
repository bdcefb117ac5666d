//! Causes of the reported uncertainty.

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use super::projection::{NoView, projection_uncertainty};

/// Covariances of the intrinsics by cause. Their sum is the reported covariance without the misfit of the lens model.
#[derive(Clone, Debug, PartialEq)]
pub struct CovarianceParts {
    /// Noise of the events, as if they were independent.
    pub noise: DMatrix<f64>,
    /// Common errors of neighbouring events, and changes between parts of the recording.
    pub between_parts: DMatrix<f64>,
    /// Errors that the event biases leave, the same in all parts of the recording.
    pub event_model: DMatrix<f64>,
    /// Lower limit of the σ of the focal lengths.
    pub focal_lengths: DMatrix<f64>,
}

/// Contribution of each cause to the uncertainty of the projection (root mean square over the sensor, in pixels). The squares add
/// up to the square of the total.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ProjectionParts {
    /// Contribution of [`CovarianceParts::noise`].
    pub noise: f64,
    /// Contribution of [`CovarianceParts::between_parts`].
    pub between_parts: f64,
    /// Contribution of [`CovarianceParts::event_model`].
    pub event_model: f64,
    /// Contribution of [`CovarianceParts::focal_lengths`].
    pub focal_lengths: f64,
    /// Contribution of the misfit of the lens model.
    pub misfit: f64,
}

impl CovarianceParts {
    /// Converts the covariances to uncertainties in the image of `camera`, together with the covariance `misfit` that was added
    /// for the misfit of its model.
    ///
    /// # Errors
    /// [`NoView`] if the lens covers almost nothing of the sensor.
    pub fn projection(
        &self,
        camera: &Camera<f64>,
        misfit: &DMatrix<f64>,
        sensor: Sensor,
    ) -> Result<ProjectionParts, NoView> {
        let Self { noise, between_parts, event_model, focal_lengths } = self;
        let rms = |covariance: &DMatrix<f64>| Ok(projection_uncertainty(camera, covariance, sensor)?.rms);
        Ok(ProjectionParts {
            noise: rms(noise)?,
            between_parts: rms(between_parts)?,
            event_model: rms(event_model)?,
            focal_lengths: rms(focal_lengths)?,
            misfit: rms(misfit)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use evcal_core::camera::ModelKind;
    use nalgebra::DVector;

    use super::*;

    #[test]
    fn squared_shares_add_up_to_the_squared_uncertainty() {
        let parameters = [331.0, 332.0, 176.0, 134.0, -0.35, 0.15, -4e-4, 5e-4, -0.03];
        let camera = Camera::from_parameters(ModelKind::Radtan, &parameters).unwrap();
        let sensor = Sensor::new(346, 260);
        let of = |sigma: [f64; 9]| DMatrix::from_diagonal(&DVector::from_fn(9, |row, _| sigma[row] * sigma[row]));
        let parts = CovarianceParts {
            noise: of([0.01, 0.01, 0.02, 0.02, 1e-4, 2e-4, 1e-5, 1e-5, 1e-4]),
            between_parts: of([0.02, 0.02, 0.03, 0.03, 3e-4, 3e-4, 1e-5, 1e-5, 1e-4]),
            event_model: of([0.01, 0.02, 0.0, 0.01, 0.0, 0.0, 0.0, 0.0, 0.0]),
            focal_lengths: of([0.05, 0.05, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        };
        let misfit = of([0.1, 0.1, 0.1, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let stated = &parts.noise + &parts.between_parts + &parts.event_model + &parts.focal_lengths + &misfit;
        let shares = parts.projection(&camera, &misfit, sensor).unwrap();
        let all = [shares.noise, shares.between_parts, shares.event_model, shares.focal_lengths, shares.misfit];
        let sum: f64 = all.iter().map(|share| share * share).sum();
        let rms = projection_uncertainty(&camera, &stated, sensor).unwrap().rms;
        assert!((sum.sqrt() - rms).abs() < 1e-9 * rms && all.iter().all(|share| *share > 0.0), "{shares:?}");
        assert_eq!(parts.projection(&camera, &DMatrix::zeros(9, 9), sensor).unwrap().misfit, 0.0);
    }
}
