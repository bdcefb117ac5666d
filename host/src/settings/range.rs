//! The range of every number among the settings.

use std::fmt;

use evcal_core::circle::MAX_NEIGHBOURS;
use evcal_core::cluster::ClusterSettings;
use evcal_core::spline::MAX_DEGREE;
use toml::{Table, Value};

/// What a number may be.
#[derive(Clone, Copy, Debug)]
pub(super) struct Range {
    least: f32,
    /// Whether `least` itself is refused.
    above: bool,
    most: f32,
    unit: &'static str,
}

const fn above(least: f32, unit: &'static str) -> Range {
    Range { least, above: true, most: f32::MAX, unit }
}

const fn at_least(least: f32, unit: &'static str) -> Range {
    Range { least, above: false, most: f32::MAX, unit }
}

const fn from_to(least: f32, most: f32, unit: &'static str) -> Range {
    Range { least, above: false, most, unit }
}

impl Range {
    /// The same range up to `most`.
    const fn to(self, most: f32) -> Self {
        Self { most, ..self }
    }

    fn holds(&self, value: f64) -> bool {
        let (least, most) = (f64::from(self.least), f64::from(self.most));
        value <= most && if self.above { value > least } else { value >= least }
    }
}

impl fmt::Display for Range {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { least, most, .. } = self;
        match (self.above, self.most == f32::MAX) {
            (true, true) => write!(f, "above {least}")?,
            (true, false) => write!(f, "above {least} and at most {most}")?,
            (false, true) => write!(f, "at least {least}")?,
            (false, false) => write!(f, "from {least} to {most}")?,
        }
        if self.unit.is_empty() { Ok(()) } else { write!(f, " {}", self.unit) }
    }
}

