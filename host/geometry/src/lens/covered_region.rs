//! The part of the sensor in which the board was seen.

use evcal_core::sensor::Sensor;
use nalgebra::Vector2;

/// Distance outside the outline at which a point still counts as inside (px), because of rounding.
const ROUNDING: f64 = 1e-9;

/// Number of points on the rim that represent a circle.
const RIM_POINTS: usize = 16;

/// Approximate largest number of points stored at once.
const MOST_POINTS: usize = 16_384;

/// A convex region of the sensor, outside of which a calibration is extrapolation.
#[derive(Clone, Debug, PartialEq)]
pub struct CoveredRegion {
    /// Its corners in pixels, in the sense of rotation from x to y; the last is joined to the first.
    corners: Vec<Vector2<f64>>,
}

impl CoveredRegion {
    /// Returns the region of a whole `sensor`.
    pub fn whole(sensor: Sensor) -> Self {
        let (right, bottom) = (f64::from(sensor.width) - 0.5, f64::from(sensor.height) - 0.5);
        let corners = [[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]];
        Self { corners: corners.map(Vector2::from).to_vec() }
    }

    /// Returns the convex hull of `points` (px), limited to the `sensor`.
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

    /// Returns the convex hull of 16 points on the rim of each of `circles`, given by centre and radius (px), limited
    /// to the `sensor`.
    ///
    /// Most circles lie inside the hull of a few outer ones and contribute no corner, so only the others are processed.
    pub fn around_circles(circles: impl Iterator<Item = (Vector2<f64>, f64)> + Clone, sensor: Sensor) -> Self {
        let directions: [Vector2<f64>; RIM_POINTS] = std::array::from_fn(|step| {
            let angle = step as f64 * std::f64::consts::TAU / RIM_POINTS as f64;
            Vector2::new(libm::cos(angle), libm::sin(angle))
        });
        let circles = circles.filter(|(center, _)| center.iter().all(|value| value.is_finite()));
        let mut farthest: [Option<Vector2<f64>>; RIM_POINTS] = [None; RIM_POINTS];
        for (center, _) in circles.clone() {
            for (farthest, direction) in farthest.iter_mut().zip(&directions) {
                if farthest.is_none_or(|farthest| direction.dot(&center) > direction.dot(&farthest)) {
                    *farthest = Some(center);
                }
            }
        }
        let inner = Self::around(farthest.into_iter().flatten(), sensor);
        let mut points = Vec::new();
        for (center, radius) in circles.filter(|(center, radius)| !inner.contains_circle(center, *radius)) {
            points.extend(directions.iter().map(|direction| center + direction * radius));
            if points.len() > MOST_POINTS {
                points = Self::around(points, sensor).corners;
            }
        }
        Self::around(points, sensor)
    }

    /// Returns `true` if the circle about `center` lies in the region.
    fn contains_circle(&self, center: &Vector2<f64>, radius: f64) -> bool {
        let next = self.corners.iter().cycle().skip(1);
        self.corners.len() > 2
            && self.corners.iter().zip(next).all(|(from, to)| {
                let side = to - from;
                side.perp(&(center - from)) > (radius + ROUNDING) * side.norm()
            })
    }

    /// Returns its corners in pixels, in the sense of rotation from x to y.
    pub fn corners(&self) -> &[Vector2<f64>] {
        &self.corners
    }

    /// Returns `true` if `pixel` lies in the region or on its boundary.
    pub fn contains(&self, pixel: &Vector2<f64>) -> bool {
        let next = self.corners.iter().cycle().skip(1);
        self.corners.len() > 2
            && self.corners.iter().zip(next).all(|(from, to)| {
                let side = to - from;
                let distance = side.perp(&(pixel - from));
                // Most points are well inside, where the side's length does not matter.
                distance >= 0.0 || distance >= -ROUNDING * side.norm()
            })
    }
}

/// Returns one half of the hull of sorted points, by Andrew's monotone chain (1979).
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
    use crate::numerics::random::uniform_in;
    use rand::SeedableRng;

    const SENSOR: Sensor = Sensor::new(346, 260);

    #[test]
    fn circles_far_inside_do_not_change_the_hull() {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let mut uniform = |low: f64, high: f64| uniform_in(&mut random, low, high);
        let circles: Vec<(Vector2<f64>, f64)> = (0..5000)
            .map(|_| (Vector2::new(uniform(-20.0, 250.0), uniform(30.0, 250.0)), uniform(3.0, 12.0)))
            .collect();
        let rims = circles.iter().flat_map(|(center, radius)| {
            (0..RIM_POINTS).map(move |step| {
                let angle = step as f64 * std::f64::consts::TAU / RIM_POINTS as f64;
                center + Vector2::new(libm::cos(angle), libm::sin(angle)) * *radius
            })
        });
        let all = CoveredRegion::around(rims, SENSOR);
        assert_eq!(CoveredRegion::around_circles(circles.iter().copied(), SENSOR), all);
        assert!(all.corners().len() > 8);
    }

    #[test]
    fn a_hull_contains_its_points_and_nothing_beyond() {
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
    fn a_region_without_area_contains_nothing() {
        for points in [vec![], vec![[3.0, 4.0]], vec![[3.0, 4.0], [5.0, 6.0]]] {
            let region = CoveredRegion::around(points.into_iter().map(Vector2::from), SENSOR);
            assert!(!region.contains(&Vector2::new(4.0, 5.0)));
        }
    }
}
