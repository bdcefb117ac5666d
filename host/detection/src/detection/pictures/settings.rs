//! Settings of the search in the camera's own frames.

use evcal_core::settings;
use evcal_core::settings::above;
use serde::{Deserialize, Serialize};

settings! {
    /// The camera's own frames, if a recording contains them.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct PictureSettings {
        /// Largest radius of a dot; grey levels are compared within this distance, and within a third of it.
        pub max_radius: f64 = 40.0, "px", above(1.0).at_most(1000.0);
    }
}
