use super::*;
use crate::event::{Event, Polarity};
use crate::sensor::Sensor;
use proptest::prelude::*;
use std::boxed::Box;
use std::collections::{BTreeMap, BTreeSet};
use std::vec;
use std::vec::Vec;

/// Wide enough for several words per row, with columns on both sides of each word boundary.
const SENSOR: Sensor = Sensor { width: 70, height: 24 };

type Small = Clusterer<f64, { row_bytes(70) }, { row_count(24) }, 2000, 600>;

type Pixel = (u16, u16);

fn event(x: u16, y: u16, polarity: Polarity) -> Event {
    Event { t: 0, x, y, polarity }
}

fn on(pixels: &[Pixel]) -> Vec<Event> {
    pixels.iter().map(|&(x, y)| event(x, y, Polarity::On)).collect()
}

/// Returns the clusters of one polarity as sets of pixels.
fn clusters(clusterer: &Small, polarity: Polarity) -> Vec<BTreeSet<Pixel>> {
    clusterer
        .clusters(polarity)
        .iter()
        .map(|cluster| clusterer.runs(cluster).flat_map(|run| run.pixels().collect::<Vec<_>>()).collect())
        .collect()
}

/// DBSCAN straight from its definition: every pixel is compared with every other.
fn naive(events: &[Event], polarity: Polarity, settings: &ClusterSettings) -> Vec<BTreeSet<Pixel>> {
    let of = |polarity: Polarity| -> BTreeSet<Pixel> {
        events.iter().filter(|event| event.polarity == polarity).map(|event| (event.y, event.x)).collect()
    };
    // As (row, column), so that sets are in reading order.
    let pixels: Vec<Pixel> = of(polarity).difference(&of(polarity.opposite())).copied().collect();
    let near = |a: &Pixel, b: &Pixel| {
        let (dy, dx) = (f64::from(a.0) - f64::from(b.0), f64::from(a.1) - f64::from(b.1));
        dx * dx + dy * dy <= f64::from(settings.epsilon) * f64::from(settings.epsilon)
    };
    let is_core: Vec<bool> = pixels
        .iter()
        .map(|a| pixels.iter().filter(|b| near(a, b)).count() >= usize::from(settings.min_points))
        .collect();
    let mut label: Vec<Option<usize>> = vec![None; pixels.len()];
    let mut clusters: Vec<BTreeSet<Pixel>> = Vec::new();
    for seed in 0..pixels.len() {
        if !is_core[seed] || label[seed].is_some() {
            continue;
        }
        let number = clusters.len();
        clusters.push(BTreeSet::new());
        let mut open = vec![seed];
        label[seed] = Some(number);
        while let Some(current) = open.pop() {
            clusters[number].insert((pixels[current].1, pixels[current].0));
            for other in 0..pixels.len() {
                if is_core[other] && label[other].is_none() && near(&pixels[current], &pixels[other]) {
                    label[other] = Some(number);
                    open.push(other);
                }
            }
        }
    }
    for border in (0..pixels.len()).filter(|&index| !is_core[index]) {
        let first_core = (0..pixels.len()).find(|&core| is_core[core] && near(&pixels[border], &pixels[core]));
        if let Some(number) = first_core.and_then(|core| label[core]) {
            clusters[number].insert((pixels[border].1, pixels[border].0));
        }
    }
    clusters.retain(|cluster| cluster.len() >= usize::from(settings.min_pixels));
    clusters
}

fn any_settings() -> impl Strategy<Value = ClusterSettings> {
    let epsilon = prop::sample::select(vec![1.0_f32, 1.5, 2.0, 2.3, 2.9, 3.0, 3.5, 4.0, 4.4, 4.9]);
    (epsilon, 1_u16..9, 1_u16..7).prop_map(|(epsilon, min_points, min_pixels)| ClusterSettings {
        epsilon,
        min_points,
        min_pixels,
    })
}

fn any_event() -> impl Strategy<Value = Event> {
    (0..SENSOR.width, 0..SENSOR.height, any::<bool>())
        .prop_map(|(x, y, on)| event(x, y, if on { Polarity::On } else { Polarity::Off }))
}

