use super::*;
use crate::cluster::{ClusterSettings, row_bytes, row_count};
use crate::detector::{Detection, Detector, DetectorSettings};
use crate::event::{Event, Polarity};
use crate::sensor::Sensor;
use proptest::prelude::*;
use std::boxed::Box;
use std::vec::Vec;

const SENSOR: Sensor = Sensor { width: 346, height: 260 };

type Detector346 = Detector<f64, { row_bytes(346) }, { row_count(260) }, 4096, 256>;

/// A dot in the image: an ellipse with half axes `major` and `minor`, rotated by `turn`, that moves by `shift` pixels
/// towards `heading` during the window. Angles in radians.
#[derive(Clone, Copy, Debug)]
struct Dot {
    center: [f64; 2],
    major: f64,
    minor: f64,
    turn: f64,
    heading: f64,
    shift: f64,
}

impl Dot {
    const fn round(x: f64, y: f64, radius: f64, heading: f64) -> Self {
        Self { center: [x, y], major: radius, minor: radius, turn: 0.0, heading, shift: 1.0 }
    }

    /// Returns the events of the moving edge, without the parts where the edge moves along itself.
    fn events(&self) -> Vec<Event> {
        let mut events = Vec::new();
        let steps = 400;
        for moment in 0..8 {
            let along = (f64::from(moment) / 7.0 - 0.5) * self.shift;
            for step in 0..steps {
                let (sin, cos) = (f64::from(step) / f64::from(steps) * core::f64::consts::TAU).sin_cos();
                let (turn_sin, turn_cos) = self.turn.sin_cos();
                let (u, v) = (self.major * cos, self.minor * sin);
                let normal_u = cos * self.minor;
                let normal_v = sin * self.major;
                let length = normal_u.hypot(normal_v);
                let normal_x = (turn_cos * normal_u - turn_sin * normal_v) / length;
                let normal_y = (turn_sin * normal_u + turn_cos * normal_v) / length;
                let across = normal_x * self.heading.cos() + normal_y * self.heading.sin();
                if across.abs() < 0.35 {
                    continue;
                }
                let x = self.center[0] + turn_cos * u - turn_sin * v + along * self.heading.cos();
                let y = self.center[1] + turn_sin * u + turn_cos * v + along * self.heading.sin();
                let polarity = if across > 0.0 { Polarity::Off } else { Polarity::On };
                events.push(Event { t: 0, x: x.round() as u16, y: y.round() as u16, polarity });
            }
        }
        events
    }
}

/// Returns uniformly distributed events, from a xorshift generator so that a test always sees the same ones.
fn noise(count: usize, mut state: u64) -> Vec<Event> {
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    };
    (0..count)
        .map(|_| {
            let polarity = if next() % 2 == 0 { Polarity::Off } else { Polarity::On };
            Event { t: 0, x: (next() % 346) as u16, y: (next() % 260) as u16, polarity }
        })
        .collect()
}

fn detect(events: &[Event], extraction: Extraction) -> (Box<Detector346>, Detection) {
    let settings = DetectorSettings { extraction, ..DetectorSettings::default() };
    let mut detector = Box::new(Detector346::new());
    let detection = detector.detect(SENSOR, events.iter().copied(), &settings).unwrap();
    assert!(!detection.overflowed());
    (detector, detection)
}

/// Returns the number of dots that have a circle whose centre is off by less than `tolerance` pixels.
fn found(dots: &[Dot], circles: &[CircleCandidate<f64>], tolerance: f64) -> usize {
    dots.iter()
        .filter(|dot| {
            circles
                .iter()
                .any(|circle| (circle.center.x - dot.center[0]).hypot(circle.center.y - dot.center[1]) < tolerance)
        })
        .count()
}

/// Returns 36 dots of an asymmetric board whose rows are compressed to `aspect` by a tilt.
fn board(radius: f64, aspect: f64, heading: f64) -> Vec<Dot> {
    (0..36)
        .map(|index| {
            let (row, column) = (index / 4, index % 4);
            let spacing = radius * 3.15;
            Dot {
                center: [40.3 + spacing * f64::from(2 * column + row % 2), 30.7 + spacing * aspect * f64::from(row)],
                major: radius,
                minor: radius * aspect,
                turn: 0.0,
                heading,
                shift: 1.0,
            }
        })
        .collect()
}

