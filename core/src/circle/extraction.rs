//! Forms circle candidates from pairs of clusters.

use super::fit::{Circle, fit_circle, total_deviation, toward_center};
use super::{CircleCandidate, CircleSettings, Extraction, MAX_NEIGHBOURS};
use crate::cluster::{CentralMoments, Cluster, PixelRun};
use heapless::Vec;
use nalgebra::RealField;

/// Number of pairs tried, of pairs rejected by reason, and of circles found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CircleCounts {
    /// Clusters too wide or high for the arc of a dot.
    pub clusters_too_large: u32,
    /// Clusters close enough to form a pair, where one of the two curves away from the other.
    pub back_to_back: u32,
    /// Pairs tried.
    pub pairs: u32,
    /// Pairs with a radius out of bounds, or whose pixels lie on a line.
    pub radius_out_of_bounds: u32,
    /// Pairs in which one arc has too few pixels for the radius.
    pub arc_too_short: u32,
    /// Pairs whose fitted radius disagrees with the distance of their centres.
    pub radius_against_distance: u32,
    /// Pairs whose fitted centre disagrees with the midpoint of their centres.
    pub center_against_midpoint: u32,
    /// Pairs whose pixels lie too far from the circle.
    pub error_too_large: u32,
    /// Pairs that passed the tests but were dropped because the storage was full.
    pub pairs_over_capacity: u32,
    /// Pairs that passed the tests, but one of the clusters has a better partner.
    pub not_mutual: u32,
    /// Circles found.
    pub circles: u32,
}

/// Reason to reject a pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Rejection {
    Arc,
    Radius,
    Distance,
    Midpoint,
    Error,
}

/// Finds the circles among `on` and `off` clusters; `runs` returns the pixels of a cluster.
///
/// Replaces the content of `circles`. The circles are in the order of their ON clusters.
pub fn extract<T: RealField + Copy, R: Iterator<Item = PixelRun>, const CLUSTERS: usize>(
    on: &[Cluster<T>],
    off: &[Cluster<T>],
    runs: impl Fn(&Cluster<T>) -> R,
    extraction: Extraction,
    settings: &CircleSettings,
    circles: &mut Vec<CircleCandidate<T>, CLUSTERS>,
) -> CircleCounts {
    circles.clear();
    let too_large = on.iter().chain(off).map(|cluster| u32::from(!may_be_arc(cluster, settings))).sum();
    let mut counts = CircleCounts { clusters_too_large: too_large, ..CircleCounts::default() };
    for (on_index, on_cluster) in (0_u16..).zip(on) {
        if !may_be_arc(on_cluster, settings) {
            continue;
        }
        for &(_, off_index) in &nearest_facing(on_cluster, off, settings, &mut counts.back_to_back) {
            let Some(off_cluster) = off.get(usize::from(off_index)) else { continue };
            counts.pairs += 1;
            let found = match extraction {
                Extraction::Hard => hard(on_cluster, off_cluster, &runs, settings),
                Extraction::Soft => soft(on_cluster, off_cluster, &runs, settings),
            };
            match found {
                Ok((circle, error)) => {
                    let candidate = CircleCandidate {
                        center: circle.center,
                        radius: circle.radius,
                        error,
                        on_cluster: on_index,
                        off_cluster: off_index,
                        on_pixels: on_cluster.pixels.min(u32::from(u16::MAX)) as u16,
                        off_pixels: off_cluster.pixels.min(u32::from(u16::MAX)) as u16,
                    };
                    if circles.push(candidate).is_err() {
                        counts.pairs_over_capacity += 1;
                    }
                }
                Err(Rejection::Arc) => counts.arc_too_short += 1,
                Err(Rejection::Radius) => counts.radius_out_of_bounds += 1,
                Err(Rejection::Distance) => counts.radius_against_distance += 1,
                Err(Rejection::Midpoint) => counts.center_against_midpoint += 1,
                Err(Rejection::Error) => counts.error_too_large += 1,
            }
        }
    }
    let passed = circles.len();
    keep_mutual(extraction, circles);
    counts.circles = circles.len() as u32;
    counts.not_mutual = (passed - circles.len()) as u32;
    counts
}

