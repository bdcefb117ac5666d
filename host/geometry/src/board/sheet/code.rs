//! QR code of a text.

use qrcodegen::{QrCode, QrCodeEcc};

use crate::board::squares::raster::Rectangle;

/// Side of a module (mm), which the camera of a telephone resolves at arm's length.
pub const MODULE: f64 = 0.5;
/// White space that readers need around a code (mm): four modules.
pub const QUIET: f64 = 4.0 * MODULE;

/// The dark parts of a QR code.
pub struct Code {
    /// Its side (mm).
    pub side: f64,
    /// Its dark modules, in mm from its top left corner.
    modules: Vec<Rectangle>,
}

impl Code {
    /// Returns the code of a text; `None` if the text is too long.
    pub fn of(text: &str) -> Option<Self> {
        let code = QrCode::encode_text(text, QrCodeEcc::Medium).ok()?;
        let places = (0..code.size()).flat_map(|row| (0..code.size()).map(move |column| (column, row)));
        let modules = places.filter(|(column, row)| code.get_module(*column, *row)).map(|(column, row)| {
            let at = |column: i32, row: i32| [column, row].map(|index| f64::from(index) * MODULE);
            Rectangle { low: at(column, row), high: at(column + 1, row + 1) }
        });
        Some(Self { side: f64::from(code.size()) * MODULE, modules: modules.collect() })
    }

    /// Returns the dark modules of the code with its top left corner at `corner` (mm).
    pub fn at(&self, corner: [f64; 2]) -> Vec<Rectangle> {
        let place = |[x, y]: [f64; 2]| [x + corner[0], y + corner[1]];
        self.modules.iter().map(|dark| Rectangle { low: place(dark.low), high: place(dark.high) }).collect()
    }
}
