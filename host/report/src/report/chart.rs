//! Plots and sensor maps as inline SVG with the colours and width of the page.
//!
//! The plotting library writes fixed colours. The page's style sheet replaces each [`Color`] by its shade for light, dark and paper, and
//! adds its dashes.

use evcal_core::sensor::Sensor;
use std::ops::Range;

use maud::{Markup, PreEscaped, Render, html};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::Color as _;

use super::palette::Palette;

/// Width of the drawings in their own units; the page scales them.
const WIDTH: u32 = 960;
const TEXT: u32 = 34;
const LABEL_WIDTH: u32 = 150;
const LABEL_HEIGHT: u32 = 84;
const MARGIN: u32 = 16;
/// Room for the right half of the last label.
const RIGHT_MARGIN: u32 = 32;
const GRID: RGBColor = RGBColor(0xd0, 0xd0, 0xd0);
const NOTHING: RGBColor = RGBColor(0xe4, 0xe7, 0xeb);
const INK: RGBColor = RGBColor(1, 2, 3);

/// A colour and dash of the style sheet. The colours of ON and OFF events are not among them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Color {
    /// Red, solid.
    First,
    /// Green, dashed.
    Second,
    /// Indigo, dotted.
    Third,
    /// Brown, dash and dot.
    Fourth,
}

impl Color {
    /// All, in the order in which curves use them; the axes x, y and z use the first three.
    pub const ALL: [Self; 4] = [Self::First, Self::Second, Self::Third, Self::Fourth];

    fn rgb(self) -> RGBColor {
        match self {
            Self::First => RGBColor(0xb8, 0x2a, 0x4f),
            Self::Second => RGBColor(0x1d, 0x7f, 0x4f),
            Self::Third => RGBColor(0x4a, 0x3f, 0xb8),
            Self::Fourth => RGBColor(0x7a, 0x5c, 0x00),
        }
    }

    /// Class of the style sheet for lines of this colour and dash.
    pub fn class(self) -> &'static str {
        match self {
            Self::First => "first",
            Self::Second => "second",
            Self::Third => "third",
            Self::Fourth => "fourth",
        }
    }
}

/// A group of curves or points.
pub struct Series {
    /// Name in the legend; empty for a series without an entry.
    pub name: String,
    /// Colour.
    pub color: Color,
    /// Curves; each is drawn without gaps.
    pub curves: Vec<Vec<(f64, f64)>>,
    /// Single points.
    pub points: Vec<(f64, f64)>,
}

/// A plot of curves and points.
pub struct Chart<'a> {
    /// Alternative text for screen readers.
    pub description: String,
    /// Quantity and unit along x.
    pub x_label: &'a str,
    /// Quantity and unit along y.
    pub y_label: &'a str,
    /// Range of the x axis.
    pub x: Range<f64>,
    /// Range of the y axis.
    pub y: Range<f64>,
    /// Curves and points.
    pub series: Vec<Series>,
}

