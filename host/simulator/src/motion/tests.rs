use nalgebra::Point3;

use evcal_core::sensor::Sensor;

use super::*;
use crate::clock::Interval;
use crate::tests::{board, kannala_brandt, radtan};

const SIZE: Sensor = Sensor::new(346, 260);

fn presets() -> [(MotionSettings, f64); 3] {
    [(MotionSettings::slow(), 150.0), (MotionSettings::fast(), 350.0), (MotionSettings::blur(), 700.0)]
}

#[test]
fn presets_keep_their_speed_and_the_board_in_view() {
    let board = board();
    for (camera, nearest, farthest) in [(radtan(), 0.5, 1.1), (kannala_brandt(), 0.25, 0.6)] {
        let rays = Rays::new(&camera, SIZE);
        for (settings, speed) in presets() {
            let duration = 10.0;
            let motion = Motion::new(&settings, &board, &rays, duration, 4).unwrap();
            let mean = motion.mean_speed(&board, &rays, duration);
            assert!((mean - speed).abs() < 0.02 * speed, "{mean} px/s, not {speed}");
            let (mut seen, mut all) = (0, 0);
            let mut cells = [false; 48];
            let mut steepest = 0.0f64;
            for step in 0..1000 {
                let pose = motion.pose(f64::from(step) * 0.01);
                steepest = steepest.max((pose.rotation * Vector3::z()).z.acos().to_degrees());
                let distance = (pose.translation.vector - motion.middle).norm();
                assert!((nearest..farthest).contains(&distance), "{distance} m");
                assert!(pose.translation.z < 0.0);
                for index in 0..board.point_count() {
                    let center = board.point(index);
                    let point = pose.inverse() * Point3::new(center.x, center.y, 0.0);
                    all += 1;
                    let pixel = camera.project(&point.coords).filter(|pixel| {
                        (0.0..346.0).contains(&pixel.x) && (0.0..260.0).contains(&pixel.y) && point.z > 0.0
                    });
                    if let Some(pixel) = pixel {
                        seen += 1;
                        cells[(pixel.y / 260.0 * 6.0) as usize * 8 + (pixel.x / 346.0 * 8.0) as usize] = true;
                    }
                }
            }
            assert!(f64::from(seen) > 0.85 * f64::from(all), "{seen} of {all} circles in view");
            assert!(cells.iter().filter(|cell| **cell).count() >= 46, "{cells:?}");
            println!("{speed} px/s: {seen} of {all} circles, steepest line of sight {steepest:.0} deg");
        }
    }
}

#[test]
fn the_tilt_stays_within_its_limit() {
    let board = board();
    let rays = Rays::new(&radtan(), SIZE);
    let settings = MotionSettings { tremor: 0.0, ..MotionSettings::fast() };
    let motion = Motion::new(&settings, &board, &rays, 20.0, 9).unwrap();
    let angles = (0..2000).map(|step| {
        let pose = motion.pose(f64::from(step) * 0.01);
        // The tilt is measured from the line of sight to the middle of the board.
        let sight = (motion.middle - pose.translation.vector).normalize();
        sight.z.acos().to_degrees()
    });
    let steepest = angles.fold(0.0, f64::max);
    assert!(steepest < 45.0 && steepest > 30.0, "{steepest}");
}

#[test]
fn the_camera_rests_in_pauses_and_sees_no_board_in_absences() {
    let board = board();
    let camera = radtan();
    let rays = Rays::new(&camera, SIZE);
    let settings = MotionSettings {
        pauses: vec![Interval { start: 1.0, end: 1.5 }],
        absences: vec![Interval { start: 4.0, end: 4.5 }],
        ..MotionSettings::fast()
    };
    let motion = Motion::new(&settings, &board, &rays, 6.0, 4).unwrap();
    let still = motion.pose(1.0);
    for step in 0..=50 {
        let pose = motion.pose(1.0 + 0.01 * f64::from(step));
        assert!((pose.translation.vector - still.translation.vector).norm() < 1e-12);
        assert!(pose.rotation.angle_to(&still.rotation) < 1e-12);
    }
    assert!((motion.pose(0.79).translation.vector - motion.pose(0.81).translation.vector).norm() > 1e-4);
    for step in 0..=50 {
        let view = View::new(&motion.pose(4.0 + 0.01 * f64::from(step)));
        let seen = rays.grid(40, 30).flatten().filter_map(|ray| view.gaze(ray)).filter(|gaze| {
            let offset = gaze.point - board.middle();
            offset.x.abs() < 0.27 && offset.y.abs() < 0.3
        });
        assert_eq!(seen.count(), 0);
    }
}

