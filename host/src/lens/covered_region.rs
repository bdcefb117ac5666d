//! The part of the sensor in which the board was seen.

use evcal_core::sensor::Sensor;
use nalgebra::Vector2;

/// How far outside the outline a point still counts as inside (px): rounding.
const ROUNDING: f64 = 1e-9;

/// A convex region of the sensor, outside of which a calibration is extrapolation.
#[derive(Clone, Debug, PartialEq)]
pub struct CoveredRegion {
    /// Its corners in pixels, in the sense in which x turns to y; the last is joined to the first.
    corners: Vec<Vector2<f64>>,
}

impl CoveredRegion {
    /// All of a `sensor` (width, height).
    pub fn whole(sensor: Sensor) -> Self {
        let (right, bottom) = (f64::from(sensor.width) - 0.5, f64::from(sensor.height) - 0.5);
        let corners = [[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]];
        Self { corners: corners.map(Vector2::from).to_vec() }
    }

    /// The convex hull of `points` (px), as far as they are on the `sensor`.
    pub fn around(points: impl IntoIterator<Item = Vector2<f64>>, sensor: Sensor) -> Self {
        let (right, bottom) = (f64::from(sensor.width) - 0.5, f64::from(sensor.height) - 0.5);
        let finite = points.into_iter().filter(|point| point.x.is_finite() && point.y.is_finite());
        let mut points: Vec<Vector2<f64>> =
            finite.map(|point| Vector2::new(point.x.clamp(-0.5, right), point.y.clamp(-0.5, bottom))).collect();
        points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
        points.dedup();
        let mut corners = chain(points.iter());
        corners.pop();
        let mut back = chain(points.iter().rev());
        back.pop();
        corners.extend(back);
        Self { corners }
    }

    /// Its corners in pixels, in the sense in which x turns to y.
    pub fn corners(&self) -> &[Vector2<f64>] {
        &self.corners
    }

    /// Whether `pixel` lies in it or on its rim.
    pub fn contains(&self, pixel: &Vector2<f64>) -> bool {
        let next = self.corners.iter().cycle().skip(1);
        self.corners.len() > 2
            && self.corners.iter().zip(next).all(|(from, to)| {
                let side = to - from;
                side.perp(&(pixel - from)) >= -ROUNDING * side.norm()
            })
    }
}

/// One half of the hull of sorted points, by Andrew's monotone chain (1979).
fn chain<'a>(points: impl Iterator<Item = &'a Vector2<f64>>) -> Vec<Vector2<f64>> {
    let mut chain: Vec<Vector2<f64>> = Vec::new();
    for point in points {
        while let [.., before, last] = chain.as_slice()
            && (last - before).perp(&(point - last)) <= 0.0
        {
            chain.pop();
        }
        chain.push(*point);
    }
    chain
}

#[cfg(test)]
mod tests {
    use super::*;

    const SENSOR: Sensor = Sensor::new(346, 260);

    #[test]
    fn a_hull_holds_its_points_and_nothing_beyond() {
        let circle = |step: u32| {
            let angle = f64::from(step * 37 % 100) * std::f64::consts::TAU / 100.0;
            Vector2::new(170.0 + 80.0 * angle.cos(), 130.0 + 60.0 * angle.sin())
        };
        let inner = (0..50).map(|step| Vector2::new(150.0 + f64::from(step % 7), 110.0 + f64::from(step % 11)));
        let region = CoveredRegion::around((0..100).map(circle).chain(inner), SENSOR);
        assert_eq!(region.corners().len(), 100);
        assert!((0..100).all(|step| region.contains(&circle(step))));
        assert!(region.contains(&Vector2::new(170.0, 130.0)));
        let outside = |step| Vector2::new(170.0, 130.0) + (circle(step) - Vector2::new(170.0, 130.0)) * 1.01;
        assert!(!(0..100).any(|step| region.contains(&outside(step))));
    }

    #[test]
    fn a_region_ends_at_the_sensor() {
        let far = [[-90.0, 10.0], [500.0, -3.0], [400.0, 300.0], [f64::NAN, 2.0]].map(Vector2::from);
        let region = CoveredRegion::around(far, SENSOR);
        assert!(region.corners().iter().all(|corner| CoveredRegion::whole(SENSOR).contains(corner)));
        assert!(CoveredRegion::whole(SENSOR).contains(&Vector2::new(345.5, 259.5)));
        assert!(!CoveredRegion::whole(SENSOR).contains(&Vector2::new(345.6, 259.5)));
    }

    #[test]
    fn a_region_without_area_holds_nothing() {
        for points in [vec![], vec![[3.0, 4.0]], vec![[3.0, 4.0], [5.0, 6.0]]] {
            let region = CoveredRegion::around(points.into_iter().map(Vector2::from), SENSOR);
            assert!(!region.contains(&Vector2::new(4.0, 5.0)));
        }
    }
}
