//! Camera and the pose of every picture together, by least squares on the centres of dots (`initial::bundle_adjustment`), and the
//! uncertainty of the camera.
//!
//! A residual is the predicted centre of area of a dot's image ([`CircleImage`]) minus the measured one.
//!
//! With the information Σ S_f of the pictures after elimination of their poses, the weights W of the prior against residuals of
//! variance σ², and S = Σ S_f + W, the covariance is σ² S⁻¹ (κ Σ S_f + W) S⁻¹. What the pictures do not determine, the prior does,
//! and its error does not show between pictures.
//!
//! The errors within a picture are not independent: blur, the shutter and the paper shift all its dots together. κ tells how much
//! this increases the variance, on average over the parameters. Without errors common to all pictures, it comes from the jackknife over pictures (Efron 1982): leaving
//! out picture f with the gradient g_f moves the parameters by δ_f = (S − S_f)⁻¹ g_f; with independent errors, the expectation of
//! δ_fᵀ S δ_f is σ² tr (S − S_f)⁻¹ S_f, and κ is the ratio of the sums of both. The jackknife's own covariance would be that of
//! a few pictures for what only these determine, such as the distortion in a corner of the image. Pictures of a board at rest
//! have the same errors of the pixels, so they are left out together.

use evcal_core::camera::{Camera, MAX_PARAMETERS};
use evcal_core::sensor::Sensor;
use nalgebra::{DMatrix, DVector, Isometry3, Vector2};

use super::circle_image::{CircleImage, circle_image_center};
use evcal_geometry::lens::distortion_prior::distortion_prior;
use evcal_geometry::lens::fixed::with_fixed;
use evcal_geometry::numerics::arrow::unit_diagonal;
use evcal_geometry::numerics::levenberg_marquardt::Costed;
use evcal_geometry::numerics::statistics::{SIGMA_BY_MEDIAN, median};
use evcal_solve::initial::bundle_adjustment::{Equations, Estimate, ImagePoint, ReprojectionResidual, Target, View};

/// A dot: its circle on the board and its centre of area in the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenDot {
    /// Centre of the circle on the board in metres.
    pub object: Vector2<f64>,
    /// The circle's radius in metres.
    pub radius: f64,
    /// Centre of area in pixels.
    pub image: Vector2<f64>,
}

/// The dots of one picture and its pose.
#[derive(Clone, Debug, PartialEq)]
pub struct PictureView {
    /// The dots.
    pub dots: Vec<SeenDot>,
    /// `T_camera_world`.
    pub pose: Isometry3<f64>,
}

/// A camera from pictures.
#[derive(Clone, Debug)]
pub struct PictureBundle {
    /// The camera.
    pub camera: Camera<f64>,
    /// `T_camera_world` of each view.
    pub poses: Vec<Isometry3<f64>>,
    /// Standard deviation of the dots of each view relative to the spread.
    pub noise: Vec<f64>,
    /// Covariance of the camera's parameters, in the order of the model.
    pub covariance: DMatrix<f64>,
    /// Ratio of the variance of the parameters to that with independent residuals, on average.
    pub inflation: f64,
    /// Robust standard deviation of a centre along one axis (px).
    pub spread: f64,
    /// Root mean square distance of the centres from their prediction (px).
    pub rms: f64,
    /// Median of that distance.
    pub median: f64,
    /// Number of steps.
    pub steps: usize,
}

/// Number of passes, each with the spread from the previous one.
const PASSES: usize = 3;
/// Distance between dots below which the board is in the same place: the width of a blurred edge (px).
const SAME_PLACE: f64 = 1.0;
/// Error that all dots have in common, as a share of their spread: it depends on the size and the tilt of the board's image, so that
/// the scatter between pictures does not show it. Of 78 simulated recordings (seeds 300 to 400), 66 were within their 95 % bound without it.
const COMMON: f64 = 0.015;
/// Number of parameters of a pose.
const POSE_PARAMETERS: usize = 6;
/// Weight of the assumption that all views are equally noisy, in residuals.
const EVENLY: f64 = 10.0;
/// Smallest spread that is used (px).
const SMALLEST_SPREAD: f64 = 0.002;