/// Returns the smallest range around `values` with a margin, at least `narrowest` wide.
pub fn range_of(values: impl Iterator<Item = f64>, narrowest: f64) -> Range<f64> {
    let (low, high) = values
        .filter(|value| value.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    if low > high {
        return -0.5 * narrowest..0.5 * narrowest;
    }
    let half = (0.54 * (high - low)).max(0.5 * narrowest);
    let middle = 0.5 * (low + high);
    middle - half..middle + half
}

type Drawing<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type DrawingError = DrawingAreaErrorKind<std::io::Error>;

fn figure(description: &str, height: u32, draw: impl FnOnce(&Drawing) -> Result<(), DrawingError>) -> Markup {
    let mut svg = String::new();
    let drawn = {
        let drawing = SVGBackend::with_string(&mut svg, (WIDTH, height)).into_drawing_area();
        draw(&drawing).and_then(|()| drawing.present())
    };
    if let Err(error) = drawn {
        return html! { p { "This plot could not be drawn: " (error) } };
    }
    let label = html! { (description) }.render().into_string();
    let opening = format!("<svg class=\"plot\" role=\"img\" aria-label=\"{label}\" ");
    PreEscaped(svg.replacen("<svg ", &opening, 1))
}

impl Chart<'_> {
    /// Returns the plot with its legend.
    pub fn render(&self) -> Markup {
        let named = || self.series.iter().filter(|series| !series.name.is_empty());
        html! {
            (figure(&self.description, 560, |drawing| self.draw(drawing)))
            @if named().count() > 1 {
                ul.legend {
                    @for series in named() {
                        li { (sample(series.color)) (series.name) }
                    }
                }
            }
        }
    }

    fn draw(&self, drawing: &Drawing) -> Result<(), DrawingError> {
        let mut chart = ChartBuilder::on(drawing)
            .margin(MARGIN)
            .margin_right(RIGHT_MARGIN)
            .x_label_area_size(LABEL_HEIGHT)
            .y_label_area_size(LABEL_WIDTH)
            .build_cartesian_2d(self.x.clone(), self.y.clone())?;
        chart
            .configure_mesh()
            .label_style(("sans-serif", TEXT))
            .axis_desc_style(("sans-serif", TEXT))
            .x_desc(self.x_label)
            .y_desc(self.y_label)
            .x_labels(7)
            .y_labels(6)
            .x_label_formatter(&label)
            .y_label_formatter(&label)
            .max_light_lines(0)
            .bold_line_style(GRID)
            .draw()?;
        for series in &self.series {
            let color = series.color.rgb();
            let curves = series.curves.iter().filter(|curve| curve.len() > 1);
            chart.draw_series(curves.map(|curve| PathElement::new(curve.clone(), color.stroke_width(4))))?;
            chart.draw_series(series.points.iter().map(|&at| Circle::new(at, 6, color.filled())))?;
        }
        Ok(())
    }
}

/// Returns a short line in the colour and dash of a series.
fn sample(color: Color) -> Markup {
    html! {
        i.sample.(color.class()) {}
    }
}

/// Returns a number for an axis, without trailing zeros and with a minus sign (U+2212).
fn label(value: &f64) -> String {
    let text = format!("{value:.6}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    match text.strip_prefix('-') {
        Some("0") => "0".to_owned(),
        Some(size) => format!("−{size}"),
        None => text.to_owned(),
    }
}

/// Returns the largest of 1, 2 and 5 times a power of ten that is not above `value`.
pub fn round_down(value: f64) -> f64 {
    let power = 10_f64.powf(value.max(1e-9).log10().floor());
    [5.0, 2.0, 1.0].into_iter().map(|step| step * power).find(|step| *step <= value).unwrap_or(power)
}

/// Returns the smallest of 1, 1.5, 2, 3, 5 and 7 times a power of ten that is not below `value`.
pub fn round_up(value: f64) -> f64 {
    let power = 10_f64.powf(value.max(1e-9).log10().floor());
    [1.0, 1.5, 2.0, 3.0, 5.0, 7.0]
        .into_iter()
        .map(|step| step * power)
        .find(|step| *step >= value)
        .unwrap_or(10.0 * power)
}

/// Returns a cell of a map around each point (px) of a regular grid, row by row, with the value at that point.
pub fn cells_of_grid(points: &[([f64; 2], Option<f64>)], columns: usize, rows: usize) -> Vec<Cell> {
    let (Some(first), Some(last)) = (points.first(), points.last()) else { return Vec::new() };
    let half = |axis: usize, count: usize| 0.5 * (last.0[axis] - first.0[axis]) / count.saturating_sub(1).max(1) as f64;
    let (half_x, half_y) = (half(0, columns), half(1, rows));
    let cell = |([x, y], value): &([f64; 2], Option<f64>)| ([x - half_x, y - half_y, x + half_x, y + half_y], *value);
    points.iter().map(cell).collect()
}

/// Left, top, right and bottom (px) of a cell of a map, and its value; `None` without data.
pub type Cell = ([f64; 4], Option<f64>);

