//! The finding on the estimated board.

use evcal_core::camera::Camera;

use super::{Cause, Finding, Severity};
use crate::quality::board_evidence::BoardEstimate;
use evcal_geometry::board::Board;
use evcal_geometry::numerics::statistics::decimals;

/// Returns a finding with the differences from the nominal `board` and their effect on the focal length of `camera`;
/// `None` without differences.
pub(super) fn board_finding(estimate: &BoardEstimate, board: &Board, camera: &Camera<f64>) -> Option<Finding> {
    let statements = statements(estimate, board);
    let effect = estimate.camera_with_nominal_board.as_ref().and_then(|stated| effect(stated, camera));
    (!statements.is_empty()).then(|| Finding {
        cause: Cause::BoardNotAsStated,
        severity: Severity::Note,
        reason: format!("{}{}", statements.join(", "), effect.unwrap_or_default()),
        advice:
            "the calibration takes this into account. A stiff, flat board and a measured print make it more certain"
                .into(),
    })
}

/// Describes each estimated parameter of the board, as part of a sentence.
fn statements(estimate: &BoardEstimate, board: &Board) -> Vec<String> {
    let [by_ratio, by_bend_x, by_bend_y, by_radius] = estimate.estimated;
    let [ratio_sigma, bend_x_sigma, bend_y_sigma, radius_sigma] = estimate.sigma;
    let shape = &estimate.shape;
    let mut statements = Vec::new();
    for (estimated, bend, sigma, axis) in
        [(by_bend_x, shape.bend[0], bend_x_sigma, "x"), (by_bend_y, shape.bend[1], bend_y_sigma, "y")]
    {
        if estimated {
            let side = if bend > 0.0 { "away from" } else { "towards" };
            let bend = with_sigma(1e3 * bend.abs(), 1e3 * sigma);
            statements.push(format!("the board is bent by {bend} mm along {axis}, its middle {side} the camera"));
        }
    }
    if by_ratio {
        let (longer, shorter) = if shape.print_ratio > 1.0 { ("x", "y") } else { ("y", "x") };
        let ratio = if shape.print_ratio > 1.0 { shape.print_ratio } else { 1.0 / shape.print_ratio };
        let percent = with_sigma(1e2 * (ratio - 1.0), 1e2 * ratio_sigma);
        statements.push(format!("the print is {percent} % longer along {longer} than along {shorter}"));
    }
    if by_radius {
        let radius = with_sigma(1e3 * shape.radius, 1e3 * radius_sigma);
        statements.push(match board {
            Board::Circles(circles) => {
                format!("the circles have a radius of {radius} mm, not {} mm", 1e3 * circles.radius)
            }
            Board::Squares(_) => {
                let wider = 2e3 * (shape.radius - board.print_radius());
                let word = if wider > 0.0 { "wider" } else { "narrower" };
                let difference = with_sigma(wider.abs(), 2e3 * radius_sigma);
                format!("the dark squares are {difference} mm {word} than stated")
            }
        });
    }
    statements
}

/// Describes the focal length with the nominal board.
fn effect(stated: &Camera<f64>, camera: &Camera<f64>) -> Option<String> {
    let (stated, fx) = (*stated.parameters().first()?, *camera.parameters().first()?);
    Some(format!("; with the nominal board, fx would be {stated:.2} px ({:+.3} %)", 1e2 * (stated / fx - 1.0)))
}

/// Formats a value and its standard deviation, with two digits of the latter.
pub(crate) fn with_sigma(value: f64, sigma: f64) -> String {
    let decimals = decimals(sigma);
    format!("{value:.decimals$} ± {sigma:.decimals$}")
}

#[cfg(test)]
mod tests {
    use evcal_core::camera::ModelKind;

    use super::*;
    use evcal_geometry::board::shape::BoardShape;

    fn estimate(shape: BoardShape, estimated: [bool; 4]) -> BoardEstimate {
        let parameters = [340.0, 340.0, 173.0, 130.0, 0.0, 0.0, 0.0, 0.0];
        let camera = Camera::from_parameters(ModelKind::Radtan4, &parameters);
        let sigma = [2e-4, 1e-4, 1.23e-4, 5e-5];
        BoardEstimate { shape, estimated, sigma, evidence: None, camera_with_nominal_board: camera }
    }

    #[test]
    fn each_difference_is_reported_with_its_uncertainty_and_its_effect() {
        let board: Board = "acircles:9x4:55mm:r17.5mm".parse().unwrap();
        let camera =
            Camera::from_parameters(ModelKind::Radtan4, &[330.0, 330.0, 173.0, 130.0, 0.0, 0.0, 0.0, 0.0]).unwrap();
        let shape = BoardShape { print_ratio: 0.997, bend: [0.0018, -0.004], radius: 0.017 };
        let reason = |estimated| board_finding(&estimate(shape, estimated), &board, &camera).map(|found| found.reason);
        assert_eq!(reason([false; 4]), None);
        let all = reason([true; 4]).unwrap();
        for part in [
            "the board is bent by 1.80 ± 0.10 mm along x, its middle away from the camera",
            "the board is bent by 4.00 ± 0.12 mm along y, its middle towards the camera",
            "the print is 0.301 ± 0.020 % longer along y than along x",
            "the circles have a radius of 17.000 ± 0.050 mm, not 17.5 mm",
            "; with the nominal board, fx would be 340.00 px (+3.030 %)",
        ] {
            assert!(all.contains(part), "{part}\n{all}");
        }
        assert!(!reason([true, false, false, false]).unwrap().contains("bent"));
    }
}
