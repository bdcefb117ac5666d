//! Comparison of the native start and native poses with OpenCV's.

#[path = "../../../solve/src/initial/tests/scene.rs"]
mod scene;

use evcal_core::camera::ModelKind;
use evcal_core::camera::refit::difference;
use evcal_detection::circles::reference_frame::{ObservedCircle, ReferenceFrame, SeenIn};
use evcal_geometry::board::Board;
use evcal_opencv::Opencv;
use evcal_solve::initial::{
    InitialModel, InitialSettings, NativeStart, PlanePoint, PosedFrame, ProjectedCircle, Start, initial_model,
};
use nalgebra::{Point3, Vector2};

use scene::{Fault, SENSOR, Scene, board};

fn model(scene: &Scene, frames: &[ReferenceFrame], start: &'static dyn Start) -> InitialModel {
    let settings = InitialSettings { start: Some(start), min_frames: 6, ..InitialSettings::default() };
    initial_model(frames, &scene.board, SENSOR, scene.camera.kind(), &settings).unwrap()
}

/// Inputs that a start must handle.
fn inputs(kind: ModelKind) -> [(&'static str, Scene); 4] {
    [
        ("exact images", Scene { noise: 0.0, misplaced: u32::MAX, step: 0.1, count: 60, ..Scene::new(kind) }),
        ("many views", Scene { step: 0.06, count: 100, ..Scene::new(kind) }),
        ("few views", Scene { step: 0.55, count: 6, ..Scene::new(kind) }),
        ("clutter", Scene { step: 0.06, count: 60, misplaced: 7, ..Scene::new(kind) }),
    ]
}

/// Both starts lead to the same frames, circles and camera. The remaining difference between the cameras comes from the
/// prior, which depends on the start, and is far below their distance from the ground truth.
#[test]
fn both_starts_reach_the_same_model_on_every_input() {
    for &kind in ModelKind::ALL {
        for (input, scene) in inputs(kind) {
            // Wrong frames among many, which both must exclude.
            let fault = |frame| match frame {
                11 if input == "many views" => Fault::Turned,
                23 if input == "many views" => Fault::Mirrored,
                35 if input == "many views" => Fault::Shifted,
                _ => Fault::None,
            };
            let frames = scene.frames(3, fault);
            let (opencv, native) = (model(&scene, &frames, &Opencv), model(&scene, &frames, &NativeStart { seed: 0 }));
            assert!(native.report.native_start && native.report.opencv.is_none());
            assert_eq!(opencv.report.opencv.as_ref().unwrap().failure, None, "{kind}, {input}");
            let of = |model: &InitialModel| -> Vec<(usize, Vec<usize>)> {
                let indices = |frame: &PosedFrame| frame.circles.iter().map(|circle| circle.index).collect();
                model.frames.iter().map(|frame| (frame.frame, indices(frame))).collect()
            };
            assert_eq!(of(&opencv), of(&native), "{kind}, {input}");
            let between = difference(&opencv.camera, &native.camera, SENSOR);
            let from_truth = difference(&scene.camera, &opencv.camera, SENSOR);
            let far_below = 1e-3_f64.max(0.1 * from_truth.largest);
            assert!(between.largest < far_below, "{kind}, {input}: {between:?} {from_truth:?}");
        }
    }
}

/// Without wrong points both find the same pose first.
#[test]
fn poses_agree_with_opencv() {
    let scene = Scene::new(ModelKind::Radtan4);
    for view in 0..50 {
        let truth = scene.truth(6 * view);
        let points: Vec<PlanePoint> = (0..board().point_count())
            .map(|index| {
                let plane = board().point(index);
                let seen = truth * Point3::new(plane.x, plane.y, 0.0);
                // Alternating errors of a tenth of a pixel.
                let error = if index % 2 == 0 { 0.1 / 345.0 } else { -0.1 / 345.0 };
                PlanePoint { plane, image: Vector2::new(seen.x / seen.z + error, seen.y / seen.z - error) }
            })
            .collect();
        let found = |start: &dyn Start| start.plane_pose(&points, 3.0 / 345.0, 100).unwrap();
        let (own, theirs) = (found(&NativeStart { seed: 0 }), found(&Opencv));
        assert_eq!(own.inliers, theirs.inliers, "view {view}");
        // OpenCV's homography weights the points slightly differently.
        let relative = own.solutions[0].inverse() * theirs.solutions[0];
        let distance = relative.translation.vector.norm() + relative.rotation.angle();
        assert!(distance < 2e-3, "view {view}: {distance}");
    }
}