/// Number of steps of a map's colours.
const SHADES: f64 = 48.0;
/// Difference between the sides of neighbouring cells (px).
const ROUNDING: f64 = 1e-6;

/// Cells of one colour: left, top, right and bottom (px).
struct Area {
    sides: [f64; 4],
    color: RGBColor,
}

/// A map of the sensor in cells.
pub struct SensorMap {
    /// Alternative text for screen readers.
    pub description: String,
    /// Width and height of the sensor (px).
    pub sensor: Sensor,
    /// Cells, in any order.
    pub cells: Vec<Cell>,
    /// Values at the ends of the palette; values beyond get the colour of the end.
    pub range: Range<f64>,
    /// Colours.
    pub palette: Palette,
    /// Unit of the values.
    pub unit: &'static str,
    /// Arrows: start (px) and vector (px, enlarged by the caller).
    pub arrows: Vec<([f64; 2], [f64; 2])>,
}

impl SensorMap {
    /// Returns the map with its scale.
    pub fn render(&self) -> Markup {
        let (width, height) = (f64::from(self.sensor.width.max(1)), f64::from(self.sensor.height.max(1)));
        let room = f64::from(WIDTH - LABEL_WIDTH - MARGIN - RIGHT_MARGIN);
        let drawing_height = (room * height / width) as u32 + LABEL_HEIGHT + 2 * MARGIN;
        let unknown = self.cells.iter().any(|cell| cell.1.is_none());
        html! {
            (figure(&self.description, drawing_height.clamp(300, 2 * WIDTH), |drawing| self.draw(drawing)))
            div.scale aria-hidden="true" {
                span { (label(&self.range.start)) }
                span.bar style=(self.palette.gradient()) {}
                span { @if self.exceeds_scale() { "≥ " } (label(&self.range.end)) " " (self.unit) }
                @if unknown { span.nothing {} span { "no data" } }
            }
        }
    }

    /// Returns the cells in one of [`SHADES`] colours; neighbours of one colour in a row are one area.
    fn areas(&self) -> Vec<Area> {
        let span = self.range.end - self.range.start;
        let mut areas: Vec<Area> = Vec::new();
        for &(sides, value) in &self.cells {
            let color = value.map_or(NOTHING, |value| {
                let shade = ((value - self.range.start) / span * SHADES).round() / SHADES;
                let [red, green, blue] = self.palette.color(shade);
                RGBColor(red, green, blue)
            });
            let [left, top, right, bottom] = sides;
            match areas.last_mut() {
                Some(last)
                    if last.color == color && last.sides[1] == top && (last.sides[2] - left).abs() < ROUNDING =>
                {
                    last.sides[2] = right;
                }
                _ => areas.push(Area { sides: [left, top, right, bottom], color }),
            }
        }
        areas
    }

    fn exceeds_scale(&self) -> bool {
        self.cells.iter().any(|cell| cell.1.is_some_and(|value| value > self.range.end))
    }