/// Every number of the settings with its range.
const RANGES: &[(&str, Range)] = &[
    // A chunk is held in memory, and so are those searched together with it.
    ("detection.chunk", above(0.0, "s").to(10.0)),
    ("detection.fewest_circles", from_to(0.0, 1.0, "of the board's circles")),
    ("detection.longest_prediction", at_least(0.0, "s")),
    ("detection.window.step", from_to(1.0, 1e6, "us")),
    ("detection.window.min_interval", at_least(1.0, "steps")),
    ("detection.window.max_interval", at_least(1.0, "steps")),
    ("detection.window.gap", at_least(0.0, "steps")),
    ("detection.window.most_events", at_least(1.0, "events")),
    ("detection.window.fewest_events", at_least(0.0, "events")),
    ("detection.cluster.epsilon", from_to(1.0, ClusterSettings::LARGEST_EPSILON, "px")),
    ("detection.cluster.min_points", at_least(1.0, "pixels")),
    ("detection.cluster.min_pixels", at_least(1.0, "pixels")),
    ("detection.circle.neighbours", from_to(1.0, MAX_NEIGHBOURS as f32, "clusters")),
    ("detection.circle.min_facing", from_to(-1.0, 1.0, "")),
    ("detection.circle.min_radius", at_least(0.0, "px")),
    ("detection.circle.max_radius", above(0.0, "px")),
    ("detection.circle.min_arc", at_least(0.0, "radii")),
    ("detection.circle.max_radius_ratio", above(0.0, "")),
    ("detection.circle.min_radius_ratio", at_least(0.0, "")),
    ("detection.circle.max_center_offset", above(0.0, "radii")),
    ("detection.circle.max_error", at_least(0.0, "px")),
    ("detection.circle.max_relative_error", at_least(0.0, "radii")),
    ("detection.circle.max_soft_error", above(0.0, "radii")),
    ("initial.min_circles", at_least(4.0, "circles")),
    ("initial.min_frames", at_least(3.0, "frames")),
    ("initial.max_interpolation_gap", at_least(0.0, "s")),
    ("initial.voters", at_least(1.0, "frames")),
    ("initial.max_row_rate", above(0.0, "rad/s")),
    ("initial.row_angle_floor", at_least(0.0, "rad")),
    ("initial.start_views", at_least(3.0, "views")),
    ("initial.first_bundle_views", at_least(3.0, "views")),
    ("initial.bundle_views", at_least(3.0, "views")),
    ("initial.max_start_rms", above(0.0, "px")),
    ("initial.start_retries", at_least(0.0, "times")),
    ("initial.huber", above(0.0, "px")),
    ("initial.max_circle_error", above(0.0, "px")),
    ("initial.ransac_iterations", at_least(1.0, "samples")),
    ("initial.min_inlier_fraction", above(0.0, "").to(1.0)),
    ("initial.max_frame_rms", above(0.0, "px")),
    ("initial.max_frame_rms_ratio", at_least(1.0, "")),
    ("initial.max_focal_deviation", above(0.0, "")),
    ("initial.max_speed", above(0.0, "m/s")),
    ("initial.position_floor", at_least(0.0, "m")),
    ("initial.max_angular_speed", above(0.0, "rad/s")),
    ("initial.angle_floor", at_least(0.0, "rad")),
    ("initial.max_acceleration", above(0.0, "m/s²")),
    ("initial.max_angular_acceleration", above(0.0, "rad/s²")),
    ("initial.max_acceleration_ratio", at_least(1.0, "")),
    ("initial.max_motion_gap", above(0.0, "s")),
    ("initial.cross_validation.rim_band", above(0.0, "px")),
    ("initial.cross_validation.max_motion_band", at_least(0.0, "px")),
    ("initial.cross_validation.min_events", at_least(1.0, "pixels")),
    ("initial.cross_validation.huber", above(0.0, "px")),
    ("initial.cross_validation.max_center_shift", above(0.0, "px")),
    ("initial.cross_validation.max_radius_change", above(0.0, "px")),
    ("initial.cross_validation.max_fit_error", above(0.0, "px")),
    ("initial.cross_validation.max_center_deviation", above(0.0, "px")),
    ("initial.cross_validation.min_fraction", from_to(0.0, 1.0, "")),
    ("model_choice.blocks", at_least(2.0, "blocks")),
    ("model_choice.folds", at_least(2.0, "parts")),
    ("model_choice.views", at_least(3.0, "views")),
    ("model_choice.standard_errors", at_least(0.0, "")),
    ("segment.longest_gap", above(0.0, "s")),
    ("segment.longest_gap_ratio", at_least(0.0, "median intervals")),
    ("segment.fewest_frames", at_least(1.0, "frames")),
    ("segment.shortest", at_least(0.0, "s")),
    ("spline.degree", from_to(2.0, MAX_DEGREE as f32, "")),
    ("spline.knot_spacing", above(0.0, "s")),
    ("knots.finest", above(0.0, "s")),
    ("knots.coarsest", above(0.0, "s")),
    ("knots.first", above(0.0, "s")),
    ("knots.gain", at_least(0.0, "")),
    ("knots.noise", at_least(1.0, "")),
    ("unexplained.cell", above(0.0, "s")),
    ("unexplained.spread", at_least(1.0, "")),
    ("unexplained.far_ratio", above(0.0, "")),
    ("poses.rate", above(0.0, "Hz")),
    ("poses.largest_position_sigma", above(0.0, "m")),
    ("poses.largest_rotation_sigma", above(0.0, "rad")),
    ("association.first_band", above(0.0, "px")),
    ("association.band", above(0.0, "σ")),
    ("association.widest_band", above(0.0, "px")),
    ("association.slowest_edge", at_least(0.0, "px/s")),
    ("association.tangent", from_to(0.0, 1.0, "")),
    ("association.burst_pause", above(0.0, "s")),
    ("association.most_events", at_least(1.0, "events")),
    ("solve.huber", above(0.0, "σ")),
    ("solve.iterations", at_least(1.0, "")),
    ("solve.tolerance", from_to(0.0, 1.0, "")),
    ("solve.bin", above(0.0, "s")),
    ("solve.acceleration", above(0.0, "m/s²")),
    ("solve.angular_acceleration", above(0.0, "rad/s²")),
    ("refinement.rounds", at_least(1.0, "")),
    ("refinement.settled", at_least(0.0, "px")),
    ("refinement.early_events", at_least(1.0, "events")),
    ("refinement.first_sigma", above(0.0, "px")),
    ("uncertainty.block", above(0.0, "s")),
    ("uncertainty.fewest_blocks", at_least(2.0, "blocks")),
    ("split_half.slice", above(0.0, "s")),
    ("split_half.fewest_slices", at_least(2.0, "slices")),
    ("split_half.iterations", at_least(1.0, "")),
    ("verdict.good", at_least(0.0, "px")),
    ("verdict.poor", at_least(0.0, "px")),
    ("verdict.shortest", at_least(0.0, "s")),
    ("verdict.smallest_fill", at_least(0.0, "of the image's shorter side")),
    ("verdict.smallest_tilt", from_to(0.0, 90.0, "degrees")),
    ("verdict.coverage", from_to(0.0, 1.0, "of the sensor")),
    ("verdict.radius", at_least(0.0, "of the radius")),
    ("verdict.pattern", at_least(0.0, "px")),
    ("verdict.pattern_ratio", at_least(1.0, "")),
    ("verdict.square_pixels", at_least(0.0, "of the focal length")),
    ("frames.min_contrast", from_to(0.0, 1.0, "of the light")),
    ("frames.min_radius", at_least(1.0, "px")),
    ("frames.max_radius", above(1.0, "px").to(1000.0)),
    ("frames.max_elongation", at_least(1.0, "")),
    ("frames.max_ellipse_error", above(0.0, "")),
    ("frames.max_unevenness", above(0.0, "")),
    ("frames.max_blur", above(0.0, "px")),
    ("frames.huber", above(0.0, "σ")),
    ("frames.agreement", above(0.0, "")),
    ("frames.too_uncertain", above(0.0, "px")),
    ("frames.max_time_offset", at_least(0.0, "s")),
    ("residual_map.columns", from_to(1.0, 256.0, "cells")),
    ("residual_map.block", above(0.0, "s")),
    ("residual_map.fewest_blocks", at_least(6.0, "blocks")),
    ("live.boards", at_least(0.0, "windows")),
    ("live.coverage", from_to(0.0, 1.0, "of the sensor's cells")),
    ("live.columns", from_to(1.0, 64.0, "cells")),
    ("live.rows", from_to(1.0, 64.0, "cells")),
    ("live.circles_per_cell", at_least(1.0, "circles")),
    ("live.tilt", from_to(0.0, 90.0, "degrees")),
    ("live.boards_per_tilt", at_least(0.0, "windows")),
    ("live.longest_wait", at_least(0.0, "s")),
];

