//! Cameras with a matrix of 3 × 3: OpenCV, ROS and DV.

use evcal_core::camera::ModelKind;
use yaml_rust2::Yaml;

use super::{YamlError, file, number, numbers, radtan, unknown, whole};
use crate::lens::camera_file::CameraFile;

/// Entries of the matrix that are not zero (or one) by less than this, in units of the focal length, are rounding errors: they
/// move no pixel by a millionth of its size.
const NEGLIGIBLE: f64 = 1e-9;

/// Kind of a distortion, under any of its names.
#[derive(Clone, Copy, PartialEq)]
enum Distortion {
    Radtan,
    Fisheye,
    Omni,
}

/// Reads OpenCV's form, which is also the form of `camera_info.yaml`. In DV's files, the model is named by the `root` of the file.
pub(super) fn camera(node: &Yaml, root: &Yaml) -> Result<CameraFile, YamlError> {
    let matrix = numbers(&node["camera_matrix"]["data"]).ok_or(YamlError::Missing("camera_matrix with data"))?;
    let coefficients = numbers(&node["distortion_coefficients"]["data"]);
    let coefficients = coefficients.ok_or(YamlError::Missing("distortion_coefficients with data"))?;
    check_part_of_image(node)?;
    let xi = Some(&node["xi"]).filter(|xi| !xi.is_badvalue());
    // A number, or a matrix with one.
    let xi = xi.map(|xi| number(xi).or_else(|| numbers(&xi["data"])?.first().copied()));
    let xi = xi.map(|xi| xi.ok_or(YamlError::Missing("xi in numbers"))).transpose()?;
    let size = [&node["image_width"], &node["image_height"]];
    let distortion = distortion(node, root, xi.is_some())?;
    if distortion.is_none() && coefficients.len() == 4 {
        return Err(YamlError::TwoMeanings);
    }
    with_matrix(&matrix, distortion.unwrap_or(Distortion::Radtan), xi, coefficients, size)
}

/// Reads a `CameraInfo` message of ROS 1 or 2 as `rostopic echo` and `ros2 topic echo` print it, or as JSON.
pub(super) fn message_camera(message: &Yaml) -> Result<CameraFile, YamlError> {
    let field = |names: [&str; 2]| {
        names.into_iter().map(|name| &message[name]).find(|field| !field.is_badvalue()).unwrap_or(&Yaml::BadValue)
    };
    let matrix = numbers(field(["k", "K"])).ok_or(YamlError::Missing("k of 9 numbers"))?;
    let coefficients = numbers(field(["d", "D"])).ok_or(YamlError::Missing("d in numbers"))?;
    check_part_of_image(message)?;
    let distortion = distortion(message, message, false)?.unwrap_or(Distortion::Radtan);
    with_matrix(&matrix, distortion, None, coefficients, [&message["width"], &message["height"]])
}

fn with_matrix(
    matrix: &[f64],
    distortion: Distortion,
    xi: Option<f64>,
    coefficients: Vec<f64>,
    size: [&Yaml; 2],
) -> Result<CameraFile, YamlError> {
    let &[fx, skew, cx, below, fy, cy, x, y, one] = matrix else {
        return Err(YamlError::Missing("camera matrix of 9 numbers"));
    };
    if skew.abs() > NEGLIGIBLE * fx.abs() {
        return Err(YamlError::Part(format!("a skew of {skew} px (second number of the camera matrix)")));
    }
    if below.abs() > NEGLIGIBLE * fy.abs() {
        return Err(YamlError::Part(format!("{below} below fx in the camera matrix, where 0 is usual")));
    }
    if [x, y, one - 1.0].iter().any(|rest| rest.abs() > NEGLIGIBLE) {
        return Err(YamlError::Part(format!("{x} {y} {one} as third row of the camera matrix, where 0 0 1 is usual")));
    }
    let (kind, coefficients) = match (distortion, coefficients.len()) {
        (Distortion::Radtan, _) => radtan("pinhole", "radtan", coefficients)?,
        (Distortion::Fisheye, 4) => (ModelKind::KannalaBrandt, coefficients),
        (Distortion::Omni, 4) => {
            (ModelKind::Omni, [&[xi.ok_or(YamlError::Missing("xi"))?], coefficients.as_slice()].concat())
        }
        (Distortion::Fisheye, count) => return Err(unknown("pinhole", "fisheye", count)),
        (Distortion::Omni, count) => return Err(unknown("pinhole", "omnidir", count)),
    };
    file(kind, &[&[fx, fy, cx, cy], coefficients.as_slice()].concat(), size)
}

