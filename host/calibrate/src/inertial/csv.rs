//! IMU samples from a text file whose first line names columns and units.

use std::io;
use std::path::{Path, PathBuf};

use evcal_files::text::excerpt;
use nalgebra::Vector3;

use super::sample::Sample;
use evcal_geometry::numerics::gravity::STANDARD_GRAVITY;

/// Reasons why a file of samples could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CsvError {
    /// Reading the file failed.
    #[error("{}: {error}; is the path right?", path.display())]
    Io {
        /// The file name.
        path: PathBuf,
        /// The reason.
        error: io::Error,
    },
    /// A column or its unit is missing.
    #[error(
        "{}, line 1: no column for {what} with its unit: name the columns, for example t_us,ax_g,ay_g,az_g,gx_deg_s,gy_deg_s,gz_deg_s (times in s, ms, us or ns; accelerations in g or m_s2; angular velocities in deg_s or rad_s), or as in EuRoC's data.csv",
        path.display()
    )]
    Column {
        /// The file name.
        path: PathBuf,
        /// The missing quantity.
        what: &'static str,
    },
    /// A line cannot be read.
    #[error("{}, line {line}: {text:?} is not a number: correct or delete the line", path.display())]
    Number {
        /// The file name.
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        /// The text found there.
        text: String,
    },
}

impl evcal_files::remedy::Remedy for CsvError {}

/// A quantity: names with which its column begins, and the factor of each unit to SI.
struct Quantity {
    what: &'static str,
    names: &'static [&'static str],
    units: &'static [(&'static str, f64)],
}

const TIME: &[(&str, f64)] = &[("ns", 1e-9), ("us", 1e-6), ("µs", 1e-6), ("ms", 1e-3), ("s", 1.0)];
/// Units of accelerations, each with its size in m/s².
pub(super) const ACCELERATION: &[(&str, f64)] =
    &[("g", STANDARD_GRAVITY), ("m_s2", 1.0), ("m s^-2", 1.0), ("m/s^2", 1.0), ("m/s²", 1.0)];
/// Units of angular velocities, each with its size in rad/s.
pub(super) const RATE: &[(&str, f64)] = &[
    ("deg_s", std::f64::consts::PI / 180.0),
    ("deg/s", std::f64::consts::PI / 180.0),
    ("°/s", std::f64::consts::PI / 180.0),
    ("rad_s", 1.0),
    ("rad s^-1", 1.0),
    ("rad/s", 1.0),
];

const QUANTITIES: [Quantity; 7] = [
    Quantity { what: "the time", names: &["t", "timestamp", "#timestamp"], units: TIME },
    Quantity { what: "the acceleration along x", names: &["ax", "a_RS_S_x"], units: ACCELERATION },
    Quantity { what: "the acceleration along y", names: &["ay", "a_RS_S_y"], units: ACCELERATION },
    Quantity { what: "the acceleration along z", names: &["az", "a_RS_S_z"], units: ACCELERATION },
    Quantity { what: "the angular velocity about x", names: &["gx", "wx", "w_RS_S_x"], units: RATE },
    Quantity { what: "the angular velocity about y", names: &["gy", "wy", "w_RS_S_y"], units: RATE },
    Quantity { what: "the angular velocity about z", names: &["gz", "wz", "w_RS_S_z"], units: RATE },
];

/// Reads the samples of `path`; times are as in the file, in seconds.
///
/// # Errors
/// [`CsvError`] names the line.
pub fn read(path: &Path) -> Result<Vec<Sample>, CsvError> {
    let text = evcal_files::text::table(path).map_err(|error| CsvError::Io { path: path.to_owned(), error })?;
    parse(path, &text)
}

