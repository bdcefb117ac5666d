//! A board sheet as SVG.

use svg::Document;
use svg::node::element::{Circle, Group, Line, Path, Rectangle, Text, Title};

use super::BoardSheet;

/// Returns the sheet as an SVG of exactly its size; one user unit is one millimetre.
pub fn svg(sheet: &BoardSheet) -> String {
    let [width, height] = sheet.size;
    let mut dark = Group::new().set("fill", "black");
    for dot in &sheet.dots {
        dark = dark.add(Circle::new().set("cx", dot.center[0]).set("cy", dot.center[1]).set("r", dot.radius));
    }
    if !sheet.rectangles.is_empty() {
        // One path, because viewers show seams between parts that are filled separately.
        let outlines = sheet.rectangles.iter().map(|rectangle| {
            let ([left, top], [right, bottom]) = (rectangle.low, rectangle.high);
            format!("M{left} {top}H{right}V{bottom}H{left}Z")
        });
        dark = dark.add(Path::new().set("d", outlines.collect::<String>()));
    }
    let mut lines = Group::new().set("stroke", "black");
    for line in &sheet.lines {
        let ([x1, y1], [x2, y2]) = (line.from, line.to);
        let drawn = Line::new().set("x1", x1).set("y1", y1).set("x2", x2).set("y2", y2);
        lines = lines.add(drawn.set("stroke-width", line.width));
    }
    let mut words = Group::new().set("fill", "black").set("font-family", "Courier, 'Courier New', monospace");
    for line in &sheet.words {
        let length = line.text.len() as f64 * 0.6 * line.size;
        let text = Text::new(&line.text).set("x", line.at[0]).set("y", line.at[1]).set("font-size", line.size);
        words = words.add(text.set("textLength", length).set("lengthAdjust", "spacingAndGlyphs"));
    }
    let document = Document::new()
        .set("width", format!("{width}mm"))
        .set("height", format!("{height}mm"))
        .set("viewBox", format!("0 0 {width} {height}"))
        .add(Title::new(format!("Board {}", sheet.board)))
        .add(Rectangle::new().set("width", width).set("height", height).set("fill", "white"))
        .add(dark)
        .add(lines)
        .add(words);
    format!("{document}\n")
}
