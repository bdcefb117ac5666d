//! Drawing of the position and the axes of an object on the camera's mount, next to the axes of the camera.

use maud::{Markup, html};
use nalgebra::{Isometry3, Vector2, Vector3};

/// Width and height of the drawing in its own units.
const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 420.0;
/// Length of an axis.
const AXIS: f64 = 90.0;
/// Distance of the object from the camera in the drawing, unless it is nearer than [`NEAR`].
const APART: f64 = 170.0;
/// Distance below which the distance in the drawing shrinks proportionally (m).
const NEAR: f64 = 0.005;
/// Direction of the line of sight, which points away from the reader, in the drawing: to the upper right, at half the
/// length.
const FORWARD: Vector2<f64> = Vector2::new(0.42, -0.3);
/// Position of a name: above its origin, or below if the other name is in the way.
const ABOVE: f64 = -12.0;
const BELOW: f64 = 28.0;
/// Distance of the origins in the drawing below which the names overlap.
const CROWDED: f64 = 60.0;
/// Names of the axes, and their colours in the style sheet.
const AXES: [(&str, &str); 3] = [("x", "var(--on)"), ("y", "var(--third)"), ("z", "var(--off)")];

/// Draws the axes of the camera and of an object called `thing`, a noun, whose pose is `thing_from_camera`
/// (T_thing_camera); `names` are the labels of both.
pub fn drawing(thing: &str, names: [&str; 2], thing_from_camera: &Isometry3<f64>) -> Markup {
    let camera_from_thing = thing_from_camera.inverse();
    let place = camera_from_thing.translation.vector;
    let apart = on_paper(&place) * (APART / place.norm().max(NEAR));
    let camera = Vector2::new(0.5 * WIDTH, 0.5 * HEIGHT) - apart * 0.5;
    let unit = camera + apart;
    html! {
        svg role="img" aria-label={ "Axes of the camera and of the " (thing) "." } viewBox={ "0 0 " (WIDTH) " " (HEIGHT) }
            style="width:100%;max-width:40rem" font-size="20" fill="currentColor" {
            (line(camera, unit, "currentColor", Some("3 6")))
            (frame(names[0], ABOVE, camera, |axis| axis))
            (frame(names[1], if apart.norm() < CROWDED { BELOW } else { ABOVE }, unit, |axis| camera_from_thing.rotation * axis))
        }
    }
}

/// Projects a direction of the camera frame onto the drawing: x to the right, y down.
fn on_paper(direction: &Vector3<f64>) -> Vector2<f64> {
    direction.xy() + FORWARD * direction.z
}

/// Draws three axes, each rotated to the camera frame by `turn`, and a name to the left of their origin, at this height
/// above or below it.
fn frame(name: &str, height: f64, origin: Vector2<f64>, turn: impl Fn(Vector3<f64>) -> Vector3<f64>) -> Markup {
    let tip = |index: usize| origin + on_paper(&turn(Vector3::ith(index, 1.0))) * AXIS;
    let axes = AXES.iter().enumerate().map(|(index, axis)| (axis, tip(index)));
    html! {
        @for ((axis, color), tip) in axes {
            @let label = tip + (tip - origin) * 0.16;
            (line(origin, tip, color, None))
            circle cx=(round(tip.x)) cy=(round(tip.y)) r="5" fill=(color) {}
            text x=(round(label.x)) y=(round(label.y + 6.0)) text-anchor="middle" fill=(color) { (axis) }
        }
        circle cx=(round(origin.x)) cy=(round(origin.y)) r="6" {}
        text x=(round(origin.x - 12.0)) y=(round(origin.y + height)) text-anchor="end" { (name) }
    }
}

fn line(from: Vector2<f64>, to: Vector2<f64>, color: &str, dashes: Option<&str>) -> Markup {
    html! {
        line x1=(round(from.x)) y1=(round(from.y)) x2=(round(to.x)) y2=(round(to.y)) stroke=(color) stroke-width="3"
            stroke-dasharray=[dashes] {}
    }
}

fn round(value: f64) -> f64 {
    (value * 10.0).round() / 10.0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the positions of the circles at the tips, in the order in which they are drawn.
    fn tips(pose: &Isometry3<f64>) -> Vec<(f64, f64)> {
        let text = drawing("inertial unit", ["camera", "unit"], pose).into_string();
        let number = |part: &str, name: &str| {
            let rest = part.split_once(&format!("{name}=\"")).unwrap().1;
            rest.split_once('"').unwrap().0.parse::<f64>().unwrap()
        };
        text.split("<circle ").skip(1).map(|part| (number(part, "cx"), number(part, "cy"))).collect()
    }

    /// An IMU rotated by 180° about the line of sight has x to the left and y up, at its position below the camera.
    #[test]
    fn axes_point_where_the_unit_has_them() {
        let turn = Vector3::z() * std::f64::consts::PI;
        let unit_in_camera = Isometry3::new(Vector3::new(0.0, 0.02, 0.0), turn);
        let tips = tips(&unit_in_camera.inverse());
        let [camera_x, camera_y, camera_z, camera, unit_x, unit_y, unit_z, unit] = tips.try_into().unwrap();
        assert!(camera_x.0 > camera.0 + 80.0 && camera_x.1 == camera.1);
        assert!(camera_y.1 > camera.1 + 80.0 && camera_y.0 == camera.0);
        assert!(camera_z.0 > camera.0 && camera_z.1 < camera.1);
        assert!(unit.1 > camera.1 + 160.0 && unit.0 == camera.0);
        assert!(unit_x.0 < unit.0 - 80.0 && unit_y.1 < unit.1 - 80.0 && unit_z.0 > unit.0);
    }

    /// The names of a camera and an IMU at the same position must not be drawn over each other.
    #[test]
    fn names_of_what_is_in_one_place_do_not_overlap() {
        let text = drawing("inertial unit", ["camera", "unit"], &Isometry3::translation(1e-5, 0.0, 2e-5)).into_string();
        let height = |name: &str| {
            let before = text.split_once(&format!(">{name}<")).unwrap().0;
            let rest = before.rsplit_once(" y=\"").unwrap().1;
            rest.split_once('"').unwrap().0.parse::<f64>().unwrap()
        };
        assert!((height("camera") - height("unit")).abs() > 20.0, "{text}");
    }
}