impl SeenDot {
    /// Returns the difference between the predicted centre of area of the circle's image and the dot (px).
    fn error(&self, camera: &Camera<f64>, pose: &Isometry3<f64>) -> Option<Vector2<f64>> {
        Some(circle_image_center(camera, pose, self.object, self.radius)? - self.image)
    }
}

impl ImagePoint for SeenDot {
    fn distance(&self, camera: &Camera<f64>, pose: &Isometry3<f64>) -> f64 {
        self.error(camera, pose).map_or(f64::INFINITY, |error| error.norm())
    }

    fn residual(&self, camera: &Camera<f64>, pose: &Isometry3<f64>) -> Option<ReprojectionResidual> {
        let CircleImage { center, by_pose, by_parameters } = CircleImage::new(camera, pose, self.object, self.radius)?;
        Some(ReprojectionResidual { error: center - self.image, by_pose, by_parameters })
    }
}

/// Returns the residuals of the dots of each view in pixels.
fn residuals(views: &[PictureView], estimate: &Estimate) -> Vec<Vec<Vector2<f64>>> {
    let of_view = |(view, pose): (&PictureView, &Isometry3<f64>)| -> Vec<Vector2<f64>> {
        view.dots.iter().filter_map(|dot| dot.error(&estimate.camera, pose)).collect()
    };
    views.iter().zip(&estimate.poses).map(of_view).collect()
}

/// Returns the standard deviation of the dots of a view with these `residuals` relative to the `spread` of all: some pictures are
/// blurred, or near the lens. Few dots do not determine it, so it is drawn towards 1.
fn noise(residuals: &[Vector2<f64>], spread: f64) -> f64 {
    let squares: f64 = residuals.iter().map(|residual| residual.norm_squared()).sum();
    let freedom = (2 * residuals.len()).saturating_sub(POSE_PARAMETERS) as f64;
    ((squares / (spread * spread) + EVENLY) / (freedom + EVENLY)).sqrt()
}

/// Returns the number of the place of the board in each picture: a board at rest stays in its place.
fn places(views: &[PictureView], estimate: &Estimate) -> Vec<usize> {
    let pixel = |pose: &Isometry3<f64>, dot: &SeenDot| circle_image_center(&estimate.camera, pose, dot.object, 0.0);
    let stays = |dots: &[SeenDot], from: &Isometry3<f64>, to: &Isometry3<f64>| {
        let moved = |dot: &SeenDot| Some((pixel(from, dot)? - pixel(to, dot)?).norm_squared());
        let moved: Vec<f64> = dots.iter().filter_map(moved).collect();
        moved.iter().sum::<f64>() < SAME_PLACE * SAME_PLACE * moved.len() as f64
    };
    let mut places = Vec::with_capacity(views.len());
    let mut place = 0;
    let mut first = None;
    for (view, pose) in views.iter().zip(&estimate.poses) {
        if !first.is_some_and(|first| stays(&view.dots, first, pose)) {
            place += usize::from(first.is_some());
            first = Some(pose);
        }
        places.push(place);
    }
    places
}

/// Inverts a symmetric positive definite matrix; `None` if it is not positive definite.
fn inverse(matrix: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let (matrix, scale) = unit_diagonal(matrix);
    let inverse = matrix.cholesky()?.inverse();
    let entry = |row: usize, column: usize| inverse[(row, column)] * scale[row] * scale[column];
    Some(DMatrix::from_fn(inverse.nrows(), inverse.ncols(), entry))
}

/// Returns a robust standard deviation along one axis.
fn robust_spread(residuals: &[Vec<Vector2<f64>>]) -> f64 {
    let mut sizes: Vec<f64> =
        residuals.iter().flatten().flat_map(|residual| [residual.x.abs(), residual.y.abs()]).collect();
    median(&mut sizes, f64::total_cmp).map_or(SMALLEST_SPREAD, |median| (SIGMA_BY_MEDIAN * median).max(SMALLEST_SPREAD))
}

