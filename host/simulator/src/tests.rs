//! The whole simulator, compared with the expected geometry and rates.

use std::collections::BTreeMap;

use evcal_core::camera::{Camera, ModelKind};
use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;
use nalgebra::{Isometry3, Vector2};

use super::clock::Interval;
use super::dots::Dots;
use super::motion::MotionSettings;
use super::rays::Rays;
use super::row::Stepping;
use super::scene::SceneSettings;
use super::sensor::{Arbiter, SensorModel};
use super::{EventCounts, Simulation, SimulationError, SimulationSettings};
use evcal_geometry::board::Board;
use evcal_geometry::board::squares::raster::Raster;

pub fn radtan() -> Camera<f64> {
    let parameters = [331.6, 331.1, 176.9, 134.2, -0.352, 0.149, -0.0004, 0.0005, -0.03];
    Camera::from_parameters(ModelKind::Radtan, &parameters).unwrap()
}

pub fn kannala_brandt() -> Camera<f64> {
    let parameters = [196.4, 196.0, 169.3, 126.1, -0.018, 0.006, -0.003, 0.0006];
    Camera::from_parameters(ModelKind::KannalaBrandt, &parameters).unwrap()
}

pub fn board() -> Board {
    "acircles:9x4:55mm:r17.5mm".parse().unwrap()
}

fn settings(sensor: SensorModel, motion: MotionSettings, duration: f64) -> SimulationSettings {
    SimulationSettings { duration, seed: 3, scene: SceneSettings::default(), sensor, motion }
}

fn simulation(sensor: SensorModel, motion: MotionSettings, duration: f64) -> Simulation {
    simulation_of(board(), sensor, motion, duration)
}

fn simulation_of(board: Board, sensor: SensorModel, motion: MotionSettings, duration: f64) -> Simulation {
    let rays = Rays::new(&radtan(), Sensor::new(346, 260));
    Simulation::new(rays, board, settings(sensor, motion, duration)).unwrap()
}

/// Returns all events in their order, and their number according to the simulation.
fn run(simulation: &Simulation) -> (Vec<Event>, EventCounts) {
    let mut events = Vec::new();
    let mut calls = 0;
    let counts = simulation
        .run(|batch| {
            calls += 1;
            events.extend_from_slice(batch);
            Ok::<(), ()>(())
        })
        .unwrap();
    assert_eq!(calls, simulation.slice_count());
    (events, counts)
}

fn by_pixel(events: &[Event]) -> BTreeMap<(u16, u16), Vec<Event>> {
    let mut pixels: BTreeMap<(u16, u16), Vec<Event>> = BTreeMap::new();
    for event in events {
        pixels.entry((event.x, event.y)).or_default().push(*event);
    }
    pixels
}

/// Returns the distance of a point on the board from the rim of the nearest circle in metres, positive inside; `None`
/// if it is farther than 1.4 radii from any centre.
fn circle_depth(point: &Vector2<f64>) -> Option<f64> {
    let board = board();
    let distances = (0..board.point_count()).map(|index| (board.point(index) - point).norm());
    let depth = board.print_radius() - distances.fold(f64::INFINITY, f64::min);
    (depth > -0.4 * board.print_radius()).then_some(depth)
}

/// Returns the distance of a point on the board from the nearest edge of a raster in metres, positive in the dark;
/// `None` within 8 mm of a corner and farther than 8 mm from any edge.
fn square_depth(raster: &Raster, point: &Vector2<f64>) -> Option<f64> {
    const NEAR: f64 = 0.008;
    let nearest = |lines: &[f64], place: f64| {
        let is_on_board = place > lines[0] - NEAR && place < lines[lines.len() - 1] + NEAR;
        let distance = lines.iter().map(|line| (line - place).abs()).fold(f64::INFINITY, f64::min);
        is_on_board.then_some(distance)
    };
    let (x, y) = (nearest(raster.x_lines(), point.x)?, nearest(raster.y_lines(), point.y)?);
    let depth = x.min(y);
    let is_alone = depth < NEAR && x.max(y) > NEAR;
    is_alone.then(|| if raster.is_dark_at([point.x, point.y]) { depth } else { -depth })
}