/// Events spread evenly, and events in clumps, so that some clusters form at any density.
fn any_events() -> impl Strategy<Value = Vec<Event>> {
    let clump = (any_event(), prop::collection::vec((-4_i32..5, -4_i32..5), 1..40)).prop_map(|(center, offsets)| {
        offsets
            .into_iter()
            .filter_map(|(dx, dy)| {
                let (x, y) = (i32::from(center.x) + dx, i32::from(center.y) + dy);
                let inside = x >= 0 && y >= 0 && x < i32::from(SENSOR.width) && y < i32::from(SENSOR.height);
                inside.then(|| event(x as u16, y as u16, center.polarity))
            })
            .collect::<Vec<_>>()
    });
    (prop::collection::vec(any_event(), 0..250), prop::collection::vec(clump, 0..8))
        .prop_map(|(spread, clumps)| clumps.into_iter().flatten().chain(spread).collect())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    #[test]
    fn equals_a_naive_dbscan(windows in prop::collection::vec(any_events(), 1..4), settings in any_settings()) {
        let mut clusterer = Box::new(Small::new());
        // One clusterer for all windows: nothing of a window may remain in the next.
        for events in windows {
            let counts = clusterer.cluster(SENSOR, events.iter().copied(), &settings).unwrap();
            for polarity in [Polarity::Off, Polarity::On] {
                prop_assert_eq!(clusters(&clusterer, polarity), naive(&events, polarity, &settings));
            }
            prop_assert_eq!(counts.events as usize, events.len());
            prop_assert_eq!(counts.pixels_over_capacity + counts.clusters_over_capacity, 0);
        }
    }

    #[test]
    fn measures_equal_their_definition(events in any_events()) {
        let settings = ClusterSettings::default();
        let mut clusterer = Box::new(Small::new());
        clusterer.cluster(SENSOR, events, &settings).unwrap();
        for cluster in clusterer.clusters(Polarity::On) {
            let pixels: Vec<Pixel> = clusterer.runs(cluster).flat_map(|run| run.pixels().collect::<Vec<_>>()).collect();
            let n = pixels.len() as f64;
            prop_assert_eq!(cluster.pixels as usize, pixels.len());
            prop_assert_eq!(cluster.min, [pixels.iter().map(|p| p.0).min().unwrap(), pixels.iter().map(|p| p.1).min().unwrap()]);
            prop_assert_eq!(cluster.max, [pixels.iter().map(|p| p.0).max().unwrap(), pixels.iter().map(|p| p.1).max().unwrap()]);
            let mean_x = pixels.iter().map(|p| f64::from(p.0)).sum::<f64>() / n;
            let uu = pixels.iter().map(|p| (f64::from(p.0) - mean_x).powi(2)).sum::<f64>();
            prop_assert!((cluster.moments.mean_x - mean_x).abs() < 1e-9);
            prop_assert!((cluster.moments.uu - uu).abs() < 1e-6);
        }
    }

    #[test]
    fn pixels_and_clusters_over_capacity_are_counted(events in any_events()) {
        type Tiny = Clusterer<f64, { row_bytes(70) }, { row_count(24) }, 12, 2>;
        let settings = ClusterSettings { min_pixels: 1, ..ClusterSettings::default() };
        let mut tiny = Box::new(Tiny::new());
        let mut roomy = Box::new(Small::new());
        let short = tiny.cluster(SENSOR, events.iter().copied(), &settings).unwrap();
        let full = roomy.cluster(SENSOR, events.iter().copied(), &settings).unwrap();
        let kept: u32 = [Polarity::Off, Polarity::On]
            .into_iter()
            .flat_map(|polarity| tiny.clusters(polarity))
            .map(|cluster| cluster.pixels)
            .sum();
        let all = full.core_pixels[0] + full.core_pixels[1] + full.border_pixels[0] + full.border_pixels[1];
        prop_assert_eq!(short.pixels, full.pixels);
        if short.clusters_over_capacity == 0 {
            prop_assert_eq!(kept + short.pixels_over_capacity, all);
        } else {
            prop_assert!(kept + short.pixels_over_capacity < all);
        }
        if short.pixels_over_capacity == 0 {
            prop_assert_eq!(
                short.clusters[0] + short.clusters[1] + short.clusters_over_capacity,
                full.clusters[0] + full.clusters[1]
            );
        }
    }
}

