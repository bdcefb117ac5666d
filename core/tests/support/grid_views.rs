//! Random views of a circle grid as candidate sets with the ground truth; shared by tests and benches.

use evcal_core::grid::GridCandidate;
use evcal_core::pattern::Pattern;
use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};

/// Image size of the simulated sensor.
pub const SIZE: (f64, f64) = (346.0, 260.0);

/// A small generator of pseudo-random numbers (SplitMix64), the same on every platform.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15))
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Returns a uniformly distributed number in [from, to).
    pub fn uniform(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * ((self.next() >> 11) as f64 / (1_u64 << 53) as f64)
    }

    /// Returns a number with a standard normal distribution.
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform(0.0, 1.0)).ln()).sqrt();
        radius * self.uniform(0.0, core::f64::consts::TAU).cos()
    }

    pub fn shuffle<V>(&mut self, values: &mut [V]) {
        for index in (1..values.len()).rev() {
            let other = (self.next() % (index as u64 + 1)) as usize;
            values.swap(index, other);
        }
    }
}

/// The lens of the simulated camera.
#[derive(Clone, Copy, Debug)]
pub enum Lens {
    /// f = 330 px, k1 = -0.35, k2 = 0.15.
    Radtan,
    /// Kannala-Brandt with f = 150 px: 130° across.
    Fisheye,
}

impl Lens {
    fn project(self, point: &Vector3<f64>) -> Option<Vector2<f64>> {
        if point.z <= 0.05 {
            return None;
        }
        let center = Vector2::new(SIZE.0, SIZE.1) * 0.5;
        let direction = point.xy() / point.z;
        let squared = direction.norm_squared();
        match self {
            Lens::Radtan => {
                // Beyond the field of view of the lens the polynomial folds back.
                if squared > 0.8 {
                    return None;
                }
                Some(center + direction * (330.0 * (1.0 - 0.35 * squared + 0.15 * squared * squared)))
            }
            Lens::Fisheye => {
                let radius = squared.sqrt();
                let angle = radius.atan();
                if angle > 1.3 {
                    return None;
                }
                let a2 = angle * angle;
                let scale = if radius > 1e-9 { angle * (1.0 - 0.03 * a2 + 0.005 * a2 * a2) / radius } else { 1.0 };
                Some(center + direction * (150.0 * scale))
            }
        }
    }
}

/// Parameters of a set of views.
#[derive(Clone, Copy, Debug)]
pub struct Setting {
    pub pattern: Pattern,
    pub lens: Lens,
    /// Largest angle between the optical axis and the board's normal, degrees.
    pub tilt: f64,
    /// Standard deviation of a centre, pixels along each axis.
    pub noise: f64,
    /// Number of false candidates.
    pub clutter: usize,
    /// Number of missing dots, chosen at random.
    pub missing: usize,
    /// `true` if the board may reach beyond the image (its dots there are missing, too).
    pub cut: bool,
}

/// A candidate set with the ground truth.
#[derive(Clone, Debug)]
pub struct View {
    pub candidates: Vec<GridCandidate<f64>>,
    /// Board index of each candidate.
    pub truth: Vec<Option<usize>>,
    /// Number of dots among the candidates.
    pub visible: usize,
    /// Pixel of each dot of the board, whether missing or not; `None` outside the image.
    pub dots: Vec<Option<Vector2<f64>>>,
}

/// Returns a random view of the board: tilt up to `setting.tilt` in any direction, any roll, from filling the image to
/// 2.5 times as far, anywhere in the image. The spacing of the board is 55 mm.
pub fn view(setting: &Setting, random: &mut Random) -> View {
    loop {
        if let Some(view) = try_view(setting, random) {
            return view;
        }
    }
}

