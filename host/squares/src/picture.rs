//! Grey-scale pictures: sampling between pixels, smoothing, enlarging.

/// A grey-scale picture. Pixel (0, 0) is the centre of the top-left pixel; beyond the border the nearest pixel counts.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

/// The difference between a pixel and a model of the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelResidual {
    /// Number of the pixel in the picture, row by row.
    pub pixel: u32,
    /// The model's value.
    pub value: f32,
    /// The picture's value minus the model's.
    pub error: f32,
}

impl Picture {
    /// Creates a picture from `values`, row by row; `None` if there are not `width` × `height` values, or no pixels at
    /// all.
    pub fn new(width: usize, height: usize, values: Vec<f32>) -> Option<Self> {
        let size = width.checked_mul(height)?;
        (size > 0 && values.len() == size).then_some(Self { width, height, values })
    }

    /// Creates a picture from bytes of a camera, row by row; `None` as for [`Picture::new`].
    pub fn from_bytes(width: usize, height: usize, bytes: &[u8]) -> Option<Self> {
        Self::new(width, height, bytes.iter().map(|&byte| byte.into()).collect())
    }

    /// Returns the number of pixels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Returns the number of pixels in a column.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Returns the pixels, row by row.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// Returns the pixels, row by row, to change them.
    pub fn values_mut(&mut self) -> &mut [f32] {
        &mut self.values
    }

    /// Returns `true` if a pixel position is at least `margin` away from the pixel centres at the border.
    pub fn contains(&self, pixel: [f32; 2], margin: f32) -> bool {
        let inside = |value: f32, size: usize| value >= margin && value <= (size - 1) as f32 - margin;
        inside(pixel[0], self.width) && inside(pixel[1], self.height)
    }

    /// Returns the difference between bright and dark: the range of the pixels without the brightest 5 % and the
    /// darkest 5 %.
    pub fn contrast(&self) -> f32 {
        // A subset of the pixels is enough; 7 does not divide any usual width.
        let step = if self.values.len() > 10_000 { 7 } else { 1 };
        let mut values: Vec<f32> = self.values.iter().copied().step_by(step).collect();
        let (rank, last) = (values.len() / 20, values.len() - 1);
        let mut at = |rank: usize| *values.select_nth_unstable_by(rank, f32::total_cmp).1;
        at(last - rank) - at(rank)
    }

    fn row(&self, y: usize) -> &[f32] {
        let start = y.min(self.height - 1) * self.width;
        &self.values[start..start + self.width]
    }

    /// Returns the value at a position between pixels, linear in x and y.
    pub fn bilinear(&self, x: f32, y: f32) -> f32 {
        // A NaN becomes 0.
        let x = x.max(0.0).min((self.width - 1) as f32);
        let y = y.max(0.0).min((self.height - 1) as f32);
        let (column, row) = (x as usize, y as usize);
        let (a, b) = (x - column as f32, y - row as f32);
        let (above, below) = (self.row(row), self.row(row + 1));
        let next = (column + 1).min(self.width - 1);
        let upper = above[column] + a * (above[next] - above[column]);
        let lower = below[column] + a * (below[next] - below[column]);
        upper + b * (lower - upper)
    }

    /// Returns the picture after a Gaussian filter with this standard deviation in pixels; unchanged for 0.
    pub fn blurred(&self, sigma: f32) -> Self {
        if sigma.is_nan() || sigma <= 0.0 {
            return self.clone();
        }
        let radius = ((3.0 * sigma).ceil() as usize).max(1);
        let weight = |offset: usize| libm::expf(-0.5 * (offset as f32 / sigma).powi(2));
        let half: Vec<f32> = (0..=radius).map(weight).collect();
        let sum = half.iter().skip(1).sum::<f32>() * 2.0 + half[0];
        let half: Vec<f32> = half.iter().map(|weight| weight / sum).collect();
        self.filtered(&half)
    }

    /// Returns the picture at half the size, each pixel the mean of 2 × 2 pixels. Pixel p of the result is at 2 p + 0.5
    /// of the original. `None` if the result has no pixel.
    pub fn halved(&self) -> Option<Self> {
        let (width, height) = (self.width / 2, self.height / 2);
        let pixel = |index: usize| {
            let (x, y) = (index % width * 2, index / width * 2);
            let (upper, lower) = (self.row(y), self.row(y + 1));
            0.25 * (upper[x] + upper[x + 1] + lower[x] + lower[x + 1])
        };
        Self::new(width, height, (0..width * height).map(pixel).collect())
    }

