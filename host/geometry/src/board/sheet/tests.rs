use super::*;

const MARGIN: f64 = 10.0;

fn board(text: &str) -> CircleBoard {
    text.parse().unwrap()
}

fn paper(text: &str) -> Paper {
    text.parse().unwrap()
}

#[test]
fn everything_keeps_off_the_margin_and_marks_keep_off_the_dots() {
    for (text, paper_name) in [
        ("acircles:9x4:20mm:r6mm", "a4"),
        ("acircles:4x9:13mm:r4mm", "letter"),
        ("circles:5x8:25mm:r8mm", "a3"),
        ("circles:2x2:8mm:r3mm", "100x90mm"),
    ] {
        let sheet = board_sheet(&board(text), &paper(paper_name), MARGIN).unwrap();
        let inside = |[x, y]: [f64; 2], around: f64| {
            let keeps = |at: f64, size: f64| at - around >= MARGIN - 1e-9 && at + around <= size - MARGIN + 1e-9;
            keeps(x, sheet.size[0]) && keeps(y, sheet.size[1])
        };
        assert_eq!(sheet.dots.len(), board(text).circle_count());
        assert!(sheet.dots.iter().all(|dot| inside(dot.center, dot.radius)), "{text}");
        for line in &sheet.lines {
            assert!(inside(line.from, 0.0) && inside(line.to, 0.0), "{text}: {line:?}");
            for dot in &sheet.dots {
                for end in [line.from, line.to] {
                    let away = (end[0] - dot.center[0]).hypot(end[1] - dot.center[1]) - dot.radius;
                    assert!(away >= CLEARANCE - 2.0, "{text}: {line:?} {dot:?}");
                }
            }
        }
        for words in &sheet.words {
            let end = [words.at[0] + words.text.len() as f64 * LETTER_WIDTH, words.at[1]];
            assert!(inside(words.at, 0.0) && inside(end, 0.0) && words.text.is_ascii(), "{text}: {words:?}");
            let lowest = sheet.dots.iter().map(|dot| dot.center[1] + dot.radius).fold(0.0, f64::max);
            assert!(words.text == "x" || words.at[1] - words.size > lowest + CLEARANCE - 2.0, "{text}");
        }
    }
}

#[test]
fn the_sheet_lies_where_the_board_is_wide() {
    let upright = board_sheet(&board("acircles:9x4:20mm:r6mm"), &paper("a4"), MARGIN).unwrap();
    let lying = board_sheet(&board("acircles:5x7:19mm:r6mm"), &paper("a4"), MARGIN).unwrap();
    assert_eq!((upright.size, lying.size), ([210.0, 297.0], [297.0, 210.0]));
    assert_eq!(upright.ruler, 100.0);
}

#[test]
fn what_does_not_fit_is_told_what_does() {
    let error = board_sheet(&board("acircles:9x4:55mm:r17.5mm"), &paper("a4"), MARGIN).unwrap_err();
    let largest = error.largest.unwrap();
    assert!(board_sheet(&largest, &paper("a4"), MARGIN).is_ok());
    let more = CircleBoard { spacing: largest.spacing + 1e-3, ..largest };
    assert!(board_sheet(&more, &paper("a4"), MARGIN).is_err());
    assert!(error.papers.contains(&"a1") && !error.papers.contains(&"a2"), "{error}");
    let [width, height] = error.needed;
    let exact = Paper { name: "custom", size: [width.min(height), width.max(height)] };
    assert!(board_sheet(&board("acircles:9x4:55mm:r17.5mm"), &exact, MARGIN).is_ok(), "{error}");
    let text = error.to_string();
    assert!(text.contains(&largest.to_string()) && text.contains("fits on a1"), "{text}");
    let huge = board_sheet(&board("circles:9x9:1m:r10cm"), &paper("a4"), MARGIN).unwrap_err().to_string();
    assert!(huge.contains("no paper that evcal knows"), "{huge}");
    let tiny = board_sheet(&board("circles:9x9:1m:r10cm"), &paper("30x30mm"), MARGIN).unwrap_err().to_string();
    assert!(tiny.contains("too small for any board"), "{tiny}");
}

#[test]
fn the_default_board_has_the_proportions_of_the_documentation() {
    let pattern = Pattern { layout: Layout::Asymmetric, rows: 9, columns: 4 };
    let fits = board_that_fits(pattern, &paper("a4"), MARGIN).unwrap();
    assert!(fits.spacing >= 0.023 && (fits.radius / fits.spacing - RADIUS_BY_SPACING).abs() < 0.005, "{fits}");
    assert!(fits.to_string().parse::<CircleBoard>().is_ok());
}
