//! The dot shape of simulated windows. Their events are the pixels that become darker or brighter when dots of some
//! form move.

use evcal_core::event::Event;
use nalgebra::{Matrix3, Vector3};

use super::*;

const PATTERN: Pattern = Pattern { layout: Layout::Symmetric, rows: 4, columns: 5 };
const RADIUS: f64 = 0.3;

/// Returns `true` if a position, in radii from the centre of a dot, is dark.
type Form = fn(f64, f64) -> bool;

fn disc(x: f64, y: f64) -> bool {
    x * x + y * y < 1.0
}

fn square(x: f64, y: f64) -> bool {
    x.abs().max(y.abs()) < 0.9
}

fn key(x: f64, y: f64) -> bool {
    let corner = |value: f64| (value.abs() - 0.45).max(0.0);
    square(x, y) && corner(x) * corner(x) + corner(y) * corner(y) < 0.45 * 0.45
}

fn ring(x: f64, y: f64) -> bool {
    disc(x, y) && !disc(2.0 * x, 2.0 * y)
}

/// A tilted view of the lattice, rotated by `turn`, in which dots in the middle have a radius of `pixels`.
fn view(pixels: f64, turn: f64) -> Matrix3<f64> {
    let scale = pixels / RADIUS;
    let (sin, cos) = turn.sin_cos();
    let slant = Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.8, 0.0, 0.0006, -0.0008, 1.0);
    let turned = Matrix3::new(scale * cos, -scale * sin, 0.0, scale * sin, scale * cos, 0.0, 0.0, 0.0, 1.0);
    let centred = Matrix3::new(1.0, 0.0, -2.0, 0.0, 1.0, -1.5, 0.0, 0.0, 1.0);
    Matrix3::new(1.0, 0.0, 170.0, 0.0, 1.0, 130.0, 0.0, 0.0, 1.0) * slant * turned * centred
}

fn through(map: &Matrix3<f64>, x: f64, y: f64) -> Vector2<f64> {
    let seen = map * Vector3::new(x, y, 1.0);
    seen.xy() / seen.z
}

/// The dots, with `share` of their radius, and the pixels that change when the board moves by `shift` radii towards `heading`.
fn window(form: Form, map: &Matrix3<f64>, share: f64, heading: f64, shift: f64) -> (Vec<Dot>, Vec<EventPixel>) {
    let back = map.try_inverse().unwrap();
    let step = Vector2::new(heading.cos(), heading.sin()) * (0.5 * shift);
    let dark = |place: Vector2<f64>| {
        let (x, y) = (place.x.round(), place.y.round());
        let on_board = (0.0..5.0).contains(&x) && (0.0..4.0).contains(&y);
        on_board && form((place.x - x) / RADIUS, (place.y - y) / RADIUS)
    };
    let mut pixels = Vec::new();
    for (x, y) in (0..260).flat_map(|y| (0..346).map(move |x| (x, y))) {
        let place = through(&back, f64::from(x), f64::from(y));
        let (before, after) = (dark(place + step * RADIUS), dark(place - step * RADIUS));
        if before != after {
            let polarity = if after { Polarity::Off } else { Polarity::On };
            pixels.push(EventPixel::new(&Event { t: 0, x, y, polarity }));
        }
    }
    let dots = (0..PATTERN.circle_count()).map(|index| {
        let (x, y) = PATTERN.lattice_position(index);
        let (x, y) = (f64::from(x), f64::from(y));
        let center = through(map, x, y);
        let right = through(map, x + 0.01, y) - center;
        let down = through(map, x, y + 0.01) - center;
        Dot { index, center, radius: share * RADIUS * (right.perp(&down).abs() * 1e4).sqrt() }
    });
    (dots.collect(), pixels)
}

fn shape(form: Form, pixels: f64, share: f64, heading: f64) -> DotShape {
    let (dots, events) = window(form, &view(pixels, 0.4), share, heading, 0.25);
    DotShape::of_dots(&dots, &events, &PATTERN)
}

const HEADINGS: [f64; 5] = [0.0, 0.5, 0.785, 2.4, 4.0];

