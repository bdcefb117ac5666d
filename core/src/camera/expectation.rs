//! What is known of a model's coefficients before a lens is seen.

/// What a coefficient does to the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CoefficientEffect {
    /// Adds this power of the squared radius to the radius, as a part of it.
    Radial(i32),
    /// Few views determine it.
    Free,
    /// Is about so large, give or take 1: the shape of a wide model, which a narrow view leaves open.
    Shape(f64),
}

/// Where estimates of a model's coefficients start, and what they are expected to be. Coefficients that a list does not
/// name are zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Expectation {
    /// What each coefficient does, in their order.
    pub effects: &'static [CoefficientEffect],
    /// Starts of a fit to a lens that is known: no distortion; where the derivative by a coefficient vanishes without,
    /// the coefficients of a wide lens. More than one where the best fit is not reached from the other side.
    pub fit_starts: &'static [&'static [f64]],
    /// Two lenses among which that of an unknown camera is looked for: one with little distortion, and one with the
    /// barrel distortion of ordinary lenses, or a fisheye where the model is for these.
    pub usual: [&'static [f64]; 2],
}
