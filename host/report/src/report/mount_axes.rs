//! A drawing of the position and axes of another sensor on the mount, next to the axes of the camera.

use maud::{Markup, html};
use nalgebra::{Isometry3, Vector2, Vector3};

use super::chart::{Color, round};

/// Width and height of the drawing in its own units.
const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 420.0;
/// Length of an axis.
const AXIS: f64 = 90.0;
/// Distance in the drawing between the camera and a thing farther away than [`NEAR`].
const SEPARATION: f64 = 170.0;
/// Distance (m) below which the distance in the drawing shrinks in proportion.
const NEAR: f64 = 0.005;
/// Direction of the camera's line of sight in the drawing: to the upper right, half as long as x and y.
const FORWARD: Vector2<f64> = Vector2::new(0.42, -0.3);
/// Height of a name above its origin, or below if the names of both origins would overlap.
const ABOVE: f64 = -12.0;
const BELOW: f64 = 28.0;
/// Distance of the origins in the drawing below which the names would overlap.
const CROWDED: f64 = 60.0;
/// Names of the axes, in the order of [`Color::ALL`].
const AXES: [&str; 3] = ["x", "y", "z"];

/// Returns a drawing of the axes of the camera and of a thing at the pose `thing_from_camera` (T_thing_camera). `thing` is a noun for the
/// alternative text, `names` are the labels of the two origins.
pub fn drawing(thing: &str, names: [&str; 2], thing_from_camera: &Isometry3<f64>) -> Markup {
    let camera_from_thing = thing_from_camera.inverse();
    let position = camera_from_thing.translation.vector;
    let offset = on_paper(&position) * (SEPARATION / position.norm().max(NEAR));
    let camera = Vector2::new(0.5 * WIDTH, 0.5 * HEIGHT) - offset * 0.5;
    let unit = camera + offset;
    html! {
        svg role="img" aria-label={ "Axes of the camera and of the " (thing) "." } viewBox={ "0 0 " (WIDTH) " " (HEIGHT) }
            class="axes" font-size="20" fill="currentColor" {
            (line(camera, unit, "mount"))
            (frame(names[0], ABOVE, camera, |axis| axis))
            (frame(names[1], if offset.norm() < CROWDED { BELOW } else { ABOVE }, unit, |axis| camera_from_thing.rotation * axis))
        }
    }
}

/// Projects a direction of the camera frame into the drawing: x to the right, y down.
fn on_paper(direction: &Vector3<f64>) -> Vector2<f64> {
    direction.xy() + FORWARD * direction.z
}

/// Draws three axes, which `turn` rotates to the camera frame, and a name to the left of their origin, at `height` relative to it.
fn frame(name: &str, height: f64, origin: Vector2<f64>, turn: impl Fn(Vector3<f64>) -> Vector3<f64>) -> Markup {
    let tip = |index: usize| origin + on_paper(&turn(Vector3::ith(index, 1.0))) * AXIS;
    let axes = AXES.into_iter().enumerate().map(|(index, axis)| (axis, tip(index)));
    html! {
        @for ((axis, tip), color) in axes.zip(Color::ALL) {
            @let label = tip + (tip - origin) * 0.16;
            (line(origin, tip, color.class()))
            circle.(color.class()) cx=(round(tip.x)) cy=(round(tip.y)) r="5" {}
            text.(color.class()) x=(round(label.x)) y=(round(label.y + 6.0)) text-anchor="middle" { (axis) }
        }
        circle cx=(round(origin.x)) cy=(round(origin.y)) r="6" {}
        text x=(round(origin.x - 12.0)) y=(round(origin.y + height)) text-anchor="end" { (name) }
    }
}

fn line(from: Vector2<f64>, to: Vector2<f64>, class: &str) -> Markup {
    html! {
        line.(class) x1=(round(from.x)) y1=(round(from.y)) x2=(round(to.x)) y2=(round(to.y)) stroke-width="3" {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Centres of the drawn circles: the tips of the axes and the origin of the camera, then of the other sensor.
    fn tips(pose: &Isometry3<f64>) -> Vec<(f64, f64)> {
        let text = drawing("IMU", ["camera", "IMU"], pose).into_string();
        let number = |part: &str, name: &str| {
            let rest = part.split_once(&format!("{name}=\"")).unwrap().1;
            rest.split_once('"').unwrap().0.parse::<f64>().unwrap()
        };
        text.split("<circle ").skip(1).map(|part| (number(part, "cx"), number(part, "cy"))).collect()
    }

    /// An IMU below the camera, rotated by 180° about the line of sight: its x points left, its y up.
    #[test]
    fn axes_are_drawn_in_the_rotation_of_the_imu() {
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

    #[test]
    fn names_do_not_overlap_if_both_origins_coincide() {
        let text = drawing("IMU", ["camera", "IMU"], &Isometry3::translation(1e-5, 0.0, 2e-5)).into_string();
        let height = |name: &str| {
            let before = text.split_once(&format!(">{name}<")).unwrap().0;
            let rest = before.rsplit_once(" y=\"").unwrap().1;
            rest.split_once('"').unwrap().0.parse::<f64>().unwrap()
        };
        assert!((height("camera") - height("IMU")).abs() > 20.0, "{text}");
    }
}
