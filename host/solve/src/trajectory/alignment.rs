//! Alignment of two devices on one mount in time and rotation, from their angular velocities.
//!
//! **Offset**: the magnitude of the angular velocity is the same whatever the devices' axes. Its normalised correlation over all
//! shifts must have a clear peak; among several, the directions of the angular velocities agree only at the right one.
//! **Rotation**: the one that maps the angular velocities of the first device to the angular
//! velocities of the second (Wahba's problem, as in Park and Martin 1994 for hand-eye calibration). If the motion does not
//! determine them, [`AlignmentError`] contains the reason.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use evcal_geometry::numerics::lag::{Lag, NoLag, Rules, lag, lags};

/// Smallest valid correlation.
const CORRELATION: f64 = 0.9;
/// Largest second peak, relative to the best one.
const SECOND_PEAK: f64 = 0.9;
/// Smallest distance of another peak (s).
const PEAK_DISTANCE: f64 = 0.4;
/// Largest number of offsets at which the directions of the angular velocities are compared.
const MOST_OFFSETS: usize = 8;
/// Another offset may be right if it leaves less than this many times as much unexplained as the best one, or as [`NOISE`], a share of
/// the angular velocities.
const CLEARLY: f64 = 2.0;
const NOISE: f64 = 0.005;
/// Root mean square of the angular velocity below which a camera hardly rotated (rad/s).
pub const LEAST_RATE: f64 = 0.08;
/// Rates at which a second device's clock may run by mistake (a counter that is added twice, another divider), and the
/// right rate 1; in seconds of the first clock per second of the second.
pub const MISTAKEN_RATES: [f64; 9] = [0.25, 1.0 / 3.0, 0.5, 2.0 / 3.0, 1.0, 1.5, 2.0, 3.0, 4.0];
/// Length of the beginning of both series that is compared at other rates (s); the time of the comparison grows with its square.
const LONGEST_OF_OTHER_RATE: f64 = 30.0;
/// Step of that comparison (s); a hand rotates more slowly.
const COARSE_STEP: f64 = 0.02;
/// Longest series (s); the times of a longer one are in another unit.
const LONGEST: f64 = 86_400.0;

/// Reasons why the motion does not determine the alignment of two devices, with remedies.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum AlignmentError {
    /// The camera hardly rotated.
    #[error("the camera rotated by only {rate:.1} °/s: rotate it about two of its axes, back and forth, quickly")]
    LittleRotation {
        /// Root mean square of the angular velocity in °/s.
        rate: f64,
    },
    /// The camera rotated at a constant rate.
    #[error(
        "the camera rotated by {rate:.1} °/s all the time, which does not determine the offset of the clocks: rotate it back and forth about two of its axes"
    )]
    EvenRotation {
        /// Mean of the angular velocity in °/s.
        rate: f64,
    },
    /// The camera rotated about one axis, as it does when it moves in a plane.
    #[error(
        "the camera rotated about one axis only, its {axis}, so positions along that axis cannot be measured: rotate the camera about another axis too"
    )]
    OneAxis {
        /// The axis in words.
        axis: &'static str,
    },
    /// The rotations have nothing in common.
    #[error(
        "the rotation of the other device does not match the camera's (best correlation {correlation:.2}, wanted {CORRELATION}): give recordings of the same session, made while it was fixed to the camera"
    )]
    OtherMotion {
        /// The largest correlation.
        correlation: f64,
    },
    /// The rotations agree at another rate of the second clock.
    #[error(
        "the clock of the other device runs {rate:.2} times as fast as the events' clock: the driver stamped it wrongly; multiply its times by {:.3}",
        1.0 / rate
    )]
    OtherRate {
        /// Seconds of the second clock per second of the first.
        rate: f64,
    },
    /// The motion is periodic.
    #[error(
        "the motion is periodic, so the offset of the clocks may be {first:.2} s or {second:.2} s: move less regularly"
    )]
    Ambiguous {
        /// The better offset (s).
        first: f64,
        /// The other one (s).
        second: f64,
    },
}

/// Values at equally spaced times; `None` if there is no value at a time.
#[derive(Clone, Debug, PartialEq)]
pub struct Series<T> {
    /// Time of the first value (s).
    pub start: f64,
    /// Time between values (s).
    pub step: f64,
    /// The values.
    pub values: Vec<Option<T>>,
}

/// Magnitudes of an angular velocity (rad/s).
pub type Rates = Series<f64>;

/// Angular velocities in the device's own axes (rad/s).
pub type Turns = Series<Vector3<f64>>;

impl<T: Copy> Series<T> {
    /// Samples `value` at every `step` from `start` to `end` (s).
    pub fn new(start: f64, end: f64, step: f64, value: impl Fn(f64) -> Option<T>) -> Self {
        let count = if end >= start { ((end - start).min(LONGEST) / step) as usize + 1 } else { 0 };
        Self { start, step, values: (0..count).map(|index| value(start + step * index as f64)).collect() }
    }