    /// Returns the part of the picture from pixel `low` to pixel `high`, both included and moved into the picture; and the position of
    /// its first pixel in the picture.
    pub fn part(&self, low: [usize; 2], high: [usize; 2]) -> (Self, [usize; 2]) {
        let last = [self.width - 1, self.height - 1];
        let [x, y] = [0, 1].map(|axis| low[axis].min(last[axis]));
        let [right, bottom] = [high[0].clamp(x, last[0]), high[1].clamp(y, last[1])];
        let values = (y..=bottom).flat_map(|row| &self.row(row)[x..=right]).copied().collect();
        (Self { width: right - x + 1, height: bottom - y + 1, values }, [x, y])
    }

    /// Returns the picture with left and right exchanged.
    pub fn mirrored(&self) -> Self {
        let values = self.values.chunks_exact(self.width).flat_map(|row| row.iter().rev()).copied().collect();
        Self { values, ..*self }
    }

    /// Returns the picture with `value` applied to each pixel.
    pub fn map(&self, value: impl Fn(f32) -> f32) -> Self {
        Self { values: self.values.iter().copied().map(value).collect(), ..*self }
    }

    /// Returns the picture with each pixel replaced by the darkest of its 3 × 3 neighbourhood.
    pub fn darkest_neighbours(&self) -> Self {
        let darkest_of_row = |index: usize| {
            let (row, x) = (self.row(index / self.width), index % self.width);
            row.iter().take(x + 2).skip(x.saturating_sub(1)).copied().fold(f32::INFINITY, f32::min)
        };
        let along_x: Vec<f32> = (0..self.values.len()).map(darkest_of_row).collect();
        let along_x = Self { values: along_x, ..*self };
        let darkest = |index: usize| {
            let (x, y) = (index % self.width, index / self.width);
            let rows = [y.saturating_sub(1), y, y + 1];
            rows.iter().filter_map(|row| along_x.row(*row).get(x)).copied().fold(f32::INFINITY, f32::min)
        };
        Self { values: (0..self.values.len()).map(darkest).collect(), ..*self }
    }

    /// Returns the picture after a symmetric filter along x and along y: `half` contains the weight of the middle and
    /// of its neighbours on one side.
    fn filtered(&self, half: &[f32]) -> Self {
        let radius = half.len() - 1;
        let mut along_x = vec![0.0; self.values.len()];
        let mut padded = vec![0.0; self.width + 2 * radius];
        for (row, out) in self.values.chunks_exact(self.width).zip(along_x.chunks_exact_mut(self.width)) {
            padded[..radius].fill(row[0]);
            padded[radius..radius + self.width].copy_from_slice(row);
            padded[radius + self.width..].fill(row[self.width - 1]);
            for (value, middle) in out.iter_mut().zip(&padded[radius..]) {
                *value = half[0] * middle;
            }
            for (offset, weight) in half.iter().enumerate().skip(1) {
                let sides = padded[radius - offset..].iter().zip(&padded[radius + offset..]);
                for (value, (left, right)) in out.iter_mut().zip(sides) {
                    *value += weight * (left + right);
                }
            }
        }
        let row = |y: usize| &along_x[y * self.width..(y + 1) * self.width];
        let mut values = vec![0.0; self.values.len()];
        for (y, out) in values.chunks_exact_mut(self.width).enumerate() {
            for (value, middle) in out.iter_mut().zip(row(y)) {
                *value = half[0] * middle;
            }
            for (offset, weight) in half.iter().enumerate().skip(1) {
                let sides = row(y.saturating_sub(offset)).iter().zip(row((y + offset).min(self.height - 1)));
                for (value, (above, below)) in out.iter_mut().zip(sides) {
                    *value += weight * (above + below);
                }
            }
        }
        Self { width: self.width, height: self.height, values }
    }

    /// Returns the picture enlarged by `factor`, by cubic convolution (Keys 1981, a = −0.5). Pixel p of this picture is
    /// at (p + 0.5) · `factor` − 0.5 of the enlarged one.
    pub fn enlarged(&self, factor: usize) -> Self {
        if factor <= 1 {
            return self.clone();
        }
        let width = self.width * factor;
        // Three additional pixels at each end of a row, for the cubic.
        let mut padded = vec![0.0; self.width + 6];
        let mut wide = vec![0.0; width * self.height];
        for (row, out) in self.values.chunks_exact(self.width).zip(wide.chunks_exact_mut(width)) {
            padded[..3].fill(row[0]);
            padded[3..self.width + 3].copy_from_slice(row);
            padded[self.width + 3..].fill(row[self.width - 1]);
            for phase in 0..factor {
                let (first, weights) = cubic(phase, factor);
                let begin = (first + 2) as usize;
                for (value, four) in out.iter_mut().skip(phase).step_by(factor).zip(padded[begin..].windows(4)) {
                    *value = weights.iter().zip(four).map(|(weight, value)| weight * value).sum();
                }
            }
        }
        let mut values = vec![0.0; width * self.height * factor];
        for (index, out) in values.chunks_exact_mut(width).enumerate() {
            let (first, weights) = cubic(index % factor, factor);
            for (place, weight) in weights.into_iter().enumerate() {
                let row = (index / factor) as isize + first - 1 + place as isize;
                let row = row.clamp(0, self.height as isize - 1) as usize;
                for (value, from) in out.iter_mut().zip(&wide[row * width..]) {
                    *value += weight * from;
                }
            }
        }
        Self { width, height: self.height * factor, values }
    }
}

