//! Findings on the orientation of the image. A board that is its own mirror image looks right in a mirrored image.

use std::collections::BTreeSet;

use evcal_core::sensor::Sensor;
use event_recordings::likely_sensor::likely_sensor;

use crate::advice::Advice;
use crate::quality::verdict::{Cause, Finding, Severity};
use evcal_geometry::board::Board;
use evcal_geometry::board::squares::SquareBoard;

/// Returns the finding on the orientation of the image of `sensor`; `None` if `board` shows that the image is not mirrored.
pub(super) fn finding_on(board: &Board, sensor: Sensor) -> Option<Finding> {
    is_own_mirror_image(board).then(|| match turned_sensor(sensor) {
        Some(turned) => Finding {
            cause: Cause::ExchangedAxes,
            severity: Severity::Failure,
            reason: format!("the sensor is {sensor} pixels, but cameras have {turned}: x and y seem to be exchanged"),
            advice: Advice::ExchangeAxes,
        },
        None => Finding {
            cause: Cause::OrientationNotChecked,
            severity: Severity::Note,
            reason: "it was not checked whether the image is mirrored, because this board is its own mirror image"
                .to_owned(),
            advice: "if in doubt, see in a picture of the events that nothing is mirrored".into(),
        },
    })
}

/// Returns the common sensor whose width and height are exchanged in `sensor`.
fn turned_sensor(sensor: Sensor) -> Option<Sensor> {
    let turned = Sensor::new(sensor.height, sensor.width);
    let (column, row) = (turned.width.checked_sub(1)?, turned.height.checked_sub(1)?);
    (sensor.height > sensor.width && likely_sensor(column, row) == Some(turned)).then_some(turned)
}

/// Returns `true` if the mirror image of `board`, turned by a multiple of 90°, has the same points. Tags show whether they are
/// mirrored.
fn is_own_mirror_image(board: &Board) -> bool {
    /// Resolution of positions, as a share of the longer side.
    const RESOLUTION: f64 = 1e-4;
    if matches!(board, Board::Squares(SquareBoard::Tags(_) | SquareBoard::Charuco(_))) {
        return false;
    }
    let (low, high) = board.extent();
    let middle = 0.5 * (low + high);
    let unit = RESOLUTION * board.longer_side();
    let points = || (0..board.point_count()).map(|index| (board.point(index) - middle) / unit);
    let rounded = |[x, y]: [f64; 2]| (x.round() as i64, y.round() as i64);
    let all: BTreeSet<(i64, i64)> = points().map(|point| rounded([point.x, point.y])).collect();
    // A point that is halfway between two positions may be rounded to either.
    let has = |(x, y): (i64, i64)| (-1..=1).any(|dx| (-1..=1).any(|dy| all.contains(&(x + dx, y + dy))));
    let mirrors: [fn(f64, f64) -> [f64; 2]; 4] = [|x, y| [-x, y], |x, y| [x, -y], |x, y| [y, x], |x, y| [-y, -x]];
    mirrors.iter().any(|mirror| points().all(|point| has(rounded(mirror(point.x, point.y)))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boards_that_are_their_own_mirror_image_are_known() {
        for (board, expected) in [
            ("acircles:9x4:55mm:r17.5mm", true),
            ("acircles:11x5:30mm:r8mm", true),
            ("acircles:6x4:55mm:r17.5mm", false),
            // As high as wide, and symmetric about its diagonal.
            ("acircles:8x4:55mm:r17.5mm", true),
            ("circles:5x7:40mm:r10mm", true),
            ("circles:6x6:40mm:r10mm", true),
            ("checkerboard:6x9:25mm", true),
            ("checkerboard:7x7:25mm", true),
            ("aprilgrid:6x6:35.2mm:0.3", false),
            ("charuco:5x7:30mm:22mm:DICT_5X5_100", false),
        ] {
            assert_eq!(is_own_mirror_image(&board.parse().unwrap()), expected, "{board}");
        }
    }

    #[test]
    fn a_sensor_that_is_higher_than_wide_has_exchanged_axes() {
        let board = "acircles:9x4:55mm:r17.5mm".parse().unwrap();
        let found = |width, height| finding_on(&board, Sensor::new(width, height)).map(|finding| finding.severity);
        assert_eq!(found(260, 346), Some(Severity::Failure));
        assert_eq!(found(720, 1280), Some(Severity::Failure));
        assert_eq!(found(346, 260), Some(Severity::Note));
        assert_eq!(found(128, 128), Some(Severity::Note));
        assert_eq!(found(300, 400), Some(Severity::Note), "no camera has 400 x 300 pixels");
        let tags = "aprilgrid:6x6:35.2mm:0.3".parse().unwrap();
        assert_eq!(finding_on(&tags, Sensor::new(260, 346)), None);
    }
}
