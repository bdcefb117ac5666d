//! Corners between four squares, fitted to the shades around them.
//!
//! The usual refinement, which follows the edges, needs smooth edges. In a picture that counts events they are not
//! smooth: a pixel has all of the events of an edge or few of them, and bright squares appear enlarged. Therefore a
//! model of two bright squares that touch is fitted to the shades, with lines at any angle, and with the width by which
//! the bright squares are enlarged.

use evcal_geometry::numerics::levenberg_marquardt::{Costed, Schedule, minimise};
use nalgebra::{SMatrix, SVector, Vector2};

use crate::found_point::FoundPoint;
use crate::picture::Picture;

/// Radius of the fitted region as a fraction of the distance to the nearest neighbour, and smallest radius in pixels.
const REACH: f64 = 0.5;
const LEAST_REACH: f64 = 2.0;
/// Largest motion of a corner (px); a larger one is wrong.
const FARTHEST: f64 = 1.5;
/// Steepness of an edge (1/px), for a sharp edge averaged over each pixel. It is fixed because an estimated value would
/// fit the noise.
const STEEPNESS: f64 = 2.0;
/// Initial enlargement of a bright square (px).
const GROWTH: f64 = 0.2;
const SCHEDULE: Schedule =
    Schedule { first_damping: 1e-3, smallest_damping: 1e-9, largest_damping: 1e6, most_steps: 40, smallest_gain: 1e-7 };

/// Column and row of the corner, angles of both lines, dark shade, difference to the bright one, enlargement of the
/// bright squares.
type Parameters = SVector<f64, 7>;

/// A pixel near a corner and its shade.
struct Shade {
    pixel: Vector2<f64>,
    value: f64,
}

/// Refines the corners of a checkerboard with this number of `columns`. A corner that cannot be fitted, or would move
/// far, is unchanged.
pub fn fit_corners(picture: &Picture, corners: &mut [FoundPoint], columns: usize) {
    let place = |index: usize| corners.iter().find(|corner| corner.index == index).map(|corner| double(corner.pixel));
    let fitted: Vec<Option<[f32; 2]>> = corners
        .iter()
        .map(|corner| {
            let (row, column) = (corner.index / columns.max(1), corner.index % columns.max(1));
            let pixel = double(corner.pixel);
            let step = |before: Option<usize>, after: Option<usize>| {
                let steps = [before.and_then(place).map(|at| pixel - at), after.and_then(place).map(|at| at - pixel)];
                let known = steps.iter().flatten().count();
                (known > 0).then(|| steps.iter().flatten().sum::<Vector2<f64>>() / known as f64)
            };
            let along =
                step((column > 0).then(|| corner.index - 1), (column + 1 < columns).then_some(corner.index + 1))?;
            let across = step((row > 0).then(|| corner.index - columns), Some(corner.index + columns))?;
            fit(picture, pixel, along, across).map(|place| [place.x as f32, place.y as f32])
        })
        .collect();
    for (corner, fitted) in corners.iter_mut().zip(fitted) {
        corner.pixel = fitted.unwrap_or(corner.pixel);
    }
}

fn double(pixel: [f32; 2]) -> Vector2<f64> {
    Vector2::from(pixel).cast()
}

