//! Compares actual errors with the reported uncertainty. `experiments/seeds.rs` does the same for many seeds.

use evcal_tests::{json, lens, read_json, text};

/// The error of each parameter of each lens is below 4 σ, and the mean square of error / σ is near 1. (The parameters of one lens
/// are correlated and count as about five independent ones.)
#[test]
fn errors_agree_with_the_reported_uncertainty() {
    let mut squares = Vec::new();
    for lens in lens::ALL {
        let (calibration, truth) = (lens.own_calibration(), lens.recording());
        let result = read_json(&calibration.join("calibration.json"));
        let evaluation = json(&["evaluate", text(&calibration), "--truth", text(&truth), "--json"]);
        // Parameters of models with xi are strongly correlated along a curve that a covariance cannot describe.
        let correlated = lens.kind().parameter_names().contains(&"xi");
        for name in lens.kind().parameter_names().iter().filter(|_| !correlated) {
            let error = evaluation["intrinsics"]["parameters"][*name]["difference"].as_f64().unwrap();
            let sigma = result["sigma"]["parameters"][*name].as_f64().unwrap();
            assert!(error.abs() < 4.0 * sigma, "{} {name}: {error} ± {sigma}", lens.model);
            squares.push(error * error / (sigma * sigma));
        }
        let difference = evaluation["projection_difference"]["rms_px"].as_f64().unwrap();
        let reported = result["uncertainty"]["projection_rms"].as_f64().unwrap();
        assert!(difference < 3.0 * reported, "{}: {difference} px, {reported} px reported", lens.model);
        let parts = result["uncertainty"]["projection_parts"].as_object().unwrap();
        let sum: f64 = parts.values().map(|part| part.as_f64().unwrap().powi(2)).sum();
        assert!((sum.sqrt() / reported - 1.0).abs() < 1e-6, "{}: {parts:?} of {reported}", lens.model);
    }
    let mean = squares.iter().sum::<f64>() / squares.len() as f64;
    assert!((0.15..2.5).contains(&mean), "{mean}");
}

/// Calibrations of the two halves of a recording differ by no more than both uncertainties allow.
#[test]
fn halves_differ_within_their_uncertainty() {
    let halves = lens::ALL.map(|lens| {
        let result = read_json(&lens.own_calibration().join("calibration.json"));
        let halves = &result["split_half"];
        (halves["difference_rms"].as_f64().unwrap(), halves["bound"].as_f64().unwrap())
    });
    let inside = halves.iter().filter(|(difference, bound)| difference < bound).count();
    assert!(inside >= 4, "{halves:?}");
}