/// Returns the signed distance in pixels from the nearest edge of the print, computed from the camera, the pose and the
/// `depth` of a point of the board.
fn edge_distance(
    camera: &Camera<f64>,
    pose: &Isometry3<f64>,
    depth: impl Fn(&Vector2<f64>) -> Option<f64>,
    pixel: Vector2<f64>,
) -> Option<f64> {
    let depth = |pixel: Vector2<f64>| {
        let direction = pose.rotation * camera.unproject(&pixel)?;
        let origin = pose.translation.vector;
        depth(&(origin - direction * (origin.z / direction.z)).xy())
    };
    let here = depth(pixel)?;
    let (right, down) = (Vector2::new(0.01, 0.0), Vector2::new(0.0, 0.01));
    let gradient =
        Vector2::new(depth(pixel + right)? - depth(pixel - right)?, depth(pixel + down)? - depth(pixel - down)?) / 0.02;
    Some(here / gradient.norm())
}

/// Returns the position at which the log intensity of a pixel that crosses a straight rim between white and black has
/// this value, in pixels from the rim, positive inside.
fn distance_at(log_intensity: f64, point_spread: f64) -> f64 {
    let black = SceneSettings::default().black;
    let black_share = (1.0 - log_intensity.exp()) / (1.0 - black);
    // Inverts the normal distribution by bisection.
    let (mut low, mut high) = (-8.0, 8.0);
    for _ in 0..60 {
        let middle: f64 = 0.5 * (low + high);
        if 0.5 * libm::erfc(-middle / std::f64::consts::SQRT_2) < black_share { low = middle } else { high = middle }
    }
    low * point_spread
}

/// An event at the rim of a circle or the edge of a square.
struct RimEvent {
    polarity: Polarity,
    /// Distance from the rim in pixels, positive in the dark.
    distance: f64,
    /// Position at which an ideal pixel that was in plain light at the start emits this event, in pixels from a
    /// straight rim.
    expected: f64,
    /// `true` if the pixel moves into the dark.
    inwards: bool,
}

/// Returns the rim events of every `step`-th pixel with events, if the pixel sees plain light at the start. `depth`
/// returns the distance of a point of the board from the edge, positive in the dark.
fn rim_events(
    simulation: &Simulation,
    events: &[Event],
    step: usize,
    depth: impl Fn(&Vector2<f64>) -> Option<f64>,
) -> Vec<RimEvent> {
    let camera = radtan();
    let sensor = &simulation.settings().sensor;
    let SceneSettings { white, black, background, .. } = *simulation.scene().settings();
    let view = super::View::new(&simulation.pose(0.0));
    let mut rim_events = Vec::new();
    for ((x, y), events) in by_pixel(events).into_iter().step_by(step) {
        let start = simulation.scene().sample(&view, simulation.rays().get(x, y).unwrap()).radiance;
        if ![white, black, background].contains(&start) {
            continue;
        }
        let mut memory = start.ln();
        for event in events {
            memory += match event.polarity {
                Polarity::Off => -sensor.threshold_off,
                Polarity::On => sensor.threshold_on,
            };
            let t = event.t as f64 * 1e-6;
            let pixel = Vector2::new(f64::from(x), f64::from(y));
            let at = |t: f64| edge_distance(&camera, &simulation.pose(t), &depth, pixel);
            if let (Some(distance), Some(before), Some(after)) = (at(t), at(t - 1e-4), at(t + 1e-4)) {
                let expected = distance_at(memory, sensor.point_spread);
                rim_events.push(RimEvent { polarity: event.polarity, distance, expected, inwards: after > before });
            }
        }
    }
    assert!(rim_events.len() > 1000);
    rim_events
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    sum / count
}

#[test]
fn events_of_an_ideal_sensor_are_at_crossings_of_log_thresholds() {
    let simulation = simulation(SensorModel::ideal(), MotionSettings::fast(), 0.3);
    let (events, _) = run(&simulation);
    let rim = rim_events(&simulation, &events, 41, circle_depth);
    for polarity in [Polarity::Off, Polarity::On] {
        let of_polarity = || rim.iter().filter(|event| event.polarity == polarity);
        let error = mean(of_polarity().map(|event| event.distance - event.expected));
        let rms = mean(of_polarity().map(|event| (event.distance - event.expected - error).powi(2))).sqrt();
        let inside = mean(of_polarity().map(|event| event.distance));
        println!("{polarity:?}: {inside:.4} px inside the rim; off by {error:.4} px, scatter {rms:.4} px");
        // The rims' curvature adds σ²/2ρ: 0.023 px for a radius of 7.7 px.
        assert!((error - 0.023).abs() < 0.005, "{polarity:?}: {error}");
        assert!(rms < 0.015, "{polarity:?}: {rms}");
        assert!(inside > 0.1 && inside < 0.6, "{polarity:?}: {inside}");
        // OFF at the leading edge of a circle, ON at its trailing edge.
        let right = of_polarity().filter(|event| event.inwards == (polarity == Polarity::Off)).count();
        assert!(right as f64 > 0.998 * of_polarity().count() as f64);
    }
}