#[test]
fn a_border_pixel_joins_the_first_core_pixel_in_reading_order() {
    // Two full squares, and a pixel between them that is within ε of a corner of each, with too few
    // neighbours of its own.
    let square = |x: u16| (0..9).map(move |index| (x + index % 3, 10 + index / 3));
    let pixels: Vec<Pixel> = square(10).chain(square(16)).chain([(14, 11)]).collect();
    let settings = ClusterSettings { epsilon: 2.0, min_points: 4, min_pixels: 1 };
    let mut clusterer = Box::new(Small::new());
    let counts = clusterer.cluster(SENSOR, on(&pixels), &settings).unwrap();
    assert_eq!(counts.border_pixels, [0, 1]);
    let sizes: Vec<u32> = clusterer.clusters(Polarity::On).iter().map(|cluster| cluster.pixels).collect();
    assert_eq!(sizes, [10, 9], "both squares are two columns away; the left one comes first");
}

#[test]
fn pixels_of_both_polarities_are_dropped() {
    let line: Vec<Pixel> = (0..11).map(|x| (x, 5)).collect();
    let mut events = on(&line);
    events.push(event(5, 5, Polarity::Off));
    let settings = ClusterSettings { epsilon: 1.0, min_points: 2, min_pixels: 2 };
    let mut clusterer = Box::new(Small::new());
    let counts = clusterer.cluster(SENSOR, events, &settings).unwrap();
    assert_eq!((counts.both_polarities, counts.pixels), (1, [0, 10]));
    assert_eq!(counts.clusters, [0, 2], "the missing pixel splits the line");
}

#[test]
fn a_pixel_counts_once_whatever_its_number_of_events() {
    let settings = ClusterSettings { epsilon: 2.0, min_points: 3, min_pixels: 1 };
    let mut clusterer = Box::new(Small::new());
    let counts = clusterer.cluster(SENSOR, on(&[(3, 3); 50]), &settings).unwrap();
    assert_eq!((counts.events, counts.pixels, counts.clusters), (50, [0, 1], [0, 0]));
}

#[test]
fn events_outside_the_sensor_are_counted() {
    let mut clusterer = Box::new(Small::new());
    let events = [(70, 0), (0, 24), (u16::MAX, u16::MAX), (69, 23)];
    let counts = clusterer.cluster(SENSOR, on(&events), &ClusterSettings::default()).unwrap();
    assert_eq!((counts.events, counts.outside_sensor, counts.unique_pixels()), (4, 3, 1));
}

#[test]
fn a_sensor_that_does_not_fit_is_rejected() {
    let mut clusterer = Box::new(Small::new());
    let sensor = Sensor { width: 346, height: 260 };
    let error = clusterer.cluster(sensor, [], &ClusterSettings::default()).unwrap_err();
    assert_eq!(error.sensor, sensor);
    assert!(error.capacity.width >= 70 && error.capacity.height == 24);
}

#[test]
fn a_sensor_wider_than_32_words_is_clustered() {
    type Wide = Clusterer<f64, { row_bytes(1280) }, { row_count(8) }, 2000, 50>;
    let sensor = Sensor { width: 1280, height: 8 };
    let mut clusterer = Box::new(Wide::new());
    let settings = ClusterSettings { epsilon: 1.5, min_points: 2, min_pixels: 2 };
    let starts = [0_u16, 31, 62, 500, 1023, 1277];
    let pixels: Vec<Pixel> = starts.iter().flat_map(|&x| [(x, 4), (x + 1, 4), (x + 2, 3)]).collect();
    for _ in 0..2 {
        clusterer.cluster(sensor, on(&pixels), &settings).unwrap();
        let found: BTreeMap<u16, u32> =
            clusterer.clusters(Polarity::On).iter().map(|cluster| (cluster.min[0], cluster.pixels)).collect();
        assert_eq!(found, starts.iter().map(|&x| (x, 3)).collect());
    }
}

#[test]
fn full_bitmaps_are_cleared_for_the_next_window() {
    let mut clusterer = Box::new(Small::new());
    let everywhere = (0..SENSOR.height).flat_map(|y| (0..SENSOR.width).map(move |x| (x, y)));
    let all: Vec<Pixel> = everywhere.collect();
    let settings = ClusterSettings::default();
    clusterer.cluster(SENSOR, on(&all), &settings).unwrap();
    assert_eq!(clusterer.clusters(Polarity::On).len(), 1);
    assert_eq!(clusterer.clusters(Polarity::On)[0].pixels, 70 * 24);
    // A smaller sensor must clear the rows of the larger one too.
    let small = Sensor { width: 10, height: 10 };
    clusterer.cluster(small, [], &settings).unwrap();
    let counts = clusterer.cluster(SENSOR, [], &settings).unwrap();
    assert_eq!((counts.unique_pixels(), counts.clusters), (0, [0, 0]));
}
