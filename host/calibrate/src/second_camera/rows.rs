//! The equations of the second camera's observations, as functions of the first camera's trajectory, the mount, and the second
//! camera's lens and event biases.

use nalgebra::{DMatrix, DVector, Matrix6, SMatrix, Vector6};

use super::carried::{CAUSES, Carried, POSE};
use super::estimate::Estimate;
use super::seen::sample_at;
use crate::solve::Problem;
use crate::solve::bearing_table::BearingTable;
use crate::solve::bordered::Part;
use crate::solve::control_band::Block;
use crate::solve::event_row::ROW_RESIDUAL;
use crate::solve::normal::{RangeEquations, border_of};
use crate::solve::observation_range::{BinSums, ObservationRange};
use crate::solve::pose_bin::PoseBin;
use crate::solve::row_products::RowProducts;

/// Equations of a part of the second camera's observations.
pub struct SecondPart {
    /// Its equations.
    pub part: Part,
    /// Number of observations.
    pub count: usize,
}

/// A bin or a circle centre, by its index, with both poses.
struct Moment {
    index: usize,
    /// Time of the first clock (s).
    t: f64,
    segment: usize,
    first: PoseBin,
    carried: Carried,
}

/// Builds the equations of an interval of the second camera's observations, one part for each segment of the first camera's
/// trajectory that they meet. `bearings` belong to the second camera, `free` its estimated global parameters.
pub fn second_parts(
    problem: &Problem,
    estimate: &Estimate,
    bearings: &BearingTable,
    free: &[usize],
    range: &ObservationRange,
) -> Vec<SecondPart> {
    let Some(observations) = problem.segments.get(range.segment) else { return Vec::new() };
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
        part_of(mount.count(), free, run, |sums, moment| {
            let bin = observations.bins.get(moment.index);
            let events = bin.and_then(|bin| observations.events.get(bin.first..bin.end)).unwrap_or_default();
            sums.add_events(problem, &estimate.second, bearings, &moment.carried.pose, events);
        })
    });
    let of_points = points.chunk_by(|a, b| a.segment == b.segment).map(|run| {
        part_of(mount.count(), free, run, |sums, moment| {
            if let Some(point) = observations.points.get(moment.index) {
                sums.add_point(problem, &estimate.second, &moment.carried.pose, point);
            }
        })
    });
    of_bins.flatten().chain(of_points.flatten()).collect()
}

/// Builds the equations of one run of moments, whose observations `add` adds. The first `of_mount` parameters of the border are
/// the mount's, followed by the `free` parameters of the second camera.
fn part_of<'a>(
    of_mount: usize,
    free: &[usize],
    run: &[Moment],
    add: impl Fn(&mut BinSums<'a>, &Moment),
) -> Option<SecondPart> {
    let begin = run.first()?;
    // Rows of a frame may be out of order of time.
    let of_points = || run.iter().map(|moment| moment.first.first);
    let (first, order) = (of_points().min()?, begin.first.order);
    let points = (of_points().max()? + order).checked_sub(first)?;
    let globals = of_mount + free.len();
    let mut part = Part {
        segment: begin.segment,
        t: begin.t,
        first,
        order,
        blocks: vec![Block::zeros(); points * order],
        globals: 0..globals,
        border: DMatrix::zeros(POSE * points, globals),
        gradient: DVector::zeros(POSE * points),
        corner: DMatrix::zeros(globals, globals),
        corner_gradient: DVector::zeros(globals),
        cost: 0.0,
    };
    let mut sums = BinSums::default();
    for moment in run {
        add(&mut sums, moment);
        add_moment(&mut part, moment, &sums.products, of_mount, free);
        sums.products.clear_pose();
    }
    let mut own = RangeEquations::new(0, 0, order);
    own.add_globals(&sums.products);
    for (row, &global) in free.iter().enumerate() {
        for (column, &other) in free.iter().enumerate() {
            part.corner[(of_mount + row, of_mount + column)] += own.corner[(global.max(other), global.min(other))];
        }
        part.corner_gradient[of_mount + row] += own.corner_gradient[global];
    }
    part.cost = sums.loss.cost;
    Some(SecondPart { part, count: sums.loss.count })
}

/// Expands the products with the second camera's pose to the control points of the first camera's trajectory and the mount.
fn add_moment(part: &mut Part, moment: &Moment, products: &RowProducts, of_mount: usize, free: &[usize]) {
    if !products.is_touched {
        return;
    }
    let (common, by) = (&products.common, &moment.carried.by);
    let own = Matrix6::from_fn(|row, column| common[row.max(column)][row.min(column)]);
    let gradient = by.tr_mul(&Vector6::from_fn(|row, _| common[ROW_RESIDUAL][row]));
    let lens = border_of(products);
    let with_lens = DMatrix::from_fn(POSE, free.len(), |row, column| lens[row][free[column]]);
    let with_lens = by.transpose() * with_lens;
    let causes: SMatrix<f64, CAUSES, CAUSES> = by.tr_mul(&(own * by));

    let mut corner = part.corner.view_mut((0, 0), (of_mount, of_mount));
    corner += causes.view((POSE, POSE), (of_mount, of_mount));
    let mixed = with_lens.rows(POSE, of_mount);
    let mut corner = part.corner.view_mut((0, of_mount), (of_mount, free.len()));
    corner += mixed;
    let mut corner = part.corner.view_mut((of_mount, 0), (free.len(), of_mount));
    corner += mixed.transpose();
    let mut corner = part.corner_gradient.rows_mut(0, of_mount);
    corner += gradient.rows(POSE, of_mount);

    let pose = &moment.first;
    let Some(before) = pose.first.checked_sub(part.first) else { return };
    let of_point = |point: usize| {
        let mut turn = Matrix6::identity() * pose.weights[point];
        turn.fixed_view_mut::<3, 3>(0, 0).copy_from(&pose.rotation_jacobians[point]);
        turn
    };
    let order = part.order;
    for point in 0..order {
        let turn = of_point(point);
        let index = before + point;
        let lines = turn.tr_mul(&causes.fixed_rows::<POSE>(0));
        for other in 0..=point {
            let block = lines.fixed_columns::<POSE>(0) * of_point(other);
            if let Some(sum) = part.blocks.get_mut(index * order + point - other) {
                *sum += block;
            }
        }
        if POSE * (index + 1) > part.gradient.len() {
            return;
        }
        let mut border = part.border.view_mut((POSE * index, 0), (POSE, of_mount));
        border += lines.columns(POSE, of_mount);
        let mut border = part.border.view_mut((POSE * index, of_mount), (POSE, free.len()));
        border += turn.transpose() * with_lens.rows(0, POSE);
        let mut sum = part.gradient.rows_mut(POSE * index, POSE);
        sum += turn.tr_mul(&gradient.fixed_rows::<POSE>(0));
    }
}

#[cfg(test)]
mod tests;
