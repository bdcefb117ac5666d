//! Finding on a board that has more rows or columns than stated.

use std::collections::BTreeSet;

use evcal_core::camera::Camera;
use evcal_core::grid::{reorder, symmetry};
use evcal_core::pattern::Pattern;
use nalgebra::{Point3, Vector2};

use crate::advice::Advice;
use crate::quality::verdict::{Cause, Finding, Severity};
use evcal_detection::circles::reference_frame::ReferenceFrame;
use evcal_detection::detection::recognition::larger_pattern::LargerPattern;
use evcal_geometry::board::CircleBoard;
use evcal_solve::trajectory::Trajectory;

/// An origin is on a circle if its distance from the circle in the image is less than this share of the distance to the
/// circle's nearest neighbour.
const ON_CIRCLE: f64 = 0.3;

/// Reports that the board in view is `larger`, and the stated `board` is a part of it. Camera and trajectories come from the
/// solve with the stated board.
pub(in crate::calibrate) fn finding_on(
    larger: &LargerPattern,
    board: &CircleBoard,
    camera: &Camera<f64>,
    trajectories: &[Trajectory],
) -> Finding {
    let (stated, seen) = (board.pattern, larger.pattern);
    let origins = trajectories.iter().map(|trajectory| origins_of(trajectory, larger, camera));
    let origins: Vec<BTreeSet<usize>> = origins.collect();
    let known = !origins.is_empty() && origins.iter().all(|origins| !origins.is_empty());
    let different: BTreeSet<usize> = origins.into_iter().flatten().collect();
    let (severity, consequence) = match different.first() {
        Some(_) if different.len() > 1 => {
            (Severity::Warning, ", and the trajectory's origin jumps from one circle of it to another")
        }
        Some(0) if known => (Severity::Note, ""),
        // If no window of a segment shows all of the board, it is not known which part was taken.
        Some(0) | None => {
            (Severity::Warning, ", and the trajectory's origin may be on another circle than its first, or jump")
        }
        Some(_) => (Severity::Warning, ", and the trajectory's origin is not on its first circle"),
    };
    Finding {
        cause: Cause::LargerBoard,
        severity,
        reason: format!(
            "only {}x{} of the board's {}x{} rows and columns are stated{consequence}",
            stated.rows, stated.columns, seen.rows, seen.columns
        ),
        advice: Advice::TakeWholeBoard(CircleBoard { pattern: seen, ..*board }),
    }
}

/// Returns the circles of the larger board at which the origin of a trajectory is, in the windows that show it.
fn origins_of(trajectory: &Trajectory, larger: &LargerPattern, camera: &Camera<f64>) -> BTreeSet<usize> {
    let frames = larger.frames.iter().filter(|frame| frame.recording == trajectory.recording);
    frames
        .filter_map(|frame| origin_in(frame, camera, trajectory))
        .map(|circle| first_equivalent(circle, larger.pattern))
        .collect()
}

/// Returns the circle of the larger board in `frame` that is at the origin of the trajectory; `None` if that circle was not
/// found, or the trajectory is of another time.
fn origin_in(frame: &ReferenceFrame, camera: &Camera<f64>, trajectory: &Trajectory) -> Option<usize> {
    let pose = trajectory.pose(frame.t())?;
    let place = camera.project(&pose.inverse_transform_point(&Point3::origin()).coords)?;
    let (distance, index, center) = *ranked_from(place, frame).first()?;
    // The nearest one is the circle itself.
    let (to_neighbour, ..) = *ranked_from(center, frame).get(1)?;
    (distance < ON_CIRCLE * to_neighbour).then_some(index)
}

/// Returns distance to `place`, index and centre of all circles, nearest first.
fn ranked_from(place: Vector2<f64>, frame: &ReferenceFrame) -> Vec<(f64, usize, Vector2<f64>)> {
    let circles = frame.circles.iter();
    let mut ranked: Vec<_> =
        circles.map(|circle| ((circle.center - place).norm(), circle.index, circle.center)).collect();
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
    ranked
}

/// Returns the first of the circles equivalent to `circle`: a symmetric board does not determine its orientation.
fn first_equivalent(circle: usize, pattern: Pattern) -> usize {
    (0..symmetry(&pattern)).filter_map(|turn| reorder(&pattern, circle, turn)).min().unwrap_or(circle)
}

