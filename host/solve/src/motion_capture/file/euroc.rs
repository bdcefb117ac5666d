//! EuRoC's CSV of poses: nanoseconds, position in metres, quaternion with w first, and columns that are not used here.

use evcal_files::text::excerpt;
use nalgebra::Vector3;

use super::{CaptureError, number, push};
use evcal_geometry::timed_pose::TimedPose;

/// Parses the poses below the first line.
pub fn parse(text: &str) -> Result<Vec<TimedPose>, CaptureError> {
    let mut poses = Vec::new();
    let mut first: Option<i64> = None;
    for (index, content) in text.lines().enumerate().skip(1) {
        if content.trim().is_empty() || content.starts_with('#') {
            continue;
        }
        let line = index + 1;
        let fields: Vec<&str> = content.split(',').collect();
        let at = |column: usize| number(fields.get(column), line);
        let stamp = fields.first().map(|field| field.trim()).unwrap_or_default();
        let stamp: i64 = stamp.parse().map_err(|_| CaptureError::Number { line, text: excerpt(stamp).into_owned() })?;
        // Nanoseconds since 1970 have more digits than a floating point number: the resolution is microseconds.
        let origin = *first.get_or_insert(stamp);
        let t = origin as f64 * 1e-9 + stamp.saturating_sub(origin) as f64 * 1e-9;
        let position = Vector3::new(at(1)?, at(2)?, at(3)?);
        push(&mut poses, line, t, position, [at(4)?, at(5)?, at(6)?, at(7)?])?;
    }
    Ok(poses)
}
