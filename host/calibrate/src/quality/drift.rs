//! Detection of a lens or a board that changed within the recordings.
//!
//! A camera that is calibrated from two lenses lies between them. Halves of alternating slices then agree with each other, because
//! each half is the same mixture. Here, everything before a moment is compared with everything after it. The model is one step δ of
//! a few parameters at that moment, with all other parameters common to both sides and the trajectories adapting. To first order,
//! everything follows from the contributions of intervals of time to the normal equations, Sᵦ and gᵦ, so nothing is solved again.
//!
//! With S = Σ Sᵦ, the equations S₂ of the part after the moment, its gradient g₂, and the directions V of the step: the information
//! about the step is J = Vᵀ(S₂ − S₂S⁻¹S₂)V, the step is δ = −J⁻¹Vᵀg₂, the common parameters change by τ = −S⁻¹S₂Vδ, and the cost
//! decreases by δᵀJδ/2. Each moment between two blocks is tried, and the one with the greatest decrease is taken (the likelihood
//! ratio scan for a change point). The variance of the step is the larger one of two: J⁻¹ times the inflation from the scatter of
//! blocks, and the scatter of the blocks' own scores about the step (the sandwich estimator), both over blocks of several lengths and
//! with the step applied, so that the step itself is not part of the scatter.

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::uncertainty::blocks::{limited_step, scatter};
use evcal_geometry::lens::projection_difference::grid;
use evcal_geometry::lens::projection_sensitivity::projection_sensitivity;
use evcal_solve::solve::equations::system::{Contribution, PackedContribution};
use evcal_solve::solve::{BOARD_INDEX, GLOBAL_COUNT};

/// Length of a block (s). Moments of a change are searched between blocks.
const BLOCK: f64 = 0.25;
/// Numbers of adjacent blocks that are summed for the scatter.
const SUMMED: [usize; 3] = [1, 2, 4];
/// Fewest blocks on each side of a change; half of it at the border between two recordings.
const FEWEST_BLOCKS: usize = 4;
/// Smallest change in units of its standard deviation. It is the most significant of six parameters at any moment.
const SIGNIFICANT: f64 = 5.0;
/// A border between two recordings is the moment of the change if it explains at least this share of the best moment's decrease.
const BORDER_SHARE: f64 = 0.8;

/// Number of parameters that may change: scale of the image, principal point along x and y; print ratio, bend along x and y.
const CHANGES: usize = 6;
/// Parameters of the lens among them.
const OF_LENS: usize = 3;

/// The thing that changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Changed {
    /// The lens, or the camera.
    Lens,
    /// The board.
    Board,
}

/// A change with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Change {
    /// The later value minus the earlier one.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// A change of the lens or the board at one moment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Drift {
    /// The thing that changed.
    pub changed: Changed,
    /// The recording in which, or at whose start, it changed.
    pub recording: usize,
    /// Time of the change in seconds since the start of the recording; `None` if it changed before the recording.
    pub t: Option<f64>,
    /// The largest change of one parameter in units of its standard deviation.
    pub significance: f64,
    /// Change of the focal lengths, as a share of them.
    pub focal_length: Option<Change>,
    /// Changes of the principal point (px).
    pub principal_point: [Option<Change>; 2],
    /// Change of the print ratio of the board.
    pub print_ratio: Option<Change>,
    /// Changes of the board's bend along x and y (m).
    pub bend: [Option<Change>; 2],
    /// Distance of the common camera from the farther one of the cameras before and after the change (px, rms over the sensor).
    pub distance: f64,
    /// The step of the intrinsics to that camera, in the order of the camera model.
    #[serde(skip)]
    pub step: Vec<f64>,
}

/// Time and place of the contributions.
#[derive(Clone, Copy, Debug)]
pub struct Interval {
    /// Number of the recording.
    pub recording: usize,
    /// Start in seconds since the start of the recording.
    pub start: f64,
    /// Second derivative of the loss as a share of the information, which counts outliers by their weight ([`Loss::curvature`]).
    ///
    /// [`Loss::curvature`]: evcal_solve::solve::rows::loss::Loss::curvature
    pub curvature: f64,
}

impl Drift {
    /// Returns the covariance of the intrinsics that makes the distance to the farther camera one standard deviation.
    pub fn covariance(&self) -> DMatrix<f64> {
        let step = DVector::from_column_slice(&self.step);
        &step * step.transpose()
    }
}