#[test]
fn events_of_a_checkerboard_happen_when_its_edges_pass() {
    let board: Board = "checkerboard:5x7:60mm".parse().unwrap();
    let Board::Squares(squares) = board else { panic!("{board}") };
    let raster = squares.raster();
    let simulation = simulation_of(board, SensorModel::ideal(), MotionSettings::fast(), 0.3);
    let (events, _) = run(&simulation);
    let edges = rim_events(&simulation, &events, 41, |point| square_depth(&raster, point));
    for polarity in [Polarity::Off, Polarity::On] {
        let of_polarity = || edges.iter().filter(|event| event.polarity == polarity);
        let error = mean(of_polarity().map(|event| event.distance - event.expected));
        let rms = mean(of_polarity().map(|event| (event.distance - event.expected - error).powi(2))).sqrt();
        println!("{polarity:?}: off by {error:.4} px, scatter {rms:.4} px");
        assert!(error.abs() < 0.005 && rms < 0.015, "{polarity:?}: {error} {rms}");
        let right = of_polarity().filter(|event| event.inwards == (polarity == Polarity::Off)).count();
        assert!(right as f64 > 0.998 * of_polarity().count() as f64);
    }
}

#[test]
fn slow_pixels_fire_after_the_edge_has_passed() {
    let ideal = simulation(SensorModel::ideal(), MotionSettings::fast(), 0.15);
    let mut sensor = quiet(SensorModel::default());
    (sensor.threshold_on, sensor.threshold_off, sensor.refractory) = (0.4, 0.43, 0.0);
    (sensor.threshold_mismatch, sensor.vignette, sensor.dark) = (0.0, 0.0, 0.0);
    let delayed = simulation(sensor, MotionSettings::fast(), 0.15);
    let inside = |simulation: &Simulation| {
        let rim = rim_events(simulation, &run(simulation).0, 41, circle_depth);
        [Polarity::Off, Polarity::On]
            .map(|polarity| mean(rim.iter().filter(|event| event.polarity == polarity).map(|event| event.distance)))
    };
    let ([off, on], [late_off, late_on]) = (inside(&ideal), inside(&delayed));
    // A pixel that moves into a circle is further inside if it fires late.
    let (lag_off, lag_on) = (late_off - off, on - late_on);
    println!("lag: OFF {lag_off:.3} px, ON {lag_on:.3} px at 350 px/s");
    // The time constant is 80 µs at white and 490 µs at black; OFF events occur in darker light.
    assert!(lag_off > lag_on && lag_off < 0.17, "{lag_off}");
    assert!(lag_on > 0.01, "{lag_on}");
}

#[test]
fn an_ideal_pixel_fires_contrast_over_threshold_times() {
    let simulation = simulation(SensorModel::ideal(), MotionSettings::fast(), 0.3);
    let (events, _) = run(&simulation);
    let pixels = by_pixel(&events);
    let SceneSettings { white, black, .. } = SceneSettings::default();
    let expected = ((white / black).ln() / 0.43).floor() as usize;
    let mut passed = 0;
    let views: Vec<_> = (0..300).map(|ms| super::View::new(&simulation.pose(f64::from(ms) * 1e-3))).collect();
    for (y, x) in (0..260).step_by(3).flat_map(|y| (0..346).step_by(3).map(move |x| (y, x))) {
        let ray = simulation.rays().get(x, y).unwrap();
        let light: Vec<f64> = views.iter().map(|view| simulation.scene().sample(view, ray).radiance).collect();
        // Pixels that start in plain white and change monotonically to plain black.
        let Some(end) = light.iter().position(|light| *light <= black) else { continue };
        if light[0] < white || light[..=end].windows(2).any(|pair| pair[1] > pair[0]) {
            continue;
        }
        let fired: Vec<Polarity> = pixels
            .get(&(x, y))
            .into_iter()
            .flatten()
            .take_while(|event| event.t <= end as i64 * 1000)
            .map(|event| event.polarity)
            .collect();
        assert_eq!(fired, vec![Polarity::Off; expected], "pixel ({x}, {y})");
        passed += 1;
    }
    assert!(passed > 100, "{passed}");
}

fn quiet(sensor: SensorModel) -> SensorModel {
    SensorModel { noise_rate: 0.0, leak_rate: 0.0, hot_pixels: 0, threshold_jitter: 0.0, arbiter: None, ..sensor }
}