/// Returns `true` if the cluster is small enough for the arc of a dot.
fn may_be_arc<T: RealField + Copy>(cluster: &Cluster<T>, settings: &CircleSettings) -> bool {
    let [width, height] = cluster.extent();
    let diameter: T = from_f32(2.0 * settings.max_radius);
    T::from_u16(width.max(height)).is_some_and(|extent| extent <= diameter)
}

/// Returns the nearest clusters of the other polarity that may be the other side of a dot, as (squared distance,
/// index).
///
/// Adds to `back_to_back` the clusters that are close enough but face away.
fn nearest_facing<T: RealField + Copy>(
    cluster: &Cluster<T>,
    others: &[Cluster<T>],
    settings: &CircleSettings,
    back_to_back: &mut u32,
) -> Vec<(T, u16), MAX_NEIGHBOURS> {
    let limit = usize::from(settings.neighbours).clamp(1, MAX_NEIGHBOURS);
    let diameter: T = from_f32(2.0 * settings.max_radius);
    let mut bound = diameter * diameter;
    let mut found: Vec<(T, u16), MAX_NEIGHBOURS> = Vec::new();
    for (index, other) in (0_u16..).zip(others) {
        let distance_squared = (other.center - cluster.center).norm_squared();
        if distance_squared < bound && may_be_arc(other, settings) {
            if !faces(cluster, other, settings) || !faces(other, cluster, settings) {
                *back_to_back += 1;
                continue;
            }
            if found.len() == limit {
                found.pop();
            }
            // Insert in order of distance, after equal distances; further entries move up by one.
            let mut moving = (distance_squared, index);
            let mut passed = false;
            for place in &mut found {
                passed |= place.0 > distance_squared;
                if passed {
                    core::mem::swap(place, &mut moving);
                }
            }
            // There is room: `limit` is at most the capacity.
            if found.push(moving).is_ok() && found.len() == limit {
                bound = found.last().map_or(bound, |&(furthest, _)| furthest);
            }
        }
    }
    found
}

/// Returns `true` if the arc `cluster` is curved around `other`, so that their dot lies between them.
fn faces<T: RealField + Copy>(cluster: &Cluster<T>, other: &Cluster<T>, settings: &CircleSettings) -> bool {
    let inward = toward_center(&cluster.moments);
    let across = other.center - cluster.center;
    let along = inward.dot(&across);
    let min_facing: T = from_f32(settings.min_facing);
    along > T::zero() && along * along >= min_facing * min_facing * inward.norm_squared() * across.norm_squared()
}

/// Returns the circle fitted to a pair and its mean deviation, if it passes the tests.
fn hard<T: RealField + Copy, R: Iterator<Item = PixelRun>>(
    on: &Cluster<T>,
    off: &Cluster<T>,
    runs: &impl Fn(&Cluster<T>) -> R,
    settings: &CircleSettings,
) -> Result<(Circle<T>, T), Rejection> {
    let moments = on.moments.joined(&off.moments);
    let circle = fit_circle(&moments).ok_or(Rejection::Radius)?;
    test_size(&circle, on, off, settings)?;
    let expected = circle_between(on, off);
    if circle.radius < from_f32::<T>(settings.min_radius_ratio) * expected.radius
        || circle.radius > from_f32::<T>(settings.max_radius_ratio) * expected.radius
    {
        return Err(Rejection::Distance);
    }
    let largest_offset = from_f32::<T>(settings.max_center_offset) * circle.radius;
    if (circle.center - expected.center).norm_squared() > largest_offset * largest_offset {
        return Err(Rejection::Midpoint);
    }
    let error = total_deviation(&circle, runs(on).chain(runs(off))) / moments.n;
    if error > from_f32::<T>(settings.max_error) + from_f32::<T>(settings.max_relative_error) * circle.radius {
        return Err(Rejection::Error);
    }
    Ok((circle, error))
}

/// Returns the circle whose diameter is the line between the pair, and its mean deviation, if it passes the tests.
fn soft<T: RealField + Copy, R: Iterator<Item = PixelRun>>(
    on: &Cluster<T>,
    off: &Cluster<T>,
    runs: &impl Fn(&Cluster<T>) -> R,
    settings: &CircleSettings,
) -> Result<(Circle<T>, T), Rejection> {
    let circle = circle_between(on, off);
    test_size(&circle, on, off, settings)?;
    let error = total_deviation(&circle, runs(on).chain(runs(off))) / (on.moments.n + off.moments.n);
    if error > from_f32::<T>(settings.max_soft_error) * circle.radius {
        return Err(Rejection::Error);
    }
    Ok((circle, error))
}

