//! Updates the tables of `docs/settings.md`: `cargo run -p evcal --example settings_document`.

use std::error::Error;
use std::path::Path;

use evcal_calibrate::settings::document;

fn main() -> Result<(), Box<dyn Error>> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/settings.md");
    let text = document(&std::fs::read_to_string(&path)?).ok_or("docs/settings.md has lost the marks of its tables")?;
    std::fs::write(&path, text)?;
    Ok(())
}
