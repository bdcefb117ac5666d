//! The Levenberg-Marquardt method.
//!
//! The caller provides the estimate, its equations and the solution of a damped step; this module decides when to
//! increase or decrease the damping, and when to stop.

/// Limits of iterations and damping.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Schedule {
    /// Damping of the first step, relative to the diagonal.
    pub first_damping: f64,
    /// Smallest damping.
    pub smallest_damping: f64,
    /// Damping from which on no step is tried.
    pub largest_damping: f64,
    /// Largest number of steps.
    pub most_steps: usize,
    /// A step that lowers the cost by less than this fraction is the last one.
    pub smallest_gain: f64,
}

/// An estimate and its cost.
#[derive(Clone, Debug, PartialEq)]
pub struct Costed<S> {
    /// The estimate.
    pub estimate: S,
    /// Its cost.
    pub cost: f64,
}

/// Lowers the cost of `best` step by step; returns the number of steps.
///
/// `linearise` sets up the equations at an estimate; `trial` returns the estimate after a step with the given damping,
/// or `None` if the equations have no solution. A step that does not lower the cost is repeated with ten times the
/// damping, unless the cost hardly rises: then the minimum is reached. After a successful step the damping is divided by
/// ten.
pub fn minimise<S, E>(
    best: &mut Costed<S>,
    schedule: &Schedule,
    linearise: impl Fn(&S) -> E,
    mut trial: impl FnMut(&S, &E, f64) -> Option<Costed<S>>,
) -> usize {
    let mut damping = schedule.first_damping;
    for steps in 0..schedule.most_steps {
        let equations = linearise(&best.estimate);
        let better = loop {
            if damping >= schedule.largest_damping {
                return steps;
            }
            match trial(&best.estimate, &equations, damping) {
                Some(better) if better.cost < best.cost => break better,
                Some(same) if same.cost - best.cost < schedule.smallest_gain * best.cost => return steps,
                _ => damping *= 10.0,
            }
        };
        let gain = (best.cost - better.cost) / best.cost;
        *best = better;
        damping = (damping * 0.1).max(schedule.smallest_damping);
        if gain < schedule.smallest_gain {
            return steps + 1;
        }
    }
    schedule.most_steps
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Vector2};

    use super::*;

    const SCHEDULE: Schedule = Schedule {
        first_damping: 1e-3,
        smallest_damping: 1e-10,
        largest_damping: 1e8,
        most_steps: 100,
        smallest_gain: 1e-12,
    };

    /// Rosenbrock's function, as two residuals.
    fn residuals(at: &Vector2<f64>) -> Vector2<f64> {
        Vector2::new(1.0 - at.x, 10.0 * (at.y - at.x * at.x))
    }

    fn rosenbrock(schedule: &Schedule) -> (Costed<Vector2<f64>>, usize) {
        let start = Vector2::new(-1.2, 1.0);
        let mut best = Costed { estimate: start, cost: residuals(&start).norm_squared() };
        let linearise = |at: &Vector2<f64>| (Matrix2::new(-1.0, 0.0, -20.0 * at.x, 10.0), residuals(at));
        let steps = minimise(&mut best, schedule, linearise, |at, (jacobian, residual), damping| {
            let mut normal = jacobian.transpose() * jacobian;
            normal.set_diagonal(&(normal.diagonal() * (1.0 + damping)));
            let estimate = at - normal.cholesky()?.solve(&(jacobian.transpose() * residual));
            Some(Costed { estimate, cost: residuals(&estimate).norm_squared() })
        });
        (best, steps)
    }

    #[test]
    fn the_minimum_of_rosenbrocks_function_is_found() {
        let (best, steps) = rosenbrock(&SCHEDULE);
        assert!((best.estimate - Vector2::new(1.0, 1.0)).norm() < 1e-9, "{best:?} after {steps}");
        assert!(steps < SCHEDULE.most_steps);
    }

    #[test]
    fn the_cost_never_rises_and_steps_are_counted() {
        let mut last = residuals(&Vector2::new(-1.2, 1.0)).norm_squared();
        for most_steps in 0..10 {
            let (best, steps) = rosenbrock(&Schedule { most_steps, ..SCHEDULE });
            assert_eq!(steps, most_steps);
            assert!(most_steps == 0 || best.cost < last, "{most_steps}: {} {last}", best.cost);
            last = best.cost;
        }
    }

    #[test]
    fn equations_without_a_solution_do_not_change_the_estimate() {
        let mut best = Costed { estimate: 3.0, cost: 9.0 };
        assert_eq!(minimise(&mut best, &SCHEDULE, |_| (), |_, (), _| None), 0);
        assert_eq!(best, Costed { estimate: 3.0, cost: 9.0 });
    }
}