    fn draw(&self, drawing: &Drawing) -> Result<(), DrawingError> {
        let (width, height) = (f64::from(self.sensor.width), f64::from(self.sensor.height));
        // The y axis of the plot points up, the rows of the sensor are counted downwards.
        let mut chart = ChartBuilder::on(drawing)
            .margin(MARGIN)
            .margin_right(RIGHT_MARGIN)
            .x_label_area_size(LABEL_HEIGHT)
            .y_label_area_size(LABEL_WIDTH)
            .build_cartesian_2d(-0.5..width - 0.5, 0.5 - height..0.5)?;
        chart
            .configure_mesh()
            .disable_mesh()
            .label_style(("sans-serif", TEXT))
            .axis_desc_style(("sans-serif", TEXT))
            .x_desc("column (px)")
            .y_desc("row (px)")
            .x_labels(7)
            .y_labels(6)
            .x_label_formatter(&label)
            .y_label_formatter(&|value| label(&-value))
            .draw()?;
        chart.draw_series(self.areas().iter().map(|Area { sides: [left, top, right, bottom], color }| {
            let inside = |value: f64, size: f64| value.clamp(-0.5, size - 0.5);
            let corners =
                [(inside(*left, width), -inside(*top, height)), (inside(*right, width), -inside(*bottom, height))];
            Rectangle::new(corners, color.filled())
        }))?;
        for (from, along) in &self.arrows {
            let tip = [from[0] + along[0], from[1] + along[1]];
            let wing = |turn: f64| {
                (tip[0] - 0.3 * (along[0] - turn * along[1]), -(tip[1] - 0.3 * (along[1] + turn * along[0])))
            };
            let tip_at = (tip[0], -tip[1]);
            let shaft = vec![(from[0], -from[1]), tip_at];
            let head = vec![wing(0.5), tip_at, wing(-0.5)];
            chart.draw_series([shaft, head].map(|path| PathElement::new(path, INK.stroke_width(3))))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_of_one_colour_are_one_area() {
        let points: Vec<([f64; 2], Option<f64>)> = (0..40)
            .map(|index| {
                let (column, row) = (f64::from(index % 10), f64::from(index / 10));
                ([column * 5.0, row * 5.0], (index != 17).then_some(if column < 6.0 { 0.101 } else { 0.9 }))
            })
            .collect();
        let map = SensorMap {
            description: String::new(),
            sensor: Sensor::new(50, 20),
            cells: cells_of_grid(&points, 10, 4),
            range: 0.0..1.0,
            palette: Palette::Amount,
            unit: "px",
            arrows: Vec::new(),
        };
        let areas = map.areas();
        // Two colours in each of four rows, and a cell without data within one of them.
        assert_eq!(areas.len(), 2 * 4 + 2);
        let size = |[left, top, right, bottom]: [f64; 4]| (right - left) * (bottom - top);
        let of_areas: f64 = areas.iter().map(|area| size(area.sides)).sum();
        assert!((of_areas - map.cells.iter().map(|cell| size(cell.0)).sum::<f64>()).abs() < 1e-9);
    }

    #[test]
    fn labels_have_no_needless_digits() {
        for (value, text) in [(0.0, "0"), (-1e-9, "0"), (1.50, "1.5"), (-20.0, "−20"), (0.000_01, "0.00001")] {
            assert_eq!(label(&value), text);
        }
    }

    #[test]
    fn scales_end_at_round_numbers() {
        for (value, down, up) in [(0.37, 0.2, 0.5), (1.0, 1.0, 1.0), (7.2, 5.0, 10.0), (130.0, 100.0, 150.0)] {
            assert!((round_down(value) - down).abs() < 1e-12, "{value}");
            assert!((round_up(value) - up).abs() < 1e-9, "{value}");
        }
    }

    #[test]
    fn ranges_contain_their_values_and_have_a_width() {
        let range = range_of([1.0, 3.0, f64::NAN].into_iter(), 0.1);
        assert!(range.start < 1.0 && range.end > 3.0 && range.end < 3.2);
        assert_eq!(range_of([2.0].into_iter(), 1.0), 1.5..2.5);
        assert_eq!(range_of(std::iter::empty(), 1.0), -0.5..0.5);
    }

    #[test]
    fn a_chart_is_one_labelled_drawing_and_text_is_escaped() {
        let series = |name: &str| Series {
            name: name.to_owned(),
            color: Color::First,
            curves: vec![vec![(0.0, 0.0), (1.0, 1.0)]],
            points: vec![(0.5, 0.5)],
        };
        let chart = Chart {
            description: "a \"plot\" <b>".to_owned(),
            x_label: "x < 1",
            y_label: "y",
            x: 0.0..1.0,
            y: 0.0..1.0,
            series: vec![series("first & last"), series("second")],
        };
        let html = chart.render().into_string();
        assert_eq!(html.matches("<svg ").count(), 1);
        assert_eq!(html.matches("</svg>").count(), 1);
        assert!(html.contains("aria-label=\"a &quot;plot&quot; &lt;b&gt;\""));
        assert!(html.contains("x &lt; 1") && html.contains("first &amp; last"));
    }
}
