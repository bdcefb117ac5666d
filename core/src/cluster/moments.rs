//! Exact sums over the pixels of a cluster, up to third order.

use nalgebra::RealField;

/// Sums over pixels at integer coordinates (x, y) relative to a local origin, with z = x² + y².
///
/// Exact for clusters up to a few thousand pixels across: third-order sums have 64 bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PixelSums {
    /// Number of pixels.
    pub n: i32,
    /// Σx.
    pub x: i32,
    /// Σy.
    pub y: i32,
    /// Σx².
    pub xx: i64,
    /// Σxy.
    pub xy: i64,
    /// Σy².
    pub yy: i64,
    /// Σx(x² + y²).
    pub xz: i64,
    /// Σy(x² + y²).
    pub yz: i64,
}

impl PixelSums {
    /// Adds the pixels (x, y), (x + 1, y), … of a run of length `length`.
    #[inline]
    pub fn add_run(&mut self, x: i32, y: i32, length: u16) {
        // No multiplication below is wider than 32 by 32 bits: one instruction on a microcontroller.
        let product = |a: i32, b: i32| i64::from(a) * i64::from(b);
        let (mut sum, mut squares, mut cubes) = (0_i32, 0_i64, 0_i64);
        for x in x..x.saturating_add(i32::from(length)) {
            sum = sum.wrapping_add(x);
            squares += product(x, x);
            cubes += product(x.wrapping_mul(x), x);
        }
        let n = i32::from(length);
        let (n_y, y_squared) = (n.wrapping_mul(y), y.wrapping_mul(y));
        self.n = self.n.wrapping_add(n);
        self.x = self.x.wrapping_add(sum);
        self.y = self.y.wrapping_add(n_y);
        self.xx += squares;
        self.xy += product(sum, y);
        self.yy += product(n_y, y);
        self.xz += cubes + product(sum, y_squared);
        self.yz += squares * i64::from(y) + product(n_y, y_squared);
    }

    /// Returns the sums of the same pixels relative to an origin moved by (dx, dy).
    #[must_use]
    pub fn moved(&self, dx: i32, dy: i32) -> Self {
        let (n, x, y) = (i64::from(self.n), i64::from(self.x), i64::from(self.y));
        let (wide_dx, wide_dy) = (i64::from(dx), i64::from(dy));
        let d = wide_dx * wide_dx + wide_dy * wide_dy;
        let z = self.xx.wrapping_add(self.yy);
        let moved_z = z - 2 * (wide_dx * x + wide_dy * y) + n * d;
        Self {
            n: self.n,
            x: self.x.wrapping_sub(self.n.wrapping_mul(dx)),
            y: self.y.wrapping_sub(self.n.wrapping_mul(dy)),
            xx: self.xx - 2 * wide_dx * x + n * wide_dx * wide_dx,
            xy: self.xy - wide_dx * y - wide_dy * x + n * wide_dx * wide_dy,
            yy: self.yy - 2 * wide_dy * y + n * wide_dy * wide_dy,
            xz: self.xz - 2 * (wide_dx * self.xx + wide_dy * self.xy) + d * x - wide_dx * moved_z,
            yz: self.yz - 2 * (wide_dx * self.xy + wide_dy * self.yy) + d * y - wide_dy * moved_z,
        }
    }
}

/// Moments about the mean, with z = u² + v² for a pixel at (u, v) from the mean. Units: px to the order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CentralMoments<T> {
    /// Number of pixels.
    pub n: T,
    /// Mean column in pixels.
    pub mean_x: T,
    /// Mean row in pixels.
    pub mean_y: T,
    /// Σu².
    pub uu: T,
    /// Σuv.
    pub uv: T,
    /// Σv².
    pub vv: T,
    /// Σu(u² + v²).
    pub uz: T,
    /// Σv(u² + v²).
    pub vz: T,
}

impl<T: RealField + Copy> CentralMoments<T> {
    /// Returns the moments of the pixels of `sums`, whose local origin lies at pixel (`origin_x`, `origin_y`).
    ///
    /// The sums are first moved to the pixel nearest to their mean, in exact integer arithmetic, so that the rounding
    /// in `T` only concerns numbers of the size of the cluster. Returns `None` if there are no pixels.
    pub fn new(sums: &PixelSums, origin_x: i32, origin_y: i32) -> Option<Self> {
        if sums.n <= 0 {
            return None;
        }
        let (near_x, near_y) = (rounded_quotient(sums.x, sums.n), rounded_quotient(sums.y, sums.n));
        let near = sums.moved(near_x, near_y);
        let n = from_i32::<T>(near.n);
        let (x, y) = (from_i32::<T>(near.x) / n, from_i32::<T>(near.y) / n);
        let moments = Self {
            n,
            mean_x: T::zero(),
            mean_y: T::zero(),
            uu: from_i64(near.xx),
            uv: from_i64(near.xy),
            vv: from_i64(near.yy),
            uz: from_i64(near.xz),
            vz: from_i64(near.yz),
        };
        let two = T::one() + T::one();
        let z = moments.uu + moments.vv;
        let d = x * x + y * y;
        Some(Self {
            n,
            mean_x: from_i32::<T>(origin_x.saturating_add(near_x)) + x,
            mean_y: from_i32::<T>(origin_y.saturating_add(near_y)) + y,
            uu: moments.uu - n * x * x,
            uv: moments.uv - n * x * y,
            vv: moments.vv - n * y * y,
            uz: moments.uz - two * (x * moments.uu + y * moments.uv) - x * z + two * n * d * x,
            vz: moments.vz - two * (x * moments.uv + y * moments.vv) - y * z + two * n * d * y,
        })
    }

