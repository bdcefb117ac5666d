//! The board as it was estimated, as it is written to `calibration.json`.

use serde::{Deserialize, Serialize};

use crate::trust::board_evidence::BoardEstimate;
use evcal_geometry::lens::camera_file::CameraDescription;

/// The printed board: where it is not as stated, and what the observations say of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PrintedBoard {
    /// Scale of the print along x over that along y.
    pub print_ratio: BoardParameter,
    /// How much further from the camera the middle is than the edges, along x (m).
    pub bend_x: BoardParameter,
    /// The same along y (m).
    pub bend_y: BoardParameter,
    /// Radius of the circles (m).
    pub radius: BoardParameter,
    /// The camera that came out with the board as it is stated; absent where nothing was estimated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera_as_stated: Option<CameraDescription>,
}

/// One parameter of the board.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BoardParameter {
    /// Its value in the calibration.
    pub value: f64,
    /// Whether it was estimated; otherwise it is as stated.
    pub estimated: bool,
    /// Its standard deviation, where it was estimated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma: Option<f64>,
    /// What the observations say of it with all of the board free; absent where they cannot tell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub if_free: Option<FreeValue>,
}

/// A parameter that is not free, if it were.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FreeValue {
    /// Its value.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

impl PrintedBoard {
    /// The board of `estimate`.
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
        let camera_as_stated = estimate.camera_as_stated.as_ref().map(CameraDescription::new);
        Self { print_ratio, bend_x, bend_y, radius, camera_as_stated }
    }
}
