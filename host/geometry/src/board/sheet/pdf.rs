//! A board sheet as PDF.

use std::f64::consts::TAU;

use pdf_writer::{Content, Finish, Name, Pdf, Rect, Ref, Str, TextStr};

use super::{BoardSheet, Dot};

/// Points per millimetre.
const POINTS: f64 = 72.0 / 25.4;

/// Number of curves that form a circle: with eight the error is at most 4·10⁻⁶ of the radius.
const CURVES: u32 = 8;

/// Returns the sheet as a PDF of one page of exactly its size, with the request to viewers not to scale it for
/// printing.
pub fn pdf(sheet: &BoardSheet) -> Vec<u8> {
    let [catalog, pages, page, content, font, information] = [1, 2, 3, 4, 5, 6].map(Ref::new);
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
    // A font that every viewer has.
    pdf.type1_font(font).base_font(Name(b"Courier")).encoding_predefined(Name(b"WinAnsiEncoding"));
    pdf.stream(content, &drawing(sheet, letters));
    pdf.finish()
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
    if !sheet.rectangles.is_empty() {
        // One path, because viewers show seams between parts that are filled separately.
        for rectangle in &sheet.rectangles {
            let ([left, top], [right, bottom]) = (point(rectangle.low), point(rectangle.high));
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