    /// Returns the moments of the union of two sets of pixels.
    #[must_use]
    pub fn joined(&self, other: &Self) -> Self {
        let n = self.n + other.n;
        let (weight, other_weight) = (self.n / n, other.n / n);
        let (dx, dy) = (other.mean_x - self.mean_x, other.mean_y - self.mean_y);
        let one = self.about(-dx * other_weight, -dy * other_weight);
        let two = other.about(dx * weight, dy * weight);
        Self {
            n,
            mean_x: self.mean_x + dx * other_weight,
            mean_y: self.mean_y + dy * other_weight,
            uu: one.uu + two.uu,
            uv: one.uv + two.uv,
            vv: one.vv + two.vv,
            uz: one.uz + two.uz,
            vz: one.vz + two.vz,
        }
    }

    /// Returns the moments about a point relative to which the mean lies at (x, y).
    fn about(&self, x: T, y: T) -> Self {
        let two = T::one() + T::one();
        let z = self.uu + self.vv;
        let d = x * x + y * y;
        Self {
            uu: self.uu + self.n * x * x,
            uv: self.uv + self.n * x * y,
            vv: self.vv + self.n * y * y,
            uz: self.uz + two * (x * self.uu + y * self.uv) + x * z + self.n * d * x,
            vz: self.vz + two * (x * self.uv + y * self.vv) + y * z + self.n * d * y,
            ..*self
        }
    }
}

fn rounded_quotient(numerator: i32, denominator: i32) -> i32 {
    numerator.saturating_add(denominator / 2).checked_div_euclid(denominator).unwrap_or(0)
}

fn from_i32<T: RealField>(value: i32) -> T {
    T::from_i32(value).unwrap_or_else(T::zero)
}

/// Converts an integer. Most sums fit into 32 bits, whose conversion is one instruction on a microcontroller.
fn from_i64<T: RealField>(value: i64) -> T {
    match i32::try_from(value) {
        Ok(value) => from_i32(value),
        Err(_) => T::from_i64(value).unwrap_or_else(T::zero),
    }
}

#[cfg(test)]
impl CentralMoments<f64> {
    /// Computes the moments of points, which need not be pixels, from the definition.
    pub(crate) fn by_definition(points: &[(f64, f64)]) -> Self {
        let n = points.len() as f64;
        let mean_x = points.iter().map(|p| p.0).sum::<f64>() / n;
        let mean_y = points.iter().map(|p| p.1).sum::<f64>() / n;
        let sum = |f: &dyn Fn(f64, f64) -> f64| points.iter().map(|p| f(p.0 - mean_x, p.1 - mean_y)).sum::<f64>();
        Self {
            n,
            mean_x,
            mean_y,
            uu: sum(&|u, _| u * u),
            uv: sum(&|u, v| u * v),
            vv: sum(&|_, v| v * v),
            uz: sum(&|u, v| u * (u * u + v * v)),
            vz: sum(&|u, v| v * (u * u + v * v)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn sums(pixels: &[(i32, i32)]) -> PixelSums {
        let mut sums = PixelSums::default();
        for &(x, y) in pixels {
            sums.add_run(x, y, 1);
        }
        sums
    }

    fn direct(pixels: &[(i32, i32)]) -> CentralMoments<f64> {
        let points: Vec<(f64, f64)> = pixels.iter().map(|&(x, y)| (x.into(), y.into())).collect();
        CentralMoments::by_definition(&points)
    }

    fn close(a: &CentralMoments<f64>, b: &CentralMoments<f64>) -> bool {
        let scale = 1.0 + b.n * 40.0_f64.powi(3);
        [a.n - b.n, a.mean_x - b.mean_x, a.mean_y - b.mean_y].iter().all(|d| d.abs() < 1e-9)
            && [a.uu - b.uu, a.uv - b.uv, a.vv - b.vv, a.uz - b.uz, a.vz - b.vz].iter().all(|d| d.abs() < 1e-11 * scale)
    }

    proptest! {
        #[test]
        fn runs_equal_their_pixels(x in -60_i32..60, y in -60_i32..60, length in 0_u16..90) {
            let mut run = PixelSums::default();
            run.add_run(x, y, length);
            let pixels: Vec<(i32, i32)> = (x..x + i32::from(length)).map(|x| (x, y)).collect();
            prop_assert_eq!(run, sums(&pixels));
            let xz: i64 = pixels.iter().map(|&(x, y)| i64::from(x * (x * x + y * y))).sum();
            prop_assert_eq!(run.xz, xz);
        }

        #[test]
        fn moving_the_origin_equals_summing_from_there(
            pixels in prop::collection::vec((-40_i32..40, -40_i32..40), 1..60),
            dx in -50_i32..50,
            dy in -50_i32..50,
        ) {
            let moved: Vec<(i32, i32)> = pixels.iter().map(|p| (p.0 - dx, p.1 - dy)).collect();
            prop_assert_eq!(sums(&pixels).moved(dx, dy), sums(&moved));
        }

        #[test]
        fn central_moments_equal_their_definition(
            pixels in prop::collection::vec((-40_i32..40, -40_i32..40), 2..60),
            split in 1_usize..59,
        ) {
            let split = split.min(pixels.len() - 1);
            let whole = CentralMoments::<f64>::new(&sums(&pixels), 0, 0).unwrap();
            prop_assert!(close(&whole, &direct(&pixels)), "{:?} {:?}", whole, direct(&pixels));
            let (one, two) = pixels.split_at(split);
            let one = CentralMoments::<f64>::new(&sums(one), 0, 0).unwrap();
            let two = CentralMoments::<f64>::new(&sums(two), 0, 0).unwrap();
            prop_assert!(close(&one.joined(&two), &whole));
        }
    }
}