/// Searches for a change. `contributions` belong to `intervals`, and to the parameters that are
/// `free`; they were evaluated at the common solution, whose camera is `camera`. Returns the most significant change, if one is
/// significant.
pub fn drift(
    camera: &Camera<f64>,
    sensor: Sensor,
    free: &[bool; GLOBAL_COUNT],
    intervals: &[Interval],
    contributions: &[PackedContribution],
) -> Option<Drift> {
    let blocks = blocks(intervals, contributions)?;
    let whole = Whole::new(blocks, directions(camera, free), first_count(free))?;
    let best = [(Changed::Lens, 0..OF_LENS), (Changed::Board, OF_LENS..CHANGES)].into_iter();
    let best = best.filter_map(|(changed, columns)| {
        let columns: Vec<usize> = columns.filter(|&column| whole.directions.column(column).amax() > 0.0).collect();
        let (place, gain) = whole.best_place(&columns)?;
        Some((changed, columns, place, gain))
    });
    let (changed, columns, place, _) = best.max_by(|a, b| a.3.total_cmp(&b.3))?;
    let (step, common) = whole.step(&columns, place)?;
    let sigma = whole.sigma(&columns, place, &step, &common)?;
    let mut changes = [None; CHANGES];
    for ((&column, &value), &sigma) in columns.iter().zip(step.iter()).zip(&sigma) {
        changes[column] = Some(Change { value, sigma });
    }
    // Both alone and together with the others, so that a correlation of two changes is not a change.
    let alone = columns.iter().filter_map(|&column| whole.significance(column, place));
    let together = step.iter().zip(&sigma).map(|(value, sigma)| value.abs() / sigma);
    let significance = alone.fold(0.0, f64::max).min(together.fold(0.0, f64::max));
    let [focal_length, x, y, print_ratio, bend_x, bend_y] = changes;
    let later = &whole.directions_of(&columns) * &step;
    let squares = projection_sensitivity(camera, &grid(sensor))?;
    let far = [common.clone(), common + later].into_iter().map(|step| {
        let step = of_camera(&step, camera, free);
        let distance = (step.dot(&(&squares.squares * &step)) / squares.seen as f64).max(0.0).sqrt();
        (distance, step.as_slice().to_vec())
    });
    let (distance, step) = far.max_by(|a, b| a.0.total_cmp(&b.0))?;
    let first = whole.blocks.get(place)?;
    (significance > SIGNIFICANT).then(|| Drift {
        changed,
        recording: first.at.recording,
        t: (!whole.is_border(place)).then_some(first.at.start),
        significance,
        focal_length,
        principal_point: [x, y],
        print_ratio,
        bend: [bend_x, bend_y],
        distance,
        step,
    })
}

/// Returns the part of a step of the `free` parameters that belongs to the `camera`.
fn of_camera(step: &DVector<f64>, camera: &Camera<f64>, free: &[bool; GLOBAL_COUNT]) -> DVector<f64> {
    let mut all = DVector::zeros(camera.parameters().len());
    let places = (0..GLOBAL_COUNT).filter(|&global| free[global]);
    for (global, value) in places.zip(step.iter()) {
        if let Some(entry) = all.get_mut(global) {
            *entry = *value;
        }
    }
    all
}

/// Returns the number of `free` parameters that are intrinsics or the board's, which come first.
fn first_count(free: &[bool; GLOBAL_COUNT]) -> usize {
    free.iter().take(BOARD_INDEX + evcal_solve::solve::BOARD_PARAMETERS).filter(|&&free| free).count()
}

/// Returns the direction of each change in the space of the `free` parameters; zero if it is not possible.
fn directions(camera: &Camera<f64>, free: &[bool; GLOBAL_COUNT]) -> DMatrix<f64> {
    let places: Vec<usize> = (0..GLOBAL_COUNT).filter(|&global| free[global]).collect();
    let parameters = camera.parameters();
    DMatrix::from_fn(places.len(), CHANGES, |row, column| {
        let global = places[row];
        match column {
            0 if global < 2 => parameters[global],
            1 | 2 if global == column + 1 => 1.0,
            3..CHANGES if global == BOARD_INDEX + column - OF_LENS => 1.0,
            _ => 0.0,
        }
    })
}

/// The equations of a block of time.
#[derive(Clone)]
struct Block {
    at: Interval,
    equations: Contribution,
}