/// Returns the distortion that a file names, in the words of OpenCV's programs, of ROS or of DV; `None` if it names none.
fn distortion(node: &Yaml, root: &Yaml, has_xi: bool) -> Result<Option<Distortion>, YamlError> {
    let mut named: Option<(Distortion, [String; 2])> = None;
    let nodes: &[&Yaml] = if std::ptr::eq(node, root) { &[node] } else { &[node, root] };
    let words =
        nodes.iter().filter_map(|node| Some(("distortion_model", node["distortion_model"].as_str()?.to_owned())));
    let flag = |name: &'static str| {
        let value = nodes.iter().map(|node| &node[name]).find(|value| !value.is_badvalue())?;
        let value = whole(value).or_else(|| value.as_bool().map(i64::from));
        Some((name, value.map_or_else(|| "an unknown value".to_owned(), |value| value.to_string())))
    };
    let flags = ["fisheye_model", "use_fisheye_model"].into_iter().filter_map(flag);
    let xi = has_xi.then(|| ("xi", "a number".to_owned()));
    for (key, value) in words.chain(flags).chain(xi) {
        let distortion = match (key, value.to_lowercase().as_str()) {
            ("xi", _) | ("distortion_model", "omnidir") => Distortion::Omni,
            ("distortion_model", "radtan" | "plumb_bob" | "rational_polynomial" | "radialtangential") => {
                Distortion::Radtan
            }
            ("distortion_model", "fisheye" | "equidistant") => Distortion::Fisheye,
            ("distortion_model", _) => return Err(unknown("pinhole", &value, coefficient_count(node))),
            (_, "0") => Distortion::Radtan,
            (_, "1") => Distortion::Fisheye,
            _ => return Err(YamlError::Part(format!("{key} = {value}"))),
        };
        match &named {
            Some((other, [first_key, first_value])) if *other != distortion => {
                return Err(YamlError::Contradiction([first_key.clone(), first_value.clone(), key.to_owned(), value]));
            }
            _ => named = Some((distortion, [key.to_owned(), value])),
        }
    }
    Ok(named.map(|(distortion, _)| distortion))
}

fn coefficient_count(node: &Yaml) -> usize {
    let lists = [&node["distortion_coefficients"]["data"], &node["d"], &node["D"]];
    lists.iter().filter_map(|list| list.as_vec()).map(Vec::len).next().unwrap_or(0)
}

/// Rejects cameras whose pixels are not those of the images: ROS counts the matrix in pixels of the whole sensor.
fn check_part_of_image(node: &Yaml) -> Result<(), YamlError> {
    for name in ["binning_x", "binning_y"] {
        if let Some(binning @ 2..) = whole(&node[name]) {
            return Err(YamlError::Part(format!("binned pixels ({name} = {binning})")));
        }
    }
    let roi = &node["roi"];
    let size = |names: [&str; 2]| names.into_iter().find_map(|name| whole(&node[name])).unwrap_or(0);
    let is_part = ["x_offset", "y_offset"].iter().any(|name| whole(&roi[*name]).unwrap_or(0) != 0)
        || [("width", size(["width", "image_width"])), ("height", size(["height", "image_height"]))]
            .iter()
            .any(|(name, size)| whole(&roi[*name]).is_some_and(|part| part != 0 && part != *size));
    if is_part {
        return Err(YamlError::Part("a region of interest (roi) that is not the whole image".to_owned()));
    }
    Ok(())
}
