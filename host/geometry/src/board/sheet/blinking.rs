//! A board that blinks on a screen, as a page for a browser.

use svg::Document;
use svg::node::element::Rectangle;

use super::svg::dark;
use super::{CLEARANCE, Printable, Shapes};

/// Returns a self-contained HTML page that shows `board` on and off, in its size once the screen was measured.
pub fn blinking_page(board: &impl Printable) -> String {
    let [width, height] = board.size().map(|side| side + 2.0 * CLEARANCE);
    let Shapes { dots, rectangles, .. } = board.shapes([CLEARANCE; 2]);
    let drawn = Document::new()
        .set("viewBox", format!("0 0 {width} {height}"))
        .add(Rectangle::new().set("width", width).set("height", height).set("fill", "white"))
        .add(dark(&dots, &[&rectangles]));
    let places = [
        ("{svg}", drawn.to_string()),
        ("{board}", board.to_string()),
        ("{width}", width.to_string()),
        ("{height}", height.to_string()),
    ];
    places.iter().fold(include_str!("blinking.html").to_owned(), |page, (place, value)| page.replace(place, value))
}
