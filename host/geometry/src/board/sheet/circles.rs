//! Printing of boards of circles.

use evcal_core::pattern::Layout;

use super::{Dot, Printable, Shapes};
use crate::board::CircleBoard;

impl Printable for CircleBoard {
    fn size(&self) -> [f64; 2] {
        let (columns, rows) = (f64::from(self.pattern.columns), f64::from(self.pattern.rows));
        let across = match self.pattern.layout {
            Layout::Asymmetric => 2.0 * columns - 1.0,
            Layout::Symmetric => columns - 1.0,
        };
        [across, rows - 1.0].map(|steps| (steps * self.spacing + 2.0 * self.radius) * 1e3)
    }

    fn shapes(&self, corner: [f64; 2]) -> Shapes {
        let radius = self.radius * 1e3;
        let first = corner.map(|low| low + radius);
        let dots = (0..self.circle_count()).map(|index| {
            let center = self.circle_center(index) * 1e3;
            Dot { center: [first[0] + center.x, first[1] + center.y], radius }
        });
        Shapes { dots: dots.collect(), rectangles: Vec::new(), corner: first.map(|middle| middle - radius) }
    }

    fn lengths(&self) -> String {
        let millimetres = |metres: f64| (metres * 1e7).round() / 1e4;
        let (spacing, across) = (millimetres(self.spacing), millimetres(2.0 * self.radius));
        let rows = match self.pattern.layout {
            Layout::Asymmetric => format!("half of the {} mm between dots of a row", millimetres(2.0 * self.spacing)),
            Layout::Symmetric => "between dots of a row".to_owned(),
        };
        format!("Spacing {spacing} mm, {rows}; dots {across} mm across.")
    }

    fn scaled(&self, spacing: f64) -> Option<Self> {
        // Round down to tenths of a millimetre.
        let radius = (spacing * (self.radius / self.spacing) * 10.0).floor() / 10.0;
        (radius > 0.0).then_some(Self { spacing: spacing / 1e3, radius: radius / 1e3, ..*self })
    }
}
