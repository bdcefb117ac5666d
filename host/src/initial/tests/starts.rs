//! The native start against the truth and, in builds with OpenCV, against the start from OpenCV.

use super::*;
use crate::initial::native_start::native_start;
use crate::initial::sighting::BoardPoint;

fn settings(start: Start) -> InitialSettings {
    InitialSettings { start, min_frames: 6, ..InitialSettings::default() }
}

fn model(scene: &Scene, frames: &[ReferenceFrame], start: Start) -> InitialModel {
    initial_model(frames, &scene.board, SENSOR, scene.camera.kind(), &settings(start)).unwrap()
}

/// What a start has to cope with.
fn inputs(kind: ModelKind) -> [(&'static str, Scene); 3] {
    [
        ("many views", Scene { step: 0.06, count: 100, ..Scene::new(kind) }),
        ("few views", Scene { step: 0.55, count: 6, ..Scene::new(kind) }),
        ("clutter", Scene { step: 0.06, count: 60, misplaced: 7, ..Scene::new(kind) }),
    ]
}

/// Exact images: the camera comes back but for what the prior on the distortion does.
#[test]
fn the_native_start_finds_the_camera_of_exact_images() {
    for &kind in ModelKind::ALL {
        let (scene, sightings) = exact_sightings(kind);
        let views: Vec<&[BoardPoint]> = sightings.iter().map(|sighting| sighting.points.as_slice()).collect();
        let found = native_start(kind, &views, SENSOR, &settings(Start::default())).unwrap();
        let from_truth = difference(&scene.camera, &found.camera, SENSOR);
        assert!(from_truth.root_mean_square < 0.01, "{kind} {from_truth:?}");
    }
}

/// Whatever samples RANSAC draws, they lead to the same camera: what is left between two comes from the prior, which
/// remembers where the refinement started, and is far below their distance from the truth.
#[test]
fn the_seed_of_ransac_does_not_change_the_camera() {
    for kind in [ModelKind::Radtan, ModelKind::KannalaBrandt] {
        for (input, scene) in inputs(kind) {
            let frames = scene.frames(3, |_| Fault::None);
            let reference = model(&scene, &frames, Start::Native { seed: 0 });
            assert!(reference.report.native_start && reference.report.opencv.is_none());
            // Where there are few views, one that is drawn or not counts most.
            for seed in 1..if input == "few views" { 32 } else { 5 } {
                let found = model(&scene, &frames, Start::Native { seed });
                let apart = difference(&reference.camera, &found.camera, SENSOR);
                let from_truth = difference(&scene.camera, &reference.camera, SENSOR);
                let far_below = 1e-3_f64.max(0.1 * from_truth.largest);
                assert!(apart.largest < far_below, "{kind}, {input}, seed {seed}: {apart:?} {from_truth:?}");
            }
        }
    }
}

/// The double sphere model has two sides, xi < 0 and xi > 0, with cameras that are nearly alike.
#[test]
fn a_start_on_the_wrong_side_of_a_model_is_left() {
    let (scene, sightings) = exact_sightings(ModelKind::DoubleSphere);
    let settings = settings(Start::default());
    let xi = |camera: &Camera<f64>| camera.parameters()[4];
    let wrong = refits(ModelKind::DoubleSphere, &scene.camera, SENSOR).find(|camera| xi(camera) > 0.1).unwrap();
    let mut report = InitialReport::default();
    let posed = poses(&wrong, sightings, &settings, &mut report);
    let views: Vec<BundleView> =
        posed.iter().map(|posed| BundleView { points: &posed.sighting.points, pose: posed.pose }).collect();
    let alone = bundle(&wrong, &views, &[true; 6], SENSOR, settings.huber).unwrap().camera;
    assert!(xi(&alone) >= 0.0, "{alone:?} has left the wrong side by itself");
    let refined = refine(&wrong, &posed, &scene.board, SENSOR, &settings, &mut report).unwrap().camera;
    let from_truth = difference(&scene.camera, &refined, SENSOR);
    assert!(from_truth.root_mean_square < 0.01, "{refined:?} {from_truth:?}");
}

fn exact_sightings(kind: ModelKind) -> (Scene, Vec<Sighting>) {
    let scene = Scene { noise: 0.0, count: 60, step: 0.1, ..Scene::new(kind) };
    let mut sightings = sighting::sightings(&scene.frames(1, |_| Fault::None), &scene.board);
    for sighting in &mut sightings {
        let pose = scene.truth(sighting.frame);
        for circle in &mut sighting.circles {
            circle.center = image(&scene.camera, &pose, &scene.board, circle.index).unwrap();
        }
    }
    sightings.retain(|sighting| sighting.circles.len() >= 12);
    sighting::pair_points(&mut sightings, &scene.board);
    (scene, sightings)
}

#[cfg(feature = "opencv")]
mod against_opencv {
    use super::*;
    use crate::initial::first_camera::refine_start;
    use crate::initial::opencv_start::opencv_start;

    #[test]
    fn both_starts_reach_the_camera_of_exact_images() {
        for &kind in ModelKind::ALL {
            let (_, sightings) = exact_sightings(kind);
            let settings = settings(Start::Opencv);
            let views: Vec<&[BoardPoint]> = sightings.iter().map(|sighting| sighting.points.as_slice()).collect();
            let (opencv, start) = opencv_start(kind, &views, SENSOR, &settings);
            assert_eq!(start.failure, None, "{kind}");
            let (_, opencv) = refine_start(&opencv.unwrap(), &views, SENSOR, &settings).unwrap();
            let native = native_start(kind, &views, SENSOR, &settings).unwrap();
            let between = difference(&opencv.camera, &native.camera, SENSOR);
            // Along the curve on which omni's parameters explain each other, steps end where nothing is gained.
            let flat = kind == ModelKind::Omni;
            assert!(between.largest < if flat { 0.1 } else { 1e-3 }, "{kind} {between:?}");
        }
    }

    /// The same frames, circles and camera from either start. What is left between the cameras comes from
    /// the prior, which remembers the start, and is far below their distance from the truth.
    #[test]
    fn both_starts_reach_the_same_model_on_every_input() {
        for &kind in ModelKind::ALL {
            for (input, scene) in inputs(kind) {
                let frames = scene.frames(3, |_| Fault::None);
                let opencv = model(&scene, &frames, Start::Opencv);
                let native = model(&scene, &frames, Start::Native { seed: 0 });
                let of = |model: &InitialModel| -> Vec<(usize, Vec<usize>)> {
                    let indices = |frame: &PosedFrame| frame.circles.iter().map(|circle| circle.index).collect();
                    model.frames.iter().map(|frame| (frame.frame, indices(frame))).collect()
                };
                assert_eq!(of(&opencv), of(&native), "{kind}, {input}");
                let apart = difference(&opencv.camera, &native.camera, SENSOR);
                let from_truth = difference(&scene.camera, &opencv.camera, SENSOR);
                let far_below = 1e-3_f64.max(0.1 * from_truth.largest);
                assert!(apart.largest < far_below, "{kind}, {input}: {apart:?} {from_truth:?}");
            }
        }
    }
}