#[test]
fn without_motion_there_is_only_noise_at_its_rate() {
    let still = MotionSettings { pauses: vec![Interval { start: -1.0, end: 100.0 }], ..MotionSettings::fast() };
    let (_, counts) = run(&simulation(quiet(SensorModel::default()), still.clone(), 1.0));
    assert_eq!(counts, EventCounts::default());

    for sensor in [SensorModel::default(), SensorModel::low_light()] {
        let duration = 1.0;
        let pixels = 346.0 * 260.0 * duration;
        let (noise, leak) = (sensor.noise_rate, sensor.leak_rate);
        let sensor = SensorModel { hot_pixels: 0, ..sensor };
        let (_, counts) = run(&simulation(sensor.clone(), still.clone(), duration));
        // Poisson noise, and a noise level that varies from pixel to pixel by 36 %.
        let tolerance = |expected: f64| 5.0 * (expected + 0.13 * expected * noise * duration).sqrt();
        let off = 0.5 * noise * pixels;
        let on = off + leak * pixels;
        assert!((counts.off as f64 - off).abs() < tolerance(off), "{} and {off}", counts.off);
        assert!((counts.on as f64 - on).abs() < tolerance(on), "{} and {on}", counts.on);

        let hot = SensorModel { hot_pixels: 40, hot_rate: [200.0, 200.0], ..sensor };
        let (_, with_hot) = run(&simulation(hot, still.clone(), duration));
        let more = (with_hot.off + with_hot.on) as f64 - (counts.off + counts.on) as f64;
        let expected = 40.0 * 200.0 * duration;
        assert!((more - expected).abs() < 0.1 * expected, "{more} and {expected}");
    }
}

#[test]
fn a_pause_is_silent() {
    let motion = MotionSettings { pauses: vec![Interval { start: 0.3, end: 0.6 }], ..MotionSettings::fast() };
    let (events, _) = run(&simulation(quiet(SensorModel::default()), motion, 0.9));
    // The slowest photoreceptor has settled after 5 ms.
    let within = |from: i64, to: i64| events.iter().filter(|event| event.t >= from && event.t < to).count();
    assert_eq!(within(305_000, 600_000), 0);
    assert!(within(0, 100_000) > 10_000 && within(800_000, 900_000) > 10_000);
}

#[test]
fn the_number_of_threads_does_not_matter_and_the_seed_does() {
    let events = |threads: usize, seed: u64| {
        let rays = Rays::new(&radtan(), Sensor::new(346, 260));
        let settings = SimulationSettings { seed, ..settings(SensorModel::default(), MotionSettings::blur(), 0.1) };
        let simulation = Simulation::new(rays, board(), settings).unwrap();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run(&simulation).0)
    };
    let one = events(1, 5);
    assert!(one.len() > 50_000);
    assert!(one == events(3, 5));
    assert!(one != events(1, 6));
}

#[test]
fn events_are_in_the_order_of_time_and_the_bus_limits_their_rate() {
    let (events, _) = run(&simulation(quiet(SensorModel::default()), MotionSettings::fast(), 0.1));
    assert!(events.is_sorted_by_key(|event| (event.t, event.y, event.x)));

    let arbiter = Arbiter { latency: 10e-6, jitter: 30e-6, event_time: 1e-6, row_time: 0.0 };
    let slow_bus = SensorModel { arbiter: Some(arbiter), ..quiet(SensorModel::default()) };
    let (delayed, _) = run(&simulation(slow_bus, MotionSettings::fast(), 0.1));
    assert_eq!(delayed.len(), events.len());
    assert!(delayed.is_sorted_by_key(|event| event.t));
    assert!(delayed.windows(2).all(|pair| pair[1].t > pair[0].t));
    let mean = |events: &[Event]| events.iter().map(|event| event.t as f64).sum::<f64>() / events.len() as f64;
    assert!(mean(&delayed) - mean(&events) > 30.0);
}

#[test]
fn events_of_a_scanned_sensor_have_the_times_of_its_scans() {
    let (events, _) = run(&simulation(quiet(SensorModel::default()), MotionSettings::fast(), 0.1));
    let scanned = SensorModel { scan: Some(200e-6), ..quiet(SensorModel::default()) };
    let (scanned, _) = run(&simulation(scanned, MotionSettings::fast(), 0.1));
    assert!(scanned.is_sorted_by_key(|event| event.t));
    let key = |event: &Event| (event.t, event.y, event.x);
    let mut expected: Vec<Event> =
        events.iter().map(|event| Event { t: (event.t + 199) / 200 * 200, ..*event }).collect();
    let mut seen = scanned;
    expected.sort_by_key(key);
    seen.sort_by_key(key);
    assert!(expected.len() > 10_000);
    assert_eq!(seen.iter().map(key).collect::<Vec<_>>(), expected.iter().map(key).collect::<Vec<_>>());
}

