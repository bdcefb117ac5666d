//! Simulate, calibrate, evaluate: every camera model comes out as it went in.

use evcal_tests::accuracy::Accuracy;
use evcal_tests::lens::{self, Lens};

/// Four seconds of a hand-moved board, default settings.
fn calibrates(lens: Lens) {
    let accuracy = Accuracy::of(&lens.own_calibration(), &lens.recording());
    let model = lens.model;
    assert!(accuracy.focal <= 1e-3, "{model}: {accuracy:?}");
    assert!(accuracy.center <= 0.5, "{model}: {accuracy:?}");
    assert!(accuracy.projection_rms <= 0.1, "{model}: {accuracy:?}");
    assert!(accuracy.projection_max <= 0.3, "{model}: {accuracy:?}");
    // The goal is 1 mm; it is only reached by the wide lens, which is nearer to the board.
    assert!(accuracy.position <= 2e-3, "{model}: {accuracy:?}");
}

#[test]
fn radtan4() {
    calibrates(lens::RADTAN4);
}

#[test]
fn radtan() {
    calibrates(lens::RADTAN);
}

#[test]
fn radtan8() {
    calibrates(lens::RADTAN8);
}

#[test]
fn kannala_brandt() {
    calibrates(lens::KANNALA_BRANDT);
}

#[test]
fn inverse_radial() {
    calibrates(lens::INVERSE_RADIAL);
}