#[cfg(test)]
mod tests {
    use evcal_core::camera::ModelKind;
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;
    use evcal_detection::circles::reference_frame::{ObservedCircle, SeenIn};
    use evcal_solve::trajectory::RotationControl;

    /// Returns the finding if the segments have their origins at these lattice positions of the larger board.
    fn finding_for(stated: &str, larger: &str, origins: &[(i32, i32)]) -> Finding {
        let [board, seen] = [stated, larger].map(|name| format!("{name}:55mm:r17.5mm").parse::<CircleBoard>().unwrap());
        let camera = Camera::from_parameters(ModelKind::Radtan4, &[300.0, 300.0, 173.0, 130.0, 0.0, 0.0, 0.0, 0.0]);
        let camera = camera.unwrap();
        // The camera is one metre in front of the larger board's middle.
        let middle = seen.middle();
        let in_world = |place: Vector2<f64>| Vector3::new(place.x, place.y, 1.0);
        let circles = (0..seen.circle_count()).map(|index| ObservedCircle {
            index,
            t: 0.5,
            center: camera.project(&in_world(seen.circle_center(index) - middle)).unwrap(),
            radius: None,
            velocity: None,
        });
        let frame = ReferenceFrame {
            recording: 0,
            start: 0.4,
            end: 0.6,
            circles: circles.collect(),
            seen_in: SeenIn::PassedEvents,
        };
        let moved = |recording: usize| ReferenceFrame { recording, ..frame.clone() };
        let trajectory = |(recording, (x, y)): (usize, &(i32, i32))| {
            let origin = Vector2::new(f64::from(*x), f64::from(*y)) * seen.spacing;
            let place = middle - origin;
            Trajectory {
                recording,
                knots: [[0.0; 4], [1.0; 4]].concat(),
                degree: 3,
                translation: vec![Vector3::new(place.x, place.y, -1.0); 4],
                rotation: RotationControl::So3(vec![UnitQuaternion::identity(); 4]),
            }
        };
        let trajectories: Vec<Trajectory> = origins.iter().enumerate().map(trajectory).collect();
        // The last recording has no trajectory.
        let frames = (0..=origins.len()).map(moved).collect();
        finding_on(&LargerPattern { pattern: seen.pattern, frames }, &board, &camera, &trajectories)
    }

    #[test]
    fn missing_rows_with_the_origin_at_the_first_circle_are_a_note() {
        let finding = finding_for("acircles:8x4", "acircles:9x4", &[(0, 0), (0, 0)]);
        assert_eq!((finding.cause, finding.severity), (Cause::LargerBoard, Severity::Note));
        assert_eq!(finding.reason, "only 8x4 of the board's 9x4 rows and columns are stated");
        assert_eq!(finding.advice, Advice::TakeWholeBoard("acircles:9x4:55mm:r17.5mm".parse().unwrap()));
    }

    #[test]
    fn an_origin_that_is_not_at_the_first_circle_is_a_warning() {
        for (stated, larger, origins, consequence) in [
            ("acircles:9x3", "acircles:9x4", &[(0, 0), (2, 0)][..], "origin jumps"),
            ("acircles:7x4", "acircles:9x4", &[(0, 2), (0, 2)], "origin is not on its first"),
            // The first origin is between circles, the second outside the board.
            ("acircles:9x3", "acircles:9x4", &[(1, 0), (12, 3)], "may be on another"),
            ("acircles:9x3", "acircles:9x4", &[], "may be on another"),
            // One segment at the first circle does not determine the others.
            ("acircles:9x3", "acircles:9x4", &[(0, 0), (12, 3)], "may be on another"),
            // The ends of a symmetric board cannot be distinguished.
            ("circles:5x5", "circles:6x5", &[(0, 0), (4, 4)], "origin jumps"),
        ] {
            let finding = finding_for(stated, larger, origins);
            assert_eq!(finding.severity, Severity::Warning, "{stated} of {larger}: {finding:?}");
            assert!(finding.reason.contains(consequence), "{stated} of {larger}: {finding:?}");
        }
        assert_eq!(finding_for("circles:5x5", "circles:6x5", &[(0, 0), (4, 5)]).severity, Severity::Note);
    }
}
