//! A board sheet as SVG.

use svg::Document;
use svg::node::element::{Circle, Group, Line, Path, Rectangle, Title};

use super::{BoardSheet, Dot};
use crate::board::squares::raster::Rectangle as Dark;

/// Returns the sheet as an SVG of exactly its size; one user unit is one millimetre.
pub fn svg(sheet: &BoardSheet) -> String {
    let [width, height] = sheet.size;
    let mut lines = Group::new().set("stroke", "black");
    for line in &sheet.lines {
        let ([x1, y1], [x2, y2]) = (line.from, line.to);
        let drawn = Line::new().set("x1", x1).set("y1", y1).set("x2", x2).set("y2", y2);
        lines = lines.add(drawn.set("stroke-width", line.width));
    }
    let mut words = Group::new().set("fill", "none").set("stroke", "black");
    words = words.set("stroke-linecap", "round").set("stroke-linejoin", "round");
    for line in &sheet.words {
        let strokes: String = line.strokes().iter().map(|stroke| polyline(stroke)).collect();
        let drawn = Path::new().set("aria-label", line.text.as_str()).set("d", strokes);
        words = words.add(drawn.set("stroke-width", micrometres(line.stroke_width())));
    }
    let document = Document::new()
        .set("width", format!("{width}mm"))
        .set("height", format!("{height}mm"))
        .set("viewBox", format!("0 0 {width} {height}"))
        .add(Title::new(format!("Board {}", sheet.board)))
        .add(Rectangle::new().set("width", width).set("height", height).set("fill", "white"))
        .add(dark(&sheet.dots, &[&sheet.rectangles, &sheet.code]))
        .add(lines)
        .add(words);
    format!("{document}\n")
}

/// Returns dots and rectangles in black.
pub(super) fn dark(dots: &[Dot], rectangles: &[&[Dark]]) -> Group {
    let mut dark = Group::new().set("fill", "black");
    for dot in dots {
        dark = dark.add(Circle::new().set("cx", dot.center[0]).set("cy", dot.center[1]).set("r", dot.radius));
    }
    for parts in rectangles.iter().filter(|parts| !parts.is_empty()) {
        dark = dark.add(Path::new().set("d", outlines(parts)));
    }
    dark
}

/// Returns the outlines of all parts as one path, because viewers show seams between parts that are filled separately.
fn outlines(parts: &[Dark]) -> String {
    let outline =
        |Dark { low: [left, top], high: [right, bottom] }: &Dark| format!("M{left} {top}H{right}V{bottom}H{left}Z");
    parts.iter().map(outline).collect()
}

/// Returns the path of a stroke; a path to its own start is a dot.
fn polyline(stroke: &[[f64; 2]]) -> String {
    let ends: Vec<String> = stroke.iter().map(|at| at.map(|value| micrometres(value).to_string()).join(" ")).collect();
    match ends.as_slice() {
        [only] => format!("M{only}L{only}"),
        ends => format!("M{}", ends.join("L")),
    }
}

fn micrometres(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}
