//! Uncertainty of the projection, from the covariance of the intrinsics.
//!
//! It is the displacement of a bearing's projection under errors of the intrinsics. The best-fitting rotation over the sensor is
//! removed ([`projection_sensitivity`](mod@evcal_geometry::lens::projection_sensitivity)), so that the result can be compared
//! with a [`projection_difference`](mod@evcal_geometry::lens::projection_difference).

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use nalgebra::{DMatrix, Matrix2, SymmetricEigen, Vector2};
use serde::Serialize;

use evcal_geometry::lens::projection_difference::{grid, grid_size};
use evcal_geometry::lens::projection_sensitivity::projection_sensitivity;

/// Uncertainty of the projection at one pixel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct GridUncertainty {
    /// The pixel.
    pub pixel: [f64; 2],
    /// Largest standard deviation of the projection over all directions, in pixels; `None` outside the domain of the lens model.
    pub sigma: Option<f64>,
}

/// Uncertainty of the projection over the sensor.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ProjectionUncertainty {
    /// Columns of the grid, from the first to the last pixel of a row.
    pub columns: u16,
    /// Rows of the grid, from the first to the last pixel of a column.
    pub rows: u16,
    /// The uncertainty, row by row.
    pub grid: Vec<GridUncertainty>,
    /// Expected root mean square distance from the true projection over the sensor (px).
    pub rms: f64,
    /// 95 % bound of that root mean square (px).
    pub rms_95: f64,
    /// Greatest standard deviation (px).
    pub max: f64,
    /// The pixel where it is greatest.
    pub max_at: [f64; 2],
}

/// The lens model covers too little of the sensor, or the covariance is not of its parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the lens model sees fewer than 3 points of the sensor")]
pub struct NoView;

/// Computes the projection uncertainty of `camera` on `sensor` from the covariance of its parameters, in their order.
///
/// # Errors
/// [`NoView`] if the lens covers almost nothing of the sensor.
pub fn projection_uncertainty(
    camera: &Camera<f64>,
    covariance: &DMatrix<f64>,
    sensor: Sensor,
) -> Result<ProjectionUncertainty, NoView> {
    let pixels = grid(sensor);
    let count = camera.parameters().len();
    if covariance.shape() != (count, count) {
        return Err(NoView);
    }
    let sensitivity = projection_sensitivity(camera, &pixels).ok_or(NoView)?;
    let mut worst = (0.0, Vector2::zeros());
    let uncertain = sensitivity.changes.iter().zip(&pixels).map(|(change, pixel)| {
        let sigma = change.as_ref().map(|change| {
            let spread = change * covariance * change.transpose();
            let spread = Matrix2::new(spread[(0, 0)], spread[(0, 1)], spread[(1, 0)], spread[(1, 1)]);
            let sigma = spread.symmetric_eigenvalues().max().max(0.0).sqrt();
            if sigma > worst.0 {
                worst = (sigma, *pixel);
            }
            sigma
        });
        GridUncertainty { pixel: (*pixel).into(), sigma }
    });
    let grid: Vec<GridUncertainty> = uncertain.collect();
    // With the root L of the covariance C = L Lᵀ: tr C Q = tr Lᵀ Q L, and tr (C Q)² is the squared norm of Lᵀ Q L. The product C Q
    // itself may have large entries of both signs whose squares do not cancel exactly, so that the variance would become negative.
    let SymmetricEigen { mut eigenvectors, eigenvalues } = covariance.clone().symmetric_eigen();
    for (mut column, variance) in eigenvectors.column_iter_mut().zip(&eigenvalues) {
        column *= variance.max(0.0).sqrt();
    }
    let root = eigenvectors;
    let spread = root.tr_mul(&sensitivity.squares) * &root / sensitivity.seen as f64;
    let mean = spread.trace().max(0.0);
    let variance = 2.0 * spread.norm_squared();
    let (columns, rows) = grid_size(sensor);
    Ok(ProjectionUncertainty {
        columns,
        rows,
        grid,
        rms: mean.sqrt(),
        rms_95: quantile_95(mean, variance).sqrt(),
        max: worst.0,
        max_at: worst.1.into(),
    })
}