/// Pairs of which the first must not exceed the second.
const ORDERED: &[(&str, &str)] = &[
    ("detection.circle.min_radius", "detection.circle.max_radius"),
    ("frames.min_radius", "frames.max_radius"),
    ("detection.circle.min_radius_ratio", "detection.circle.max_radius_ratio"),
];

/// The number at a path of names with dots between them.
fn number(settings: &Table, path: &str) -> Option<f64> {
    let (tables, name) = path.rsplit_once('.')?;
    let table = tables.split('.').try_fold(settings, |table, name| table.get(name)?.as_table())?;
    match table.get(name)? {
        Value::Float(value) => Some(*value),
        Value::Integer(value) => Some(*value as f64),
        _ => None,
    }
}

/// Which number is out of its range, and what it may be.
pub(super) fn check(settings: &Table) -> Result<(), String> {
    for (path, range) in RANGES {
        if let Some(value) = number(settings, path).filter(|value| !range.holds(*value)) {
            return Err(format!("{path} is {}; it must be {range}", value as f32));
        }
    }
    for (low, high) in ORDERED {
        if let (Some(least), Some(most)) = (number(settings, low), number(settings, high))
            && least > most
        {
            return Err(format!("{low} is {least}; it must be at most {high}, which is {most}"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::Settings;
    use super::*;

    fn defaults() -> Table {
        toml::from_str(&Settings::default().to_toml()).unwrap()
    }

    /// The paths of all numbers in a table.
    fn numbers(prefix: &str, table: &Table) -> Vec<String> {
        let paths = table.iter().flat_map(|(name, value)| match value {
            Value::Table(inner) => numbers(&format!("{prefix}{name}."), inner),
            Value::Float(_) | Value::Integer(_) => vec![format!("{prefix}{name}")],
            _ => Vec::new(),
        });
        paths.collect()
    }

    #[test]
    fn every_number_has_one_range_and_nothing_else_has() {
        let mut known: Vec<&str> = RANGES.iter().map(|(path, _)| *path).collect();
        let mut numbers = numbers("", &defaults());
        known.sort_unstable();
        numbers.sort_unstable();
        assert_eq!(known, numbers);
        assert!(ORDERED.iter().all(|(low, high)| known.contains(low) && known.contains(high)));
    }

    /// The defaults with another value at `path`.
    fn with(path: &str, value: f64) -> Table {
        let mut settings = defaults();
        let (tables, name) = path.rsplit_once('.').unwrap();
        let mut table = &mut settings;
        for inner in tables.split('.') {
            table = table[inner].as_table_mut().unwrap();
        }
        table[name] = Value::Float(value);
        settings
    }

    #[test]
    fn a_value_out_of_its_range_is_refused_by_name() {
        for (path, range) in RANGES {
            let below = f64::from(range.least) - if range.above { 0.0 } else { 0.01 };
            for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, below] {
                let message = check(&with(path, value)).unwrap_err();
                assert!(message.starts_with(path), "{path} = {value}: {message}");
            }
            if range.most < f32::MAX {
                let message = check(&with(path, f64::from(range.most) * 1.001)).unwrap_err();
                assert!(message.contains("to ") || message.contains("at most"), "{message}");
                assert_eq!(check(&with(path, range.most.into())), Ok(()));
            }
        }
    }

    #[test]
    fn limits_that_leave_nothing_between_them_are_refused() {
        for (low, high) in ORDERED {
            let message = check(&with(low, 1e3)).unwrap_err();
            assert!(message.contains(low) && message.contains(high), "{message}");
        }
    }

    #[test]
    fn a_refusal_says_what_is_allowed() {
        let message = |path, value| check(&with(path, value)).unwrap_err();
        let epsilon = message("detection.cluster.epsilon", 6.0);
        assert_eq!(epsilon, "detection.cluster.epsilon is 6; it must be from 1 to 4.99 px");
        assert_eq!(message("solve.huber", 0.0), "solve.huber is 0; it must be above 0 σ");
        assert_eq!(message("detection.chunk", -0.1), "detection.chunk is -0.1; it must be above 0 and at most 10 s");
    }
}