#[test]
fn the_motion_is_smooth() {
    let board = board();
    let rays = Rays::new(&kannala_brandt(), SIZE);
    let settings = MotionSettings {
        pauses: vec![Interval { start: 0.5, end: 0.8 }],
        absences: vec![Interval { start: 2.0, end: 2.1 }],
        ..MotionSettings::blur()
    };
    let motion = Motion::new(&settings, &board, &rays, 3.0, 1).unwrap();
    let h = 1e-4;
    let position = |t: f64| motion.pose(t).translation.vector;
    let acceleration = |t: f64| (position(t + h) - 2.0 * position(t) + position(t - h)) / (h * h);
    // A jump of position, velocity or acceleration would be visible between samples 0.1 ms apart.
    for step in 10..30_000 {
        let t = f64::from(step) * 1e-4;
        let change = (acceleration(t + 1e-4) - acceleration(t)).norm();
        assert!(change < 5.0, "{change} m/s² at {t}");
    }
}

#[test]
fn each_seed_has_its_own_motion() {
    let rays = Rays::new(&radtan(), SIZE);
    let pose = |seed: u64| Motion::new(&MotionSettings::fast(), &board(), &rays, 2.0, seed).unwrap().pose(1.0);
    assert_eq!(pose(1), pose(1));
    assert!((pose(1).translation.vector - pose(2).translation.vector).norm() > 1e-3);
}

/// Returns angular velocities in the axes of the camera (rad/s), every 20 ms for 6 s.
fn turns(settings: &MotionSettings, seed: u64) -> Vec<Vector3<f64>> {
    let motion = Motion::new(settings, &board(), &Rays::new(&radtan(), SIZE), 6.0, seed).unwrap();
    let rotation = |t: f64| motion.pose(t).rotation;
    let h = 1e-4;
    (0..300)
        .map(|step| 0.02 * f64::from(step))
        .map(|t| (rotation(t - h).inverse() * rotation(t + h)).scaled_axis() / (2.0 * h))
        .collect()
}

#[test]
fn rotations_follow_the_settings() {
    let largest =
        |turns: &[Vector3<f64>], axis: usize| turns.iter().fold(0.0_f64, |most, turn| most.max(turn[axis].abs()));
    for seed in 1..=3 {
        let turns = |turning| turns(&MotionSettings::turned(turning), seed);
        assert!(turns(Turning::Never).iter().all(|turn| turn.norm() < 1e-6));
        let one = turns(Turning::OneAxis);
        assert!(largest(&one, 0) < 1e-6 && largest(&one, 2) < 1e-6 && largest(&one, 1) > 0.5);
        let even = turns(Turning::Evenly);
        let rate = Vector3::z() * -60f64.to_radians();
        assert!(even.iter().all(|turn| (turn - rate).norm() < 1e-6), "{}", even[0]);
        let little =
            Motion::new(&MotionSettings::turned(Turning::Little), &board(), &Rays::new(&radtan(), SIZE), 6.0, seed);
        let little = little.unwrap();
        let first = little.pose(0.0).rotation;
        let angle =
            (0..300).map(|step| little.pose(0.02 * f64::from(step)).rotation.angle_to(&first)).fold(0.0, f64::max);
        assert!((5.0..28.0).contains(&angle.to_degrees()), "{}", angle.to_degrees());
    }
}

#[test]
fn a_motion_to_and_fro_repeats_itself() {
    let motion = Motion::new(&MotionSettings::to_and_fro(), &board(), &Rays::new(&radtan(), SIZE), 6.0, 1).unwrap();
    for step in 0..100 {
        let t = 0.02 * f64::from(step);
        let [before, after] = [t, t + 2.0].map(|t| motion.pose(t));
        assert!((before.translation.vector - after.translation.vector).norm() < 1e-9, "{t}");
    }
}