impl ProjectionUncertainty {
    /// Widens the bound for a covariance that is estimated from `freedom` + 1 views: few views determine σ itself poorly.
    pub fn of_few_views(self, freedom: usize) -> Self {
        Self { rms_95: self.rms_95 * student_ratio(freedom as f64), ..self }
    }
}

/// Returns the ratio of two 97.5 % quantiles: Student's t with `freedom` degrees of freedom to the normal distribution
/// (Abramowitz and Stegun 26.7.5).
fn student_ratio(freedom: f64) -> f64 {
    const NORMAL: f64 = 1.959_963_984_540_054;
    let square = NORMAL * NORMAL;
    let freedom = freedom.max(1.0);
    1.0 + (square + 1.0) / (4.0 * freedom) + (5.0 * square * square + 16.0 * square + 3.0) / (96.0 * freedom * freedom)
}

/// Returns the 95 % quantile of a sum of squares of normal variables with this mean and variance. It is the quantile
/// (Wilson and Hilferty 1931) of a scaled χ² with the same mean and variance (Satterthwaite 1946).
fn quantile_95(mean: f64, variance: f64) -> f64 {
    const NORMAL_95: f64 = 1.644_853_626_951_472_2;
    if variance <= 0.0 {
        return mean;
    }
    let scale = variance / (2.0 * mean);
    let freedom = mean / scale;
    let share = 2.0 / (9.0 * freedom);
    scale * freedom * libm::pow((1.0 - share + NORMAL_95 * share.sqrt()).max(0.0), 3.0)
}

#[cfg(test)]
mod tests {
    use evcal_core::camera::ModelKind;
    use nalgebra::DVector;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use evcal_core::sensor::Sensor;

    use super::*;
    use evcal_geometry::lens::projection_difference::projection_difference;
    use evcal_geometry::numerics::random::uniform_in;

    const SIZE: Sensor = Sensor::new(346, 260);
    const PARAMETERS: [f64; 9] = [331.6, 331.1, 176.9, 134.2, -0.352, 0.149, -0.0004, 0.0005, -0.03];

    fn camera(parameters: &[f64]) -> Camera<f64> {
        Camera::from_parameters(ModelKind::Radtan, parameters).unwrap()
    }

    #[test]
    fn the_bound_for_few_views_agrees_with_tables_of_students_t() {
        for (freedom, quantile) in [(5.0, 2.571), (7.0, 2.365), (13.0, 2.160), (30.0, 2.042), (120.0, 1.980)] {
            let ratio = student_ratio(freedom) * 1.960;
            assert!((ratio / quantile - 1.0).abs() < 0.01, "{ratio} instead of {quantile}");
        }
    }

    /// Quantiles of χ² with 1, 2 and 10 degrees of freedom, from tables; the approximation of Wilson and Hilferty is
    /// within 3 %.
    #[test]
    fn quantiles_agree_with_chi_square() {
        for (freedom, quantile) in [(1.0, 3.841), (2.0, 5.991), (10.0, 18.307)] {
            let found = quantile_95(freedom, 2.0 * freedom);
            assert!((found / quantile - 1.0).abs() < 0.03, "{freedom}: {found}");
        }
    }

