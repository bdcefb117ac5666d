//! Static transforms of ROS from the first camera to the others.
//!
//! The transform of frame `dvs1_optical` in frame `dvs_optical` maps coordinates of the second camera to coordinates of the
//! first: it is the inverse of `T_second_first`.

use super::{Pair, clocks};
use crate::export::static_transform::{Frames, static_transform};

/// Writes `static_transforms.yaml`: one document for each camera except the first.
pub fn write(pairs: &[Pair]) -> String {
    let document = |(index, pair): (usize, &Pair)| {
        let child = format!("dvs{}_optical", index + 1);
        let frames = Frames { parent: "dvs_optical", child: &child };
        let text = static_transform(&frames, &pair.second_first.inverse());
        format!("---\n# {}\n{text}", clocks(pair))
    };
    pairs.iter().enumerate().map(document).collect()
}
