use super::*;
use crate::event::{Event, Polarity};
use proptest::prelude::*;
use std::vec::Vec;

const NOTHING: Outcome = Outcome::NotFound { unique_pixels: 0 };

fn settings() -> WindowSettings {
    WindowSettings { step: 500, min_interval: 3, max_interval: 9, gap: 5, most_events: 1000, fewest_events: 0 }
}

/// Returns the windows that the planner tries over `events`, with outcomes from `judge`.
fn planned(
    settings: WindowSettings,
    events: &[Event],
    end_us: i64,
    judge: impl Fn(i64, &[Event]) -> Outcome,
) -> Vec<(i64, i64, Vec<Event>)> {
    let mut planner = WindowPlanner::new(settings, 0, end_us);
    let mut tried = Vec::new();
    while let Some(window) = planner.next(events) {
        let inside = &events[window.first..window.last];
        tried.push((window.start_us, window.end_us, inside.to_vec()));
        planner.report(judge(window.end_us, inside));
    }
    tried
}

/// Returns the windows that the buffer tries, one event after the other.
fn buffered(
    settings: WindowSettings,
    events: &[Event],
    judge: impl Fn(i64, &[Event]) -> Outcome,
) -> Vec<(i64, i64, Vec<Event>)> {
    let mut storage = EventStorage::<512>::new();
    let mut windows = WindowBuffer::new(settings, 0, &mut storage);
    let mut tried = Vec::new();
    for &event in events {
        let mut progress = windows.push(event);
        while progress == Progress::Complete {
            let inside: Vec<Event> = windows.events().collect();
            let window = windows.window();
            assert_eq!(window.len(), inside.len());
            tried.push((window.start_us, window.end_us, inside.clone()));
            progress = windows.report(judge(window.end_us, &inside));
        }
    }
    assert_eq!(windows.counts().overflow, 0);
    tried
}

fn event(t: i64) -> Event {
    Event {
        t,
        x: (t % 346) as u16,
        y: (t % 260) as u16,
        polarity: if t % 2 == 0 { Polarity::On } else { Polarity::Off },
    }
}

#[test]
fn lengths_grow_from_minimum_to_maximum_then_the_start_advances() {
    let events: Vec<Event> = (0..200).map(|i| event(i * 50)).collect();
    let tried = planned(settings(), &events, 6000, |_, _| NOTHING);
    let lengths: Vec<(i64, i64)> = tried.iter().take(9).map(|w| (w.0, (w.1 - w.0) / 500)).collect();
    let expected: Vec<(i64, i64)> = (3..=9).map(|n| (0, n)).chain([(2250, 3), (2250, 4)]).collect();
    assert_eq!(lengths, expected);
}

#[test]
fn after_a_failure_the_start_advances_by_half_the_length() {
    let mut state = WindowState::new(settings(), 100);
    for _ in 3..=9 {
        assert_eq!(state.start_us(), 100);
        state.report(NOTHING);
    }
    assert_eq!((state.start_us(), state.length()), (100 + 9 * 500 / 2, 3));
}

#[test]
fn success_leaves_a_gap() {
    let mut state = WindowState::new(settings(), 0);
    state.report(NOTHING);
    assert_eq!(state.end_us(), 2000);
    state.report(Outcome::Found);
    assert_eq!((state.start_us(), state.end_us()), (2000 + 2500, 2000 + 2500 + 1500));
}

#[test]
fn a_window_at_the_cap_does_not_grow() {
    let mut state = WindowState::new(settings(), 0);
    state.report(Outcome::NotFound { unique_pixels: 999 });
    assert_eq!((state.start_us(), state.length()), (0, 4));
    state.report(Outcome::NotFound { unique_pixels: 1000 });
    assert_eq!((state.start_us(), state.length()), (1000, 3));
}

#[test]
fn degenerate_settings_still_advance_the_window() {
    let zero = WindowSettings { step: 0, min_interval: 0, max_interval: 0, gap: 0, most_events: 0, fewest_events: 0 };
    let events: Vec<Event> = (0..40).map(event).collect();
    let tried = planned(zero, &events, 39, |_, _| NOTHING);
    assert_eq!(tried.len(), 39);
    assert_eq!(tried, buffered(zero, &events, |_, _| NOTHING));

    let last = [Event { t: i64::MAX, ..event(0) }];
    assert!(planned(settings(), &last, i64::MAX, |_, _| NOTHING).len() <= 1);
}

#[test]
fn silence_is_skipped() {
    let events: Vec<Event> =
        (0..100).map(|i| event(i * 10)).chain((0..400).map(|i| event(60_000_000 + i * 10))).collect();
    let tried = planned(settings(), &events, i64::MAX, |_, _| NOTHING);
    // One start for the burst of 1 ms, two of 2.25 ms for the burst of 4 ms, each with seven lengths.
    assert_eq!(tried.len(), (1 + 2) * 7);
    assert!(tried.iter().any(|window| window.0 == 60_000_000));
}

