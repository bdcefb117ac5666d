//! Distribution of the residuals of event classes.

use evcal_solve::solve::observation_range::EventResidual;
use evcal_solve::solve::rows::event_bias::EventKind;

/// Residuals beyond this are counted in the outermost bins (px).
pub const BOUND: f64 = 1.5;
/// Number of bins from −[`BOUND`] to [`BOUND`].
pub const BIN_COUNT: usize = 60;

/// The residuals of one event class, or of several.
#[derive(Clone, Debug, PartialEq)]
pub struct ClassResiduals {
    /// Number of residuals.
    pub count: usize,
    /// Mean (px).
    pub mean: f64,
    /// Root mean square (px).
    pub rms: f64,
    /// Residuals in each bin, in order.
    pub bins: [usize; BIN_COUNT],
}

/// Computes the residuals of each of `COUNT` groups of event classes; `group` is below `COUNT`.
pub fn class_residuals<const COUNT: usize>(
    residuals: &[EventResidual],
    group: impl Fn(EventKind) -> usize,
) -> [ClassResiduals; COUNT] {
    let empty = ClassResiduals { count: 0, mean: 0.0, rms: 0.0, bins: [0; BIN_COUNT] };
    let mut classes: [ClassResiduals; COUNT] = std::array::from_fn(|_| empty.clone());
    for event in residuals {
        let Some(class) = classes.get_mut(group(EventKind::of_class(event.class.into()))) else { continue };
        let residual = f64::from(event.residual);
        class.count += 1;
        class.mean += residual;
        class.rms += residual * residual;
        let bin = (residual + BOUND) / (2.0 * BOUND) * BIN_COUNT as f64;
        if let Some(bin) = class.bins.get_mut((bin.max(0.0) as usize).min(BIN_COUNT - 1)) {
            *bin += 1;
        }
    }
    for class in &mut classes {
        let count = class.count.max(1) as f64;
        class.mean /= count;
        class.rms = (class.rms / count).sqrt();
    }
    classes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn residuals_are_counted_by_class_and_size() {
        let event = |class, residual| EventResidual { class, residual, ..EventResidual::default() };
        let residuals = [event(1, 0.02), event(1, 0.08), event(1, -9.0), event(3, 1.42)];
        let classes: [_; 4] = class_residuals(&residuals, |kind| kind.class());
        assert_eq!((classes[0].count, classes[1].count, classes[3].count), (0, 3, 1));
        assert_eq!((classes[1].bins[0], classes[1].bins[30], classes[1].bins[31]), (1, 1, 1));
        assert_eq!(classes[3].bins[58], 1);
        assert!((classes[1].mean + 8.9 / 3.0).abs() < 1e-6);
        assert!((classes[3].rms - 1.42).abs() < 1e-6);
        let [all] = class_residuals(&residuals, |_| 0);
        assert_eq!(all.count, 4);
    }
}
