//! Families of square tags: the codes of AprilTag and of OpenCV's ArUco dictionaries.

use std::fmt;
use std::str::FromStr;

use super::codes;

/// A family of tags whose inner modules form a square. The tags of AprilTag's families are upright as their authors and
/// Kalibr print them, and OpenCV draws them rotated by 180°. The tags of the other families are upright as drawn by
/// OpenCV.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TagFamily {
    /// AprilTag 16h5.
    April16h5,
    /// AprilTag 25h9.
    April25h9,
    /// AprilTag 36h10.
    April36h10,
    /// AprilTag 36h11.
    April36h11,
    /// OpenCV's dictionaries of 4 × 4 modules; the smaller dictionaries are the beginning of the largest.
    Aruco4x4,
    /// OpenCV's dictionaries of 5 × 5 modules.
    Aruco5x5,
    /// OpenCV's dictionaries of 6 × 6 modules.
    Aruco6x6,
    /// OpenCV's dictionaries of 7 × 7 modules.
    Aruco7x7,
    /// The tags of the first ArUco library.
    ArucoOriginal,
    /// ArUco MIP 36h12.
    ArucoMip36h12,
}

/// Rows of the tags of the first ArUco library: each encodes two bits of the number, highest first.
const ORIGINAL_ROWS: [u64; 4] = [0b10000, 0b10111, 0b01001, 0b01110];

impl TagFamily {
    /// Returns the number of inner modules along each side, without the border.
    pub fn inner_side(self) -> usize {
        match self {
            Self::April16h5 | Self::Aruco4x4 => 4,
            Self::April25h9 | Self::Aruco5x5 | Self::ArucoOriginal => 5,
            Self::April36h10 | Self::April36h11 | Self::Aruco6x6 | Self::ArucoMip36h12 => 6,
            Self::Aruco7x7 => 7,
        }
    }

    /// Returns `true` for the families of AprilTag, which OpenCV draws rotated by 180°.
    pub fn is_april(self) -> bool {
        matches!(self, Self::April16h5 | Self::April25h9 | Self::April36h10 | Self::April36h11)
    }

    /// Returns the inner modules of tag `id` row by row from the top left, the first in the highest bit, light as 1;
    /// `None` if the family has no such tag.
    pub fn code(self, id: u16) -> Option<u64> {
        let table: &[u64] = match self {
            Self::April16h5 => &codes::APRILTAG_16H5,
            Self::April25h9 => &codes::APRILTAG_25H9,
            Self::April36h10 => &codes::APRILTAG_36H10,
            Self::April36h11 => &codes::APRILTAG_36H11,
            Self::Aruco4x4 => &codes::ARUCO_4X4,
            Self::Aruco5x5 => &codes::ARUCO_5X5,
            Self::Aruco6x6 => &codes::ARUCO_6X6,
            Self::Aruco7x7 => &codes::ARUCO_7X7,
            Self::ArucoMip36h12 => &codes::ARUCO_MIP_36H12,
            Self::ArucoOriginal => return original_code(id),
        };
        table.get(usize::from(id)).copied()
    }

    /// Returns the shades of the modules of tag `id` with a dark border of `border` modules, row by row from the top
    /// left, `true` for light; `None` if the family has no such tag.
    pub fn light(self, id: u16, border: u8) -> Option<Vec<bool>> {
        let code = self.code(id)?;
        let (inner, border) = (self.inner_side(), usize::from(border));
        let side = inner + 2 * border;
        let is_light = |module: usize| {
            let (row, column) = ((module / side).checked_sub(border), (module % side).checked_sub(border));
            match (row, column) {
                (Some(row), Some(column)) if row < inner && column < inner => {
                    code >> (inner * inner - 1 - (row * inner + column)) & 1 == 1
                }
                _ => false,
            }
        };
        Some((0..side * side).map(is_light).collect())
    }
}

fn original_code(id: u16) -> Option<u64> {
    (id < 1024).then(|| {
        let rows = [8, 6, 4, 2, 0].map(|shift| ORIGINAL_ROWS[usize::from(id >> shift & 3)]);
        rows.into_iter().fold(0, |code, row| code << 5 | row)
    })
}

/// The first tags of a family, as in OpenCV's predefined dictionaries.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Dictionary {
    /// The family.
    pub family: TagFamily,
    /// Number of tags; the ids begin at 0.
    pub tags: u16,
}