#[test]
fn coarse_and_fine_sampling_give_the_same_events() {
    let tags: Board = "aprilgrid:6x6:88mm:0.3".parse().unwrap();
    for (board, sensor, name) in [
        (board(), SensorModel::ideal(), "ideal"),
        (board(), quiet(SensorModel::default()), "default"),
        (tags, SensorModel::ideal(), "tags"),
    ] {
        let mut simulation = simulation_of(board, sensor, MotionSettings::fast(), 0.05);
        let few = by_pixel(&run(&simulation).0);
        simulation.stage.stepping = Stepping { step: 0.01, far_step: 0.0, longest_step: 1, longest_skip: 1 };
        let all = by_pixel(&run(&simulation).0);
        let (mut same, mut sum, mut square, mut count) = (0usize, 0.0, 0.0, 0.0);
        for (pixel, exact) in &all {
            let coarse = few.get(pixel).map(Vec::as_slice).unwrap_or_default();
            if coarse.len() == exact.len() {
                same += 1;
                for (a, b) in exact.iter().zip(coarse) {
                    let pixels = (b.t - a.t) as f64 * 1e-6 * 350.0;
                    sum += pixels;
                    square += pixels * pixels;
                    count += 1.0;
                }
            }
        }
        let share = same as f64 / all.len() as f64;
        let (mean, rms) = (sum / count, (square / count).sqrt());
        println!("{name}: {share:.4} of the pixels fire as often, mean {mean:.5} px, rms {rms:.5} px");
        assert!(share > 0.985, "{share}");
        assert!(mean.abs() < 0.005 && rms < 0.05, "{mean} {rms}");
    }
}

#[test]
fn the_truth_is_a_camera_file_and_survives_a_round_trip() {
    let simulation = simulation(SensorModel::default(), MotionSettings::fast(), 0.1);
    let (_, counts) = run(&simulation);
    let truth = super::truth::Truth::new(&radtan(), &simulation, counts);
    let text = serde_json::to_string_pretty(&truth).unwrap();
    assert_eq!(serde_json::from_str::<super::truth::Truth>(&text).unwrap(), truth);
    let file: evcal_geometry::lens::camera_file::CameraFile = serde_json::from_str(&text).unwrap();
    assert_eq!(file.camera.camera().unwrap().parameters(), radtan().parameters());
    assert_eq!(truth.board.parse::<Board>().unwrap(), board());
    let trajectory = simulation.trajectory(1000.0);
    assert_eq!(trajectory.len(), 101);
    assert_eq!(trajectory[50].pose, simulation.pose(trajectory[50].t));
}

#[test]
fn a_wrong_setting_is_named() {
    let refused = |change: fn(&mut SimulationSettings)| {
        let mut settings = settings(SensorModel::default(), MotionSettings::fast(), 1.0);
        change(&mut settings);
        Simulation::new(Rays::new(&radtan(), Sensor::new(346, 260)), board(), settings).unwrap_err().to_string()
    };
    assert!(refused(|settings| settings.duration = f64::NAN).contains("duration is NaN"));
    assert!(refused(|settings| settings.sensor.threshold_on = 0.0).contains("sensor.threshold_on is 0"));
    assert!(refused(|settings| settings.motion.tilt = 90.0).contains("motion.tilt is 90; it must be at least 0"));
    assert!(refused(|settings| settings.scene.black = 0.0).contains("scene.black is 0; it must be above 0"));
    let squares = Simulation::new(
        Rays::new(&radtan(), Sensor::new(346, 260)),
        "checkerboard:6x9:25mm".parse().unwrap(),
        SimulationSettings {
            scene: SceneSettings { dots: Dots::Rings, ..SceneSettings::default() },
            ..settings(SensorModel::default(), MotionSettings::fast(), 1.0)
        },
    );
    assert_eq!(squares.unwrap_err(), SimulationError::NoDots("rings"));
    let backwards = refused(|settings| settings.motion.pauses.push(Interval { start: 2.0, end: 1.0 }));
    assert!(backwards.contains("motion.pauses"));
    let nothing = Simulation::new(
        Rays::new(&radtan(), Sensor::new(0, 0)),
        board(),
        settings(SensorModel::default(), MotionSettings::fast(), 1.0),
    );
    assert_eq!(nothing.unwrap_err(), SimulationError::NoFieldOfView);
}
