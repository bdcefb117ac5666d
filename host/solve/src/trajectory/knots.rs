//! Knots from data: dense knots where poses are dense.

use evcal_core::spline::MAX_ORDER;

use super::TrajectoryError;

/// Returns the number of control points of a spline of `degree` over `duration` seconds whose knots are `spacing` seconds apart
/// on average: at least `degree + 1`, a single span; otherwise never more than there are `samples`.
pub fn control_point_count(duration: f64, spacing: f64, degree: usize, samples: usize) -> usize {
    // A float-to-integer cast saturates, and maps NaN to 0.
    let spans = (duration / spacing).round() as usize;
    spans.max(1).saturating_add(degree).min(samples).max(degree + 1)
}

/// Returns clamped knots from `start` to `end` for `count` control points, such that every span contains one of the sample
/// `times` (*The NURBS Book*, equations 9.68 and 9.69, with the samples' own times as their parameters). The system of a
/// least-squares fit is then positive definite.
///
/// `start` and `end` may lie outside the times: the outer spans grow.
///
/// # Errors
/// Too few times, times that do not increase or lie outside the range, or a `count` outside `degree + 1 ..= times.len()`.
pub fn from_times(
    times: &[f64],
    start: f64,
    end: f64,
    count: usize,
    degree: usize,
) -> Result<Vec<f64>, TrajectoryError> {
    let samples = times.len();
    if samples < degree + 1 {
        return Err(TrajectoryError::TooFewPoses { degree, found: samples });
    }
    if count < degree + 1 || count > samples {
        return Err(TrajectoryError::ControlPointCount { found: count, degree, poses: samples });
    }
    // The comparisons are written so that a NaN fails.
    if let Some(&t) = times.iter().find(|&&t| !(start <= t && t <= end)) {
        return Err(TrajectoryError::PoseOutside { t, start, end });
    }
    let rises = |pair: &[f64]| pair[0] < pair[1];
    if let Some(index) = times.windows(2).position(|pair| !rises(pair)) {
        return Err(TrajectoryError::TimesDoNotIncrease { index: index + 1, t: times[index + 1] });
    }

    let spans = count - degree;
    let mut knots = vec![start; degree + 1];
    for j in 1..spans {
        // Integers, because rounding must not move a knot past a sample: j samples/spans = i + α.
        let i = j * samples / spans;
        let share = (j * samples % spans) as f64 / spans as f64;
        knots.push((1.0 - share) * times[i - 1] + share * times[i]);
    }
    knots.extend(std::iter::repeat_n(end, degree + 1));
    Ok(knots)
}

/// Returns the Greville abscissae (s): for each control point of a spline of `degree` the mean of its inner knots. Control points
/// that move evenly over them make a curve that moves evenly over time.
pub fn greville(knots: &[f64], degree: usize) -> Vec<f64> {
    let degree = degree.max(1);
    let inner = knots.get(1..knots.len().saturating_sub(1)).unwrap_or_default();
    inner.windows(degree).map(|window| window.iter().sum::<f64>() / degree as f64).collect()
}

/// One control point on finer knots as a combination of those on coarser ones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Blend {
    /// Index of the first coarse control point concerned.
    pub first: usize,
    /// Weights of `degree + 1` coarse control points from `first` on; they add up to 1.
    pub weights: [f64; MAX_ORDER],
}