/// Dictionaries by OpenCV's names without `DICT_`.
const DICTIONARIES: [(&str, TagFamily, u16); 22] = [
    ("4X4_50", TagFamily::Aruco4x4, 50),
    ("4X4_100", TagFamily::Aruco4x4, 100),
    ("4X4_250", TagFamily::Aruco4x4, 250),
    ("4X4_1000", TagFamily::Aruco4x4, 1000),
    ("5X5_50", TagFamily::Aruco5x5, 50),
    ("5X5_100", TagFamily::Aruco5x5, 100),
    ("5X5_250", TagFamily::Aruco5x5, 250),
    ("5X5_1000", TagFamily::Aruco5x5, 1000),
    ("6X6_50", TagFamily::Aruco6x6, 50),
    ("6X6_100", TagFamily::Aruco6x6, 100),
    ("6X6_250", TagFamily::Aruco6x6, 250),
    ("6X6_1000", TagFamily::Aruco6x6, 1000),
    ("7X7_50", TagFamily::Aruco7x7, 50),
    ("7X7_100", TagFamily::Aruco7x7, 100),
    ("7X7_250", TagFamily::Aruco7x7, 250),
    ("7X7_1000", TagFamily::Aruco7x7, 1000),
    ("ARUCO_ORIGINAL", TagFamily::ArucoOriginal, 1024),
    ("ARUCO_MIP_36h12", TagFamily::ArucoMip36h12, 250),
    ("APRILTAG_16h5", TagFamily::April16h5, 30),
    ("APRILTAG_25h9", TagFamily::April25h9, 35),
    ("APRILTAG_36h10", TagFamily::April36h10, 2320),
    ("APRILTAG_36h11", TagFamily::April36h11, 587),
];

impl Dictionary {
    /// AprilTag's family 36h11.
    pub const APRIL_36H11: Self = Self { family: TagFamily::April36h11, tags: 587 };

    /// Returns all predefined dictionaries.
    pub fn all() -> impl Iterator<Item = Self> {
        DICTIONARIES.iter().map(|(_, family, tags)| Self { family: *family, tags: *tags })
    }

    /// Returns the name that AprilTag's authors use for one of their families, such as `36h11`.
    pub fn april_name(self) -> Option<&'static str> {
        self.name().and_then(|name| name.strip_prefix("APRILTAG_"))
    }

    fn name(self) -> Option<&'static str> {
        let is_same = |(_, family, tags): &&(&str, TagFamily, u16)| *family == self.family && *tags == self.tags;
        DICTIONARIES.iter().find(is_same).map(|(name, ..)| *name)
    }
}

/// Error: a text is not the name of a predefined dictionary.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown dictionary")]
pub struct UnknownDictionary;

/// Parses OpenCV's names, with or without `DICT_`, and AprilTag's own: `36h11` or `tag36h11`.
impl FromStr for Dictionary {
    type Err = UnknownDictionary;

    fn from_str(text: &str) -> Result<Self, UnknownDictionary> {
        let upper = text.to_uppercase();
        let bare = upper.strip_prefix("DICT_").unwrap_or(&upper);
        let april = format!("APRILTAG_{}", bare.strip_prefix("TAG").unwrap_or(bare));
        let is_named = |name: &str| name.eq_ignore_ascii_case(bare) || name.eq_ignore_ascii_case(&april);
        let found = DICTIONARIES.iter().find(|(name, ..)| is_named(name));
        found.map(|(_, family, tags)| Self { family: *family, tags: *tags }).ok_or(UnknownDictionary)
    }
}

impl fmt::Display for Dictionary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.name() {
            Some(name) => write!(f, "DICT_{name}"),
            None => write!(f, "{} tags of {:?}", self.tags, self.family),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn turned(rows: &str) -> String {
        rows.chars().rev().collect()
    }

