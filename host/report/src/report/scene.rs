//! The path of the camera in front of the board, as one drawing without scripts.

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use maud::{Markup, html};
use nalgebra::{Isometry3, Point3, Vector2};

use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_geometry::board::Board;

use super::chart::round;

/// Width of the drawing in its own units, and its margin.
const WIDTH: f64 = 900.0;
const MARGIN: f64 = 20.0;
/// Direction from which the scene is seen: turned about the vertical, then lifted (rad).
const TURN: f64 = -0.9;
const LIFT: f64 = 0.31;
/// Number of viewing pyramids, and their length as a share of the scene.
const PYRAMIDS: usize = 24;
const LENGTH: f64 = 0.12;
/// A longer pause between two poses interrupts the path (s).
const PAUSE: f64 = 0.2;
/// Number of pieces of the path, each in one colour.
const PIECES: usize = 300;

/// Returns the drawing of `poses` (time in s, T_world_camera), in order of time; empty without poses.
pub fn drawing(calibrated: &Calibrated, board: &Board, poses: &[(f64, Isometry3<f64>)]) -> Markup {
    let (Some((begin, _)), Some((end, _))) = (poses.first(), poses.last()) else { return html! {} };
    let middle = board.middle();
    let middle = Point3::new(middle.x, middle.y, 0.0);
    let size = poses.iter().map(|(_, pose)| (pose.translation.vector - middle.coords).norm()).fold(0.0, f64::max);
    let sight = sight(calibrated.camera(), calibrated.sensor, LENGTH * size);
    let outlines: Vec<Vec<Vector2<f64>>> = board
        .outlines()
        .iter()
        .map(|outline| outline.iter().map(|at| seen(&Point3::new(at.x, at.y, 0.0))).collect())
        .collect();
    let every = poses.len().div_ceil(PYRAMIDS).max(1);
    let pyramids: Vec<(f64, Vector2<f64>, Vec<Vector2<f64>>)> = poses
        .iter()
        .step_by(every)
        .map(|(t, pose)| {
            (*t, seen(&pose.translation.vector.into()), sight.iter().map(|corner| seen(&(pose * corner))).collect())
        })
        .collect();
    let apart = poses.len().div_ceil(PIECES).max(1);
    let path: Vec<(f64, Vector2<f64>)> =
        poses.iter().step_by(apart).map(|(t, pose)| (*t, seen(&pose.translation.vector.into()))).collect();
    let drawn = outlines.iter().flatten().chain(path.iter().map(|point| &point.1));
    let drawn = drawn.chain(pyramids.iter().flat_map(|(_, _, base)| base));
    let (low, high) = drawn
        .fold((Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY)), |(low, high), at| {
            (low.inf(at), high.sup(at))
        });
    let scale = (WIDTH - 2.0 * MARGIN) / (high - low).x.max(1e-9);
    let place = |at: &Vector2<f64>| ((at - low) * scale).add_scalar(MARGIN).map(round);
    let points = |line: &[Vector2<f64>]| {
        let line: Vec<String> = line.iter().map(&place).map(|at| format!("{},{}", at.x, at.y)).collect();
        line.join(" ")
    };
    let color = |t: f64| format!("hsl({:.0} 75% 45%)", 225.0 - 200.0 * (t - begin) / (end - begin).max(1e-9));
    html! {
        svg.scene preserveAspectRatio="xMinYMin" role="img" aria-label="The board and the path of the camera in front of it, seen from the side; blue at the beginning, red at the end."
            viewBox={ "0 0 " (WIDTH) " " (round((high - low).y * scale + 2.0 * MARGIN)) } {
            @for outline in &outlines { polyline.board points=(points(outline)) {} }
            @for pair in path.windows(2) {
                @if let [(t, from), (next, to)] = pair {
                    @if next - t < PAUSE * apart as f64 {
                        polyline.path points=(points(&[*from, *to])) stroke=(color(*t)) {}
                    }
                }
            }
            @for (t, center, base) in &pyramids {
                g stroke=(color(*t)) fill=(color(*t)) {
                    title { (format!("{t:.2} s")) }
                    polygon points=(points(base)) {}
                    @for corner in base { polyline points=(points(&[*center, *corner])) {} }
                }
            }
        }
    }
}

/// Returns the corners of the image at this distance (m) in the frame of the camera; those that a wide lens sees behind itself are drawn
/// as if they were at its side.
fn sight(camera: &Camera<f64>, Sensor { width, height }: Sensor, length: f64) -> Vec<Point3<f64>> {
    let (right, bottom) = (f64::from(width) - 1.0, f64::from(height) - 1.0);
    let corners = [[0.0, 0.0], [right, 0.0], [right, bottom], [0.0, bottom]];
    let bearings = corners.iter().filter_map(|corner| camera.unproject(&Vector2::from(*corner)));
    bearings.map(|bearing| (bearing * (length / bearing.z.max(0.3 * bearing.norm()))).into()).collect()
}

/// Projects a point of the world (m) into the drawing: x to the right, y down. The camera is at negative z.
fn seen(point: &Point3<f64>) -> Vector2<f64> {
    let (sin, cos) = TURN.sin_cos();
    let (x, depth) = (cos * point.x + sin * point.z, -sin * point.x + cos * point.z);
    Vector2::new(x, LIFT.cos() * point.y - LIFT.sin() * depth)
}

#[cfg(test)]
mod tests {
    use evcal_core::camera::ModelKind;

    use super::*;

    /// The pyramid of a pinhole camera has the shape of its image.
    #[test]
    fn a_pyramid_has_the_shape_of_the_image() {
        let camera =
            Camera::from_parameters(ModelKind::Radtan4, &[100.0, 100.0, 99.5, 49.5, 0.0, 0.0, 0.0, 0.0]).unwrap();
        let base = sight(&camera, Sensor::new(200, 100), 0.1);
        assert_eq!(base.len(), 4);
        let expected = Point3::new(-0.0995, -0.0495, 0.1);
        assert!((base[0] - expected).norm() < 1e-9, "{base:?}");
        assert!((base[2] + expected.coords).coords.xy().norm() < 1e-9, "{base:?}");
    }

    /// A camera in front of the board is on one side of it, and what is lower in the world is lower in the drawing.
    #[test]
    fn the_scene_is_upright() {
        let at = |x: f64, y: f64, z: f64| seen(&Point3::new(x, y, z));
        assert!(at(0.0, 0.1, 0.0).y > at(0.0, 0.0, 0.0).y);
        assert!(at(0.0, 0.0, -1.0).x > at(0.0, 0.0, 0.0).x);
        assert!(at(0.1, 0.0, 0.0).x > at(0.0, 0.0, 0.0).x);
    }
}
