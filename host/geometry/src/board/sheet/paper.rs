//! Paper sizes.

use std::fmt;
use std::str::FromStr;

/// A paper size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Paper {
    /// Its name, lower case.
    pub name: &'static str,
    /// Shorter and longer side (mm).
    pub size: [f64; 2],
}

/// Paper sizes of ISO 216 and ANSI.
pub const PAPERS: &[Paper] = &[
    Paper { name: "a4", size: [210.0, 297.0] },
    Paper { name: "letter", size: [215.9, 279.4] },
    Paper { name: "a3", size: [297.0, 420.0] },
    Paper { name: "tabloid", size: [279.4, 431.8] },
    Paper { name: "a2", size: [420.0, 594.0] },
    Paper { name: "a1", size: [594.0, 841.0] },
    Paper { name: "a0", size: [841.0, 1189.0] },
];

/// Largest side (mm), a limit of PDF.
const LARGEST: f64 = 5000.0;

/// Error: a text is neither the name nor the size of a paper.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown paper {0:?}; write a4, a3, a2, a1, a0, letter, tabloid, or a size such as 600x400mm")]
pub struct UnknownPaper(String);

impl FromStr for Paper {
    type Err = UnknownPaper;

    fn from_str(text: &str) -> Result<Self, UnknownPaper> {
        let name = text.to_lowercase();
        if let Some(paper) = PAPERS.iter().find(|paper| paper.name == name) {
            return Ok(*paper);
        }
        let side = |part: &str| part.trim().parse().ok().filter(|side: &f64| *side > 0.0 && *side <= LARGEST);
        name.strip_suffix("mm")
            .and_then(|sides| sides.split_once('x'))
            .and_then(|(a, b)| Some([side(a)?, side(b)?]))
            .map(|[a, b]| Self { name: "custom", size: [a.min(b), a.max(b)] })
            .ok_or_else(|| UnknownPaper(text.to_owned()))
    }
}

impl fmt::Display for Paper {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, size: [width, height] } = self;
        if *name == "custom" { write!(f, "{width} x {height} mm") } else { write!(f, "{}", name.to_uppercase()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn papers_are_given_by_name_or_size() {
        assert_eq!("A4".parse::<Paper>().unwrap().size, [210.0, 297.0]);
        assert_eq!("600x400.5mm".parse::<Paper>().unwrap().size, [400.5, 600.0]);
        for text in ["", "a9", "600x400", "0x5mm", "-1x5mm", "nanx5mm", "1e9x5mm"] {
            assert!(text.parse::<Paper>().unwrap_err().to_string().contains("600x400mm"), "{text}");
        }
    }
}