/// Returns the weights of the four source pixels for part `phase` of the `factor` parts of a pixel, and the position of
/// the second source pixel relative to this pixel.
fn cubic(phase: usize, factor: usize) -> (isize, [f32; 4]) {
    let position = (phase as f32 + 0.5) / factor as f32 - 0.5;
    let first = position.floor();
    let a = position - first;
    let weights = [
        -0.5 * a + a * a - 0.5 * a * a * a,
        1.0 - 2.5 * a * a + 1.5 * a * a * a,
        0.5 * a + 2.0 * a * a - 1.5 * a * a * a,
        -0.5 * a * a + 0.5 * a * a * a,
    ];
    (first as isize, weights)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(width: usize, height: usize, value: impl Fn(f32, f32) -> f32) -> Picture {
        let values = (0..width * height).map(|index| value((index % width) as f32, (index / width) as f32)).collect();
        Picture::new(width, height, values).unwrap()
    }

    #[test]
    fn a_plane_stays_a_plane() {
        let plane = |x: f32, y: f32| 3.0 + 0.5 * x - 0.25 * y;
        let small = picture(20, 15, plane);
        assert!((small.bilinear(7.3, 4.8) - plane(7.3, 4.8)).abs() < 1e-5);
        assert!((small.blurred(1.3).bilinear(9.0, 7.0) - plane(9.0, 7.0)).abs() < 1e-4);
        let large = small.enlarged(3);
        assert_eq!((large.width(), large.height()), (60, 45));
        let at = |p: f32| (p + 0.5) * 3.0 - 0.5;
        assert!((large.bilinear(at(8.0), at(6.0)) - plane(8.0, 6.0)).abs() < 1e-4);
        let half = small.halved().unwrap();
        assert_eq!((half.width(), half.height()), (10, 7));
        assert!((half.bilinear(3.0, 2.0) - plane(6.5, 4.5)).abs() < 1e-4);
        assert!((large.bilinear(at(8.4), at(6.2)) - plane(8.4, 6.2)).abs() < 1e-4);
    }

    #[test]
    fn blur_keeps_the_sum_and_has_its_width() {
        let dot = picture(41, 41, |x, y| if (x, y) == (20.0, 20.0) { 1.0 } else { 0.0 });
        let blurred = dot.blurred(1.5);
        let sum: f32 = blurred.values().iter().sum();
        let square: f32 =
            blurred.values().iter().enumerate().map(|(index, v)| v * ((index % 41) as f32 - 20.0).powi(2)).sum();
        assert!((sum - 1.0).abs() < 1e-4);
        assert!((square.sqrt() - 1.5).abs() < 0.05, "{}", square.sqrt());
    }

    #[test]
    fn dark_regions_grow_by_a_pixel_to_each_side() {
        let dot = picture(9, 7, |x, y| if (x, y) == (8.0, 3.0) { 0.0 } else { 1.0 });
        let dark = |(index, value): (usize, &f32)| (*value < 0.5).then_some((index % 9, index / 9));
        let found: Vec<_> = dot.darkest_neighbours().values().iter().enumerate().filter_map(dark).collect();
        assert_eq!(found, [(7, 2), (8, 2), (7, 3), (8, 3), (7, 4), (8, 4)]);
    }

    #[test]
    fn positions_beyond_the_border_have_its_value() {
        let one = picture(1, 1, |_, _| 4.0);
        for (x, y) in [(-5.0, 2.0), (0.4, f32::NAN), (f32::INFINITY, 0.0)] {
            assert_eq!(one.bilinear(x, y), 4.0);
        }
        assert_eq!(one.blurred(2.0).values().len(), 1);
        assert_eq!(Picture::new(2, 2, vec![0.0; 3]), None);
        assert_eq!(Picture::new(0, 2, vec![]), None);
    }
}
