//! The centre of area of a circle's image, with derivatives.
//!
//! The centre of a dark dot in a picture is neither the image of the circle's centre nor, with lens distortion, the centre of an
//! ellipse: it is the centre of area of the distorted image of the disc. The difference reaches half a pixel for near, tilted
//! dots. So the model predicts the measured centre (Heikkilä 2000; Kannala and Brandt 2006, section 4.2, who integrate
//! numerically too): with the rim's image (x(θ), y(θ)) and Green's theorem
//!
//! A = ∮ x dy,   c_x = ∮ x² dy / 2A,   c_y = −∮ y² dx / 2A.
//!
//! The rim is smooth and closed, so a few points, the derivative of their trigonometric interpolation and the sum over them yield
//! the integrals with an error far below measurement errors.

use std::sync::LazyLock;

use evcal_core::camera::{Camera, PointJacobian, Projection, ProjectionParameterJacobian};
use nalgebra::{Isometry3, Matrix2, Point3, SMatrix, Vector2, Vector3};

/// Number of points on the rim.
const POINTS: usize = 10;

/// Cosine and sine of the angle of each point, and the matrix that differentiates a function of the angle given at the points.
struct Rim {
    directions: [[f64; 2]; POINTS],
    derivative: [[f64; POINTS]; POINTS],
}

static RIM: LazyLock<Rim> = LazyLock::new(|| {
    let step = std::f64::consts::TAU / POINTS as f64;
    let angle = |index: usize| index as f64 * step;
    // Trefethen, Spectral Methods in MATLAB, equation 3.9.
    let derivative = |row: usize, column: usize| {
        if row == column {
            return 0.0;
        }
        let sign = if row.abs_diff(column).is_multiple_of(2) { 0.5 } else { -0.5 };
        sign / libm::tan(0.5 * (angle(row) - angle(column)))
    };
    Rim {
        directions: std::array::from_fn(|index| [libm::cos(angle(index)), libm::sin(angle(index))]),
        derivative: std::array::from_fn(|row| std::array::from_fn(|column| derivative(row, column))),
    }
});

impl Rim {
    fn differentiate(&self, values: &[f64; POINTS]) -> [f64; POINTS] {
        self.derivative.map(|row| row.iter().zip(values).map(|(weight, value)| weight * value).sum())
    }
}

/// Returns the centre of area of a closed curve and its derivative by each of the curve's points; `None` if the curve has no
/// area.
fn center_of_area(points: &[Vector2<f64>; POINTS]) -> Option<(Vector2<f64>, [Matrix2<f64>; POINTS])> {
    let rim = &*RIM;
    let origin = points[0];
    let x = points.map(|point| point.x - origin.x);
    let y = points.map(|point| point.y - origin.y);
    let (along_x, along_y) = (rim.differentiate(&x), rim.differentiate(&y));
    let (squared_x, squared_y) = (x.map(|x| x * x), y.map(|y| y * y));
    let sum = |a: &[f64; POINTS], b: &[f64; POINTS]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let area = sum(&x, &along_y);
    let center = Vector2::new(0.5 * sum(&squared_x, &along_y), -0.5 * sum(&squared_y, &along_x)) / area;
    if !center.iter().all(|value| value.is_finite()) {
        return None;
    }
    // The differentiation matrix is antisymmetric: ∂Σ f (Dy) / ∂y = −Df.
    let (squared_x_along, squared_y_along) = (rim.differentiate(&squared_x), rim.differentiate(&squared_y));
    let by_point = std::array::from_fn(|index| {
        let area_by = Vector2::new(along_y[index], -along_x[index]);
        let x_by = Vector2::new(x[index] * along_y[index], -0.5 * squared_x_along[index]);
        let y_by = Vector2::new(0.5 * squared_y_along[index], -y[index] * along_x[index]);
        Matrix2::from_rows(&[
            ((x_by - area_by * center.x) / area).transpose(),
            ((y_by - area_by * center.y) / area).transpose(),
        ])
    });
    Some((origin + center, by_point))
}