fn parse(path: &Path, text: &str) -> Result<Vec<Sample>, CsvError> {
    // Spreadsheets begin a file with a byte order mark.
    let mut lines = text.trim_start_matches('\u{feff}').lines().enumerate();
    let header = lines.next().map_or("", |(_, line)| line);
    let columns = columns(path, header)?;
    let mut samples = Vec::new();
    // Nanoseconds since 1970 have more digits than a floating point number, so integer times are relative to the first one.
    let mut origin = None;
    for (line, content) in lines {
        if content.trim().is_empty() || content.starts_with('#') {
            continue;
        }
        let fields: Vec<&str> = content.split(',').map(str::trim).collect();
        let mut values = [0.0; QUANTITIES.len()];
        for (place, (value, (column, factor))) in values.iter_mut().zip(&columns).enumerate() {
            let field = fields.get(*column).copied().unwrap_or_default();
            let wrong =
                || CsvError::Number { path: path.to_owned(), line: line + 1, text: excerpt(field).into_owned() };
            let number = || field.parse::<f64>().ok().filter(|value| value.is_finite()).ok_or_else(wrong);
            *value = factor
                * match (place, field.parse::<i64>()) {
                    (0, Ok(whole)) => whole.saturating_sub(*origin.get_or_insert(whole)) as f64,
                    (0, Err(_)) => number()? - *origin.get_or_insert(0) as f64,
                    _ => number()?,
                };
        }
        let [t, ax, ay, az, gx, gy, gz] = values;
        samples.push(Sample { t, acceleration: Vector3::new(ax, ay, az), angular_velocity: Vector3::new(gx, gy, gz) });
    }
    let shift = origin.zip(columns.first()).map_or(0.0, |(origin, (_, factor))| origin as f64 * factor);
    samples.iter_mut().for_each(|sample| sample.t += shift);
    Ok(samples)
}

/// Returns the column and the factor of the unit for each quantity.
fn columns(path: &Path, header: &str) -> Result<Vec<(usize, f64)>, CsvError> {
    let titles: Vec<&str> = header.split(',').map(str::trim).collect();
    let find = |quantity: &Quantity| {
        titles.iter().enumerate().find_map(|(column, title)| {
            let unit = quantity.names.iter().filter_map(|name| title.strip_prefix(name)).find_map(|rest| {
                let unit = rest.strip_prefix('_').or_else(|| rest.trim().strip_prefix('[')?.strip_suffix(']'))?;
                quantity.units.iter().find(|(name, _)| *name == unit.trim()).map(|(_, factor)| *factor)
            });
            unit.map(|factor| (column, factor))
        })
    };
    QUANTITIES
        .iter()
        .map(|quantity| find(quantity).ok_or(CsvError::Column { path: path.to_owned(), what: quantity.what }))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_found_by_name_and_unit() {
        let text = "t_us,ax_g,ay_g,az_g,gx_deg_s,gy_deg_s,gz_deg_s\n1000,0,-1,0.5,90,0,-180\n";
        let samples = parse(Path::new("imu.csv"), text).unwrap();
        assert_eq!(parse(Path::new("imu.csv"), &format!("\u{feff}{text}")).unwrap(), samples);
        assert!((samples[0].t - 1e-3).abs() < 1e-12);
        assert!((samples[0].acceleration - Vector3::new(0.0, -9.80665, 4.903325)).norm() < 1e-12);
        assert!((samples[0].angular_velocity.z + std::f64::consts::PI).abs() < 1e-12);
        let euroc = "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n\
                     1403636579758555392,1,2,3,4,5,6\n1403636579763555392,1,2,3,4,5,6\n";
        let samples = parse(Path::new("data.csv"), euroc).unwrap();
        assert!((samples[1].t - samples[0].t - 0.005).abs() < 1e-6);
        assert_eq!(samples[1].acceleration, Vector3::new(4.0, 5.0, 6.0));
    }

    #[test]
    fn whole_seconds_are_on_the_same_clock() {
        let line = |t: &str| format!("{t},0,1,0,0,0,0\n");
        for times in [["0.999", "1", "1.001"], ["1", "1.001", "2"], ["-0.5", "0", "0.5"]] {
            let text = format!("t_s,ax_g,ay_g,az_g,gx_deg_s,gy_deg_s,gz_deg_s\n{}", times.map(line).concat());
            let found: Vec<f64> = parse(Path::new("imu.csv"), &text).unwrap().iter().map(|sample| sample.t).collect();
            let wanted: Vec<f64> = times.iter().map(|t| t.parse().unwrap()).collect();
            assert!(found.iter().zip(&wanted).all(|(found, wanted)| (found - wanted).abs() < 1e-12), "{found:?}");
        }
    }

    #[test]
    fn mistakes_are_named() {
        let error = parse(Path::new("a.csv"), "t_us,ax,ay,az,gx,gy,gz\n").unwrap_err();
        assert!(error.to_string().contains("line 1: no column for the acceleration along x"), "{error}");
        let text = "t_us,ax_g,ay_g,az_g,gx_deg_s,gy_deg_s,gz_deg_s\n1,2,3,4,5,6,7\n1,2,3,4,x,6,7\n";
        let error = parse(Path::new("a.csv"), text).unwrap_err();
        assert!(error.to_string().contains("line 3: \"x\" is not a number"), "{error}");
    }
}
