//! By how much the clocks of two things on one mount are apart, and how these are turned against each other, from how they turn.
//!
//! **Offset**: how fast both turn is the same whatever their axes. Its normalised correlation over all shifts must have one clear
//! peak. **Rotation**: the one that carries the angular velocities of the first to those of the second (Wahba's problem, as Park and
//! Martin 1994 for hand-eye calibration). Where the motion does not tell them, [`AlignmentError`] says why.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use evcal_geometry::numerics::lag::{Lag, NoLag, Rules, lag, lags};

/// Smallest correlation that is believed.
const CORRELATION: f64 = 0.9;
/// Share of the best peak that another one must stay below.
const SECOND_PEAK: f64 = 0.9;
/// Nearest another peak may be (s).
const PEAK_DISTANCE: f64 = 0.4;
/// Root mean square of the angular velocity below which a camera hardly turned (rad/s).
pub const LEAST_RATE: f64 = 0.08;
/// Rates at which the clock of a second device runs by mistake, in seconds of the first per second of it: a counter that is added
/// twice, another divider.
pub const MISTAKEN_RATES: [f64; 9] = [0.25, 1.0 / 3.0, 0.5, 2.0 / 3.0, 1.0, 1.5, 2.0, 3.0, 4.0];
/// As much of the beginning of both series is compared at other rates (s): the time that this takes grows with its square.
const LONGEST_OF_OTHER_RATE: f64 = 30.0;
/// In such steps (s): a hand turns more slowly.
const COARSE_STEP: f64 = 0.02;
/// Longest series (s); longer ones have other units.
const LONGEST: f64 = 86_400.0;

/// Why the motion does not tell how two things are aligned, and what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum AlignmentError {
    /// The camera hardly turned.
    #[error("the camera turned by {rate:.1} °/s only: turn it about two of its axes, back and forth, quickly")]
    LittleRotation {
        /// Root mean square of the angular velocity in °/s.
        rate: f64,
    },
    /// The camera turned at the same rate all the time.
    #[error(
        "the camera turned by {rate:.1} °/s all the time, which leaves the offset of the clocks open: turn it back and forth about two of its axes"
    )]
    EvenRotation {
        /// Mean of the angular velocity in °/s.
        rate: f64,
    },
    /// The camera turned about one axis, as it does where it moves in a plane.
    #[error(
        "the camera turned about one axis only, its {axis}: where a thing lies along that axis cannot be measured: turn the camera about another axis too"
    )]
    OneAxis {
        /// The axis in words.
        axis: &'static str,
    },
    /// The turns have nothing in common.
    #[error(
        "the other device does not turn as the camera does (best correlation {correlation:.2}, wanted {CORRELATION}): give recordings of the same session, made while it was fixed to the camera"
    )]
    OtherMotion {
        /// The largest correlation.
        correlation: f64,
    },
    /// The turns are the same at another rate of the second clock.
    #[error(
        "the clock of the other device runs {rate:.2} times as fast as that of the camera's events: the driver stamped it wrongly; multiply its times by {:.3}",
        1.0 / rate
    )]
    OtherRate {
        /// Seconds of the second clock per second of the first.
        rate: f64,
    },
    /// The motion repeats itself.
    #[error(
        "the motion repeats itself, so that the clocks may be {first:.2} s or {second:.2} s apart: move less regularly"
    )]
    Ambiguous {
        /// The better offset (s).
        first: f64,
        /// The other one (s).
        second: f64,
    },
}

/// Values at even times, where they are known.
#[derive(Clone, Debug, PartialEq)]
pub struct Series<T> {
    /// Time of the first (s).
    pub start: f64,
    /// From one to the next (s).
    pub step: f64,
    /// The values.
    pub values: Vec<Option<T>>,
}

/// How fast something turns (rad/s).
pub type Rates = Series<f64>;

/// How something turns: its angular velocity in its own axes (rad/s).
pub type Turns = Series<Vector3<f64>>;

impl<T: Copy> Series<T> {
    /// The `value` of every `step` from `start` to `end` (s).
    pub fn new(start: f64, end: f64, step: f64, value: impl Fn(f64) -> Option<T>) -> Self {
        let count = if end >= start { ((end - start).min(LONGEST) / step) as usize + 1 } else { 0 };
        Self { start, step, values: (0..count).map(|index| value(start + step * index as f64)).collect() }
    }

