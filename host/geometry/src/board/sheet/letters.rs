//! Letters made of strokes, so that a sheet looks the same in every viewer, whatever fonts it has.
//!
//! A letter is drawn on a lattice: x from 0 to 4, y upwards from 0 (descenders) over 2 (base line) and 6 (small letters) to 8
//! (capitals). One step is a tenth of the size of the letters, and a letter is six steps wide.

/// Position of the base line on the lattice.
const BASE_LINE: f64 = 2.0;
/// White space to the left of a letter, in steps of the lattice.
const BEARING: f64 = 1.0;
/// Steps of the lattice per size of the letters.
pub const STEPS: f64 = 10.0;
/// Width of the strokes in steps of the lattice.
pub const STROKE: f64 = 0.85;
/// Length of a stroke of one corner in steps of the lattice.
const DOT: f64 = 0.5;
/// Width of a letter in steps of the lattice.
pub const ADVANCE: f64 = 6.0;

/// Each letter with its strokes, which `|` separates; each pair of digits is a corner. A stroke of one corner is a dot.
const LETTERS: [(char, &str); 77] = [
    ('0', "12 32 43 47 38 18 07 03 12|14 36"),
    ('1', "07 28 22|02 42"),
    ('2', "07 18 38 47 46 02 42"),
    ('3', "07 18 38 47 46 35 15|35 44 43 32 12 03"),
    ('4', "32 38 04 44"),
    ('5', "48 08 05 35 44 43 32 12 03"),
    ('6', "47 38 18 07 03 12 32 43 44 35 15 04"),
    ('7', "08 48 12"),
    ('8', "15 06 07 18 38 47 46 35 15 04 03 12 32 43 44 35"),
    ('9', "03 12 32 43 47 38 18 07 06 15 35 46"),
    ('A', "02 06 28 46 42|04 44"),
    ('B', "02 08 38 47 46 35 05|35 44 43 32 02"),
    ('C', "47 38 18 07 03 12 32 43"),
    ('D', "02 08 28 46 44 22 02"),
    ('E', "48 08 02 42|05 35"),
    ('F', "48 08 02|05 35"),
    ('G', "47 38 18 07 03 12 32 43 45 25"),
    ('H', "02 08|42 48|05 45"),
    ('I', "12 32|22 28|18 38"),
    ('J', "28 48|38 33 22 12 03"),
    ('K', "02 08|48 05 42"),
    ('L', "08 02 42"),
    ('M', "02 08 25 48 42"),
    ('N', "02 08 42 48"),
    ('O', "12 32 43 47 38 18 07 03 12"),
    ('P', "02 08 38 47 46 35 05"),
    ('Q', "12 32 43 47 38 18 07 03 12|24 42"),
    ('R', "02 08 38 47 46 35 05|25 42"),
    ('S', "47 38 18 07 06 15 35 44 43 32 12 03"),
    ('T', "08 48|28 22"),
    ('U', "08 03 12 32 43 48"),
    ('V', "08 22 48"),
    ('W', "08 12 25 32 48"),
    ('X', "02 48|08 42"),
    ('Y', "08 25 48|25 22"),
    ('Z', "08 48 02 42"),
    ('a', "16 36 45 42|43 32 12 03 14 44"),
    ('b', "08 02|03 12 32 43 45 36 16 05"),
    ('c', "45 36 16 05 03 12 32 43"),
    ('d', "48 42|43 32 12 03 05 16 36 45"),
    ('e', "04 44 45 36 16 05 03 12 42"),
    ('f', "48 38 27 22|06 46"),
    ('g', "46 41 30 10 01|43 32 12 03 05 16 36 45"),
    ('h', "08 02|05 16 36 45 42"),
    ('i', "16 26 22|12 32|28"),
    ('j', "16 36 31 20 10|38"),
    ('k', "08 02|46 04 42"),
    ('l', "18 28 22|12 32"),
    ('m', "02 06|05 16 25 22|25 36 45 42"),
    ('n', "02 06|05 16 36 45 42"),
    ('o', "12 32 43 45 36 16 05 03 12"),
    ('p', "00 06|05 16 36 45 43 32 12 03"),
    ('q', "40 46|45 36 16 05 03 12 32 43"),
    ('r', "12 16|15 26 36 45"),
    ('s', "46 16 05 14 34 43 32 02"),
    ('t', "18 13 22 42|06 36"),
    ('u', "06 03 12 32 43|46 42"),
    ('v', "06 22 46"),
    ('w', "06 12 24 32 46"),
    ('x', "02 46|06 42"),
    ('y', "06 22|46 10"),
    ('z', "06 46 02 42"),
    ('.', "22"),
    (',', "22 11"),
    (':', "22|25"),
    (';', "25|22 11"),
    ('-', "04 44"),
    ('_', "01 41"),
    ('/', "02 48"),
    ('%', "02 48|07 08 18 17 07|32 33 43 42 32"),
    ('(', "38 27 23 32"),
    (')', "18 27 23 12"),
    ('+', "04 44|22 26"),
    ('=', "03 43|05 45"),
    ('<', "46 04 42"),
    ('>', "06 44 02"),
    ('\'', "28 26"),
];

/// Strokes of a character without a letter: a box.
const BOX: &str = "02 08 48 42 02";

/// Returns the corners of each stroke of a letter, in steps of the lattice from the left end of the base line, y upwards.
pub fn strokes(letter: char) -> Vec<Vec<[f64; 2]>> {
    if letter == ' ' {
        return Vec::new();
    }
    let written = LETTERS.iter().find(|(known, _)| *known == letter).map_or(BOX, |(_, strokes)| strokes);
    let corner = |pair: &str| {
        let mut digits = pair.chars().filter_map(|digit| digit.to_digit(10)).map(f64::from);
        Some([digits.next()? + BEARING, digits.next()? - BASE_LINE])
    };
    let stroke = |written: &str| {
        let mut corners: Vec<[f64; 2]> = written.split(' ').filter_map(corner).collect();
        // Viewers draw a stroke without a length as a hairline.
        if let [[x, y]] = corners[..] {
            corners.push([x + DOT, y]);
        }
        corners
    };
    written.split('|').map(stroke).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_differ_and_keep_within_their_width() {
        for (index, (letter, written)) in LETTERS.iter().enumerate() {
            let later = LETTERS.iter().skip(index + 1);
            assert!(later.clone().all(|(other, strokes)| other != letter && strokes != written), "{letter}");
            let corners: Vec<[f64; 2]> = strokes(*letter).concat();
            let dots = written.split('|').filter(|stroke| stroke.len() == 2).count();
            assert_eq!(corners.len(), written.split(['|', ' ']).count() + dots, "{letter}");
            assert!(corners.iter().all(|[x, y]| (1.0..=5.0).contains(x) && (-2.0..=6.0).contains(y)), "{letter}");
        }
        assert!(strokes(' ').is_empty());
        assert_eq!(strokes('~'), strokes('\u{fc}'), "both are boxes");
    }
}