/// Refines the parameters of `camera` that have no value in `fixed`, and the poses of `views`. `sensor` is (width, height) in pixels,
/// `huber` the distance in spreads from which a centre counts linearly.
///
/// Returns `None` if no camera has the `fixed` values, a dot starts outside the camera's domain, or the views do not determine the
/// camera.
pub fn picture_bundle(
    camera: &Camera<f64>,
    views: &[PictureView],
    sensor: Sensor,
    huber: f64,
    fixed: &[Option<f64>; MAX_PARAMETERS],
) -> Option<PictureBundle> {
    let camera = &with_fixed(camera, fixed, sensor)?;
    let count = camera.parameters().len();
    let free = fixed.map(|value| value.is_none());
    let estimated = free.iter().take(count).filter(|free| **free).count();
    let dots: usize = views.iter().map(|view| view.dots.len()).sum();
    let freedom = (2 * dots).checked_sub(6 * views.len() + estimated).filter(|freedom| *freedom > 0)?;
    let prior = distortion_prior(camera, sensor);
    let mut seen: Vec<View<'_, SeenDot>> =
        views.iter().map(|view| View { points: &view.dots, pose: view.pose, noise: 1.0 }).collect();
    let start = Estimate { camera: *camera, poses: views.iter().map(|view| view.pose).collect() };
    let mut best = Costed { estimate: start, cost: f64::INFINITY };
    let (mut steps, mut spread) = (0, SMALLEST_SPREAD);
    for pass in 0..PASSES {
        let residuals = residuals(views, &best.estimate);
        spread = robust_spread(&residuals);
        if pass > 0 {
            seen.iter_mut().zip(&residuals).for_each(|(view, of_view)| view.noise = noise(of_view, spread));
        }
        let target = Target { views: &seen, free: &free, prior: prior.against(spread), huber: huber * spread };
        best.cost = target.cost(&best.estimate);
        steps += target.refine(&mut best);
        if !best.cost.is_finite() {
            return None;
        }
    }
    let estimate = best.estimate;
    let residuals = residuals(views, &estimate);
    let target = Target { views: &seen, free: &free, prior: prior.against(spread), huber: huber * spread };
    let linear = target.linearise(&estimate);
    let squares: f64 = linear.iter().map(|view| view.squares).sum();
    // Border and gradient of each view, with its pose eliminated.
    let of_view = |view: &Equations| {
        let eliminated = view.eliminate(0.0)?;
        let border = (view.border - eliminated.border).view((0, 0), (count, count)).into_owned();
        Some((border, (view.border_gradient - eliminated.gradient).rows(0, count).into_owned()))
    };
    let eliminated: Vec<(DMatrix<f64>, DVector<f64>)> = linear.iter().map(of_view).collect::<Option<_>>()?;
    let mut information = DMatrix::zeros(count, count);
    for (of_view, _) in &eliminated {
        information += of_view;
    }
    let weights = target.prior.equations(&estimate.camera, &free).weights;
    let weights = DMatrix::from_diagonal(&DVector::from_column_slice(weights.rows(0, count).as_slice()));
    let mut border = &information + &weights;
    for (index, free) in free.iter().enumerate().take(count) {
        // A fixed parameter does not move.
        border[(index, index)] += f64::from(u8::from(!free));
    }
    // Pictures of one place together.
    let mut blocks: Vec<(DMatrix<f64>, DVector<f64>)> = Vec::new();
    for ((of_view, gradient), place) in eliminated.into_iter().zip(places(views, &estimate)) {
        match blocks.get_mut(place) {
            Some((of_block, sum)) => (*of_block, *sum) = (&*of_block + of_view, &*sum + gradient),
            None => blocks.push((of_view, gradient)),
        }
    }
    if blocks.len() < 2 {
        return None;
    }
    // The squares of the parameters' shifts without one block, in terms of the uncertainty, and as independent errors make them.
    let (mut shifts, mut expected) = (0.0, 0.0);
    for (of_block, gradient) in &blocks {
        let without = inverse(&(&border - of_block))?;
        let moved = &without * gradient;
        shifts += moved.dot(&(&border * &moved));
        expected += (without * of_block).trace();
    }
    let variance = squares / freedom as f64;
    let unscaled = inverse(&border)?;
    let dependence = (shifts / (variance * expected)).max(1.0) + COMMON * COMMON * dots as f64;
    let covariance = &unscaled * (information * dependence + weights) * &unscaled * variance;
    let inflation = (&border * &covariance).trace() / (estimated as f64 * variance);
    let mut distances: Vec<f64> = residuals.iter().flatten().map(|residual| residual.norm()).collect();
    let square: f64 = distances.iter().map(|distance| distance * distance).sum();
    Some(PictureBundle {
        camera: estimate.camera,
        poses: estimate.poses,
        noise: seen.iter().map(|view| view.noise).collect(),
        covariance,
        inflation,
        spread: robust_spread(&residuals),
        rms: (square / distances.len().max(1) as f64).sqrt(),
        median: median(&mut distances, f64::total_cmp).unwrap_or(0.0),
        steps,
    })
}