/// Returns a point of the rim in camera axes about the world's origin, that is before the translation.
fn rim_point(pose: &Isometry3<f64>, center: Vector2<f64>, radius: f64, direction: [f64; 2]) -> Vector3<f64> {
    let point = center + Vector2::from(direction) * radius;
    pose.rotation * Vector3::new(point.x, point.y, 0.0)
}

/// Returns the centre of area, in pixels, of the image of the circle at `center` with `radius` (metres on the board) seen from
/// `pose` (`T_camera_world`); with a radius of 0 the image of the point. Returns `None` if a part of it is outside the camera's
/// domain.
pub fn circle_image_center(
    camera: &Camera<f64>,
    pose: &Isometry3<f64>,
    center: Vector2<f64>,
    radius: f64,
) -> Option<Vector2<f64>> {
    if radius == 0.0 {
        return camera.project(&(pose * Point3::new(center.x, center.y, 0.0)).coords);
    }
    let mut points = [Vector2::zeros(); POINTS];
    for (point, direction) in points.iter_mut().zip(RIM.directions) {
        *point = camera.project(&(rim_point(pose, center, radius, direction) + pose.translation.vector))?;
    }
    center_of_area(&points).map(|(center, _)| center)
}

/// Returns the centre of area of an image minus the image of the circle's centre, in pixels.
pub fn center_bias(
    camera: &Camera<f64>,
    pose: &Isometry3<f64>,
    center: Vector2<f64>,
    radius: f64,
) -> Option<Vector2<f64>> {
    let image = camera.project(&(pose * Point3::new(center.x, center.y, 0.0)).coords)?;
    Some(circle_image_center(camera, pose, center, radius)? - image)
}

/// The centre of area of a circle's image, with its derivatives.
pub struct CircleImage {
    /// The centre of area in pixels.
    pub center: Vector2<f64>,
    /// Its derivative by a small rotation (rad, camera axes, from the left) and translation (m) of
    /// `T_camera_world`.
    pub by_pose: SMatrix<f64, 2, 6>,
    /// Its derivative by the camera's parameters.
    pub by_parameters: ProjectionParameterJacobian<f64>,
}

impl CircleImage {
    /// Computes [`circle_image_center`] with derivatives.
    pub fn new(camera: &Camera<f64>, pose: &Isometry3<f64>, center: Vector2<f64>, radius: f64) -> Option<Self> {
        if radius == 0.0 {
            return Self::of_point(camera, pose, center);
        }
        let turned = RIM.directions.map(|direction| rim_point(pose, center, radius, direction));
        let mut points = [Vector2::zeros(); POINTS];
        let mut derivatives = [(PointJacobian::zeros(), ProjectionParameterJacobian::zeros()); POINTS];
        for ((point, derivative), turned) in points.iter_mut().zip(&mut derivatives).zip(&turned) {
            let Projection { pixel, by_point, by_parameters } =
                camera.project_with_jacobians(&(turned + pose.translation.vector))?;
            *point = pixel;
            *derivative = (by_point, by_parameters);
        }
        let (center, by_rim) = center_of_area(&points)?;
        let mut by_pose = SMatrix::<f64, 2, 6>::zeros();
        let mut by_all_parameters = ProjectionParameterJacobian::zeros();
        for ((by_rim, (by_point, by_parameters)), turned) in by_rim.iter().zip(&derivatives).zip(&turned) {
            let by_point = by_rim * by_point;
            let mut rotation = by_pose.fixed_columns_mut::<3>(0);
            rotation -= by_point * turned.cross_matrix();
            let mut translation = by_pose.fixed_columns_mut::<3>(3);
            translation += by_point;
            by_all_parameters += by_rim * by_parameters;
        }
        Some(Self { center, by_pose, by_parameters: by_all_parameters })
    }

    /// Computes the image of a point of the board.
    fn of_point(camera: &Camera<f64>, pose: &Isometry3<f64>, point: Vector2<f64>) -> Option<Self> {
        let turned = pose.rotation * point.push(0.0);
        let Projection { pixel, by_point, by_parameters } =
            camera.project_with_jacobians(&(turned + pose.translation.vector))?;
        let mut by_pose = SMatrix::<f64, 2, 6>::zeros();
        by_pose.fixed_columns_mut::<3>(0).copy_from(&(-by_point * turned.cross_matrix()));
        by_pose.fixed_columns_mut::<3>(3).copy_from(&by_point);
        Some(Self { center: pixel, by_pose, by_parameters })
    }
}

