//! Scales of colours for values.

/// A scale of colours that stay distinguishable in print and with a colour vision deficiency.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Palette {
    /// From low (dark violet) to high (yellow).
    Amount,
    /// From good (yellow) to bad (dark).
    Error,
    /// From negative (blue) through zero (white) to positive (red).
    Signed,
}

/// Anchors of the colour map viridis of matplotlib (public domain), evenly spaced.
const AMOUNT: [[u8; 3]; 5] = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
const ERROR: [[u8; 3]; 5] = [[253, 231, 37], [94, 201, 98], [33, 145, 140], [59, 82, 139], [68, 1, 84]];
const SIGNED: [[u8; 3]; 5] = [[33, 102, 172], [146, 197, 222], [247, 247, 247], [244, 165, 130], [178, 24, 43]];

impl Palette {
    fn anchors(self) -> &'static [[u8; 3]; 5] {
        match self {
            Self::Amount => &AMOUNT,
            Self::Error => &ERROR,
            Self::Signed => &SIGNED,
        }
    }

    /// Returns the colour at `share` of the scale, which is clamped to 0 to 1.
    pub fn color(self, share: f64) -> [u8; 3] {
        let anchors = self.anchors();
        let place = if share.is_nan() { 0.0 } else { share.clamp(0.0, 1.0) } * (anchors.len() - 1) as f64;
        let first = (place as usize).min(anchors.len() - 2);
        let within = place - first as f64;
        match anchors.get(first..first + 2) {
            Some([low, high]) => std::array::from_fn(|channel| {
                let (low, high) = (f64::from(low[channel]), f64::from(high[channel]));
                (low + within * (high - low)).round() as u8
            }),
            _ => [0; 3],
        }
    }

    /// Returns the scale as a CSS background.
    pub fn gradient(self) -> String {
        let stops: Vec<String> = self.anchors().iter().map(|[r, g, b]| format!("rgb({r},{g},{b})")).collect();
        format!("background:linear-gradient(90deg,{})", stops.join(","))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ends_and_the_middle_are_the_anchors() {
        assert_eq!(Palette::Amount.color(-1.0), [68, 1, 84]);
        assert_eq!(Palette::Amount.color(2.0), [253, 231, 37]);
        assert_eq!(Palette::Signed.color(0.5), [247, 247, 247]);
        assert_eq!(Palette::Amount.color(0.125), [64, 42, 112]);
        assert_eq!(Palette::Error.color(f64::NAN), [253, 231, 37]);
    }
}