/// Returns the control points on the knots `fine` of a curve on the knots `coarse`, which must all be among `fine` (knot
/// insertion by the Oslo algorithm: Cohen, Lyche and Riesenfeld 1980). Both are clamped.
pub fn insertion(coarse: &[f64], fine: &[f64], degree: usize) -> Vec<Blend> {
    let count = coarse.len().saturating_sub(degree + 1);
    let at = |knots: &[f64], index: usize| knots.get(index).copied().unwrap_or(0.0);
    let mut span = degree;
    (0..fine.len().saturating_sub(degree + 1))
        .map(|index| {
            while span + 1 < count && at(coarse, span + 1) <= at(fine, index) {
                span += 1;
            }
            let mut weights = [0.0; MAX_ORDER];
            weights[0] = 1.0;
            for order in 1..=degree.min(MAX_ORDER - 1) {
                let knot = at(fine, index + order);
                let mut carried = 0.0;
                for (place, weight) in weights.iter_mut().enumerate().take(order) {
                    let right = at(coarse, span + place + 1) - knot;
                    let left = knot - at(coarse, span + 1 + place - order);
                    let part = *weight / (right + left);
                    *weight = carried + right * part;
                    carried = left * part;
                }
                weights[order] = carried;
            }
            Blend { first: span - degree, weights }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn equation_9_69_by_hand() {
        // m + 1 = 10 samples, n + 1 = 7 control points, p = 3: d = 10/4 = 2.5.
        let times = [0.0, 1.0, 2.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 12.0];
        let knots = from_times(&times, 0.0, 12.0, 7, 3).unwrap();
        // j = 1: i = 2, α = 0.5; j = 2: i = 5, α = 0; j = 3: i = 7, α = 0.5.
        assert_eq!(knots, [0.0, 0.0, 0.0, 0.0, 1.5, 5.0, 7.5, 12.0, 12.0, 12.0, 12.0]);
    }

    #[test]
    fn extended_ends_move_the_outer_knots_only() {
        let times = [0.0, 1.0, 2.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 12.0];
        let inside = from_times(&times, 0.0, 12.0, 7, 3).unwrap();
        let extended = from_times(&times, -0.5, 12.25, 7, 3).unwrap();
        assert_eq!(extended[4..7], inside[4..7]);
        assert_eq!((extended[0], extended[3], extended[7], extended[10]), (-0.5, -0.5, 12.25, 12.25));
    }

    #[test]
    fn invalid_times_and_counts_are_refused() {
        let times = [0.0, 1.0, 2.0, 3.0];
        assert_eq!(from_times(&times[..3], 0.0, 3.0, 4, 3), Err(TrajectoryError::TooFewPoses { degree: 3, found: 3 }));
        for found in [0, 3, 5] {
            assert_eq!(
                from_times(&times, 0.0, 3.0, found, 3),
                Err(TrajectoryError::ControlPointCount { found, degree: 3, poses: 4 })
            );
        }
        assert_eq!(
            from_times(&times, 0.5, 3.0, 4, 3),
            Err(TrajectoryError::PoseOutside { t: 0.0, start: 0.5, end: 3.0 })
        );
        assert!(matches!(from_times(&times, 0.0, f64::NAN, 4, 3), Err(TrajectoryError::PoseOutside { .. })));
        assert_eq!(
            from_times(&[0.0, 1.0, 1.0, 3.0], 0.0, 3.0, 4, 3),
            Err(TrajectoryError::TimesDoNotIncrease { index: 2, t: 1.0 })
        );
    }

    #[test]
    fn the_number_of_control_points_follows_the_spacing_within_what_the_samples_allow() {
        assert_eq!(control_point_count(1.0, 0.1, 3, 200), 13);
        assert_eq!(control_point_count(1.0, 0.1, 3, 8), 8);
        assert_eq!(control_point_count(0.01, 0.1, 3, 200), 4);
        assert_eq!(control_point_count(1.0, 0.1, 5, 2), 6);
        assert_eq!(control_point_count(1.0, 0.0, 3, 20), 20);
        assert_eq!(control_point_count(1.0, f64::NAN, 3, 20), 4);
    }

    proptest! {
        #[test]
        fn every_span_contains_a_sample(
            gaps in prop::collection::vec(1e-3..1.0_f64, 5..60),
            place in 0.0..=1.0_f64,
            degree in 1..=5_usize,
            before in 0.0..0.5_f64,
            after in 0.0..0.5_f64,
        ) {
            let times: Vec<f64> = gaps.iter().scan(0.0, |t, gap| { *t += gap; Some(*t) }).collect();
            prop_assume!(times.len() > degree);
            let count = degree + 1 + (place * (times.len() - degree - 1) as f64) as usize;
            let (start, end) = (times[0] - before, times[times.len() - 1] + after);
            let knots = from_times(&times, start, end, count, degree).unwrap();
            prop_assert_eq!(evcal_core::spline::Knots::new(&knots, degree).map(|knots| knots.control_point_count()), Ok(count));
            for span in knots[degree..=count].windows(2) {
                prop_assert!(times.iter().any(|t| (span[0]..=span[1]).contains(t)), "no sample in {:?}", span);
            }
        }
    }

    #[test]
    fn inserted_knots_do_not_change_the_curve() {
        for degree in 1..=4 {
            let clamped = |inner: &[f64]| {
                let ends = |t: f64| std::iter::repeat_n(t, degree + 1);
                ends(0.0).chain(inner.iter().copied()).chain(ends(1.0)).collect::<Vec<f64>>()
            };
            let (coarse, fine) = (clamped(&[0.2, 0.5]), clamped(&[0.1, 0.2, 0.25, 0.5, 0.8]));
            let control: Vec<f64> = (0..degree + 3).map(|index| ((index * index) % 7) as f64).collect();
            let blends = insertion(&coarse, &fine, degree);
            assert_eq!(blends.len(), degree + 6);
            let inserted: Vec<f64> = blends
                .iter()
                .map(|blend| (0..=degree).map(|place| blend.weights[place] * control[blend.first + place]).sum())
                .collect();
            let value = |knots: &[f64], control: &[f64], t: f64| -> f64 {
                let basis = evcal_core::spline::Knots::new(knots, degree).unwrap().basis(t).unwrap();
                (0..basis.order).map(|place| basis.value[place] * control[basis.first + place]).sum()
            };
            for step in 0..=50 {
                let t = f64::from(step) / 50.0;
                assert!((value(&coarse, &control, t) - value(&fine, &inserted, t)).abs() < 1e-12, "{degree} {t}");
            }
        }
    }
}