#[test]
fn discs_are_round_and_full_in_every_direction_of_motion() {
    for pixels in [4.0, 8.0, 14.0] {
        for heading in HEADINGS {
            let shape = shape(disc, pixels, 1.0, heading);
            let (amplitude, sigma) = shape.corners().unwrap();
            assert!(amplitude < 3.5 * sigma.max(0.004), "{pixels} px, {heading}: {amplitude} ± {sigma}");
            assert!(shape.hollowness() < 0.02, "{pixels} px, {heading}: {}", shape.hollowness());
        }
    }
}

/// The amplitude of four corners of a square of half side 1 is 0.12, relative to its mean radius of 1.12. If it moves along a
/// side, only two sides have events, which one window cannot distinguish from flat arcs; the detector finds no circle there.
#[test]
fn squares_and_keys_have_corners_in_every_direction_of_motion() {
    for pixels in [4.0, 8.0, 14.0] {
        for heading in HEADINGS.into_iter().skip(1) {
            let (amplitude, sigma) = shape(square, pixels, 1.0, heading).corners().unwrap();
            assert!((0.08..0.16).contains(&amplitude) && amplitude > 5.0 * sigma, "{amplitude} ± {sigma}");
            let (amplitude, sigma) = shape(key, pixels, 1.0, heading).corners().unwrap();
            assert!((0.05..0.13).contains(&amplitude), "{pixels} px, {heading}: {amplitude} ± {sigma}");
        }
    }
}

/// Window panes are bright squares: their polarities are exchanged.
#[test]
fn bright_squares_have_corners_too() {
    let (dots, events) = window(square, &view(9.0, 0.4), 1.0, 1.1, 0.25);
    let exchanged = events.iter().map(|pixel| {
        let polarity = if pixel.polarity() == Polarity::On { Polarity::Off } else { Polarity::On };
        EventPixel::new(&Event { t: 0, x: pixel.x(), y: pixel.y(), polarity })
    });
    let mut exchanged: Vec<EventPixel> = exchanged.collect();
    exchanged.sort_unstable();
    let of = |pixels: &[EventPixel]| DotShape::of_dots(&dots, pixels, &PATTERN).corners().unwrap().0;
    assert!((of(&exchanged) - of(&events)).abs() < 1e-9 && of(&events) > 0.08);
}

#[test]
fn rings_are_hollow_whichever_rim_was_found() {
    for pixels in [7.0, 10.0, 14.0] {
        for heading in HEADINGS {
            for share in [1.0, 0.5] {
                let hollowness = shape(ring, pixels, share, heading).hollowness();
                assert!(hollowness > 0.25, "{pixels} px, {share}, {heading}: {hollowness}");
            }
        }
    }
}

#[test]
fn evidence_of_more_windows_reduces_the_uncertainty() {
    let mut all = DotShape::default();
    assert_eq!(all.corners(), None);
    let single = shape(key, 8.0, 1.0, 0.5);
    for heading in [0.5, 1.1, 2.2, 3.3] {
        all.add(&shape(key, 8.0, 1.0, heading));
    }
    let ((_, one), (amplitude, four)) = (single.corners().unwrap(), all.corners().unwrap());
    assert!(four < 0.7 * one && amplitude > 10.0 * four, "{amplitude} ± {four}, one {one}");
}

#[test]
fn unusual_dots_have_no_evidence_and_no_effect() {
    let (dots, events) = window(disc, &view(8.0, 0.0), 1.0, 0.0, 0.2);
    assert_eq!(DotShape::of_dots(&dots[..2], &events, &PATTERN).corners(), None);
    assert_eq!(DotShape::of_dots(&dots, &[], &PATTERN).corners(), None);
    let same: Vec<Dot> = dots.iter().map(|dot| Dot { center: dots[0].center, ..*dot }).collect();
    let off: Vec<Dot> =
        dots.iter().map(|dot| Dot { center: Vector2::repeat(f64::NAN), radius: f64::INFINITY, ..*dot }).collect();
    for odd in [same, off] {
        let shape = DotShape::of_dots(&odd, &events, &PATTERN);
        assert!(shape.corners().is_none() && shape.hollowness() == 0.0, "{shape:?}");
    }
}
