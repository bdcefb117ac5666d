//! The equations of the second camera's observations, as functions of the first camera's trajectory, the mount, and the second
//! camera's lens and event biases.

use super::carried::Carried;
use super::estimate::Estimate;
use super::seen::sample_at;
use evcal_solve::solve::equations::band::Band;
use evcal_solve::solve::equations::border::Columns;
use evcal_solve::solve::equations::normal::Equations;
use evcal_solve::solve::equations::pose_products::PoseProducts;
use evcal_solve::solve::observation_range::{BinSums, ObservationRange};
use evcal_solve::solve::rows::bearing_table::BearingTable;
use evcal_solve::solve::rows::pose_bin::PoseBin;
use evcal_solve::solve::{Problem, SolveError};

/// A bin or a circle centre, by its index, with both poses.
struct Moment {
    index: usize,
    /// Time of the first clock (s).
    t: f64,
    segment: usize,
    first: PoseBin,
    carried: Carried,
}

/// Builds the equations of an interval of the second camera's observations, one piece for each segment of the first camera's
/// trajectory that they meet. `bearings` belong to the second camera, whose estimated global parameters have `columns`, after those
/// of the mount.
///
/// # Errors
/// [`SolveError::OutOfBand`] if an observation does not fit to its piece.
pub fn second_pieces(
    problem: &Problem,
    estimate: &Estimate,
    bearings: &BearingTable,
    columns: &Columns,
    range: &ObservationRange,
) -> Result<Vec<Equations>, SolveError> {
    let observations = problem.segments.get(range.segment).ok_or(SolveError::OutOfBand)?;
    let mount = &estimate.mount;
    let moment = |index: usize, t: f64, rows: f64| {
        let t = mount.row_time(t, rows);
        let time = mount.first_time(t);
        let (segment, sample) = sample_at(&estimate.first.trajectories, time)?;
        let first = PoseBin::of_sample(sample);
        let carried = Carried::new(&first, mount, t, rows);
        Some(Moment { index, t: time, segment, first, carried })
    };
    let bins = range.bins.clone().filter_map(|bin| moment(bin, observations.bins.get(bin)?.t, 0.0));
    let bins: Vec<Moment> = bins.collect();
    let middle = 0.5 * (f64::from(problem.sensor.height) - 1.0);
    let points = range.points.clone().filter_map(|index| {
        let point = observations.points.get(index)?;
        moment(index, point.t, point.pixel.y - middle)
    });
    let points: Vec<Moment> = points.collect();
    let of_bins = bins.chunk_by(|a, b| a.segment == b.segment).map(|run| {
        piece_of(mount.count(), columns, run, |sums, moment| {
            let bin = observations.bins.get(moment.index);
            let events = bin.and_then(|bin| observations.events.get(bin.first..bin.end)).unwrap_or_default();
            sums.add_events(problem, &estimate.second, bearings, &moment.carried.pose, events);
        })
    });
    let of_points = points.chunk_by(|a, b| a.segment == b.segment).map(|run| {
        piece_of(mount.count(), columns, run, |sums, moment| {
            if let Some(point) = observations.points.get(moment.index) {
                sums.add_point(problem, &estimate.second, &moment.carried.pose, point);
            }
        })
    });
    of_bins.chain(of_points).collect()
}

/// Builds the equations of one run of moments, whose observations `add` adds. The first `of_mount` parameters of the border are
/// the mount's.
fn piece_of<'a>(
    of_mount: usize,
    columns: &Columns,
    run: &[Moment],
    add: impl Fn(&mut BinSums<'a>, &Moment),
) -> Result<Equations, SolveError> {
    let begin = run.first().ok_or(SolveError::OutOfBand)?;
    // Rows of a frame may be out of order of time.
    let first_points = || run.iter().map(|moment| moment.first.first);
    let (first, order) = (first_points().min().unwrap_or(0), begin.first.order);
    let count = first_points().max().unwrap_or(0) + order - first;
    let band = Band::new(first, count, order, columns.width());
    let mut equations = Equations::new(begin.segment, begin.t, columns.range(), band);
    let mut sums = BinSums::default();
    let mut of_pose = PoseProducts::new(columns.width());
    for moment in run {
        add(&mut sums, moment);
        if sums.products.is_touched {
            of_pose.take(&sums.products, columns);
            let carried = of_pose.carried(&moment.carried.by, of_mount, &mut equations.corner);
            equations.band.add(&moment.first, &carried)?;
            sums.products.clear_pose();
        }
    }
    equations.add_globals(&sums.products, columns);
    equations.loss = sums.loss;
    Ok(equations)
}

#[cfg(test)]
mod tests;