/// Fits the corner near `start`; `along` and `across` are the steps to its neighbours.
fn fit(picture: &Picture, start: Vector2<f64>, along: Vector2<f64>, across: Vector2<f64>) -> Option<Vector2<f64>> {
    let reach = (REACH * along.norm().min(across.norm())).max(LEAST_REACH);
    let shades = shades(picture, start, reach);
    let values = || shades.iter().map(|shade| shade.value);
    let (dark, bright) = (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
    let angle = |direction: Vector2<f64>| libm::atan2(direction.y, direction.x);
    // Two starts: the bright squares lie between both directions, or do not.
    let starts = [0.0, std::f64::consts::PI].map(|turn| {
        let (along, across) = (angle(along), angle(across) + turn);
        Parameters::from([start.x, start.y, along, across, dark, bright - dark, GROWTH])
    });
    let fitted = starts.into_iter().map(|start| {
        let mut best = Costed { cost: cost(&shades, &start), estimate: start };
        minimise(
            &mut best,
            &SCHEDULE,
            |at| equations(&shades, at),
            |at, (normal, gradient), damping| {
                let mut damped = *normal;
                damped.set_diagonal(&(normal.diagonal() * (1.0 + damping)).add_scalar(1e-12));
                let estimate = at - damped.cholesky()?.solve(gradient);
                Some(Costed { cost: cost(&shades, &estimate), estimate })
            },
        );
        best
    });
    let best = fitted.min_by(|a, b| a.cost.total_cmp(&b.cost))?;
    let place = best.estimate.fixed_rows::<2>(0).into_owned();
    (shades.len() > Parameters::zeros().len() && (place - start).norm() < FARTHEST).then_some(place)
}

/// Returns the pixels within `reach` of `center`.
fn shades(picture: &Picture, center: Vector2<f64>, reach: f64) -> Vec<Shade> {
    let range = |center: f64, size: usize| {
        let first = (center - reach).ceil().max(0.0) as usize;
        first..((center + reach).floor() + 1.0).clamp(0.0, size as f64) as usize
    };
    let columns = range(center.x, picture.width());
    let rows = range(center.y, picture.height());
    let pixels = rows.flat_map(|y| columns.clone().map(move |x| (x, y)));
    let shade = |(x, y): (usize, usize)| {
        let pixel = Vector2::new(x as f64, y as f64);
        let value = f64::from(*picture.values().get(y * picture.width() + x)?);
        ((pixel - center).norm() <= reach).then_some(Shade { pixel, value })
    };
    pixels.filter_map(shade).collect()
}

/// Difference between a fit and a shade, and its derivatives.
struct Residual {
    error: f64,
    by_parameters: Parameters,
}

fn residual(shade: &Shade, at: &Parameters) -> Residual {
    let [x, y, along, across, dark, contrast, growth] = (*at).into();
    let offset = shade.pixel - Vector2::new(x, y);
    // Signed distances from both lines.
    let line = |angle: f64| {
        let (sine, cosine) = libm::sincos(angle);
        let distance = offset.y * cosine - offset.x * sine;
        (distance, SVector::<f64, 3>::new(sine, -cosine, -offset.x * cosine - offset.y * sine))
    };
    let ((first, by_first), (second, by_second)) = (line(along), line(across));
    // The bright fraction at a signed distance from an edge, 0 to 1, and its derivative.
    let inside = |distance: f64| {
        let tanh = libm::tanh(STEEPNESS * distance);
        (0.5 * (1.0 + tanh), 0.5 * STEEPNESS * (1.0 - tanh * tanh))
    };
    let square = |first: f64, second: f64| {
        let ((a, by_a), (b, by_b)) = (inside(first), inside(second));
        // The bright fraction, and its derivatives with respect to both distances.
        (a * b, by_a * b, a * by_b)
    };
    let (one, one_first, one_second) = square(first + growth, second + growth);
    let (other, other_first, other_second) = square(growth - first, growth - second);
    let (by_one, by_other) = (1.0 - other, 1.0 - one);
    let share = 1.0 - by_one * by_other;
    let by_distance = [by_one * one_first - by_other * other_first, by_one * one_second - by_other * other_second];
    let by_growth = by_one * (one_first + one_second) + by_other * (other_first + other_second);
    let by_place = |axis: usize| contrast * (by_distance[0] * by_first[axis] + by_distance[1] * by_second[axis]);
    let by_parameters = Parameters::from([
        by_place(0),
        by_place(1),
        contrast * by_distance[0] * by_first[2],
        contrast * by_distance[1] * by_second[2],
        1.0,
        share,
        contrast * by_growth,
    ]);
    Residual { error: dark + contrast * share - shade.value, by_parameters }
}

fn cost(shades: &[Shade], at: &Parameters) -> f64 {
    shades.iter().map(|shade| residual(shade, at).error.powi(2)).sum()
}

fn equations(shades: &[Shade], at: &Parameters) -> (SMatrix<f64, 7, 7>, Parameters) {
    let mut normal = SMatrix::zeros();
    let mut gradient = Parameters::zeros();
    for shade in shades {
        let Residual { error, by_parameters } = residual(shade, at);
        normal += by_parameters * by_parameters.transpose();
        gradient += by_parameters * error;
    }
    (normal, gradient)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rendering::{View, noisy};

    fn distance(a: [f32; 2], b: [f32; 2]) -> f32 {
        (a[0] - b[0]).hypot(a[1] - b[1])
    }

    /// A pixel of a bright square has all of its events as soon as a quarter of the pixel is bright, so bright squares
    /// are enlarged.
    #[test]
    fn corners_of_enlarged_squares_are_accurate() {
        let view = View::new([4.0, 2.5], 20.0, [0.4, -0.3, 0.3]);
        let bright = |x: f64, y: f64| f32::from(((x.floor() + y.floor()) as i32).rem_euclid(2) == 0);
        let picture = view.render(bright);
        let values = picture.values().iter().map(|value| (4.0 * value).min(1.0)).collect();
        let picture = noisy(&Picture::new(picture.width(), picture.height(), values).unwrap(), 0.1);
        let truth: Vec<[f32; 2]> =
            (0..54).map(|index| view.pixel(Vector2::new(f64::from(index % 9), f64::from(index / 9)))).collect();
        let off = |(index, pixel): (usize, &[f32; 2])| FoundPoint { index, pixel: [pixel[0] + 0.5, pixel[1] - 0.4] };
        let mut corners: Vec<FoundPoint> = truth.iter().enumerate().map(off).collect();
        fit_corners(&picture, &mut corners, 9);
        let errors: Vec<f32> =
            corners.iter().zip(&truth).map(|(corner, truth)| distance(corner.pixel, *truth)).collect();
        let rms = (errors.iter().map(|error| error * error).sum::<f32>() / errors.len() as f32).sqrt();
        assert!(rms < 0.05, "{rms} px: {errors:?}");
    }

    #[test]
    fn derivatives_agree_with_differences_of_the_residual() {
        let shade = Shade { pixel: Vector2::new(3.0, 4.0), value: 0.4 };
        let at = Parameters::from([2.6, 4.3, 0.3, 1.9, 0.1, 0.8, 0.15]);
        let derivatives = residual(&shade, &at).by_parameters;
        for index in 0..at.len() {
            let moved = |by: f64| {
                let mut at = at;
                at[index] += by;
                residual(&shade, &at).error
            };
            let numeric = (moved(1e-6) - moved(-1e-6)) / 2e-6;
            assert!((numeric - derivatives[index]).abs() < 1e-8, "{index}: {numeric} {}", derivatives[index]);
        }
    }

    #[test]
    fn corners_that_cannot_be_fitted_are_unchanged() {
        let flat = Picture::new(40, 40, vec![0.5; 1600]).unwrap();
        let pixels = [[10.0, 10.0], [20.0, 10.0], [10.0, 20.0], [f32::NAN, 3.0]];
        let mut corners: Vec<FoundPoint> =
            pixels.iter().enumerate().map(|(index, &pixel)| FoundPoint { index, pixel }).collect();
        fit_corners(&flat, &mut corners, 2);
        assert_eq!(corners[0].pixel, pixels[0]);
        assert!(corners[3].pixel[0].is_nan());
    }
}
