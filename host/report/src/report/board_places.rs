//! The positions of the board: pixels on the sensor, distance, tilt.

use maud::html;
use nalgebra::{Isometry3, Point3, Vector3};

use super::chart::{Chart, Color, Series, range_of};
use super::number::percent;
use super::page::Section;
use super::scene;
use super::trusted_places::observation_map;
use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_calibrate::quality::coverage::Coverage;
use evcal_geometry::board::Board;

/// Limit of points in a plot; more would not be distinguishable.
const MOST: usize = 600;

/// Position of the board relative to the camera in one reference frame.
struct Place {
    /// Distance of its centre from the camera (m).
    distance: f64,
    /// Angle between the board's normal and the line of sight to its centre (°).
    tilt: f64,
    /// Tilt (°) as a vector in the image, right and down, towards the side that the board faces.
    lean: [f64; 2],
}

/// Returns the section with the observations on the sensor, the distances and the tilts.
pub fn section(calibrated: &Calibrated, board: &Board) -> Option<Section> {
    let poses = || calibrated.posed().map(|(posed, frame)| (frame, calibrated.best_pose(posed, frame)));
    let places: Vec<Place> = poses().map(|(_, pose)| place(board, &pose)).collect();
    let mut path: Vec<_> =
        poses().filter(|(frame, _)| frame.recording == 0).map(|(frame, pose)| (frame.t(), pose)).collect();
    path.sort_by(|a, b| a.0.total_cmp(&b.0));
    let Coverage { distance, tilt, fill, .. } = &calibrated.quality.coverage;
    let content = html! {
        p {
            "Focal length and distance are determined separately only if the board is near and tilted in all directions. Here it was "
            (format!("{:.2} to {:.2} m away, tilted by up to {:.0}°, and filled up to {} of the image's shorter side", distance.low, distance.high, tilt.high, percent(fill.high)))
            " (5 % of the poses are beyond each figure)."
        }
        figure {
            (scene::drawing(calibrated, board, &path))
            figcaption { "The path of the camera in front of the board (in the first recording), from blue to red, with what it sees at some moments." }
        }
        div.trio {
            (observation_map(calibrated))
            figure {
                (distances(&places).render())
                figcaption { "Distance and tilt of the board, one point per reference frame." }
            }
            figure {
                (tilts(&places).render())
                figcaption { "Direction of the tilt. Points on all sides of the centre are best." }
            }
        }
    };
    Some(Section { id: "board", title: "Positions of the board", folded: false, content })
}

fn place(board: &Board, pose: &Isometry3<f64>) -> Place {
    let middle = board.middle();
    let to_middle = pose.inverse_transform_point(&Point3::new(middle.x, middle.y, 0.0)).coords;
    // The camera is at −z of the world, in front of the board.
    let normal = pose.inverse_transform_vector(&-Vector3::z());
    let sight = -to_middle;
    let lean = normal - sight * (normal.dot(&sight) / sight.norm_squared());
    let tilt = normal.angle(&sight).to_degrees();
    let length = lean.xy().norm();
    let lean = if length > 0.0 { lean.xy() * (tilt / length) } else { lean.xy() };
    Place { distance: to_middle.norm(), tilt, lean: lean.into() }
}

fn points(name: &str, points: Vec<(f64, f64)>) -> Vec<Series> {
    vec![Series { name: name.to_owned(), color: Color::First, curves: Vec::new(), points: thinned(&points) }]
}

/// Returns at most [`MOST`] of the points, evenly chosen.
fn thinned(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    points.iter().step_by(points.len().div_ceil(MOST).max(1)).copied().collect()
}

fn distances(places: &[Place]) -> Chart<'static> {
    let far = places.iter().map(|place| place.distance).fold(0.0, f64::max);
    let tilted = places.iter().map(|place| place.tilt).fold(30.0, f64::max);
    Chart {
        description: "Distance of the board from the camera against its tilt, one point per reference frame."
            .to_owned(),
        x_label: "tilt (°)",
        y_label: "distance (m)",
        x: 0.0..1.05 * tilted,
        y: 0.0..1.1 * far.max(1e-3),
        series: points("board", places.iter().map(|place| (place.tilt, place.distance)).collect()),
    }
}

fn tilts(places: &[Place]) -> Chart<'static> {
    let leans = || places.iter().map(|place| (place.lean[0], -place.lean[1]));
    let most = leans().map(|(x, y)| x.abs().max(y.abs())).fold(30.0, f64::max);
    let range = range_of([-most, most].into_iter(), 1.0);
    Chart {
        description: "Direction and size of the board's tilt, one point per reference frame.".to_owned(),
        x_label: "faces left ← tilt (°) → faces right",
        y_label: "down ← tilt (°) → up",
        x: range.clone(),
        y: range,
        series: points("board", leans().collect()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};

    fn seen(rotation: UnitQuaternion<f64>, distance: f64) -> Place {
        let board: Board = "circles:5x5:40mm:r10mm".parse().unwrap();
        let middle = board.middle();
        // The camera looks at the centre of the board from `distance`.
        let center = Vector3::new(middle.x, middle.y, 0.0) - rotation * Vector3::z() * distance;
        place(&board, &Isometry3::from_parts(Translation3::from(center), rotation))
    }

    #[test]
    fn distance_and_tilt_are_relative_to_the_camera() {
        let head_on = seen(UnitQuaternion::identity(), 0.7);
        assert!((head_on.distance - 0.7).abs() < 1e-12 && head_on.tilt < 1e-6);
        // The camera is to the left of the board (−x) and looks right, so the board faces to the right of the camera.
        let from_left = seen(UnitQuaternion::from_euler_angles(0.0, 0.5, 0.0), 0.7);
        assert!((from_left.tilt - 0.5_f64.to_degrees()).abs() < 1e-9);
        assert!(from_left.lean[0].abs() > 28.0 && from_left.lean[1].abs() < 1e-9);
        let normal_in_camera = UnitQuaternion::from_euler_angles(0.0, 0.5, 0.0).inverse() * -Vector3::z();
        assert_eq!(from_left.lean[0] > 0.0, normal_in_camera.x > 0.0);
    }
}
