//! Other objects that move in front of the camera: a textured room behind the board, a hand over it.

use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// A distant room with dark and bright patches of random shape. It drifts sideways, as behind a board that is held in a
/// hand, and moves in the image when the camera rotates.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Texture {
    /// Radiance of dark and bright patches.
    pub radiance: [f64; 2],
    /// Angular size of a patch, in radians.
    pub patch: f64,
    /// Sideways drift of the room, in radians per second.
    pub drift: f64,
}

impl Default for Texture {
    fn default() -> Self {
        Self { radiance: [0.1, 0.8], patch: 0.05, drift: 0.3 }
    }
}

/// Cosine of the angle to the board's normal below which the room has no patches.
const SIDE: f64 = 0.1;
/// Steepness of the edges of patches: they are a sixth of a patch wide.
const STEEPNESS: f64 = 3.0;

impl Texture {
    /// Returns the radiance in a direction of the world at time `t` (s).
    pub(super) fn radiance(&self, direction: &Vector3<f64>, t: f64) -> f64 {
        let [dark, bright] = self.radiance;
        let mean = 0.5 * (dark + bright);
        let toward = direction.z.abs();
        if toward < SIDE {
            return mean;
        }
        let x = (direction.x / toward + self.drift * t) / self.patch;
        let y = direction.y / toward / self.patch;
        let (column, row) = (x.floor(), y.floor());
        let smooth = |share: f64| share * share * (3.0 - 2.0 * share);
        let (along_x, along_y) = (smooth(x - column), smooth(y - row));
        let corner = |dx: i64, dy: i64| random(column as i64 + dx, row as i64 + dy);
        let upper = corner(0, 0) + (corner(1, 0) - corner(0, 0)) * along_x;
        let lower = corner(0, 1) + (corner(1, 1) - corner(0, 1)) * along_x;
        let height = STEEPNESS * (upper + (lower - upper) * along_y - 0.5);
        dark + (bright - dark) * smooth((0.5 + height).clamp(0.0, 1.0))
    }
}

/// Returns a number from 0 to 1 for each point of a lattice (the finaliser of MurmurHash3).
fn random(x: i64, y: i64) -> f64 {
    let mut bits = (x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (y as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f);
    for factor in [0xff51_afd7_ed55_8ccd, 0xc4ce_b9fe_1a85_ec53] {
        bits = (bits ^ (bits >> 33)).wrapping_mul(factor);
    }
    (bits >> 33) as f64 / f64::from(1u32 << 31)
}

/// A hand flat on the board that moves back and forth: a palm with four fingers, over about a quarter of the board.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Hand {
    /// Radiance of the skin.
    pub radiance: f64,
    /// Amplitude of the motion to each side, as a fraction of the board's half height.
    pub reach: f64,
    /// Frequency of the motion in hertz.
    pub frequency: f64,
}

impl Default for Hand {
    fn default() -> Self {
        Self { radiance: 0.5, reach: 0.25, frequency: 0.4 }
    }
}

/// Radius of the palm, length of a finger and half its width, in half heights of the board.
const PALM: f64 = 0.42;
const FINGER: f64 = 0.95;
const FINGER_RADIUS: f64 = 0.09;
/// Directions of the fingers in radians.
const FINGERS: [f64; 4] = [-0.45, -0.15, 0.15, 0.45];

impl Hand {
    /// Returns the signed distance of a point of the board to the hand's edge at time `t` (s), positive on the hand,
    /// and the direction away from the hand. `middle` is the middle of the board, `half` its half height.
    pub(super) fn depth(&self, point: &Vector2<f64>, middle: &Vector2<f64>, half: f64, t: f64) -> (f64, Vector2<f64>) {
        let angle = std::f64::consts::TAU * self.frequency * t;
        // The hand comes from the lower right, with the fingers up.
        let sway = Vector2::new(libm::sin(angle), 0.5 * libm::sin(0.77 * angle));
        let palm = middle + (Vector2::new(0.45, 1.0) + sway * self.reach) * half;
        let mut best = away(point, &palm, &Vector2::zeros(), PALM * half);
        for finger in FINGERS {
            let along = Vector2::new(libm::sin(finger), -libm::cos(finger)) * (FINGER * half);
            let this = away(point, &palm, &along, FINGER_RADIUS * half);
            if this.0 > best.0 {
                best = this;
            }
        }
        best
    }

    /// Returns the largest speed of the hand, in metres per second.
    pub(super) fn top_speed(&self, half: f64) -> f64 {
        std::f64::consts::TAU * self.frequency * self.reach * half * 1.1
    }
}

/// Returns the depth in, and the direction away from, the region within `radius` of the line from `start` to `start` +
/// `along`.
fn away(point: &Vector2<f64>, start: &Vector2<f64>, along: &Vector2<f64>, radius: f64) -> (f64, Vector2<f64>) {
    let from = point - start;
    let length = along.norm_squared();
    let share = if length > 0.0 { (from.dot(along) / length).clamp(0.0, 1.0) } else { 0.0 };
    let offset = from - along * share;
    let distance = offset.norm();
    let normal = if distance > 0.0 { offset / distance } else { Vector2::x() };
    (radius - distance, normal)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_room_has_dark_and_bright_patches_that_drift() {
        let texture = Texture::default();
        let direction = |step: i32, t: f64| {
            let toward = Vector3::new(f64::from(step % 100) * 0.01 - 0.5, f64::from(step / 100) * 0.01 - 0.5, 1.0);
            texture.radiance(&toward.normalize(), t)
        };
        let values: Vec<f64> = (0..10_000).map(|step| direction(step, 0.0)).collect();
        let share = |of: &dyn Fn(f64) -> bool| values.iter().filter(|&&value| of(value)).count() as f64 / 1e4;
        assert!(share(&|value| value < 0.2) > 0.15 && share(&|value| value > 0.7) > 0.15);
        assert!(values.iter().all(|value| (0.1..=0.8).contains(value)));
        // After 0.1 s the room has moved by 0.03.
        assert!(
            (0..9_700)
                .filter(|step| step % 100 < 97)
                .all(|step| { (direction(step, 0.1) - direction(step + 3, 0.0)).abs() < 1e-9 })
        );
    }

    #[test]
    fn a_hand_covers_a_part_of_the_board_and_keeps_its_speed() {
        let (hand, middle, half) = (Hand::default(), Vector2::new(0.2, 0.2), 0.22);
        let depth = |x: f64, y: f64, t: f64| hand.depth(&Vector2::new(x, y), &middle, half, t).0;
        for moment in 0..50 {
            let t = f64::from(moment) * 0.1;
            let covered = (0..2500)
                .filter(|step| {
                    depth(f64::from(step % 50) * 0.0088 - 0.02, f64::from(step / 50) * 0.0088 - 0.02, t) > 0.0
                })
                .count();
            assert!((150..1000).contains(&covered), "{covered} of 2500 at {t} s");
            let speed = (depth(0.25, 0.3, t + 1e-4) - depth(0.25, 0.3, t)).abs() / 1e-4;
            assert!(speed <= hand.top_speed(half) + 1e-6, "{speed}");
        }
    }
}
