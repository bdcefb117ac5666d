//! The estimated board, as stored in `calibration.json`.

use serde::{Deserialize, Serialize};

use crate::quality::board_evidence::BoardEstimate;
use evcal_geometry::lens::camera_file::CameraDescription;

/// The printed board: differences from its nominal shape, and evidence for them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PrintedBoard {
    /// Scale of the print along x divided by the scale along y.
    pub print_ratio: BoardParameter,
    /// Distance of the middle from the plane through the edges, away from the camera, along x (m).
    pub bend_x: BoardParameter,
    /// The same distance along y (m).
    pub bend_y: BoardParameter,
    /// Radius of the circles (m).
    pub radius: BoardParameter,
    /// The camera from the solve with the nominal board; absent if no parameter was estimated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera_as_stated: Option<CameraDescription>,
}

/// One parameter of the board.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BoardParameter {
    /// Its value in the calibration.
    pub value: f64,
    /// `true` if it was estimated; otherwise it has its nominal value.
    pub estimated: bool,
    /// Its standard deviation, if it was estimated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma: Option<f64>,
    /// Its estimate with all parameters of the board estimated; absent if the observations do not determine it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub if_free: Option<FreeValue>,
}

/// Value of a fixed parameter if it were estimated.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FreeValue {
    /// Its value.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

impl PrintedBoard {
    /// Returns the board of `estimate`.
    pub fn new(estimate: &BoardEstimate) -> Self {
        let values = estimate.shape.parameters();
        let [print_ratio, bend_x, bend_y, radius] = std::array::from_fn(|index| {
            let estimated = estimate.estimated[index];
            let if_free = estimate
                .evidence
                .map(|evidence| FreeValue { value: evidence.values[index], sigma: evidence.sigma[index] })
                .filter(|free| free.sigma.is_finite());
            BoardParameter {
                value: values[index],
                estimated,
                sigma: estimated.then_some(estimate.sigma[index]),
                if_free,
            }
        });
        let camera_as_stated = estimate.camera_with_nominal_board.as_ref().map(CameraDescription::new);
        Self { print_ratio, bend_x, bend_y, radius, camera_as_stated }
    }
}