    /// Cameras drawn from the covariance differ from the mean camera as the uncertainty predicts.
    #[test]
    fn cameras_drawn_from_the_covariance_scatter_as_reported() {
        const DRAWS: usize = 300;
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let sigma = [0.1, 0.12, 0.2, 0.15, 1e-3, 2e-3, 1e-4, 1e-4, 1e-3];
        // Correlated: fx and fy move together.
        let mut root = DMatrix::from_diagonal(&DVector::from_column_slice(&sigma));
        root[(1, 0)] = 0.1;
        let covariance = &root * root.transpose();
        let middle = camera(&PARAMETERS);
        let stated = projection_uncertainty(&middle, &covariance, SIZE).unwrap();
        let mut squares = Vec::new();
        let mut corner = [[0.0; 2]; 2];
        for _ in 0..DRAWS {
            // A sum of twelve uniform numbers is as good as normal.
            let normal = DVector::from_fn(9, |_, _| (0..12).map(|_| uniform_in(&mut rng, -0.5, 0.5)).sum::<f64>());
            let step = &root * normal;
            let drawn: Vec<f64> = PARAMETERS.iter().zip(step.iter()).map(|(value, step)| value + step).collect();
            let difference = projection_difference(&middle, &camera(&drawn), SIZE).unwrap();
            squares.push(difference.rms * difference.rms);
            let [x, y] = difference.grid[0].difference.unwrap();
            corner[0][0] += x * x / DRAWS as f64;
            corner[0][1] += x * y / DRAWS as f64;
            corner[1][1] += y * y / DRAWS as f64;
        }
        let rms = (squares.iter().sum::<f64>() / DRAWS as f64).sqrt();
        assert!((rms / stated.rms - 1.0).abs() < 0.1, "{rms} {}", stated.rms);
        let inside = squares.iter().filter(|square| square.sqrt() < stated.rms_95).count();
        assert!((270..=297).contains(&inside), "{inside} of {DRAWS}");
        let spread = Matrix2::new(corner[0][0], corner[0][1], corner[0][1], corner[1][1]);
        let sigma = spread.symmetric_eigenvalues().max().sqrt();
        assert!((sigma / stated.grid[0].sigma.unwrap() - 1.0).abs() < 0.15, "{sigma} {:?}", stated.grid[0]);
    }

    /// A rational lens with a pole in a corner, whose parameters are strongly correlated. The ratio of the bound to the expected error
    /// depends on the shape of the covariance only; rounding errors had changed it, and made it 1 in a recording.
    #[test]
    fn the_bound_grows_with_the_expected_error() {
        const CORRELATED: [f64; 12] = [
            338.4613617200501,
            338.1605438486105,
            173.34682672211045,
            128.40476915458504,
            -1.1600694079360754,
            -2.377131015240334,
            0.0003773070081852862,
            0.0004820206205034499,
            0.36837925323546644,
            -0.8075897726252972,
            -2.814935036831113,
            -0.34798664122942013,
        ];
        let camera = Camera::from_parameters(ModelKind::Radtan8, &CORRELATED).unwrap();
        let inner: Vec<_> = (3..32).flat_map(|x| (3..23).map(move |y| Vector2::new(x, y).cast() * 10.0)).collect();
        let [inner, whole] =
            [inner, grid(SIZE)].map(|pixels| projection_sensitivity(&camera, &pixels).unwrap().squares);
        let information = inner * 10.0 + whole * 0.1;
        let sigma = information.map_diagonal(|entry: f64| 1.0 / entry.sqrt());
        let scale = DMatrix::from_diagonal(&sigma);
        let scaled = &scale * information * &scale + DMatrix::identity(12, 12) * 1e-13;
        let covariance = &scale * scaled.cholesky().unwrap().inverse() * &scale;
        let ratio = |factor: f64| {
            let stated = projection_uncertainty(&camera, &(&covariance * factor), SIZE).unwrap();
            stated.rms_95 / stated.rms
        };
        let expected = ratio(1.0);
        assert!((1.1..1.98).contains(&expected), "{expected}");
        for factor in [1.0 + 1e-7, 1.0 + 1e-6, 3.0] {
            assert!((ratio(factor) / expected - 1.0).abs() < 1e-3, "{factor}: {} and {expected}", ratio(factor));
        }
    }

    #[test]
    fn a_principal_point_alone_is_nearly_a_rotation() {
        let mut covariance = DMatrix::zeros(9, 9);
        covariance[(2, 2)] = 1.0;
        let stated = projection_uncertainty(&camera(&PARAMETERS), &covariance, SIZE).unwrap();
        assert!(stated.rms < 0.3 && stated.rms > 0.0, "{}", stated.rms);
    }

    #[test]
    fn a_covariance_of_another_model_is_refused() {
        assert_eq!(projection_uncertainty(&camera(&PARAMETERS), &DMatrix::zeros(8, 8), SIZE), Err(NoView));
    }
}