#[cfg(test)]
mod tests {
    use evcal_core::camera::ModelKind;
    use nalgebra::{Translation3, UnitQuaternion, Vector3};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use evcal_geometry::board::Board;
    use evcal_geometry::numerics::random::normal;

    const SENSOR: Sensor = Sensor::new(346, 260);
    const VIEWS: usize = 30;
    const NOTHING_FIXED: [Option<f64>; MAX_PARAMETERS] = [None; MAX_PARAMETERS];

    fn camera() -> Camera<f64> {
        let parameters = [331.2, 330.7, 174.1, 127.3, -0.33, 0.12, 0.0006, -0.0004];
        Camera::from_parameters(ModelKind::Radtan4, &parameters).unwrap()
    }

    /// Dots with noise that differs between pictures: a fifth of the pictures is four times as noisy, and each picture is
    /// slightly scaled, as by blur.
    fn views(camera: &Camera<f64>, seed: u64) -> Vec<PictureView> {
        let board: Board = "acircles:9x4:55mm:r17.5mm".parse().unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let middle = Vector2::new(173.0, 130.0);
        (0..VIEWS)
            .map(|view| {
                let wave = |rate: f64| libm::sin(rate * (view as f64 + 1.0));
                let rotation = UnitQuaternion::from_euler_angles(0.5 * wave(1.1), 0.5 * wave(2.3), 0.6 * wave(0.7));
                let center = board.middle();
                let position = Vector3::new(0.06 * wave(1.7), 0.05 * wave(0.4), 0.62 + 0.1 * wave(3.1));
                let turned = rotation * Vector3::new(center.x, center.y, 0.0);
                let pose = Isometry3::from_parts(Translation3::from(position - turned), rotation);
                let noise = if view % 5 == 0 { 0.08 } else { 0.02 };
                let scale = 1.0 + 2e-4 * normal(&mut rng);
                let dots = (0..board.point_count()).filter_map(|index| {
                    let object = board.point(index);
                    let image = circle_image_center(camera, &pose, object, board.dot_radius())?;
                    let noise = Vector2::new(normal(&mut rng), normal(&mut rng)) * noise;
                    Some(SeenDot {
                        object,
                        radius: board.dot_radius(),
                        image: middle + (image - middle) * scale + noise,
                    })
                });
                PictureView { dots: dots.collect(), pose }
            })
            .collect()
    }

    /// Dots whose noise is that of good pictures: 0.01 px.
    fn evenly_noisy_views(camera: &Camera<f64>) -> Vec<PictureView> {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut views = views(camera, 5);
        for view in &mut views {
            for dot in &mut view.dots {
                let center = circle_image_center(camera, &view.pose, dot.object, dot.radius).unwrap();
                dot.image = center + Vector2::new(normal(&mut rng), normal(&mut rng)) * 0.01;
            }
        }
        views
    }

