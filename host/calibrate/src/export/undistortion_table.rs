//! The undistortion table of [`evcal_core::undistortion`] as source code for a device, in C or Rust.
//!
//! Both files are self-contained: they have the nodes, and a function that interpolates between them like
//! [`UndistortionTable::undistort`].

use std::fmt::Write as _;

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use evcal_core::undistortion::{IdealCamera, TableError, UndistortionTable};

/// Largest number of pixels of a sensor.
const MOST_PIXELS: u32 = 1 << 24;

/// Node spacings that are tried, in pixels, coarsest first.
const SPACINGS: [u16; 7] = [64, 32, 16, 8, 4, 2, 1];

/// A table with its accuracy.
#[derive(Clone, Debug)]
pub struct ExportedTable {
    /// The table.
    pub table: UndistortionTable<Vec<[f32; 2]>>,
    /// Largest error over all pixels of the sensor, in pixels of the calibrated camera.
    pub largest_error: f64,
    /// The pixel of the largest error.
    pub at: [u16; 2],
    /// Number of pixels in the domain of the lens model for which the table has no value.
    pub without_value: u32,
    /// Lens and ideal camera, for the comment.
    camera: Camera<f64>,
    ideal: IdealCamera<f64>,
}

/// Reasons why there is no table.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExportTableError {
    /// Sensor or table is too small.
    #[error("no undistortion table: {0}")]
    Table(#[from] TableError),
    /// The sensor is too large: its table is compared with the lens at every pixel.
    #[error(
        "no undistortion table: the calibration is for {0} pixels, but tables are for sensors of up to {MOST_PIXELS}"
    )]
    TooLarge(Sensor),
    /// Even one node per pixel is not accurate enough.
    #[error(
        "an error of {wanted} px cannot be reached; a node at every pixel gives {reached} px, the precision of 32-bit numbers"
    )]
    NotExact {
        /// Requested error, in pixels.
        wanted: f64,
        /// Smallest possible error, in pixels.
        reached: f64,
    },
}

impl evcal_files::remedy::Remedy for ExportTableError {}

/// Returns the camera without distortion that has the matrix of `camera`.
pub fn ideal_of(camera: &Camera<f64>) -> IdealCamera<f64> {
    // Every model begins with fx, fy, cx and cy.
    let [fx, fy, cx, cy] = camera.parameters().first_chunk().copied().unwrap_or([1.0, 1.0, 0.0, 0.0]);
    IdealCamera { fx, fy, cx, cy }
}

/// Returns the coarsest table whose error is at most `max_error` pixels of `camera`.
///
/// # Errors
/// [`ExportTableError`] if no table has so small an error.
pub fn fit_table(
    camera: &Camera<f64>,
    ideal: &IdealCamera<f64>,
    sensor: Sensor,
    max_error: f64,
) -> Result<ExportedTable, ExportTableError> {
    let mut reached = f64::INFINITY;
    for spacing in SPACINGS {
        let nodes = |pixels: u16| pixels.saturating_sub(1).div_ceil(spacing).saturating_add(1);
        let table = table(camera, ideal, sensor, [nodes(sensor.width), nodes(sensor.height)])?;
        reached = table.largest_error;
        if reached <= max_error {
            return Ok(table);
        }
    }
    Err(ExportTableError::NotExact { wanted: max_error, reached })
}

/// Returns the table with `size` (columns, rows) nodes.
///
/// # Errors
/// [`ExportTableError::Table`] with fewer than 2 nodes or pixels in a direction.
pub fn table(
    camera: &Camera<f64>,
    ideal: &IdealCamera<f64>,
    sensor: Sensor,
    size: [u16; 2],
) -> Result<ExportedTable, ExportTableError> {
    if u32::from(sensor.width) * u32::from(sensor.height) > MOST_PIXELS {
        return Err(ExportTableError::TooLarge(sensor));
    }
    let room = vec![[f32::NAN; 2]; usize::from(size[0]) * usize::from(size[1])];
    let table = UndistortionTable::new(camera, ideal, sensor, size, room)?;
    let accuracy = table.accuracy(camera, ideal);
    let focal = camera.parameters().first().copied().unwrap_or(ideal.fx);
    Ok(ExportedTable {
        table,
        largest_error: f64::from(accuracy.largest_error) * focal / ideal.fx,
        at: accuracy.at,
        without_value: accuracy.without_value,
        camera: *camera,
        ideal: *ideal,
    })
}