    /// Returns the known values.
    pub fn known(&self) -> impl Iterator<Item = T> + '_ {
        self.values.iter().flatten().copied()
    }
}

impl Rates {
    /// Returns the beginning of the series in coarse steps, if each second of its clock is `rate` seconds.
    fn coarse(&self, rate: f64) -> Self {
        let value = |t: f64| {
            let place = (t / rate - self.start) / self.step;
            let below = place.floor();
            if below < 0.0 {
                return None;
            }
            let (before, after) = ((*self.values.get(below as usize)?)?, (*self.values.get(below as usize + 1)?)?);
            Some(before + (after - before) * (place - below))
        };
        let (start, length) = (rate * self.start, rate * self.step * self.values.len() as f64);
        Self::new(start, start + length.min(LONGEST_OF_OTHER_RATE), COARSE_STEP, value)
    }

    /// Returns the root mean square (rad/s).
    pub fn root_mean_square(&self) -> f64 {
        let count = self.known().count().max(1) as f64;
        (self.known().map(|rate| rate * rate).sum::<f64>() / count).sqrt()
    }

    /// Checks that the camera rotated.
    ///
    /// # Errors
    /// [`AlignmentError::LittleRotation`] if it hardly did.
    pub fn check(&self) -> Result<(), AlignmentError> {
        let rate = self.root_mean_square();
        if rate < LEAST_RATE {
            return Err(AlignmentError::LittleRotation { rate: rate.to_degrees() });
        }
        Ok(())
    }
}

impl Turns {
    /// Returns the magnitudes.
    pub fn rates(&self) -> Rates {
        let values = self.values.iter().map(|value| value.map(|velocity| velocity.norm())).collect();
        Rates { start: self.start, step: self.step, values }
    }

    /// Interpolates between known values.
    fn at(&self, t: f64) -> Option<Vector3<f64>> {
        let place = (t - self.start) / self.step;
        let below = place.floor();
        if below < 0.0 {
            return None;
        }
        let (before, after) =
            (self.values.get(below as usize)?.as_ref()?, self.values.get(below as usize + 1)?.as_ref()?);
        Some(before.lerp(after, place - below))
    }
}

/// Shortest common time of both series.
#[derive(Clone, Copy, Debug)]
pub struct Overlap {
    /// Share of the shorter series.
    pub share: f64,
    /// Length in seconds.
    pub seconds: f64,
}

/// The offset between two clocks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Offset {
    /// Time by which the second clock is ahead of the first (s).
    pub seconds: f64,
    /// Correlation of the rates at this offset.
    pub correlation: f64,
}

/// Returns the offset of the clock of `second` from the clock of `first`, the camera; both have the same step.
///
/// # Errors
/// [`AlignmentError`] if no offset is clearly the best.
pub fn offset(first: &Turns, second: &Turns, overlap: Overlap) -> Result<Offset, AlignmentError> {
    let [of_first, of_second] = [first, second].map(Turns::rates);
    let offsets = offsets(&of_first, &of_second, overlap, MOST_OFFSETS)?;
    let compared = |offset: Offset| (ComparedTurns::new(first, second, offset.seconds).unexplained(), offset);
    let mut found: Vec<(f64, Offset)> = offsets.into_iter().map(compared).collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    match *found.as_slice() {
        [(best, one), (next, other), ..] if next < CLEARLY * best.max(NOISE) => {
            let in_another_clock = in_another_clock(&of_first, &of_second, overlap);
            Err(in_another_clock.unwrap_or(ambiguous(one, other, first.step)))
        }
        [(_, one), ..] => Ok(one),
        [] => Err(AlignmentError::OtherMotion { correlation: 0.0 }),
    }
}

/// Returns all offsets that may be right, the best first, at most `most` of them: more than one if the motion is periodic.
///
/// # Errors
/// [`AlignmentError`] if no offset fits.
pub fn offsets(first: &Rates, second: &Rates, overlap: Overlap, most: usize) -> Result<Vec<Offset>, AlignmentError> {
    let seconds = |steps: f64| second.start - first.start + steps * first.step;
    match lags(&first.values, &second.values, &rules(first, second, overlap), most) {
        Ok(found) => {
            let offset = |lag: &Lag| Offset { seconds: seconds(lag.steps), correlation: lag.correlation };
            Ok(found.iter().map(offset).collect())
        }
        Err(NoLag::Steady { mean }) => Err(AlignmentError::EvenRotation { rate: mean.to_degrees() }),
        Err(NoLag::Unlike { correlation }) => {
            let unlike = AlignmentError::OtherMotion { correlation };
            Err(in_another_clock(first, second, overlap).unwrap_or(unlike))
        }
        Err(NoLag::Ambiguous { first, second }) => {
            Err(AlignmentError::Ambiguous { first: seconds(first), second: seconds(second) })
        }
    }
}

