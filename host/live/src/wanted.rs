//! Remaining requirements, worded for the person who holds the board.

use super::Tilt;

/// A remaining requirement.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Requirement {
    /// This many more windows with the board.
    Views(u64),
    /// The board in this part of the image, as (column, row): −1 is left or top, 0 the middle, 1 right or bottom.
    Part(i8, i8),
    /// The board tilted so that this side is nearer, by this angle in degrees.
    Nearer(Tilt, f64),
    /// This many more seconds with the board.
    Time(f64),
    /// Tilts that determine a first camera.
    OtherTilts,
    /// The first checkpoint.
    FirstCheckpoint,
    /// The deficiency of the latest checkpoint, as its own text.
    Checkpoint(String),
}

impl Requirement {
    /// Returns the requirement in words, for a view as seen by the camera or in a mirror.
    pub fn words(&self, mirrored: bool) -> String {
        match self {
            Self::Views(count) => format!("{count} more views of the board"),
            Self::Part(x, y) => format!("the board at the {}", part(if mirrored { -x } else { *x }, *y)),
            Self::Nearer(side, angle) => {
                format!("a tilt of {angle:.0}° with the {} side nearer", side.seen(mirrored).name())
            }
            Self::Time(seconds) => format!("{:.0} s more with the board", seconds.ceil()),
            Self::OtherTilts => "the board tilted differently".to_owned(),
            Self::FirstCheckpoint => "a first checkpoint".to_owned(),
            Self::Checkpoint(text) => text.clone(),
        }
    }
}

/// Returns all requirements in words.
pub fn words(wanted: &[Requirement], mirrored: bool) -> Vec<String> {
    wanted.iter().map(|wanted| wanted.words(mirrored)).collect()
}

fn part(x: i8, y: i8) -> &'static str {
    match (x, y) {
        (0, 0) => "middle",
        (0, ..=-1) => "top",
        (0, _) => "bottom",
        (..=-1, 0) => "left",
        (_, 0) => "right",
        (..=-1, ..=-1) => "upper left",
        (..=-1, _) => "lower left",
        (_, ..=-1) => "upper right",
        (_, _) => "lower right",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn left_and_right_are_exchanged_in_a_mirrored_picture() {
        for (wanted, plain, mirrored) in [
            (Requirement::Part(-1, 1), "the board at the lower left", "the board at the lower right"),
            (Requirement::Part(0, -1), "the board at the top", "the board at the top"),
            (
                Requirement::Nearer(Tilt::Right, 15.0),
                "a tilt of 15° with the right side nearer",
                "a tilt of 15° with the left side nearer",
            ),
            (
                Requirement::Nearer(Tilt::Top, 15.0),
                "a tilt of 15° with the top side nearer",
                "a tilt of 15° with the top side nearer",
            ),
            (Requirement::Time(3.2), "4 s more with the board", "4 s more with the board"),
        ] {
            assert_eq!((wanted.words(false).as_str(), wanted.words(true).as_str()), (plain, mirrored));
        }
    }
}
