//! Comparison of the calibrated with the simulated board, from their files.

use std::fmt;
use std::path::Path;

use serde::Deserialize;

use evcal_geometry::board::Board;
use evcal_geometry::board::shape::BoardShape;

/// A parameter of the board in both files.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardPair {
    /// Its name in `calibration.json`.
    pub name: &'static str,
    /// The true value (ratio, or m).
    pub truth: f64,
    /// The calibrated one.
    pub calibration: f64,
    /// Its standard deviation; `None` if it was not estimated.
    pub sigma: Option<f64>,
}

/// Comparison of a calibrated with the true board.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardComparison {
    /// Print ratio, bends and radius.
    pub parameters: Vec<BoardPair>,
}

#[derive(Deserialize)]
struct CalibrationPart {
    printed_board: PrintedPart,
}

#[derive(Deserialize)]
struct PrintedPart {
    print_ratio: ParameterPart,
    bend_x: ParameterPart,
    bend_y: ParameterPart,
    radius: ParameterPart,
}

#[derive(Deserialize)]
struct ParameterPart {
    value: f64,
    sigma: Option<f64>,
}

#[derive(Deserialize)]
struct TruthPart {
    board: String,
    settings: SettingsPart,
}

#[derive(Deserialize)]
struct SettingsPart {
    scene: ScenePart,
}

#[derive(Deserialize)]
struct ScenePart {
    printed: Option<BoardShape>,
}

/// Compares the boards of two files; `None` if they do not contain one, or both are nominal.
pub fn compare_boards(calibration: &Path, truth: &Path) -> Option<BoardComparison> {
    let CalibrationPart { printed_board: board } = read(calibration)?;
    let TruthPart { board: stated, settings } = read(truth)?;
    let stated: Board = stated.parse().ok()?;
    let truth = settings.scene.printed.unwrap_or(BoardShape::nominal(&stated)).parameters();
    let names = ["print_ratio", "bend_x", "bend_y", "radius"];
    let found = [board.print_ratio, board.bend_x, board.bend_y, board.radius];
    let differs_from_nominal =
        settings.scene.printed.is_some() || found.iter().any(|parameter| parameter.sigma.is_some());
    let pairs = names.into_iter().zip(truth).zip(found);
    let parameters = pairs.map(|((name, truth), ParameterPart { value, sigma })| BoardPair {
        name,
        truth,
        calibration: value,
        sigma,
    });
    differs_from_nominal.then(|| BoardComparison { parameters: parameters.collect() })
}

fn read<T: serde::de::DeserializeOwned>(file: &Path) -> Option<T> {
    serde_json::from_str(&std::fs::read_to_string(file).ok()?).ok()
}

impl fmt::Display for BoardComparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:13} {:>12} {:>12}   difference", "board", "truth", "calibration")?;
        for BoardPair { name, truth, calibration, sigma } in &self.parameters {
            let (factor, unit) = if *name == "print_ratio" { (1.0, "") } else { (1e3, " mm") };
            let [truth, calibration] = [factor * truth, factor * calibration];
            write!(f, "\n{name:13} {truth:12.5} {calibration:12.5} {:12.5}{unit}", calibration - truth)?;
            if let Some(sigma) = sigma.filter(|sigma| *sigma > 0.0) {
                write!(f, " ({:+.1} σ)", (calibration - truth) / (factor * sigma))?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(printed: &str, sigma: &str) -> Option<BoardComparison> {
        let folder = tempfile::tempdir().unwrap();
        let (calibration, truth) = (folder.path().join("calibration.json"), folder.path().join("truth.json"));
        let same = r#"{"value": 0.0, "estimated": false}"#;
        let ratio = r#"{"value": 1.0, "estimated": false}"#;
        let radius = r#"{"value": 0.0175, "estimated": false}"#;
        let bend = format!(r#"{{"value": 0.00203, "estimated": true{sigma}}}"#);
        let text = format!(
            r#"{{"printed_board": {{"print_ratio": {ratio}, "bend_x": {bend}, "bend_y": {same}, "radius": {radius}}}}}"#
        );
        std::fs::write(&calibration, text).unwrap();
        let text = format!(r#"{{"board": "acircles:9x4:55mm:r17.5mm", "settings": {{"scene": {{{printed}}}}}}}"#);
        std::fs::write(&truth, text).unwrap();
        compare_boards(&calibration, &truth)
    }

    #[test]
    fn an_estimated_bend_is_compared_in_units_of_its_sigma() {
        let printed = r#""printed": {"print_ratio": 1.0, "bend": [0.002, 0.0], "radius": 0.0175}"#;
        let found = files(printed, r#", "sigma": 0.00002"#).unwrap();
        assert_eq!((found.parameters[1].truth, found.parameters[1].calibration), (0.002, 0.00203));
        let text = found.to_string();
        assert!(text.contains("bend_x") && text.contains("0.03000 mm (+1.5 σ)"), "{text}");
    }

    #[test]
    fn nominal_boards_are_not_compared() {
        assert_eq!(files("", ""), None);
    }
}