/// Sums the contributions over blocks of about [`BLOCK`] seconds, none of which is in two recordings; shorter ones if the recordings are
/// short. Returns `None` if there are too few.
fn blocks(intervals: &[Interval], contributions: &[PackedContribution]) -> Option<Vec<Block>> {
    let mut ordered: Vec<(&Interval, &PackedContribution)> = intervals.iter().zip(contributions).collect();
    ordered.sort_by(|(a, _), (b, _)| a.recording.cmp(&b.recording).then(a.start.total_cmp(&b.start)));
    let mut blocks: Vec<(Interval, f64, Vec<&PackedContribution>)> = Vec::new();
    for (interval, contribution) in ordered {
        match blocks.last_mut() {
            Some((at, curvature, parts)) if at.recording == interval.recording && interval.start < at.start + BLOCK => {
                *curvature += interval.curvature;
                parts.push(contribution);
            }
            _ => blocks.push((*interval, interval.curvature, vec![contribution])),
        }
    }
    let sum = |(at, curvature, parts): (Interval, f64, Vec<&PackedContribution>)| {
        let curvature = curvature / parts.len() as f64;
        let mut equations = PackedContribution::sum(parts)?;
        equations.information *= curvature;
        Some(Block { at, equations })
    };
    let blocks: Vec<Block> = blocks.into_iter().filter_map(sum).collect();
    (blocks.len() >= 2 * FEWEST_BLOCKS).then_some(blocks)
}

/// All blocks with the sum of their equations. The sum of the gradients is zero.
struct Whole {
    blocks: Vec<Block>,
    /// For each block, the sum of the equations of this block and all later ones.
    after: Vec<Contribution>,
    /// Inverse of the sum of the information.
    formal: DMatrix<f64>,
    directions: DMatrix<f64>,
    /// Number of parameters of lens and board, which come first.
    first: usize,
}

impl Whole {
    fn new(mut blocks: Vec<Block>, directions: DMatrix<f64>, first: usize) -> Option<Self> {
        let sum = |blocks: &[Block]| {
            let parts = blocks.iter().map(|block| &block.equations);
            parts.cloned().reduce(|a, b| plus(&a, &b))
        };
        let all = sum(&blocks)?;
        let formal = all.information.cholesky()?.inverse();
        // The equations were evaluated near the common solution; the rest of the way is one step.
        let rest = -(&formal * all.gradient);
        for block in &mut blocks {
            block.equations.gradient += &block.equations.information * &rest;
        }
        let mut after: Vec<Contribution> = Vec::with_capacity(blocks.len());
        for block in blocks.iter().rev() {
            let later = after.last().map_or_else(|| block.equations.clone(), |later| plus(later, &block.equations));
            after.push(later);
        }
        after.reverse();
        Some(Self { blocks, after, formal, directions, first })
    }

    fn directions_of(&self, columns: &[usize]) -> DMatrix<f64> {
        self.directions.select_columns(columns)
    }

    /// Returns `true` if the block at `place` is the first one of a recording other than the first.
    fn is_border(&self, place: usize) -> bool {
        let recording = |place: usize| self.blocks.get(place).map(|block| block.at.recording);
        place > 0 && recording(place - 1) != recording(place)
    }

    /// Returns the place at which a change of `columns` decreases the cost most, with twice the decrease.
    fn best_place(&self, columns: &[usize]) -> Option<(usize, f64)> {
        if columns.is_empty() {
            return None;
        }
        let count = self.blocks.len();
        let is_inside = |place: &usize| {
            let fewest = if self.is_border(*place) { FEWEST_BLOCKS / 2 } else { FEWEST_BLOCKS };
            *place >= fewest && place + fewest <= count
        };
        let gains = (0..count).filter(is_inside).filter_map(|place| {
            let after = self.after.get(place)?;
            let (information, _) = self.information(columns, place)?;
            let gradient = self.directions_of(columns).tr_mul(&after.gradient);
            Some((place, information.cholesky()?.solve(&gradient).dot(&gradient)))
        });
        let gains: Vec<(usize, f64)> = gains.collect();
        let most = |a: &(usize, f64), b: &(usize, f64)| a.1.total_cmp(&b.1);
        let best = gains.iter().copied().max_by(most)?;
        let border = gains.iter().copied().filter(|(place, _)| self.is_border(*place)).max_by(most);
        Some(border.filter(|border| border.1 > BORDER_SHARE * best.1).unwrap_or(best))
    }