#[test]
fn a_dot_is_found_as_a_circle() {
    // Soft: the mean of an arc of pixels is shifted along the arc by a fraction of its length.
    for (extraction, tolerance) in [(Extraction::Hard, 0.01), (Extraction::Soft, 0.03)] {
        for degrees in (0..360).step_by(15) {
            for radius in [4.0, 7.5, 12.0, 25.0] {
                let dot = Dot::round(150.3, 120.8, radius, f64::from(degrees).to_radians());
                let (detector, detection) = detect(&dot.events(), extraction);
                let [circle] = detector.circles() else {
                    panic!("{extraction:?}, radius {radius}, heading {degrees}: {detection:?}")
                };
                assert_eq!(
                    found(&[dot], &[*circle], 0.2 + tolerance * radius),
                    1,
                    "{extraction:?}, heading {degrees}: {circle:?}"
                );
                assert!((circle.radius - radius).abs() < 0.05 * radius + 0.15, "{extraction:?} {radius}: {circle:?}");
                assert!(circle.error < 0.8);
                let on = &detector.clusters(Polarity::On)[usize::from(circle.on_cluster)];
                assert_eq!(u32::from(circle.on_pixels), on.pixels);
            }
        }
    }
}

#[test]
fn the_dots_of_a_board_are_found_in_noise() {
    for (extraction, fewest) in [(Extraction::Hard, 36), (Extraction::Soft, 35)] {
        for degrees in (0..180).step_by(20) {
            let dots = board(8.0, 1.0, f64::from(degrees).to_radians());
            let mut events: Vec<Event> = dots.iter().flat_map(Dot::events).collect();
            events.extend(noise(500, 77 + degrees as u64));
            let (detector, detection) = detect(&events, extraction);
            assert!(
                found(&dots, detector.circles(), 1.0) >= fewest,
                "{extraction:?}, heading {degrees}: {detection:?}"
            );
            assert!(detector.circles().len() <= 38, "{extraction:?}, heading {degrees}: {detection:?}");
        }
    }
}

#[test]
fn dots_seen_as_ellipses_are_found() {
    for extraction in [Extraction::Hard, Extraction::Soft] {
        for aspect in [0.85, 0.7, 0.5] {
            for degrees in (0..180).step_by(30) {
                let dots = board(9.0, aspect, f64::from(degrees).to_radians());
                let events: Vec<Event> = dots.iter().flat_map(Dot::events).collect();
                let (detector, detection) = detect(&events, extraction);
                let count = found(&dots, detector.circles(), 2.0);
                assert!(count >= 33, "{extraction:?}, aspect {aspect}, heading {degrees}: {count}, {detection:?}");
            }
        }
    }
}

#[test]
fn arcs_back_to_back_are_rejected() {
    // The ON side of one dot and the OFF side of the next, without their other halves.
    let left = Dot::round(100.0, 100.0, 8.0, 0.0);
    let right = Dot::round(122.0, 100.0, 8.0, 0.0);
    let mut events = left.events();
    events.retain(|event| event.polarity == Polarity::Off);
    events.extend(right.events().into_iter().filter(|event| event.polarity == Polarity::On));
    for extraction in [Extraction::Hard, Extraction::Soft] {
        let (detector, detection) = detect(&events, extraction);
        assert_eq!(detection.clusters.clusters, [1, 1]);
        assert_eq!((detector.circles().len(), detection.circles.back_to_back), (0, 1));
    }
}

#[test]
fn every_pair_is_accounted_for() {
    let dots = board(8.0, 1.0, 0.3);
    let mut events: Vec<Event> = dots.iter().flat_map(Dot::events).collect();
    events.extend(noise(3000, 5));
    for extraction in [Extraction::Hard, Extraction::Soft] {
        let (_, detection) = detect(&events, extraction);
        let CircleCounts {
            clusters_too_large: _,
            back_to_back: _,
            pairs,
            radius_out_of_bounds,
            arc_too_short,
            radius_against_distance,
            center_against_midpoint,
            error_too_large,
            pairs_over_capacity,
            not_mutual,
            circles,
        } = detection.circles;
        let rejected = radius_out_of_bounds
            + arc_too_short
            + radius_against_distance
            + center_against_midpoint
            + error_too_large
            + pairs_over_capacity
            + not_mutual;
        assert_eq!(pairs, rejected + circles);
    }
}