    /// Those that are known.
    pub fn known(&self) -> impl Iterator<Item = T> + '_ {
        self.values.iter().flatten().copied()
    }
}

impl Rates {
    /// The beginning of the same in coarse steps, where each second of its clock is `rate` seconds.
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

    /// Root mean square (rad/s).
    pub fn root_mean_square(&self) -> f64 {
        let count = self.known().count().max(1) as f64;
        (self.known().map(|rate| rate * rate).sum::<f64>() / count).sqrt()
    }

    /// Whether the camera turned at all.
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
    /// How fast it turns.
    pub fn rates(&self) -> Rates {
        let values = self.values.iter().map(|value| value.map(|velocity| velocity.norm())).collect();
        Rates { start: self.start, step: self.step, values }
    }

    /// Between the times that are known.
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

/// How long both must be known at the least.
#[derive(Clone, Copy, Debug)]
pub struct Overlap {
    /// As a share of the shorter series.
    pub share: f64,
    /// In seconds.
    pub seconds: f64,
}

/// The offset between two clocks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Offset {
    /// By how much the second clock is ahead of the first (s).
    pub seconds: f64,
    /// Correlation of the rates there.
    pub correlation: f64,
}

/// By how much the clock of `second` is ahead of that of `first`, the camera; both have the same step.
///
/// # Errors
/// [`AlignmentError`] when no offset is clearly the best.
pub fn offset(first: &Rates, second: &Rates, overlap: Overlap) -> Result<Offset, AlignmentError> {
    match *offsets(first, second, overlap, 2)?.as_slice() {
        [one] => Ok(one),
        [one, other, ..] => Err(in_another_clock(first, second, overlap).unwrap_or(ambiguous(one, other, first.step))),
        [] => Err(AlignmentError::OtherMotion { correlation: 0.0 }),
    }
}

/// All offsets that may be the right one, the best first, `most` of them at the most: more than one where the motion repeats itself.
///
/// # Errors
/// [`AlignmentError`] when there is none.
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

/// The motion repeats itself, so that both may be right; to a `step` (s).
pub fn ambiguous(one: Offset, other: Offset, step: f64) -> AlignmentError {
    let rounded = |offset: Offset| (offset.seconds / step).round() * step;
    AlignmentError::Ambiguous { first: rounded(one), second: rounded(other) }
}

/// What makes an offset clear.
fn rules(first: &Rates, second: &Rates, overlap: Overlap) -> Rules {
    let known = |rates: &Rates| rates.known().count() as f64;
    Rules {
        fewest_pairs: (overlap.share * known(first).min(known(second))).max(overlap.seconds / first.step),
        correlation: CORRELATION,
        second_peak: SECOND_PEAK,
        peak_distance: (PEAK_DISTANCE / first.step) as usize,
    }
}

/// The rate of the second clock, if both turn alike at another one.
fn in_another_clock(first: &Rates, second: &Rates, overlap: Overlap) -> Option<AlignmentError> {
    let first = first.coarse(1.0);
    let fits = |rate: &&f64| {
        let second = second.coarse(**rate);
        lag(&first.values, &second.values, &rules(&first, &second, overlap)).is_ok()
    };
    let rate = MISTAKEN_RATES.iter().filter(|rate| **rate != 1.0).find(fits);
    rate.map(|rate| AlignmentError::OtherRate { rate: 1.0 / rate })
}

/// Whether the camera turned about more than one axis; `turns` is the sum of the products of angular velocities with those of the camera, whose
/// second singular value must be more than `share` of the first.
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

/// The turns of two things compared at the same times.
pub struct ComparedTurns {
    /// Sum of the products of the second's angular velocities with the first's.
    pub products: Matrix3<f64>,
    /// Sum of the squares of the first's.
    pub of_first: f64,
    /// Sum of the squares of the second's.
    pub of_second: f64,
}

/// The rotation that explains the turns best.
pub struct BestRotation {
    /// `R_second_first`.
    pub rotation: UnitQuaternion<f64>,
    /// What it explains of the products; what the squares have beyond that it leaves.
    pub explained: f64,
    /// The same of the best mirrored one.
    pub explained_mirrored: f64,
}

impl ComparedTurns {
    /// Of `first` and `second`, whose clock is ahead by `offset` (s).
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

    /// The rotation between them; `None` if there is none.
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