    /// Returns the information about a change of `columns` at `place`, and S⁻¹S₂V.
    fn information(&self, columns: &[usize], place: usize) -> Option<(DMatrix<f64>, DMatrix<f64>)> {
        let directions = self.directions_of(columns);
        let moved = &self.after.get(place)?.information * &directions;
        let follows = &self.formal * &moved;
        Some((directions.tr_mul(&moved) - moved.tr_mul(&follows), follows))
    }

    /// Returns the change of `columns` at `place`, and the change of the common parameters with it.
    fn step(&self, columns: &[usize], place: usize) -> Option<(DVector<f64>, DVector<f64>)> {
        let (information, follows) = self.information(columns, place)?;
        let gradient = self.directions_of(columns).tr_mul(&self.after.get(place)?.gradient);
        let step = -information.cholesky()?.solve(&gradient);
        let common = -(follows * &step);
        Some((step, common))
    }

    /// Returns the significance of a change of one parameter at `place`.
    fn significance(&self, column: usize, place: usize) -> Option<f64> {
        let columns = [column];
        let (step, common) = self.step(&columns, place)?;
        let sigma = self.sigma(&columns, place, &step, &common)?;
        Some(step.iter().next()?.abs() / sigma.first()?)
    }

    /// Returns the standard deviation of each change of `columns` at `place`, whose estimate is `step`.
    fn sigma(&self, columns: &[usize], place: usize, step: &DVector<f64>, common: &DVector<f64>) -> Option<Vec<f64>> {
        let (information, follows) = self.information(columns, place)?;
        let formal = information.cholesky()?.inverse();
        let directions = self.directions_of(columns);
        let moved = &directions * step;
        let with_step = |(index, block): (usize, &Block)| {
            let Contribution { gradient, information } = &block.equations;
            let step = if index >= place { common + &moved } else { common.clone() };
            Contribution { gradient: gradient + information * step, information: information.clone() }
        };
        let blocks: Vec<Contribution> = self.blocks.iter().enumerate().map(with_step).collect();
        let (before, after) = blocks.split_at_checked(place)?;
        let mut variances = DVector::zeros(columns.len());
        for summed in SUMMED {
            let sum = |part: &[Contribution]| part.iter().cloned().reduce(|a, b| plus(&a, &b));
            let [before, after] =
                [before, after].map(|side| side.chunks(summed).filter_map(sum).collect::<Vec<Contribution>>());
            let mut spread = DMatrix::zeros(columns.len(), columns.len());
            for (side, is_after) in [(&before, false), (&after, true)] {
                let own = if is_after { directions.clone() } else { DMatrix::zeros(directions.nrows(), columns.len()) };
                let influence = own - &follows;
                let scores = side.iter().map(|block| influence.tr_mul(&block.gradient));
                let sum: DMatrix<f64> =
                    scores.fold(DMatrix::zeros(columns.len(), columns.len()), |sum, one| sum + &one * one.transpose());
                let count = side.len().max(2) as f64;
                spread += sum * (count / (count - 1.0));
            }
            let sandwich = &formal * spread * &formal;
            let all = before.into_iter().chain(after);
            let inflation = scatter(&self.formal, all, self.first, limited_step).map_or(1.0, |one| one.inflation);
            let inflated = &formal * inflation.max(1.0);
            for index in 0..columns.len() {
                variances[index] = f64::max(variances[index], sandwich[(index, index)].max(inflated[(index, index)]));
            }
        }
        Some(variances.iter().map(|variance: &f64| variance.sqrt()).collect())
    }
}

fn plus(a: &Contribution, b: &Contribution) -> Contribution {
    Contribution { gradient: &a.gradient + &b.gradient, information: &a.information + &b.information }
}

#[cfg(test)]
mod tests {
    use evcal_core::camera::ModelKind;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use evcal_geometry::numerics::random::normal;

    const SENSOR: Sensor = Sensor::new(346, 260);
    /// Length of an interval (s), and number of intervals.
    const STEP: f64 = 0.05;
    const COUNT: usize = 120;

    fn camera() -> Camera<f64> {
        Camera::from_parameters(ModelKind::Radtan4, &[332.0, 331.0, 173.0, 131.0, -0.3, 0.1, 0.0, 0.0]).unwrap()
    }

    /// Focal lengths, principal point, print ratio and bends are estimated.
    fn free() -> [bool; GLOBAL_COUNT] {
        std::array::from_fn(|global| global < 4 || (BOARD_INDEX..BOARD_INDEX + 3).contains(&global))
    }

    /// What [`drift`] is given.
    struct Measured {
        intervals: Vec<Interval>,
        contributions: Vec<PackedContribution>,
    }

