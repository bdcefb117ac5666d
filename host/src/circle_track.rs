//! (under construction)

/// Whether text begins with the header of a circle-track file.
pub fn is_circle_track(text: &str) -> bool {
    let header = text.lines().find(|line| !line.trim().is_empty() && !line.starts_with('#')).unwrap_or_default();
    let names: Vec<&str> = header.split(',').map(str::trim).collect();
    names.contains(&"x_px") && names.contains(&"y_px") && (names.contains(&"t_s") || names.contains(&"t_us"))
}