fn try_view(setting: &Setting, random: &mut Random) -> Option<View> {
    let pattern = &setting.pattern;
    let spacing = 0.055;
    let board: Vec<Vector3<f64>> = (0..pattern.circle_count())
        .map(|index| {
            let (x, y) = pattern.lattice_position(index);
            Vector3::new(f64::from(x) * spacing, f64::from(y) * spacing, 0.0)
        })
        .collect();
    let middle = board.iter().sum::<Vector3<f64>>() / board.len() as f64;
    let reach = board.iter().map(|dot| (dot - middle).norm()).fold(0.0, f64::max);

    let tilt = random.uniform(0.0, setting.tilt.to_radians());
    let azimuth = random.uniform(0.0, core::f64::consts::TAU);
    let roll = random.uniform(0.0, core::f64::consts::TAU);
    let axis = nalgebra::Unit::new_normalize(Vector3::new(azimuth.cos(), azimuth.sin(), 0.0));
    let turn: Matrix3<f64> =
        (Rotation3::from_axis_angle(&axis, tilt) * Rotation3::from_axis_angle(&Vector3::z_axis(), roll)).into_inner();
    let nearest = match setting.lens {
        Lens::Radtan => 1.8 * reach,
        Lens::Fisheye => 0.9 * reach,
    };
    let distance = nearest * random.uniform(1.0, 2.5);
    // Bearing of the middle of the board, within the field of view.
    let half_view = match setting.lens {
        Lens::Radtan => (0.5, 0.37),
        Lens::Fisheye => (1.5, 1.0),
    };
    let direction =
        Vector3::new(random.uniform(-half_view.0, half_view.0), random.uniform(-half_view.1, half_view.1), 1.0);
    let position = direction * distance;

    let mut dots: Vec<Option<Vector2<f64>>> = Vec::new();
    for dot in &board {
        let image = setting.lens.project(&(turn * (dot - middle) + position));
        let inside = image.filter(|image| image.x > 0.0 && image.x < SIZE.0 && image.y > 0.0 && image.y < SIZE.1);
        if inside.is_none() && !setting.cut {
            return None;
        }
        dots.push(inside);
    }
    // Dots must be separated: a detector needs a few pixels per circle, and more at this noise.
    let closest = f64::max(5.0, 8.0 * setting.noise);
    let seen: Vec<Vector2<f64>> = dots.iter().flatten().copied().collect();
    for (index, a) in seen.iter().enumerate() {
        if seen.iter().skip(index + 1).any(|b| (a - b).norm() < closest) {
            return None;
        }
    }
    if seen.len() < 4 {
        return None;
    }

    let places = dots.clone();
    let mut order: Vec<usize> = (0..dots.len()).collect();
    random.shuffle(&mut order);
    for &index in order.iter().take(setting.missing) {
        if let Some(dot) = dots.get_mut(index) {
            *dot = None;
        }
    }
    let mut entries: Vec<(Vector2<f64>, Option<usize>)> = Vec::new();
    for (index, dot) in dots.iter().enumerate() {
        if let Some(dot) = dot {
            let noise = Vector2::new(random.normal(), random.normal()) * setting.noise;
            entries.push((dot + noise, Some(index)));
        }
    }
    let visible = entries.len();
    // Clutter lies in the board's bounding box, widened by a fifth on each side, within the image, and at least 2 px
    // from dots and other clutter, because a detector could not separate them.
    let low = seen.iter().fold(seen[0], |low, dot| low.inf(dot));
    let high = seen.iter().fold(seen[0], |high, dot| high.sup(dot));
    let margin = (high - low) * 0.2;
    let low = (low - margin).sup(&Vector2::zeros());
    let high = (high + margin).inf(&Vector2::new(SIZE.0, SIZE.1));
    while entries.len() < visible + setting.clutter {
        let place = Vector2::new(random.uniform(low.x, high.x), random.uniform(low.y, high.y));
        if entries.iter().all(|(other, _)| (other - place).norm() > 2.0) {
            entries.push((place, None));
        }
    }
    random.shuffle(&mut entries);
    Some(View {
        candidates: entries.iter().map(|&(center, _)| GridCandidate { center, radius: 0.0 }).collect(),
        truth: entries.iter().map(|&(_, truth)| truth).collect(),
        visible,
        dots: places,
    })
}
