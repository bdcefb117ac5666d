//! A board sheet as PDF.

use std::f64::consts::TAU;

use pdf_writer::types::{LineCapStyle, LineJoinStyle, SystemInfo, UnicodeCmap};
use pdf_writer::{Content, Finish, Name, Pdf, Rect, Ref, Str, TextStr};

use super::letters::{ADVANCE, STEPS, STROKE, strokes};
use super::{BoardSheet, Dot};
use crate::board::squares::raster::Rectangle;

/// Points per millimetre.
const POINTS: f64 = 72.0 / 25.4;

/// Number of curves that form a circle: with eight the error is at most 4·10⁻⁶ of the radius.
const CURVES: u32 = 8;

/// Returns the sheet as a PDF of one page of exactly its size, with the request to viewers not to scale it for
/// printing.
pub fn pdf(sheet: &BoardSheet) -> Vec<u8> {
    let [catalog, pages, page, content, font, information, names] = [1, 2, 3, 4, 5, 6, 7].map(Ref::new);
    let mut pdf = Pdf::new();
    let mut root = pdf.catalog(catalog);
    root.pages(pages);
    root.viewer_preferences().pair(Name(b"PrintScaling"), Name(b"None"));
    root.finish();
    pdf.document_info(information).title(TextStr(&format!("Board {}", sheet.board)));
    pdf.pages(pages).kids([page]).count(1);
    let letters = Name(b"Letters");
    let [width, height] = sheet.size.map(|side| (side * POINTS) as f32);
    let mut one = pdf.page(page);
    one.parent(pages).media_box(Rect::new(0.0, 0.0, width, height)).contents(content);
    one.resources().fonts().pair(letters, font);
    one.finish();
    pdf.stream(content, &drawing(sheet, letters));
    embed_letters(&mut pdf, font, names);
    pdf.finish()
}

/// Codes of the characters that can be written.
const CODES: std::ops::RangeInclusive<u8> = b' '..=b'~';

/// Writes the font with the letters of the sheet, and the characters that its codes mean. The text can be copied from the sheet.
fn embed_letters(pdf: &mut Pdf, font: Ref, names: Ref) {
    let step = (1.0 / STEPS) as f32;
    // A letter has the number of its code as its name, and a stream after the other objects.
    let letters: Vec<(u8, String, Ref)> =
        CODES.map(|code| (code, format!("c{code}"), Ref::new(names.get() + 1 + i32::from(code)))).collect();
    let mut written = pdf.type3_font(font);
    // The whole range of the letters, with their strokes.
    written.bbox(Rect::new(0.0, -3.0, ADVANCE as f32, 7.0)).matrix([step, 0.0, 0.0, step, 0.0, 0.0]);
    written.first_char(*CODES.start()).last_char(*CODES.end()).widths(CODES.map(|_| ADVANCE as f32));
    let mut shapes = written.char_procs();
    letters.iter().for_each(|(_, name, shape)| _ = shapes.pair(Name(name.as_bytes()), *shape));
    shapes.finish();
    let known = letters.iter().map(|(_, name, _)| Name(name.as_bytes()));
    written.encoding_custom().differences().consecutive(*CODES.start(), known);
    written.to_unicode(names);
    written.finish();
    let information = SystemInfo { registry: Str(b"Adobe"), ordering: Str(b"UCS"), supplement: 0 };
    let mut characters = UnicodeCmap::<u8>::new(Name(b"Letters"), information);
    for (code, _, shape) in letters {
        characters.pair(code, char::from(code));
        let mut content = Content::new();
        content.start_color_glyph(ADVANCE as f32).set_line_width(STROKE as f32);
        content.set_line_cap(LineCapStyle::RoundCap).set_line_join(LineJoinStyle::RoundJoin);
        for stroke in strokes(char::from(code)) {
            let mut corners = stroke.iter().map(|corner| corner.map(|value| value as f32));
            let Some([x, y]) = corners.next() else { continue };
            content.move_to(x, y);
            match stroke.len() {
                // A line to its own start is a dot.
                1 => _ = content.line_to(x, y),
                _ => corners.for_each(|[x, y]| _ = content.line_to(x, y)),
            }
            content.stroke();
        }
        pdf.stream(shape, &content.finish());
    }
    pdf.cmap(names, &characters.finish());
}

fn drawing(sheet: &BoardSheet, letters: Name) -> Vec<u8> {
    // The origin of PDF is the lower left corner.
    let point = |[x, y]: [f64; 2]| [x * POINTS, (sheet.size[1] - y) * POINTS].map(|value| value as f32);
    let mut content = Content::new();
    content.set_fill_gray(0.0).set_stroke_gray(0.0);
    for dot in &sheet.dots {
        circle(&mut content, dot, point);
        content.fill_nonzero();
    }
    for parts in [&sheet.rectangles, &sheet.code].into_iter().filter(|parts| !parts.is_empty()) {
        // One path, because viewers show seams between parts that are filled separately.
        for Rectangle { low, high } in parts {
            let ([left, top], [right, bottom]) = (point(*low), point(*high));
            content.move_to(left, top).line_to(right, top).line_to(right, bottom).line_to(left, bottom).close_path();
        }
        content.fill_nonzero();
    }
    for line in &sheet.lines {
        let ([x0, y0], [x1, y1]) = (point(line.from), point(line.to));
        content.set_line_width((line.width * POINTS) as f32).move_to(x0, y0).line_to(x1, y1).stroke();
    }
    for words in &sheet.words {
        let [x, y] = point(words.at);
        content.begin_text().set_font(letters, (words.size * POINTS) as f32).next_line(x, y);
        content.show(Str(words.text.as_bytes())).end_text();
    }
    content.finish().to_vec()
}

/// Draws a circle of cubic curves.
fn circle(content: &mut Content, dot: &Dot, point: impl Fn([f64; 2]) -> [f32; 2]) {
    let step = TAU / f64::from(CURVES);
    // Length of the handles with which the middle of each curve lies on the circle.
    let handle = 4.0 / 3.0 * libm::tan(step / 4.0);
    let at = |index: u32, along: f64| {
        let (sin, cos) = libm::sincos(step * f64::from(index));
        point([dot.center[0] + dot.radius * (cos - along * sin), dot.center[1] + dot.radius * (sin + along * cos)])
    };
    let [x, y] = at(0, 0.0);
    content.move_to(x, y);
    for index in 0..CURVES {
        let ([x1, y1], [x2, y2], [x3, y3]) = (at(index, handle), at(index + 1, -handle), at(index + 1, 0.0));
        content.cubic_to(x1, y1, x2, y2, x3, y3);
    }
    content.close_path();
}