/// Returns the error for a periodic motion for which both offsets may be right, rounded to `step` (s).
pub fn ambiguous(one: Offset, other: Offset, step: f64) -> AlignmentError {
    let rounded = |offset: Offset| (offset.seconds / step).round() * step;
    AlignmentError::Ambiguous { first: rounded(one), second: rounded(other) }
}

/// Returns the conditions for a clear offset.
fn rules(first: &Rates, second: &Rates, overlap: Overlap) -> Rules {
    let known = |rates: &Rates| rates.known().count() as f64;
    Rules {
        fewest_pairs: (overlap.share * known(first).min(known(second))).max(overlap.seconds / first.step),
        correlation: CORRELATION,
        second_peak: SECOND_PEAK,
        peak_distance: (PEAK_DISTANCE / first.step) as usize,
    }
}

/// Returns an error with the rate of the second clock, if the rotations agree at another rate.
fn in_another_clock(first: &Rates, second: &Rates, overlap: Overlap) -> Option<AlignmentError> {
    let first = first.coarse(1.0);
    let fits = |rate: &&f64| {
        let second = second.coarse(**rate);
        lag(&first.values, &second.values, &rules(&first, &second, overlap)).is_ok()
    };
    let rate = MISTAKEN_RATES.iter().filter(|rate| **rate != 1.0).find(fits);
    rate.map(|rate| AlignmentError::OtherRate { rate: 1.0 / rate })
}

/// Checks that the camera rotated about more than one axis. `turns` is the sum of the outer products of another
/// device's angular velocities with the camera's; its second singular value must be more than `share` of the first.
///
/// # Errors
/// [`AlignmentError::OneAxis`] names the axis.
pub fn check_axes(turns: &Matrix3<f64>, share: f64) -> Result<(), AlignmentError> {
    let svd = turns.svd(false, true);
    let sizes = svd.singular_values;
    match svd.v_t {
        Some(axes) if sizes[1] < share * sizes[0] => {
            let axis = axes.row(0).transpose().iamax();
            let axis = ["x axis (to the right)", "y axis (downwards)", "z axis (the line of sight)"][axis];
            Err(AlignmentError::OneAxis { axis })
        }
        _ => Ok(()),
    }
}

/// Angular velocities of two devices, compared at the same times.
pub struct ComparedTurns {
    /// Sum of the outer products of the second device's angular velocities with the first device's (rad²/s²).
    pub products: Matrix3<f64>,
    /// Sum of the squares of the first device's angular velocities (rad²/s²).
    pub of_first: f64,
    /// Sum of the squares of the second device's angular velocities (rad²/s²).
    pub of_second: f64,
}

/// The rotation that explains the angular velocities best.
pub struct BestRotation {
    /// `R_second_first`.
    pub rotation: UnitQuaternion<f64>,
    /// Sum of the scalar products of the second device's angular velocities with the first device's, rotated.
    pub explained: f64,
    /// The same sum for the best mirrored rotation.
    pub explained_mirrored: f64,
}

impl ComparedTurns {
    /// Compares `first` and `second`, whose clock is ahead by `offset` (s).
    pub fn new(first: &Turns, second: &Turns, offset: f64) -> Self {
        let mut sums = Self { products: Matrix3::zeros(), of_first: 0.0, of_second: 0.0 };
        for (index, own) in first.values.iter().enumerate() {
            let Some(own) = own else { continue };
            let Some(other) = second.at(first.start + first.step * index as f64 + offset) else { continue };
            sums.products += other * own.transpose();
            sums.of_first += own.norm_squared();
            sums.of_second += other.norm_squared();
        }
        sums
    }

    /// Returns the share of the angular velocities that no rotation explains, mirrored or not.
    fn unexplained(&self) -> f64 {
        let explained = self.rotation().map_or(0.0, |best| best.explained.max(best.explained_mirrored));
        1.0 - explained / (self.of_first * self.of_second).sqrt().max(f64::MIN_POSITIVE)
    }

    /// Returns the rotation between them; `None` if they determine no rotation.
    pub fn rotation(&self) -> Option<BestRotation> {
        let svd = self.products.svd(true, true);
        let (left, right, sizes) = (svd.u?, svd.v_t?, svd.singular_values);
        let determinant = (left * right).determinant().signum();
        let matrix = left * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, determinant)) * right;
        Some(BestRotation {
            rotation: UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix)),
            explained: sizes[0] + sizes[1] + determinant * sizes[2],
            explained_mirrored: sizes[0] + sizes[1] - determinant * sizes[2],
        })
    }
}