#[cfg(test)]
mod tests {
    use evcal_core::camera::ModelKind;
    use nalgebra::{Translation3, UnitQuaternion, Vector6};

    use super::*;
    use evcal_geometry::numerics::rigid::step_pose;

    const CENTER: Vector2<f64> = Vector2::new(0.165, 0.22);
    const RADIUS: f64 = 0.0175;

    fn radtan() -> Camera<f64> {
        let parameters = [331.6, 331.1, 176.9, 134.2, -0.352, 0.149, -0.0004, 0.0005, -0.03];
        Camera::from_parameters(ModelKind::Radtan, &parameters).unwrap()
    }

    /// Near, tilted by 45°, with the dot towards a corner of the image.
    fn pose() -> Isometry3<f64> {
        let rotation = UnitQuaternion::from_euler_angles(0.7, 0.3, 0.4);
        Isometry3::from_parts(Translation3::new(0.05, -0.12, 0.35), rotation)
    }

    /// The mean over the disc of its image, each part weighted with the area of its own image.
    fn mean_over_the_disc(camera: &Camera<f64>) -> Vector2<f64> {
        const RINGS: usize = 60;
        const SECTORS: usize = 120;
        let (mut sum, mut weights) = (Vector2::zeros(), 0.0);
        for ring in 0..RINGS {
            let radius = RADIUS * (ring as f64 + 0.5) / RINGS as f64;
            for sector in 0..SECTORS {
                let angle = std::f64::consts::TAU * (sector as f64 + 0.5) / SECTORS as f64;
                let board = CENTER + Vector2::new(angle.cos(), angle.sin()) * radius;
                let seen = pose() * Point3::new(board.x, board.y, 0.0);
                let projection = camera.project_with_jacobians(&seen.coords).unwrap();
                let rotation = pose().rotation.to_rotation_matrix();
                let by_board = projection.by_point * rotation.matrix().fixed_columns::<2>(0);
                let weight = radius * by_board.determinant();
                sum += projection.pixel * weight;
                weights += weight;
            }
        }
        sum / weights
    }

    #[test]
    fn the_center_of_area_is_the_integral_over_the_disc() {
        let camera = radtan();
        let found = circle_image_center(&camera, &pose(), CENTER, RADIUS).unwrap();
        let expected = mean_over_the_disc(&camera);
        assert!((found - expected).norm() < 1e-4, "{found} {expected}");
        // It differs significantly from the image of the centre.
        let bias = center_bias(&camera, &pose(), CENTER, RADIUS).unwrap();
        assert!(bias.norm() > 0.1, "{bias}");
    }

    #[test]
    fn jacobians_equal_difference_quotients() {
        assert_jacobians(RADIUS);
        assert_jacobians(0.0);
    }

    fn assert_jacobians(radius: f64) {
        let camera = radtan();
        let exact = CircleImage::new(&camera, &pose(), CENTER, radius).unwrap();
        for index in 0..6 {
            let at = |step: f64| {
                let mut direction = Vector6::zeros();
                direction[index] = step;
                circle_image_center(&camera, &step_pose(&pose(), &direction), CENTER, radius).unwrap()
            };
            let numeric = (at(1e-6) - at(-1e-6)) / 2e-6;
            assert!((numeric - exact.by_pose.column(index)).norm() < 1e-5 * exact.by_pose.norm(), "{index}");
        }
        for index in 0..9 {
            let at = |step: f64| {
                let mut parameters = camera.parameters();
                parameters[index] += step;
                let camera = Camera::from_parameters(camera.kind(), &parameters).unwrap();
                circle_image_center(&camera, &pose(), CENTER, radius).unwrap()
            };
            let numeric = (at(1e-5) - at(-1e-5)) / 2e-5;
            let column = exact.by_parameters.column(index);
            assert!((numeric - column).norm() < 1e-6 * (1.0 + column.norm()), "{index}: {numeric} {column}");
        }
    }
}
