//! Map from image to lattice coordinates: a homography behind a lens.
//!
//! A pixel (x, y), relative to the distortion centre and in units of half the image diagonal, has the bearing
//! (x, y, 1 + λ₁ s + λ₂ s²), s = x² + y² (the division model of Fitzgibbon, CVPR 2001, with a second term). A
//! homography maps these vectors to lattice coordinates. There are twelve parameters: eight of the homography, λ₁, λ₂
//! and the centre. Weak priors on the last six (moderate slant and distortion, centre near the middle of the image)
//! make a few points sufficient. The map models perspective and lenses up to fisheyes so closely that a point off the
//! map is not a circle of the board.

use nalgebra::{Matrix2, Matrix3, RealField, Vector2, Vector3};

use super::lattice::{Axes, Lattice};
use super::points::Points;

/// Number of parameters: a, b, c, d, e, f, g, h of the homography [a b c; d e f; g h 1], λ₁, λ₂,
/// centre x, y.
pub(super) const COUNT: usize = 12;

/// λ₁ of a lens between pinhole (0) and fisheye (-0.8).
pub(super) const USUAL_DISTORTION: f64 = -0.35;

/// The map.
#[derive(Clone, Copy, Debug)]
pub(super) struct Warp<T> {
    /// Middle of the image, pixels.
    pub middle: Vector2<T>,
    /// Half the image diagonal, pixels.
    pub unit: T,
    pub parameters: [T; COUNT],
}

/// The map at one pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Local<T> {
    /// Lattice coordinates.
    pub site: Vector2<T>,
    /// Pixels per lattice step (columns: u, v).
    pub steps: Matrix2<T>,
    /// The ray, divided by the denominator of the homography.
    ray: [T; 3],
    /// Derivative of the lattice coordinates with respect to the third coordinate of the ray.
    by_depth: Vector2<T>,
    /// Squared distance from the distortion centre.
    squared: T,
}

impl<T: RealField + Copy> Local<T> {
    /// Returns the offset in pixels from the map's position of lattice point `site`.
    pub fn residual(&self, site: Vector2<T>) -> Vector2<T> {
        self.steps * (self.site - site)
    }

    /// Returns the squared distance to the nearest lattice neighbour, in square pixels.
    pub fn spacing_squared(&self) -> T {
        let (u, v) = (self.steps.column(0), self.steps.column(1));
        u.norm_squared().min(v.norm_squared()).min((u + v).norm_squared()).min((u - v).norm_squared())
    }

    /// Returns the derivatives of the residual with respect to the parameters: those of x, then those of y.
    pub fn slopes(&self, unit: T) -> [[T; COUNT]; 2] {
        let [x, y, depth] = self.ray;
        let inward = -(self.steps * self.site);
        let deeper = self.steps * self.by_depth;
        let s = self.squared;
        core::array::from_fn(|axis| {
            let (along_u, along_v) = (self.steps[(axis, 0)], self.steps[(axis, 1)]);
            let (inward, deeper) = (inward[axis], deeper[axis]);
            let by_center = if axis == 0 { (-unit, T::zero()) } else { (T::zero(), -unit) };
            [
                along_u * x,
                along_u * y,
                along_u * depth,
                along_v * x,
                along_v * y,
                along_v * depth,
                inward * x,
                inward * y,
                deeper * s,
                deeper * s * s,
                by_center.0,
                by_center.1,
            ]
        })
    }
}

impl<T: RealField + Copy> Warp<T> {
    /// Returns the affine map that fits a lattice best.
    pub fn affine<const N: usize>(lattice: &Lattice<N>, points: &Points<T, N>, image_size: (f64, f64)) -> Option<Self> {
        let half: T = nalgebra::convert(0.5);
        let size = Vector2::new(nalgebra::convert::<f64, T>(image_size.0), nalgebra::convert(image_size.1));
        let middle = (size - Vector2::repeat(T::one())) * half;
        let unit = size.norm() * half;
        let affine = lattice.affine(points)?;
        let back = affine.steps.try_inverse()?;
        let offset = back * (middle - affine.mean_position) + affine.mean_site;
        let mut parameters = [T::zero(); COUNT];
        parameters[8] = nalgebra::convert(USUAL_DISTORTION);
        parameters[0] = back[(0, 0)] * unit;
        parameters[1] = back[(0, 1)] * unit;
        parameters[2] = offset.x;
        parameters[3] = back[(1, 0)] * unit;
        parameters[4] = back[(1, 1)] * unit;
        parameters[5] = offset.y;
        Some(Self { middle, unit, parameters })
    }