#[test]
fn each_test_rejects_its_own_kind_of_pair() {
    let dot = Dot::round(150.0, 120.0, 10.0, 0.0);
    let reject = |change: &dyn Fn(&mut CircleSettings), extraction: Extraction| {
        let mut settings = DetectorSettings { extraction, ..DetectorSettings::default() };
        change(&mut settings.circle);
        let mut detector = Box::new(Detector346::new());
        detector.detect(SENSOR, dot.events(), &settings).unwrap().circles
    };
    for extraction in [Extraction::Hard, Extraction::Soft] {
        assert_eq!(reject(&|settings| settings.min_radius = 15.0, extraction).radius_out_of_bounds, 1);
        assert_eq!(reject(&|settings| settings.min_arc = 20.0, extraction).arc_too_short, 1);
        assert_eq!(reject(&|settings| settings.max_radius = 5.0, extraction).clusters_too_large, 2);
        assert_eq!(reject(&|settings| settings.min_facing = 1.01, extraction).back_to_back, 1);
    }
    assert_eq!(reject(&|settings| settings.max_soft_error = 0.001, Extraction::Soft).error_too_large, 1);
    assert_eq!(reject(&|settings| settings.min_radius_ratio = 1.5, Extraction::Hard).radius_against_distance, 1);
    assert_eq!(reject(&|settings| settings.max_radius_ratio = 0.5, Extraction::Hard).radius_against_distance, 1);
    assert_eq!(
        reject(&|settings| settings.max_center_offset = -1.0, Extraction::Hard).circles,
        1,
        "an offset is squared"
    );
    assert_eq!(reject(&|settings| settings.max_center_offset = 1e-6, Extraction::Hard).center_against_midpoint, 1);
    let no_error = |settings: &mut CircleSettings| {
        settings.max_error = 0.01;
        settings.max_relative_error = 0.0;
    };
    assert_eq!(reject(&no_error, Extraction::Hard).error_too_large, 1);
}

#[test]
fn too_many_pairs_are_counted() {
    type Tiny = Detector<f64, { row_bytes(346) }, { row_count(260) }, 4096, 8>;
    let dots = board(8.0, 1.0, 0.3);
    let events: Vec<Event> = dots.iter().flat_map(Dot::events).collect();
    let mut detector = Box::new(Tiny::new());
    let detection = detector.detect(SENSOR, events, &DetectorSettings::default()).unwrap();
    assert_eq!(detection.clusters.clusters, [8, 8]);
    assert_eq!(detection.clusters.clusters_over_capacity, 2 * 28);
    assert!(detection.overflowed());
    assert!(detector.circles().len() <= 8);
}

#[test]
fn single_and_double_precision_agree() {
    type Single = Detector<f32, { row_bytes(346) }, { row_count(260) }, 4096, 256>;
    let dots = board(8.0, 0.8, 1.0);
    let mut events: Vec<Event> = dots.iter().flat_map(Dot::events).collect();
    events.extend(noise(500, 3));
    let (double, _) = detect(&events, Extraction::Hard);
    let mut single = Box::new(Single::new());
    single.detect(SENSOR, events, &DetectorSettings::default()).unwrap();
    assert_eq!(single.circles().len(), double.circles().len());
    for (one, two) in single.circles().iter().zip(double.circles()) {
        assert_eq!((one.on_cluster, one.off_cluster), (two.on_cluster, two.off_cluster));
        assert!((f64::from(one.center.x) - two.center.x).abs() < 1e-3, "{one:?} {two:?}");
        assert!((f64::from(one.radius) - two.radius).abs() < 1e-3, "{one:?} {two:?}");
        assert!((f64::from(one.error) - two.error).abs() < 1e-3, "{one:?} {two:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// No events and no settings cause a panic, and all circles are within their bounds.
    #[test]
    fn any_input_gives_circles_within_bounds(
        seed in 1_u64..u64::MAX,
        count in 0_usize..6000,
        soft in any::<bool>(),
        epsilon in -1.0_f32..9.0,
        min_points in 0_u16..8,
        min_pixels in 0_u16..8,
        neighbours in 0_u8..20,
        max_radius in -1.0..200.0_f32,
    ) {
        let mut settings = DetectorSettings {
            cluster: ClusterSettings { epsilon, min_points, min_pixels },
            ..DetectorSettings::default()
        };
        settings.extraction = if soft { Extraction::Soft } else { Extraction::Hard };
        settings.circle.neighbours = neighbours;
        settings.circle.max_radius = max_radius;
        let mut detector = Box::new(Detector346::new());
        let detection = detector.detect(SENSOR, noise(count, seed), &settings).unwrap();
        prop_assert_eq!(detection.circles.circles as usize, detector.circles().len());
        for circle in detector.circles() {
            prop_assert!(circle.radius >= f64::from(settings.circle.min_radius) && circle.radius <= f64::from(max_radius));
            prop_assert!(circle.center.x.is_finite() && circle.center.y.is_finite() && circle.error.is_finite());
        }
    }
}
