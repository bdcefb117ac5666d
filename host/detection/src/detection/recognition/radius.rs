//! Check of the stated radius, if no frame can be used.

use evcal_core::pattern::Layout;

use crate::circles::reference_frame::ReferenceFrame;
use crate::detection::recognition::layout::radius_ratios;
use evcal_files::remedy::{Remedy, Words};
use evcal_geometry::board::CircleBoard;
use evcal_geometry::numerics::statistics::median;

/// Ratio of the stated to the observed radius, at the stated spacing, from which it is reported. Circles found in events are
/// slightly larger than the printed ones, and narrower if the board is tilted.
const DISAGREES: f64 = 1.3;
/// Range of the ratio in which the stated radius is probably a diameter.
const DIAMETER: std::ops::Range<f64> = 1.6..2.4;

/// The circles appear to have another radius than stated.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "the circles appear to have a radius of {:.1} mm, not {:.1} mm, for the stated spacing: {}",
    1e3 * .seen, 1e3 * .stated, in_words(.meant)
)]
pub struct OtherRadius {
    /// The observed radius, at the stated spacing (m).
    pub seen: f64,
    /// The radius stated (m).
    pub stated: f64,
    /// The boards that may be intended, each with the question that decides it: the radius may be a diameter, or the
    /// spacing the distance of neighbours in a row.
    pub meant: Vec<(&'static str, CircleBoard)>,
}

impl Remedy for OtherRadius {
    fn remedy(&self, say: &Words) -> Option<String> {
        let boards: Vec<String> = self.meant.iter().map(|(_, board)| say.board.with(board)).collect();
        Some(match boards.is_empty() {
            true => format!("give the measured lengths with {}", say.board),
            false => format!("use {}", boards.join(" or ")),
        })
    }
}

/// Describes the boards that may be intended.
fn in_words(meant: &[(&'static str, CircleBoard)]) -> String {
    let meant: Vec<String> =
        meant.iter().map(|(question, board)| format!("{question} Then the board is {board}")).collect();
    match meant.as_slice() {
        [] => "measure both on the board".to_owned(),
        meant => meant.join("; "),
    }
}

/// Returns the observed radius of the circles of `frames`, if it differs from the radius of `board`.
pub fn other_radius(frames: &[ReferenceFrame], board: &CircleBoard) -> Option<OtherRadius> {
    let mut ratios: Vec<f64> = frames.iter().flat_map(|frame| radius_ratios(frame, board)).collect();
    let seen = median(&mut ratios, f64::total_cmp)? * board.neighbour_distance();
    let times = board.radius / seen;
    if (1.0 / DISAGREES..DISAGREES).contains(&times) {
        return None;
    }
    let mut meant = Vec::new();
    if DIAMETER.contains(&times) {
        meant.push(("is the radius a diameter?", CircleBoard { radius: 0.5 * board.radius, ..*board }));
    }
    if DIAMETER.contains(&(1.0 / times)) && board.pattern.layout == Layout::Asymmetric {
        meant.push((
            "is the spacing the distance of neighbours in a row (half of it is required)?",
            CircleBoard { spacing: 0.5 * board.spacing, ..*board },
        ));
    }
    Some(OtherRadius { seen, stated: board.radius, meant })
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;
    use crate::circles::reference_frame::{ObservedCircle, SeenIn};

    /// A board seen head-on at 2 px per millimetre.
    fn frame(board: &CircleBoard) -> ReferenceFrame {
        let circle = |index| {
            let center: Vector2<f64> = board.circle_center(index) * 2000.0;
            ObservedCircle { index, t: 0.0, center, radius: Some(board.radius * 2000.0), velocity: None }
        };
        let circles = (0..board.circle_count()).map(circle).collect();
        ReferenceFrame { recording: 0, start: 0.0, end: 0.01, circles, seen_in: SeenIn::Events(Vec::new()) }
    }

    #[test]
    fn diameters_and_distances_in_a_row_are_recognised() {
        let parse = |text: &str| text.parse::<CircleBoard>().unwrap();
        let seen = [frame(&parse("acircles:9x4:55mm:r17.5mm"))];
        assert_eq!(other_radius(&seen, &parse("acircles:9x4:55mm:r17.5mm")), None);
        assert_eq!(other_radius(&seen, &parse("acircles:9x4:55mm:r20mm")), None);
        let meant = |text: &str| {
            let found = other_radius(&seen, &parse(text)).unwrap();
            found.meant.iter().map(|(_, board)| board.to_string()).collect::<Vec<_>>()
        };
        assert_eq!(meant("acircles:9x4:55mm:r35mm"), ["acircles:9x4:55mm:r17.5mm"]);
        assert_eq!(meant("acircles:9x4:110mm:r17.5mm"), ["acircles:9x4:55mm:r17.5mm"]);
        assert!(meant("acircles:9x4:55mm:r25mm").is_empty());
        let found = other_radius(&seen, &parse("acircles:9x4:55mm:r25mm")).unwrap();
        assert!((found.seen - 0.0175).abs() < 1e-9, "{found:?}");
    }
}
