//! Whether the truth lies where the stated uncertainty says. `experiments/seeds.rs` does the same for many seeds.

use evcal_tests::{json, lens, read_json, text};

/// All parameters of all lenses: each within four σ, and together neither much nearer nor much farther than
/// stated. (The parameters of one lens are correlated, so some tens of them are worth about five each.)
#[test]
fn the_truth_lies_within_the_stated_uncertainty() {
    let mut squares = Vec::new();
    for lens in lens::ALL {
        let (calibration, truth) = (lens.own_calibration(), lens.recording());
        let result = read_json(&calibration.join("calibration.json"));
        let evaluation = json(&["evaluate", text(&calibration), "--truth", text(&truth), "--json"]);
        // With xi only all parameters together are known, along a curve that no covariance can follow.
        let together = lens.kind().parameter_names().contains(&"xi");
        for name in lens.kind().parameter_names().iter().filter(|_| !together) {
            let error = evaluation["intrinsics"]["parameters"][*name]["difference"].as_f64().unwrap();
            let sigma = result["sigma"]["parameters"][*name].as_f64().unwrap();
            assert!(error.abs() < 4.0 * sigma, "{} {name}: {error} ± {sigma}", lens.model);
            squares.push(error * error / (sigma * sigma));
        }
        let difference = evaluation["projection_difference"]["rms_px"].as_f64().unwrap();
        let stated = result["uncertainty"]["projection_rms"].as_f64().unwrap();
        assert!(difference < 3.0 * stated, "{}: {difference} px, {stated} px stated", lens.model);
        let parts = result["uncertainty"]["projection_parts"].as_object().unwrap();
        let sum: f64 = parts.values().map(|part| part.as_f64().unwrap().powi(2)).sum();
        assert!((sum.sqrt() / stated - 1.0).abs() < 1e-6, "{}: {parts:?} of {stated}", lens.model);
    }
    let mean = squares.iter().sum::<f64>() / squares.len() as f64;
    assert!((0.15..2.5).contains(&mean), "{mean}");
}

/// Two halves of a recording, calibrated apart, differ by what both uncertainties allow.
#[test]
fn halves_differ_as_stated() {
    let halves = lens::ALL.map(|lens| {
        let result = read_json(&lens.own_calibration().join("calibration.json"));
        let halves = &result["split_half"];
        (halves["difference_rms"].as_f64().unwrap(), halves["bound"].as_f64().unwrap())
    });
    let inside = halves.iter().filter(|(difference, bound)| difference < bound).count();
    assert!(inside >= 4, "{halves:?}");
}
