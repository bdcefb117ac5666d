//! The distortion curve of the lens, and the reprojection errors of the detected points.

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use maud::{Markup, html};
use nalgebra::{Vector2, Vector3};

use super::chart::{Chart, Color, Series, range_of, round_up};
use super::number::{count, signed};
use super::words::words;
use evcal_calibrate::calibrate::calibrated::{Calibrated, Evidence};
use evcal_geometry::board::Board;

/// Number of points of a curve.
const POINTS: usize = 200;
/// Limit of drawn points; more would hide each other.
const MOST_POINTS: usize = 1500;

/// Returns the distortion curve.
pub fn curve_figure(calibrated: &Calibrated) -> Markup {
    html! {
        figure {
            (curve(calibrated.camera(), calibrated.sensor).render())
            figcaption {
                "Distance of a ray's image from the principal point, towards the farthest corner of the sensor, with this lens and with a lens without "
                "distortion."
            }
        }
    }
}

/// Returns the reprojection errors, folded; empty if no frame has a pose.
pub fn reprojection_errors(calibrated: &Calibrated, board: &Board) -> Markup {
    let offsets = offsets(calibrated, board);
    html! {
        @if !offsets.is_empty() {
            details {
                summary { "Reprojection errors of " (words(board).points) }
                div.pair { (scatter(&offsets, words(board).points, matches!(calibrated.evidence, Evidence::Events(_)))) }
            }
        }
    }
}

/// Returns the distance from the principal point (px) over the angle from the optical axis (°).
fn curve(camera: &Camera<f64>, Sensor { width, height }: Sensor) -> Chart<'static> {
    let parameters = camera.parameters();
    let at = |index: usize| parameters.get(index).copied().unwrap_or_default();
    let (focal, center) = (at(0), Vector2::new(at(2), at(3)));
    let side = |center: f64, length: u16| {
        let last = f64::from(length) - 1.0;
        if last - center > center { last - center } else { -center }
    };
    let corner = Vector2::new(side(center.x, width), side(center.y, height));
    let farthest = camera.unproject(&(center + corner));
    let largest = farthest.map_or(0.0, |ray| ray.angle(&Vector3::z())).max(1e-3);
    // The rays are in one plane through the axis; the tangential distortion of a decentred lens bends its image
    // slightly.
    let plane = farthest.map_or(Vector2::x(), |ray| ray.xy()).try_normalize(0.0).unwrap_or(Vector2::x());
    let angles = || (0..=POINTS).map(|index| largest * index as f64 / POINTS as f64);
    let seen = angles().filter_map(|angle| {
        let ray = Vector3::new(plane.x * angle.sin(), plane.y * angle.sin(), angle.cos());
        Some((angle.to_degrees(), (camera.project(&ray)? - center).norm()))
    });
    let seen: Vec<(f64, f64)> = seen.collect();
    let top = round_up(1.3 * seen.iter().map(|point| point.1).fold(1.0, f64::max));
    // In some models the scale at the axis is not the focal length.
    let scale = seen.get(1).filter(|point| point.0 > 0.0).map_or(focal, |point| point.1 / point.0.to_radians().tan());
    let straight = angles().map(|angle| (angle.to_degrees(), scale * angle.tan()));
    let straight: Vec<(f64, f64)> = straight.take_while(|point| (0.0..=top).contains(&point.1)).collect();
    let series =
        |name: &str, color, curve| Series { name: name.to_owned(), color, curves: vec![curve], points: Vec::new() };
    Chart {
        description: "Distance from the principal point over the angle from the optical axis.".to_owned(),
        x_label: "angle from the axis (°)",
        y_label: "distance (px)",
        x: 0.0..largest.to_degrees(),
        y: 0.0..top,
        series: vec![series("this lens", Color::First, seen), series("no distortion", Color::Second, straight)],
    }
}

/// Returns the offset (px) of each detected circle from its projection with the camera and the pose of its frame.
fn offsets(calibrated: &Calibrated, board: &Board) -> Vec<Vector2<f64>> {
    let camera = match &calibrated.evidence {
        Evidence::Events(events) => &events.initial.camera,
        Evidence::Pictures(_) => calibrated.camera(),
    };
    let of_frames = calibrated.posed().flat_map(|(posed, frame)| {
        posed.circles.iter().filter_map(move |circle| {
            let point = board.point(circle.index).push(0.0);
            let expected = camera.project(&posed.pose.inverse_transform_point(&point.into()).coords)?;
            let moved = circle.velocity.map_or(Vector2::zeros(), |velocity| velocity * (frame.t() - circle.t));
            Some(circle.center + moved - expected)
        })
    });
    of_frames.collect()
}

fn scatter(offsets: &[Vector2<f64>], points: &str, from_events: bool) -> Markup {
    let rms = (offsets.iter().map(Vector2::norm_squared).sum::<f64>() / offsets.len().max(1) as f64).sqrt();
    let every = offsets.len().div_ceil(MOST_POINTS).max(1);
    let shown: Vec<(f64, f64)> = offsets.iter().step_by(every).map(|offset| (offset.x, offset.y)).collect();
    let half = range_of(shown.iter().flat_map(|point| [point.0, point.1, -point.0, -point.1]), 0.2).end;
    let chart = Chart {
        description: format!("Reprojection errors of {points} along columns and rows, up to {half:.1} px."),
        x_label: "along the row (px)",
        y_label: "along the column (px)",
        x: -half..half,
        y: -half..half,
        series: vec![Series { name: String::new(), color: Color::First, curves: Vec::new(), points: shown.clone() }],
    };
    html! {
        figure {
            (chart.render())
            figcaption {
                "Reprojection errors of " (points) @if from_events { " with the initial camera, before the joint solve" }
                ": " (signed(rms, 3)) " px (rms). " (count(shown.len() as u64)) " of " (count(offsets.len() as u64)) " " (points) " are drawn. They should scatter evenly around 0."
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use evcal_core::camera::ModelKind;

    use super::*;

    #[test]
    fn the_curve_ends_at_the_farthest_corner_and_begins_without_distortion() {
        let parameters = [300.0, 300.0, 150.0, 120.0, -0.3, 0.05, 0.0, 0.0, 0.0];
        let camera = Camera::from_parameters(ModelKind::Radtan, &parameters).unwrap();
        let chart = curve(&camera, Sensor::new(346, 260));
        let corner = (195.0_f64 * 195.0 + 139.0 * 139.0).sqrt();
        let [lens, straight] = [0, 1].map(|index| chart.series[index].curves[0].clone());
        assert!((lens.last().unwrap().1 - corner).abs() < 1e-6);
        // With barrel distortion the curve of the lens is below the other.
        assert!(straight.last().unwrap().1 > lens[straight.len() - 1].1 + 5.0);
        assert!((straight[1].1 - 300.0 * straight[1].0.to_radians().tan()).abs() < 1e-3);
    }
}