    /// Evaluates the map at a pixel; `None` if it is not one-to-one or is mirrored there.
    pub fn at(&self, pixel: &Vector2<T>) -> Option<Local<T>> {
        let [a, b, c, d, e, f, g, h, first, second, center_x, center_y] = self.parameters;
        let two: T = nalgebra::convert(2.0);
        let place = (pixel - self.middle) / self.unit - Vector2::new(center_x, center_y);
        let (x, y) = (place.x, place.y);
        let s = place.norm_squared();
        let depth = T::one() + (first + second * s) * s;
        let denominator = g * x + h * y + depth;
        if denominator < nalgebra::convert(1e-3) {
            return None;
        }
        let scale = T::one() / denominator;
        let u = (a * x + b * y + c * depth) * scale;
        let v = (d * x + e * y + f * depth) * scale;
        let by_depth = Vector2::new(c - u, f - v) * scale;
        let depth_slope = (first + second * s * two) * two;
        let by_x = Vector2::new(a - u * g, d - v * g) * scale + by_depth * (depth_slope * x);
        let by_y = Vector2::new(b - u * h, e - v * h) * scale + by_depth * (depth_slope * y);
        let determinant = by_x.perp(&by_y);
        if determinant <= T::zero() {
            return None;
        }
        let factor = self.unit / determinant;
        let steps = Matrix2::new(by_y.y, -by_y.x, -by_x.y, by_x.x) * factor;
        Some(Local {
            site: Vector2::new(u, v),
            steps,
            ray: [x * scale, y * scale, depth * scale],
            by_depth,
            squared: s,
        })
    }
}

/// Focal lengths tried by [`LatticeImage::shear`], in units of half the image diagonal: from a fisheye to a
/// telephoto lens.
const FOCAL_LENGTHS: [f64; 7] = [0.5, 0.75, 1.1, 1.6, 2.4, 3.6, 5.4];

/// The inverse map, from lattice to image.
#[derive(Clone, Copy, Debug)]
pub(super) struct LatticeImage<T> {
    warp: Warp<T>,
    to_ray: Matrix3<T>,
}

impl<T: RealField + Copy> LatticeImage<T> {
    /// Returns `None` if the map is degenerate.
    pub fn new(warp: &Warp<T>) -> Option<Self> {
        let [a, b, c, d, e, f, g, h, ..] = warp.parameters;
        let to_ray = Matrix3::new(a, b, c, d, e, f, g, h, T::one()).try_inverse()?;
        Some(Self { warp: *warp, to_ray })
    }

    /// Returns the ratio of the board's scales along its two axes (at least 1), if `axes` maps lattice to board
    /// coordinates. The focal length is not known, so several are tried and the smallest ratio is returned. With exact
    /// measurements it is 1 for the right axes, because the slant of the board explains the perspective, and at least
    /// 2.6 for all others. Returns `None` if the map is degenerate.
    pub fn shear(&self, axes: &Axes) -> Option<T> {
        let axes = Matrix2::from_fn(|row, column| nalgebra::convert::<f64, T>(f64::from(axes[row][column])));
        let rays = self.to_ray.fixed_columns::<2>(0) * axes.try_inverse()?;
        let across = rays.fixed_rows::<2>(0).into_owned();
        let along = rays.fixed_rows::<1>(2).into_owned();
        let two: T = nalgebra::convert(2.0);
        let mut least: Option<T> = None;
        for focal_length in FOCAL_LENGTHS {
            let squared: T = nalgebra::convert(focal_length * focal_length);
            let metric = across.transpose() * across + along.transpose() * along * squared;
            // For scales s ≥ t: (s² + t²) / (s t) = r + 1/r with r = s/t.
            let half_sum = metric.trace() / metric.determinant().sqrt() / two;
            let ratio = half_sum + (half_sum * half_sum - T::one()).max(T::zero()).sqrt();
            if ratio.is_finite() {
                least = Some(least.map_or(ratio, |known| known.min(ratio)));
            }
        }
        least
    }

    /// Returns the pixel of a lattice site; `None` if it is beyond the field of view of the lens.
    pub fn at(&self, u: i32, v: i32) -> Option<Vector2<T>> {
        let [.., first, second, center_x, center_y] = self.warp.parameters;
        let site = Vector3::new(nalgebra::convert(f64::from(u)), nalgebra::convert(f64::from(v)), T::one());
        let ray = self.to_ray * site;
        if ray.z <= T::zero() {
            return None;
        }
        let direction = ray.xy() / ray.z;
        let s = direction.norm_squared();
        let (two, four): (T, T) = (nalgebra::convert(2.0), nalgebra::convert(4.0));
        // The radius shrinks by the factor k with k = 1 + λ₁ s k² + λ₂ s² k⁴: Newton's method, from
        // the solution for λ₂ = 0.
        let mut k = two / (T::one() + (T::one() - four * first * s).max(T::zero()).sqrt());
        for _ in 0..5 {
            let value = T::one() + (first + second * s * k * k) * s * k * k - k;
            let slope = (first * two + second * s * k * k * four) * s * k - T::one();
            if slope >= T::zero() {
                return None;
            }
            k -= value / slope;
        }
        let place = direction * k + Vector2::new(center_x, center_y);
        let pixel = place * self.warp.unit + self.warp.middle;
        // If Newton's method failed, the pixel does not map back to the site.
        let back = self.warp.at(&pixel)?.site;
        let tolerance: T = nalgebra::convert(0.1);
        ((back - site.xy()).norm() < tolerance).then_some(pixel)
    }
}