    #[test]
    fn the_reported_uncertainty_agrees_with_the_scatter_over_repetitions() {
        const REPETITIONS: u64 = 60;
        let truth = camera();
        let (mut squares, mut stated) = ([0.0; 8], [0.0; 8]);
        for seed in 0..REPETITIONS {
            let bundle = picture_bundle(&truth, &views(&truth, seed), SENSOR, 2.5, &NOTHING_FIXED).unwrap();
            let found = bundle.camera.parameters();
            for index in 0..8 {
                squares[index] += (found[index] - truth.parameters()[index]).powi(2) / REPETITIONS as f64;
                stated[index] += bundle.covariance[(index, index)] / REPETITIONS as f64;
            }
        }
        for (index, (square, stated)) in squares.iter().zip(stated).enumerate() {
            let ratio: f64 = (stated / square).sqrt();
            assert!((0.75..1.45).contains(&ratio), "parameter {index}: stated {ratio} times the scatter");
        }
    }

    /// A camera at rest takes the same picture again and again, with the same errors of its pixels.
    #[test]
    fn pictures_of_a_board_at_rest_count_once() {
        let truth = camera();
        let once = views(&truth, 3);
        let thrice: Vec<PictureView> = once.iter().flat_map(|view| std::iter::repeat_n(view.clone(), 3)).collect();
        let sigma = |views: &[PictureView]| {
            picture_bundle(&truth, views, SENSOR, 2.5, &NOTHING_FIXED).unwrap().covariance.diagonal().map(f64::sqrt)
        };
        for (once, thrice) in sigma(&once).iter().zip(&sigma(&thrice)) {
            assert!((0.8..1.2).contains(&(thrice / once)), "{once} {thrice}");
        }
    }

    #[test]
    fn a_fisheye_that_fills_a_part_of_the_view_is_not_pulled_towards_the_prior() {
        let parameters = [150.0, 149.5, 174.0, 131.0, 0.02, -0.01, 0.004, -0.001];
        let truth = Camera::from_parameters(ModelKind::KannalaBrandt, &parameters).unwrap();
        let bundle = picture_bundle(&truth, &evenly_noisy_views(&truth), SENSOR, 2.5, &NOTHING_FIXED).unwrap();
        let difference =
            DVector::from_column_slice(&bundle.camera.parameters()) - DVector::from_column_slice(&parameters);
        let squares = difference.dot(&(inverse(&bundle.covariance).unwrap() * &difference));
        assert!(squares < 20.0, "χ² of {squares} for 8 parameters: {difference}");
    }

    #[test]
    fn fixed_parameters_keep_their_values_and_have_no_uncertainty() {
        let truth = camera();
        let mut fixed = NOTHING_FIXED;
        (fixed[2], fixed[6]) = (Some(174.1), Some(0.0));
        let bundle = picture_bundle(&truth, &evenly_noisy_views(&truth), SENSOR, 2.5, &fixed).unwrap();
        let found = bundle.camera.parameters();
        assert_eq!((found[2], found[6]), (174.1, 0.0));
        let sigma = bundle.covariance.diagonal().map(f64::sqrt);
        for index in 0..8 {
            assert_eq!(sigma[index] > 0.0, fixed[index].is_none(), "parameter {index}: {sigma}");
        }
        assert!((found[0] - 331.2).abs() < 0.2, "{found:?}");
    }

    #[test]
    fn the_camera_is_found_from_a_distance() {
        let truth = camera();
        let mut views = views(&truth, 1);
        let start = Camera::from_parameters(ModelKind::Radtan4, &[345.0, 345.0, 170.0, 131.0, -0.3, 0.08, 0.0, 0.0]);
        for view in &mut views {
            view.pose.translation.vector.z *= 1.04;
        }
        let bundle = picture_bundle(&start.unwrap(), &views, SENSOR, 2.5, &NOTHING_FIXED).unwrap();
        let sigma = bundle.covariance.diagonal().map(f64::sqrt);
        for (index, (found, truth)) in bundle.camera.parameters().iter().zip(truth.parameters()).enumerate() {
            assert!((found - truth).abs() < 4.0 * sigma[index], "parameter {index}: {found} {truth}");
        }
        assert!(bundle.rms < 0.08 && bundle.spread < 0.04, "{} {}", bundle.rms, bundle.spread);
    }
}