/// Returns the circle whose diameter is the line between the outermost points of two arcs.
///
/// The mean of an arc of half-angle α lies at r sin α / α from the centre, not on the circle. With d the distance of
/// the mean from the centre and v the variance of the pixels across the line, r ≈ d + v / (2 d), to 1 % up to α = 75°
/// and to 3 % for a half circle.
fn circle_between<T: RealField + Copy>(on: &Cluster<T>, off: &Cluster<T>) -> Circle<T> {
    let half: T = nalgebra::convert(0.5);
    let line = off.center - on.center;
    let distance_squared = line.norm_squared();
    // In units of the line's length: v / (2 d), where d is half the line.
    let rise = |cluster: &Cluster<T>| {
        let CentralMoments { n, uu, uv, vv, .. } = cluster.moments;
        let across = uu * line.y * line.y - (uv + uv) * line.x * line.y + vv * line.x * line.x;
        across / (n * distance_squared * distance_squared)
    };
    let (on_rise, off_rise) = (rise(on), rise(off));
    let half_line = half + (on_rise + off_rise) * half;
    Circle {
        center: (on.center + off.center) * half + line * ((off_rise - on_rise) * half),
        radius: distance_squared.sqrt() * half_line,
    }
}

fn test_size<T: RealField + Copy>(
    circle: &Circle<T>,
    on: &Cluster<T>,
    off: &Cluster<T>,
    settings: &CircleSettings,
) -> Result<(), Rejection> {
    if circle.radius < from_f32(settings.min_radius) || circle.radius > from_f32(settings.max_radius) {
        return Err(Rejection::Radius);
    }
    let fewest = from_f32::<T>(settings.min_arc) * circle.radius;
    if on.moments.n < fewest || off.moments.n < fewest {
        return Err(Rejection::Arc);
    }
    Ok(())
}

/// Keeps the pairs that are the best for both of their clusters; of equal pairs the earlier one wins.
///
/// Hard: the best pair has the least area between pixels and circle (error × radius) relative to the length of the
/// shorter arc. The criterion of the paper, the error relative to the radius, would prefer a large circle through the
/// arcs of two dots. Soft: the best pair has the least distance.
fn keep_mutual<T: RealField + Copy, const CLUSTERS: usize>(
    extraction: Extraction,
    circles: &mut Vec<CircleCandidate<T>, CLUSTERS>,
) {
    let badness = |circle: &CircleCandidate<T>| match extraction {
        Extraction::Hard => circle.error * circle.radius / from_u16(circle.on_pixels.min(circle.off_pixels)),
        Extraction::Soft => circle.radius,
    };
    let mut best_of_on: [Option<(u16, T)>; CLUSTERS] = [None; CLUSTERS];
    let mut best_of_off = best_of_on;
    for (index, circle) in (0_u16..).zip(circles.iter()) {
        let badness = badness(circle);
        for (best, cluster) in [(&mut best_of_on, circle.on_cluster), (&mut best_of_off, circle.off_cluster)] {
            if let Some(best) = best.get_mut(usize::from(cluster))
                && best.is_none_or(|(_, least)| badness < least)
            {
                *best = Some((index, badness));
            }
        }
    }
    let is_best = |best: &[Option<(u16, T)>; CLUSTERS], cluster: u16, index: u16| {
        best.get(usize::from(cluster)).copied().flatten().is_some_and(|(best, _)| best == index)
    };
    let mut index = 0;
    circles.retain(|circle| {
        let keep = is_best(&best_of_on, circle.on_cluster, index) && is_best(&best_of_off, circle.off_cluster, index);
        index += 1;
        keep
    });
}

fn from_f32<T: RealField>(value: f32) -> T {
    nalgebra::convert(value)
}

fn from_u16<T: RealField>(value: u16) -> T {
    T::from_u16(value).unwrap_or_else(T::one)
}