    /// Inner modules of tags 0 and 17 as drawn by OpenCV 5.0 (`generateImageMarker`), light as `#`.
    #[test]
    fn codes_equal_the_drawings_of_opencv() {
        let drawn = [
            ("DICT_4X4_50", "#.##/.#.#/..##/..#.", ".##./.##./..../...."),
            ("DICT_5X5_100", "#.#../.#.##/.##../#.#.#/###..", ".#.##/###.#/.#.../#..##/.####"),
            ("DICT_6X6_250", "...###/#...##/##.###/.##.../..#.#./#..##.", "...#.#/.#.#../##.##./####.#/...##./..####"),
            (
                "DICT_7X7_1000",
                "##.###./#.#.###/...##.#/#..#.#./.#.###./.#.#.../..#.#.#",
                "......./####.../.##..##/##.##../###.##./.#...##/#.##.##",
            ),
            ("DICT_ARUCO_ORIGINAL", "#..../#..../#..../#..../#....", "#..../#..../#.###/#..../#.###"),
            (
                "DICT_ARUCO_MIP_36h12",
                "##.#../#.#.##/.##.../###.#./....#./.###.#",
                ".#..##/.....#/.##..#/#.#..#/.#..../...##.",
            ),
            (
                "DICT_APRILTAG_36h10",
                "###.../.#.##./.#.#.#/..#..#/.#.#../###...",
                "#...##/.#.#.#/.##.#./..#..#/#...#./.##..#",
            ),
            (
                "DICT_APRILTAG_36h11",
                "..#.../.##.#./...#.#/...##./#.###./#.#.##",
                "..##../#...##/.##.##/.###.#/##..../.#.##.",
            ),
            ("DICT_APRILTAG_25h9", "#...#/#####/.#..#/##.#./#.#.#", "#..../..###/.##../##.##/#..#."),
            ("DICT_APRILTAG_16h5", "##.#/#.../##../.#..", "..#./##.#/##../#..#"),
        ];
        for (name, first, other) in drawn {
            let dictionary: Dictionary = name.parse().unwrap();
            let family = dictionary.family;
            for (id, rows) in [(0, first), (17, other)] {
                let light = family.light(id, 0).unwrap();
                let lines = light.chunks(family.inner_side());
                let lines = lines.map(|row| row.iter().map(|light| if *light { '#' } else { '.' }).collect::<String>());
                let found = lines.collect::<Vec<_>>().join("/");
                assert_eq!(found, if family.is_april() { turned(rows) } else { rows.to_owned() }, "{name} {id}");
            }
            assert!(family.code(dictionary.tags - 1).is_some());
        }
    }

    /// The first codes in the tables of AprilTag's authors; Kalibr prints them from the top left with the highest bit
    /// first.
    #[test]
    fn april_tags_are_upright_as_kalibr_prints_them() {
        let first = |family: TagFamily| family.code(0).unwrap();
        assert_eq!(first(TagFamily::April36h11), 0xd_5d62_8584);
        assert_eq!(first(TagFamily::April25h9), 0x155_cbf1);
        assert_eq!(first(TagFamily::April16h5), 0x231b);
    }

    #[test]
    fn families_and_dictionaries_have_the_same_number_of_tags() {
        for dictionary in Dictionary::all().filter(|dictionary| !matches!(dictionary.tags, 50 | 100 | 250)) {
            assert!(dictionary.family.code(dictionary.tags - 1).is_some(), "{dictionary}");
            assert_eq!(dictionary.family.code(dictionary.tags), None, "{dictionary}");
        }
    }

    #[test]
    fn the_border_is_dark() {
        for border in [1, 2] {
            let light = TagFamily::April36h11.light(0, border).unwrap();
            let side = 6 + 2 * usize::from(border);
            assert_eq!(light.len(), side * side);
            let inner = light.iter().enumerate().filter(|(_, light)| **light);
            let edge = usize::from(border)..side - usize::from(border);
            assert!(
                inner.clone().all(|(module, _)| edge.contains(&(module / side)) && edge.contains(&(module % side)))
            );
            assert_eq!(inner.count() as u32, TagFamily::April36h11.code(0).unwrap().count_ones());
        }
    }

    #[test]
    fn dictionaries_have_the_names_of_both_libraries() {
        for dictionary in Dictionary::all() {
            assert_eq!(dictionary.to_string().parse(), Ok(dictionary));
        }
        for name in ["36h11", "tag36h11", "TAG36H11", "apriltag_36h11", "dict_apriltag_36h11"] {
            assert_eq!(name.parse(), Ok(Dictionary::APRIL_36H11), "{name}");
        }
        for name in ["", "DICT_", "5X5", "36h9", "4X4_500"] {
            assert_eq!(name.parse::<Dictionary>(), Err(UnknownDictionary), "{name}");
        }
    }
}