    /// Measurements of the seven parameters with noise of one unit, each `copies` times in a row. `truth` returns the parameters of
    /// an interval.
    fn measured(
        seed: u64,
        copies: usize,
        recording: impl Fn(usize) -> usize,
        truth: impl Fn(usize) -> [f64; 7],
    ) -> Measured {
        /// Typical derivative of a residual by each parameter.
        const SCALE: [f64; 7] = [0.3, 0.3, 0.2, 0.2, 100.0, 4e3, 4e3];
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut one = |index: usize| {
            let mut sum = Contribution { gradient: DVector::zeros(7), information: DMatrix::zeros(7, 7) };
            for _ in 0..100 {
                let row = DVector::from_fn(7, |place, _| SCALE[place] * normal(&mut rng));
                let residual = row.dot(&DVector::from_column_slice(&truth(index))) + normal(&mut rng);
                sum.gradient -= &row * (residual * copies as f64);
                sum.information += &row * row.transpose() * copies as f64;
            }
            sum
        };
        let all = (0..COUNT).map(|index| {
            let start = STEP * (index % (COUNT / (recording(COUNT - 1) + 1))) as f64;
            (Interval { recording: recording(index), start, curvature: 1.0 }, one(index).into())
        });
        let (intervals, contributions) = all.unzip();
        Measured { intervals, contributions }
    }

    fn found(measured: &Measured) -> Option<Drift> {
        drift(&camera(), SENSOR, &free(), &measured.intervals, &measured.contributions)
    }

    #[test]
    fn noise_is_not_a_change_even_if_measurements_count_several_times() {
        for seed in 0..20 {
            assert_eq!(found(&measured(seed, 1, |_| 0, |_| [0.0; 7])), None, "{seed}");
            // Errors that neighbouring measurements have in common look like more information than there is.
            assert_eq!(found(&measured(seed, 25, |_| 0, |_| [3.0, 3.0, 1.0, 2.0, 1e-3, 1e-4, 0.0])), None, "{seed}");
        }
    }

    /// The focal length grows by 0.5 % after two of six seconds.
    #[test]
    fn a_refocused_lens_is_dated_and_measured() {
        let change = [0.005 * 332.0, 0.005 * 331.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        for seed in 0..5 {
            let truth = |index: usize| if index < 40 { [0.0; 7] } else { change };
            let drift = found(&measured(seed, 1, |_| 0, truth)).expect("a change");
            assert_eq!((drift.changed, drift.recording), (Changed::Lens, 0));
            assert!((drift.t.unwrap() - 2.0).abs() < 0.26, "{drift:?}");
            let Change { value, sigma } = drift.focal_length.unwrap();
            assert!((value - 0.005).abs() < 4.0 * sigma && sigma < 5e-4, "{drift:?}");
            for centre in drift.principal_point.iter().flatten() {
                assert!(centre.value.abs() < 4.0 * centre.sigma, "{drift:?}");
            }
            // A third of the events have the first lens, so the common camera is two thirds of the change away from it.
            assert!((drift.step[0] + change[0] * 2.0 / 3.0).abs() < 0.3, "{drift:?}");
            // 0.5 % of the distance of most pixels from the middle, about 100 px, times two thirds.
            assert!((0.15..0.45).contains(&drift.distance), "{drift:?}");
        }
    }

    #[test]
    fn a_change_between_recordings_is_at_their_border_and_a_bend_is_of_the_board() {
        let recording = |index: usize| usize::from(index >= COUNT / 2);
        let truth = |index: usize| [0.0, 0.0, 0.0, 0.0, 0.0, if index < COUNT / 2 { 3e-3 } else { -3e-3 }, 0.0];
        let drift = found(&measured(3, 1, recording, truth)).expect("a change");
        assert_eq!((drift.changed, drift.recording, drift.t), (Changed::Board, 1, None));
        let Change { value, sigma } = drift.bend[0].unwrap();
        assert!((value + 6e-3).abs() < 4.0 * sigma, "{drift:?}");
    }

    #[test]
    fn short_recordings_are_not_compared() {
        let Measured { intervals, contributions } = measured(1, 1, |_| 0, |_| [0.0; 7]);
        assert_eq!(drift(&camera(), SENSOR, &free(), &intervals[..30], &contributions[..30]), None);
        assert_eq!(drift(&camera(), SENSOR, &free(), &[], &[]), None);
    }
}
