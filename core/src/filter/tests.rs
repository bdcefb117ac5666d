//! Comparison with the rules in their simplest form, with unlimited memory.

use std::boxed::Box;
use std::collections::{HashMap, HashSet};
use std::vec::Vec;

use proptest::prelude::*;

use super::*;
use crate::event::Polarity;

const SENSOR: Sensor = Sensor { width: 23, height: 17 };

fn event(t: i64, x: u16, y: u16) -> Event {
    Event { t, x, y, polarity: Polarity::On }
}

/// Returns the time of the first event on the sensor, from which periods are counted.
fn origin(events: &[Event]) -> i64 {
    let inside = |event: &&Event| event.x < SENSOR.width && event.y < SENSOR.height;
    events.iter().find(inside).map_or(0, |event| event.t)
}

/// Compares every event with all earlier ones.
fn naive(events: &[Event], settings: &FilterSettings, cell: u16) -> Vec<EventFate> {
    let origin = origin(events);
    let period = |event: &Event| (event.t - origin) / i64::from(settings.hot_period_us);
    let units = |event: &Event, unit: i64| (event.t - origin) / unit;
    let mut counts: HashMap<(u16, u16, i64), u32> = HashMap::new();
    let mut last: HashMap<(u16, u16), i64> = HashMap::new();
    let mut neighbours: Vec<&Event> = Vec::new();
    let mut fates = Vec::new();
    for event in events {
        if event.x >= SENSOR.width || event.y >= SENSOR.height {
            fates.push(EventFate::Outside);
            continue;
        }
        let pixel = (event.x, event.y);
        *counts.entry((event.x, event.y, period(event))).or_default() += 1;
        let count = |period| counts.get(&(event.x, event.y, period)).copied().unwrap_or(0);
        let most = u32::from(settings.hot_events);
        let hot = most > 0 && (count(period(event)) > most || count(period(event) - 1) > most);
        let now = units(event, 16);
        let refractory = i64::from(settings.refractory_us.div_ceil(16));
        let soon = last.get(&pixel).is_some_and(|last| now - last < refractory);
        if hot || !soon {
            last.insert(pixel, now);
        }
        if hot || soon {
            fates.push(if hot { EventFate::Hot } else { EventFate::Refractory });
            continue;
        }
        let near = |other: &&&Event| {
            let along = |a: u16, b: u16, size: u16| {
                (a.saturating_sub(1)..=(a + 1).min(size - 1)).any(|pixel| pixel / cell == b / cell)
            };
            along(event.x, other.x, SENSOR.width)
                && along(event.y, other.y, SENSOR.height)
                && units(event, 64) - units(other, 64) < i64::from(settings.background_us / 64)
        };
        // The filter stores only the last event of a cell. Comparing with all events is the same, because the last one
        // is the youngest.
        let supported = settings.background_us == 0 || neighbours.iter().rev().any(|other| near(&other));
        neighbours.push(event);
        fates.push(if supported { EventFate::Keep } else { EventFate::Background });
    }
    fates
}

fn judge<const CELLS: usize, const SLOTS: usize>(
    events: &[Event],
    settings: FilterSettings,
) -> (Vec<EventFate>, FilterCounts, u16) {
    let mut storage = Box::new(FilterStorage::<CELLS, SLOTS>::new());
    let mut filter = EventFilter::new(SENSOR, settings, &mut storage).unwrap();
    let fates = events.iter().map(|event| filter.judge(event)).collect();
    (fates, *filter.counts(), filter.cell_size())
}

fn count(fates: &[EventFate], fate: EventFate) -> u32 {
    fates.iter().filter(|&&other| other == fate).count() as u32
}

prop_compose! {
    fn settings()(
        hot_events in 0_u16..6,
        hot_period_us in 500_u32..4000,
        refractory in 0_u32..500,
        background_us in prop_oneof![Just(0), 64_u32..3000],
    ) -> FilterSettings {
        FilterSettings { hot_events, hot_period_us, refractory_us: refractory, background_us }
    }
}

/// Events of the whole sensor, of one corner, and of one pixel, up to seconds apart but never so long that 16 bits wrap.
fn events() -> impl Strategy<Value = Vec<Event>> {
    let step = prop_oneof![20 => 0_i64..200, 1 => 0_i64..5000];
    let place = prop_oneof![(0_u16..24, 0_u16..18), (0_u16..4, 0_u16..4), Just((11, 5))];
    (any::<u32>(), prop::collection::vec((step, place), 0..400)).prop_map(|(start, parts)| {
        let mut t = i64::from(start);
        let event = |(step, (x, y))| {
            t += step;
            event(t, x, y)
        };
        parts.into_iter().map(event).collect()
    })
}