impl ExportedTable {
    /// Returns the size of the nodes in bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(self.table.nodes())
    }

    /// Returns the table as a C99 header.
    pub fn c_header(&self) -> String {
        let (Sensor { width, height }, [columns, rows]) = (self.table.sensor(), self.table.size());
        let [nodes_x, nodes_y] = self.nodes_a_pixel();
        let mut text = String::from("/*\n");
        for line in self.description() {
            let _ = writeln!(text, " * {line}");
        }
        text += " */\n";
        let _ = write!(
            text,
            "\
#ifndef EVCAL_UNDISTORTION_H
#define EVCAL_UNDISTORTION_H

#include <math.h>
#include <stdbool.h>

#define EVCAL_SENSOR_WIDTH {width}
#define EVCAL_SENSOR_HEIGHT {height}
#define EVCAL_NODE_COLUMNS {columns}
#define EVCAL_NODE_ROWS {rows}

/* x and y of each node, row by row; NAN where the lens model has no value. */
static const float evcal_undistortion[EVCAL_NODE_ROWS][EVCAL_NODE_COLUMNS][2] = {{
"
        );
        for row in self.table.nodes().chunks(usize::from(columns.max(1))) {
            text += "    {";
            for (index, [x, y]) in row.iter().enumerate() {
                let separator = if index == 0 { "" } else { ", " };
                let _ = write!(text, "{separator}{{{}, {}}}", c_float(*x), c_float(*y));
            }
            text += "},\n";
        }
        let _ = write!(
            text,
            "\
}};

/* Computes the position of pixel (x, y) without distortion; false outside the sensor or the lens model. */
static inline bool evcal_undistort(float x, float y, float *undistorted_x, float *undistorted_y)
{{
    if (!(x >= -0.5f && x <= EVCAL_SENSOR_WIDTH - 0.5f && y >= -0.5f && y <= EVCAL_SENSOR_HEIGHT - 0.5f)) {{
        return false;
    }}
    const float column = x * {nodes_x:?}f;
    const float row = y * {nodes_y:?}f;
    int left = column > 0.0f ? (int)column : 0;
    int top = row > 0.0f ? (int)row : 0;
    if (left > EVCAL_NODE_COLUMNS - 2) {{
        left = EVCAL_NODE_COLUMNS - 2;
    }}
    if (top > EVCAL_NODE_ROWS - 2) {{
        top = EVCAL_NODE_ROWS - 2;
    }}
    const float right_share = column - (float)left;
    const float lower_share = row - (float)top;
    float value[2];
    for (int axis = 0; axis < 2; ++axis) {{
        const float *upper = &evcal_undistortion[top][left][axis];
        const float *lower = &evcal_undistortion[top + 1][left][axis];
        const float above = upper[0] + (upper[2] - upper[0]) * right_share;
        const float below = lower[0] + (lower[2] - lower[0]) * right_share;
        value[axis] = above + (below - above) * lower_share;
    }}
    if (!isfinite(value[0]) || !isfinite(value[1])) {{
        return false;
    }}
    *undistorted_x = value[0];
    *undistorted_y = value[1];
    return true;
}}

#endif
"
        );
        text
    }

    /// Returns the table as a Rust module that depends only on `core`.
    pub fn rust_module(&self) -> String {
        let (Sensor { width, height }, [columns, rows]) = (self.table.sensor(), self.table.size());
        let [nodes_x, nodes_y] = self.nodes_a_pixel();
        let mut text = String::new();
        for line in self.description() {
            let _ = writeln!(text, "// {line}");
        }
        let _ = write!(
            text,
            "
/// Width of the sensor in pixels.
pub const SENSOR_WIDTH: u16 = {width};
/// Height of the sensor in pixels.
pub const SENSOR_HEIGHT: u16 = {height};
/// Columns of nodes.
pub const COLUMNS: u16 = {columns};
/// Rows of nodes.
pub const ROWS: u16 = {rows};

/// x and y of each node, row by row; NaN where the lens model has no value. With evcal-core:
/// `UndistortionTable::from_nodes(Sensor {{ width, height }}, [COLUMNS, ROWS], &NODES)`.
#[rustfmt::skip]
pub static NODES: [[f32; 2]; {count}] = [
",
            count = self.table.nodes().len()
        );
        for row in self.table.nodes().chunks(usize::from(columns.max(1))) {
            text += "   ";
            for [x, y] in row {
                let _ = write!(text, " [{}, {}],", rust_float(*x), rust_float(*y));
            }
            text += "\n";
        }
        let _ = write!(
            text,
            "\
];

/// Returns the position of pixel (x, y) without distortion; `None` outside the sensor or the lens model.
pub fn undistort(x: f32, y: f32) -> Option<[f32; 2]> {{
    let (column, right_share) = cell(x, SENSOR_WIDTH, {nodes_x:?}, COLUMNS)?;
    let (row, lower_share) = cell(y, SENSOR_HEIGHT, {nodes_y:?}, ROWS)?;
    let first = row * COLUMNS as usize + column;
    let upper = [NODES.get(first)?, NODES.get(first + 1)?];
    let lower = [NODES.get(first + COLUMNS as usize)?, NODES.get(first + COLUMNS as usize + 1)?];
    let value = |axis: usize| {{
        let above = upper[0][axis] + (upper[1][axis] - upper[0][axis]) * right_share;
        let below = lower[0][axis] + (lower[1][axis] - lower[0][axis]) * right_share;
        above + (below - above) * lower_share
    }};
    let value = [value(0), value(1)];
    if value[0].is_finite() && value[1].is_finite() {{ Some(value) }} else {{ None }}
}}

/// The cell of nodes that a coordinate lies in, and how far in it, from 0 to 1.
fn cell(coordinate: f32, pixels: u16, nodes_a_pixel: f32, nodes: u16) -> Option<(usize, f32)> {{
    if !(coordinate >= -0.5 && coordinate <= pixels as f32 - 0.5) {{
        return None;
    }}
    let place = coordinate * nodes_a_pixel;
    let cell = (place as usize).min(nodes as usize - 2);
    Some((cell, place - cell as f32))
}}
"
        );
        text
    }

    fn nodes_a_pixel(&self) -> [f32; 2] {
        let (Sensor { width, height }, [columns, rows]) = (self.table.sensor(), self.table.size());
        let ratio = |nodes: u16, pixels: u16| (f32::from(nodes) - 1.0) / (f32::from(pixels) - 1.0);
        [ratio(columns, width), ratio(rows, height)]
    }

    fn description(&self) -> Vec<String> {
        let kind = self.camera.kind();
        let values = self.camera.parameters();
        let parameters = kind.parameter_names().iter().zip(&values);
        let parameters: Vec<String> = parameters.map(|(name, value)| format!("{name} {value}")).collect();
        let IdealCamera { fx, fy, cx, cy } = self.ideal;
        let [x, y] = self.at;
        vec![
            "Undistortion of single pixels, written by evcal.".to_owned(),
            format!("Lens: {kind}, {}.", parameters.join(", ")),
            format!("Undistorted pixels are those of a pinhole camera: fx {fx}, fy {fy}, cx {cx}, cy {cy}."),
            "Pixel (0, 0) is the centre of the top-left pixel.".to_owned(),
            format!("Largest error against the exact inverse: {:.4} px, at pixel ({x}, {y}).", self.largest_error),
        ]
    }
}

fn c_float(value: f32) -> String {
    if value.is_finite() { format!("{value:?}f") } else { "NAN".to_owned() }
}

fn rust_float(value: f32) -> String {
    if value.is_finite() { format!("{value:?}") } else { "f32::NAN".to_owned() }
}