#[test]
fn windows_with_too_few_events_are_skipped_and_counted() {
    let events: Vec<Event> = (0..100).map(|i| event(i * 100)).collect();
    let mut planner = WindowPlanner::new(WindowSettings { fewest_events: 30, ..settings() }, 0, 10_000);
    let window = planner.next(&events).unwrap();
    assert_eq!((window.start_us, window.end_us, window.len()), (0, 3000, 30));
    assert_eq!(planner.too_few_events(), 3);
}

#[test]
fn a_window_that_fills_the_storage_ends_there() {
    let mut storage = EventStorage::<8>::new();
    let mut windows = WindowBuffer::new(settings(), 0, &mut storage);
    for t in 0..8 {
        assert_eq!(windows.push(event(t * 10)), Progress::Collecting);
    }
    assert_eq!(windows.push(event(90)), Progress::Complete);
    assert_eq!(windows.window(), Window { start_us: 0, end_us: 90, first: 0, last: 8 });
    assert_eq!(windows.events().collect::<Vec<_>>(), (0..8).map(|t| event(t * 10)).collect::<Vec<_>>());
    windows.push(event(91));
    assert_eq!(windows.counts().overflow, 1, "an unreported window takes no event");
    // The next start is half a window later, so all stored events lie before it.
    assert_eq!(windows.report(NOTHING), Progress::Collecting);
    assert_eq!((windows.window().start_us, windows.window().len()), (750, 0));
    assert_eq!((windows.counts().full, windows.counts().before_start), (1, 1));
}

#[test]
fn no_event_is_lost_to_a_full_storage_when_every_window_is_reported() {
    let mut storage = EventStorage::<8>::new();
    let mut windows = WindowBuffer::new(WindowSettings { gap: 0, ..settings() }, 0, &mut storage);
    let mut seen = 0;
    for t in 0..4000 {
        let mut progress = windows.push(event(t * 7));
        while progress == Progress::Complete {
            let window = windows.window();
            assert!(windows.events().all(|event| (window.start_us..window.end_us).contains(&event.t)));
            seen += windows.events().count() as u32;
            progress = windows.report(Outcome::Found);
        }
    }
    let counts = windows.counts();
    assert_eq!((counts.overflow, seen + counts.before_start + windows.window().len() as u32), (0, 4000));
    assert!(counts.full > 0);
}

#[test]
fn a_restart_discards_all_earlier_events() {
    let mut storage = EventStorage::<8>::new();
    let mut windows = WindowBuffer::new(settings(), 0, &mut storage);
    for t in [10, 20, 30] {
        windows.push(event(t));
    }
    windows.restart(1200);
    assert_eq!(windows.push(event(1300)), Progress::Collecting);
    assert_eq!(windows.push(event(5000)), Progress::Complete);
    assert_eq!(windows.window(), Window { start_us: 1200, end_us: 2700, first: 0, last: 1 });
    assert_eq!(windows.counts().forgotten, 3);
}

#[test]
fn events_that_step_back_in_time_are_counted() {
    let mut storage = EventStorage::<8>::new();
    let mut windows = WindowBuffer::new(settings(), 0, &mut storage);
    for t in [10, 30, 20] {
        windows.push(event(t));
    }
    windows.push(event(5000));
    assert_eq!(windows.counts().out_of_order, 1);
    assert_eq!(windows.events().map(|event| event.t).collect::<Vec<_>>(), [10, 30, 30]);
}

proptest! {
    #[test]
    fn planner_and_buffer_try_the_same_windows(
        gaps in prop::collection::vec(prop_oneof![20 => 0_i64..40, 1 => 0_i64..20_000], 1..400),
        offset in prop_oneof![Just(0_i64), Just(u32::MAX as i64 - 3000)],
        min_interval in 1_u16..4,
        growth in 0_u16..6,
        gap in 0_u16..7,
        fewest_events in 0_u32..40,
        most_events in 20_u32..200,
        luck in 1_i64..9,
    ) {
        let mut t = offset;
        let events: Vec<Event> = gaps.iter().map(|gap| { t += gap; event(t) }).collect();
        let max_interval = min_interval + growth;
        let settings = WindowSettings { step: 100, min_interval, max_interval, gap, most_events, fewest_events };
        let judge = |end_us: i64, inside: &[Event]| {
            if (end_us / 100) % 9 < luck / 2 { Outcome::Found } else { Outcome::NotFound { unique_pixels: inside.len() as u32 } }
        };
        prop_assert_eq!(planned(settings, &events, t, judge), buffered(settings, &events, judge));
    }
}