proptest! {
    /// Each of the 391 pixels has a slot of its own. The cells are one, two and eight pixels wide.
    #[test]
    fn with_room_for_every_pixel_the_filter_equals_the_rules(events in events(), settings in settings()) {
        for (fates, counts, cell) in [
            judge::<400, 512>(&events, settings),
            judge::<108, 512>(&events, settings),
            judge::<9, 512>(&events, settings),
        ] {
            prop_assert_eq!(&fates, &naive(&events, &settings, cell));
            prop_assert_eq!(counts.kept, count(&fates, EventFate::Keep));
            prop_assert_eq!(counts.outside, count(&fates, EventFate::Outside));
            prop_assert_eq!(counts.hot, count(&fates, EventFate::Hot));
            prop_assert_eq!(counts.refractory, count(&fates, EventFate::Refractory));
            prop_assert_eq!(counts.background, count(&fates, EventFate::Background));
        }
    }

    /// If many pixels share a slot, an event is dropped only because of earlier events of its own pixel.
    #[test]
    fn with_few_slots_no_event_is_dropped_without_reason(events in events(), settings in settings()) {
        let settings = FilterSettings { background_us: 0, ..settings };
        let (fates, ..) = judge::<1, 8>(&events, settings);
        let origin = origin(&events);
        for (index, (event, fate)) in events.iter().zip(&fates).enumerate() {
            let before = || events[..index].iter().zip(&fates).filter(|(other, _)| (other.x, other.y) == (event.x, event.y));
            match fate {
                EventFate::Hot => {
                    let period = |event: &Event| (event.t - origin) / i64::from(settings.hot_period_us);
                    let in_period = |wanted| before().filter(|(other, _)| period(other) == wanted).count();
                    let most = usize::from(settings.hot_events);
                    let period = period(event);
                    prop_assert!(in_period(period) >= most || in_period(period - 1) > most);
                }
                EventFate::Refractory => {
                    let mut kept = before().filter(|(_, fate)| matches!(fate, EventFate::Keep | EventFate::Hot));
                    prop_assert!(kept.any(|(other, _)| event.t - other.t < i64::from(settings.refractory_us) + 32));
                }
                _ => {}
            }
        }
    }

    #[test]
    fn arbitrary_times_do_not_panic(times in prop::collection::vec(any::<i64>(), 0..100), settings in settings()) {
        let events: Vec<Event> = times.iter().map(|&t| event(t, (t & 7) as u16, (t >> 3 & 7) as u16)).collect();
        prop_assert_eq!(judge::<32, 8>(&events, settings).0.len(), events.len());
    }
}

/// An edge on a noisy sensor with hot pixels: the filter keeps the edge and removes the noise.
#[test]
fn an_edge_passes_and_noise_is_dropped() {
    const WIDE: Sensor = Sensor { width: 346, height: 260 };
    let mut state = 1_u64;
    let mut random = |below: u64| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) % below
    };
    // Every 10 µs: an edge that moves at 300 px/s over 100 rows, with two events per pixel; noise of about 0.3 events
    // per second and pixel; five hot pixels of 1000 events per second each.
    let hot: [(u16, u16); 5] = [(3, 3), (300, 20), (180, 250), (42, 99), (200, 100)];
    let mut events = Vec::new();
    for step in 0..100_000_i64 {
        let t = step * 10;
        if step % 10 < 6 {
            let column = t * 300 / 1_000_000;
            events.push((event(t, column as u16, 80 + random(100) as u16), "edge"));
        }
        if random(100) < 27 {
            events.push((event(t, random(346) as u16, random(260) as u16), "noise"));
        }
        if step % 20 == 0 {
            let (x, y) = hot[(step / 20 % 5) as usize];
            events.push((event(t, x, y), "hot"));
        }
    }
    let mut storage = Box::new(FilterStorage::<5655, 1024>::new());
    let mut filter = EventFilter::new(WIDE, FilterSettings::default(), &mut storage).unwrap();
    assert_eq!(filter.cell_size(), 4);
    let mut kept: HashMap<&str, (u32, u32)> = HashMap::new();
    let mut hot_dropped = HashSet::new();
    for (event, kind) in &events {
        let fate = filter.judge(event);
        let (all, passed) = kept.entry(kind).or_default();
        *all += 1;
        *passed += u32::from(fate == EventFate::Keep);
        if fate == EventFate::Hot {
            hot_dropped.insert((event.x, event.y));
        }
    }
    let share = |kind| f64::from(kept[kind].1) / f64::from(kept[kind].0);
    assert!(share("edge") > 0.97, "{kept:?}");
    assert!(share("noise") < 0.1, "{kept:?}");
    assert!(share("hot") < 0.05, "{kept:?}");
    assert_eq!(hot_dropped, hot.into_iter().collect());
}

#[test]
fn too_small_storage_is_rejected() {
    let large = Sensor { width: 32_767, height: 32_767 };
    let all = FilterSettings::default();
    let refused = |settings| {
        let mut storage = FilterStorage::<100, 8>::new();
        EventFilter::new(large, settings, &mut storage).err()
    };
    assert_eq!(refused(all), Some(StorageTooSmall::Slots));
    assert_eq!(refused(FilterSettings { hot_events: 0, ..all }), Some(StorageTooSmall::Cells));
    assert_eq!(refused(FilterSettings { hot_events: 0, background_us: 0, ..all }), None);
}

#[test]
fn the_storage_is_as_small_as_documented() {
    assert_eq!(size_of::<FilterStorage<5655, 1024>>(), 2 * 5655 + 2 + 8 * 1024 - 2);
}
