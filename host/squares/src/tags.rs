//! Finds boards of square tags, also in blurred pictures in which no decoder can read the tags.
//!
//! 1. Dark quadrilaterals are candidates.
//! 2. The modules in a candidate are compared with the tags of this board only: the correlation must be good, and
//!    clearly better than with any other tag.
//! 3. Tags that disagree with the others about the board's position are excluded.
//! 4. From the tags found, the others are predicted through a local homography. A predicted tag is accepted if its
//!    modules correlate.
//!
//! The corners of a tag are determined from all its edges together (`alignment`).

use evcal_geometry::board::homography::homography;
use evcal_geometry::board::tag::Tag;
use nalgebra::{Matrix3, Vector2};

use crate::alignment::{Pattern, Slopes, SquareMap, align};
use crate::picture::Picture;
use crate::quads::{Quad, find_quads, quads_by_scale};
use crate::saddles::{SaddleTest, refine_saddle};

/// Standard deviation in pixels of the smoothing before tags are compared and aligned.
const SMOOTHING: f32 = 0.7;
/// Smallest correlation of the modules of a candidate with a tag before its position is refined, and after.
const LEAST_AT_FIRST: f32 = 0.4;
const LEAST: f32 = 0.6;
/// Smallest difference of the correlation to that with any other tag.
const LEAST_MARGIN: f32 = 0.12;
/// Smallest correlation at the predicted position of a tag.
const LEAST_PREDICTED: f32 = 0.55;
/// Smallest correlation of the modules of a candidate with a dark border around a light inside. (For a tag it is at
/// least 0.3 times the correlation with the tag's own modules.)
const LEAST_BORDER: f32 = 0.12;
/// Smallest difference in brightness between the board around a tag and the tag's border, as a fraction of the tag's
/// contrast.
const LEAST_AROUND: f32 = 0.25;
/// Usual widths of a tag's dark border in modules.
const BORDERS: [usize; 3] = [1, 2, 3];
/// Standard deviation in pixels of a corner that follows from all edges of its tag.
const SIGMA: f32 = 0.5;
/// Half the window for a corner that is a saddle, in modules, and its limits in pixels.
const WINDOW: f64 = 1.3;
const WINDOWS: [f64; 2] = [2.0, 5.0];
/// Smallest distance in pixels of corners from the border of the picture.
const BORDER: f32 = 1.0;
/// Two quadrilaterals are the same if their middles are closer than this fraction of the side.
const SAME: f64 = 0.1;
/// Two tags agree if each predicts the other's middle with an error of at most this fraction of their distance.
const AGREEMENT: f64 = 0.25;
/// Number of tags used for a prediction; and largest distance of the predicted tag from the nearest of them, in
/// distances of neighbouring tags.
const PREDICTING: usize = 3;
const NEIGHBOURHOOD: f64 = 1.6;
/// Largest number of missing tags next to the tags found, per tag found.
const MOST_MISSING: usize = 1;
/// Smallest correlation of a tag that is found alone.
const LEAST_ALONE: f32 = 0.75;
/// The search ends early if at least this number of tags was found for each missing one next to them.
const FOUND_PER_MISSING: usize = 2;
/// If this number of tags is found at expected positions, or among large candidates, other candidates are not searched.
const ENOUGH: usize = 3;
/// Greatest gain of correlation by the alignment of a tag whose position is known from another picture of the same moment.
const ALIGNED: f32 = 0.005;
/// Smallest margin in pixels around the board, if only the part of a picture with the board is examined.
const LEAST_MARGIN_IN_PIXELS: f64 = 16.0;

/// A tag of a board, found in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FoundTag {
    /// Index among the board's tags.
    pub index: usize,
    /// Its corners in the picture, in the order of [`Tag::corners`].
    pub corners: [[f32; 2]; 4],
    /// Correlation of its modules with the tag's, at most 1.
    pub score: f32,
}

/// Reason why the search for tags cannot be prepared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TagsError {
    /// There are no tags.
    #[error("the board has no tags")]
    NoTags,
    /// All tags of a board must have the same number of modules, at least three along each side.
    #[error("tag {id} does not have {side} x {side} modules")]
    Modules {
        /// Number of the tag in its family.
        id: u16,
        /// Modules along each side of the first tag.
        side: usize,
    },
}

/// Reason why a picture has no tags of a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
#[non_exhaustive]
pub enum NoTags {
    /// No dark square could be a tag.
    #[error("no dark square could be a tag")]
    NoQuads,
    /// There are dark squares, but they are not tags of this board.
    #[error("no tag of this board among {quads} dark quadrilaterals")]
    OtherTags {
        /// Number of dark quadrilaterals; the same one may count several times.
        quads: usize,
    },
    /// Single squares match tags of this board, but the squares next to them do not: the board has another family,
    /// border width or spacing.
    #[error("{found} tags match this board, but {missing} next to them do not")]
    OtherBoard {
        /// Number of tags that match the board.
        found: usize,
        /// Number of positions next to them without the board's tag.
        missing: usize,
    },
    /// The dark border of the tags has a different width than on the board.
    #[error("the dark border of the tags is {border} modules wide")]
    OtherBorder {
        /// Its width in modules.
        border: usize,
    },
    /// The tags are mirror images of the board's.
    #[error("{tags} tags are mirrored")]
    Mirrored {
        /// Number of mirrored tags.
        tags: usize,
    },
    /// The tags are negatives of the board's.
    #[error("{tags} tags have dark and light exchanged")]
    Inverted {
        /// Number of negatives.
        tags: usize,
    },
}

/// Finds the tags of one board.
#[derive(Clone, Debug)]
pub struct TagFinder {
    tags: Vec<Tag>,
    side: usize,
    /// Width of the dark border in modules.
    border: usize,
    /// The modules of each tag, with mean 0 and norm 1.
    patterns: Vec<Vec<f32>>,
    /// Middle and side of each tag on the board.
    places: Vec<Place>,
    /// Largest distance on the board between middles over which a prediction is valid.
    reach: f64,
}

/// A smoothed picture for comparing and aligning tags.
pub(crate) struct Smooth {
    picture: Picture,
    slopes: Slopes,
}

impl Smooth {
    pub(crate) fn new(picture: &Picture) -> Self {
        let picture = picture.blurred(SMOOTHING);
        Self { slopes: Slopes::new(&picture), picture }
    }

    /// Returns the smoothed picture.
    pub(crate) fn picture(&self) -> &Picture {
        &self.picture
    }
}

/// A part of a picture.
struct Part {
    picture: Picture,
    smooth: Smooth,
    /// Position of its first pixel in the whole picture.
    first: [f32; 2],
}

impl Part {
    /// Returns a tag of the whole picture in coordinates of the part.
    fn of_picture(&self, tag: &FoundTag) -> FoundTag {
        let [x, y] = self.first;
        FoundTag { corners: tag.corners.map(|corner| [corner[0] - x, corner[1] - y]), ..*tag }
    }

    /// Returns a tag of the part in coordinates of the whole picture.
    fn in_picture(&self, tag: &FoundTag) -> FoundTag {
        let [x, y] = self.first;
        FoundTag { corners: tag.corners.map(|corner| [corner[0] + x, corner[1] + y]), ..*tag }
    }
}

/// A picture in which the board was not found.
struct Failed {
    /// Number of tags that match the board.
    found: usize,
    /// Number of positions next to them without the board's tag.
    missing: usize,
    quads: Vec<Quad>,
    /// Width of the border of the tags, if the board has another one.
    border: Option<usize>,
}

impl Failed {
    /// Returns a number that is greater the more the picture looks like the board.
    fn likeness(&self) -> (bool, usize, usize) {
        (self.border.is_some(), self.found, self.quads.len())
    }
}

/// A homography from the board to the picture.
pub(crate) struct BoardMap(Matrix3<f64>);

impl BoardMap {
    fn image(&self, point: Vector2<f64>) -> Vector2<f64> {
        let image = self.0 * point.push(1.0);
        image.xy() / image.z
    }

    /// Returns the position of a point of the board in the picture.
    pub(crate) fn pixel(&self, point: Vector2<f64>) -> [f32; 2] {
        self.image(point).cast().into()
    }
}

#[derive(Clone, Copy, Debug)]
struct Place {
    middle: Vector2<f64>,
    side: f64,
}

/// A tag, the number of quarter turns that bring a candidate upright, and its correlation.
#[derive(Clone, Copy)]
struct Match {
    tag: usize,
    turn: usize,
    score: f32,
    /// Best correlation with another tag.
    other: f32,
}

impl TagFinder {
    /// Prepares the search for these tags.
    ///
    /// # Errors
    /// Returns [`TagsError`] if there are no tags, or if they differ in their number of modules.
    pub fn new(tags: &[Tag]) -> Result<Self, TagsError> {
        let side = tags.first().ok_or(TagsError::NoTags)?.side;
        let wrong = |tag: &&Tag| side < 3 || tag.side != side || side.checked_mul(side) != Some(tag.light.len());
        if let Some(tag) = tags.iter().find(wrong) {
            return Err(TagsError::Modules { id: tag.id, side });
        }
        let pattern = |tag: &Tag| {
            let mut values: Vec<f32> = tag.light.iter().map(|&light| if light { 1.0 } else { 0.0 }).collect();
            normalise(&mut values);
            values
        };
        let place = |tag: &Tag| {
            let [first, second, ..] = tag.corners.map(Vector2::from);
            Place { middle: tag.middle(), side: (second - first).norm() }
        };
        let (patterns, places): (_, Vec<Place>) =
            (tags.iter().map(pattern).collect(), tags.iter().map(place).collect());
        let others = |index: usize| places.iter().enumerate().filter(move |(other, _)| *other != index);
        let neighbour = |(index, place): (usize, &Place)| {
            others(index).map(|(_, other)| (other.middle - place.middle).norm()).fold(f64::INFINITY, f64::min)
        };
        let neighbours = places.iter().enumerate().map(neighbour).fold(f64::INFINITY, f64::min);
        // Determines how far the outer modules of all tags are dark.
        let dark = |border: &usize| {
            let outer = |index: usize| {
                [index % side, index / side].iter().any(|place| (*place).min(side - 1 - place) < *border)
            };
            tags.iter().all(|tag| !tag.light.iter().enumerate().any(|(index, light)| *light && outer(index)))
        };
        let border = (0..side / 2).take_while(dark).last().unwrap_or(0);
        Ok(Self { tags: tags.to_vec(), side, border, patterns, places, reach: NEIGHBOURHOOD * neighbours })
    }

    /// Finds the tags in a picture, by increasing index. `expected` are the tags of a neighbouring picture, if there is
    /// one, moved to their expected positions.
    ///
    /// # Errors
    /// Returns [`NoTags`] if no tag is found.
    pub fn find(&self, picture: &Picture, expected: &[FoundTag]) -> Result<Vec<FoundTag>, NoTags> {
        self.search(picture, expected).map_err(|failed| self.explain(picture, &failed))
    }

    /// Finds the tags in several pictures of one moment, by increasing index; each tag is taken from the picture in
    /// which it correlates best. `expected` as for [`TagFinder::find`].
    ///
    /// # Errors
    /// Returns [`NoTags`] if no picture has a tag, with the reason of the picture that looks most like the board.
    pub fn find_in_any(&self, pictures: &[Picture], expected: &[FoundTag]) -> Result<Vec<FoundTag>, NoTags> {
        let mut best = vec![None; self.tags.len()];
        let mut failure: Option<(&Picture, Failed)> = None;
        for picture in pictures {
            let known: Vec<FoundTag> = best.iter().flatten().copied().collect();
            if known.len() >= ENOUGH {
                self.better(picture, &known).into_iter().for_each(|tag| keep_better(&mut best, Some(tag)));
                continue;
            }
            match self.search(picture, if known.is_empty() { expected } else { &known }) {
                Ok(found) => found.into_iter().for_each(|tag| keep_better(&mut best, Some(tag))),
                Err(failed) => {
                    if failure.as_ref().is_none_or(|(_, other)| other.likeness() < failed.likeness()) {
                        failure = Some((picture, failed));
                    }
                }
            }
        }
        self.leave_out_disagreeing(&mut best);
        let found: Vec<FoundTag> = best.into_iter().flatten().collect();
        match failure {
            _ if !found.is_empty() => Ok(found),
            Some((picture, failed)) => Err(self.explain(picture, &failed)),
            None => Err(NoTags::NoQuads),
        }
    }

    /// Searches a picture, as [`find`](Self::find) does. If enough tags are at their expected positions, only the part with the board
    /// is examined.
    fn search(&self, picture: &Picture, expected: &[FoundTag]) -> Result<Vec<FoundTag>, Failed> {
        let enough = ENOUGH.min(self.tags.len());
        let mut found = vec![None; self.tags.len()];
        if !expected.is_empty() {
            let part = self.part(picture, expected);
            for tag in expected {
                keep_better(&mut found, self.verified(&part.smooth, tag.index, &part.of_picture(tag).corners));
            }
            self.leave_out_disagreeing(&mut found);
            if found.iter().flatten().count() >= enough {
                let tags = self.completed(&part.picture, &part.smooth, found, Vec::new(), 0)?;
                return Ok(tags.iter().map(|tag| part.in_picture(tag)).collect());
            }
            found.iter_mut().flatten().for_each(|tag| *tag = part.in_picture(tag));
        }
        let smooth = Smooth::new(picture);
        let (mut quads, mut disagreeing) = (Vec::new(), 0);
        for of_scale in quads_by_scale(picture) {
            for quad in &of_scale {
                // Most quadrilaterals are found several times, with surroundings of different sizes.
                if !found.iter().flatten().any(|tag| is_same_place(&tag.corners, quad)) {
                    keep_better(&mut found, self.recognised(&smooth, quad));
                }
            }
            disagreeing += self.leave_out_disagreeing(&mut found);
            quads.extend(of_scale);
            // If most tags next to those found are not where these predict them (a fisheye bends the board), they may be
            // among the quadrilaterals of another size.
            if found.iter().flatten().count() >= enough
                && FOUND_PER_MISSING * self.grow(&smooth, &mut found) <= found.iter().flatten().count()
            {
                break;
            }
        }
        self.completed(picture, &smooth, found, quads, disagreeing)
    }

    /// Adds the tags next to those found among the `quads` of a picture.
    fn completed(
        &self,
        picture: &Picture,
        smooth: &Smooth,
        mut found: Vec<Option<FoundTag>>,
        quads: Vec<Quad>,
        disagreeing: usize,
    ) -> Result<Vec<FoundTag>, Failed> {
        let missing = self.grow(smooth, &mut found);
        let tags: Vec<FoundTag> = found.into_iter().flatten().collect();
        // On a board with other numbers of rows and columns, most tags are elsewhere.
        let is_elsewhere = disagreeing >= ENOUGH && disagreeing > tags.len();
        if !is_board(&tags, missing) || is_elsewhere {
            return Err(Failed { found: tags.len(), missing: missing.max(disagreeing), quads, border: None });
        }
        match self.best_border(&smooth.picture, &tags) {
            border if border == self.border => Ok(self.sharpened(picture, tags)),
            border => Err(Failed { found: tags.len(), missing: 0, quads, border: Some(border) }),
        }
    }

    /// Returns the reason why a search failed.
    fn explain(&self, picture: &Picture, failed: &Failed) -> NoTags {
        if let Some(border) = failed.border {
            return NoTags::OtherBorder { border };
        }
        let (found, quads) = (failed.found, failed.quads.len());
        match self.mirrored(picture, &failed.quads) {
            tags if tags > found => NoTags::Mirrored { tags },
            _ if found > 0 => NoTags::OtherBoard { found, missing: failed.missing },
            _ => match (self.inverted(picture), quads) {
                (0, 0) => NoTags::NoQuads,
                (0, quads) => NoTags::OtherTags { quads },
                (tags, _) => NoTags::Inverted { tags },
            },
        }
    }

    /// Returns those of the `known` tags, found in another picture of the same moment, that correlate better in this one, and the
    /// tags next to them that the other picture does not show.
    fn better(&self, picture: &Picture, known: &[FoundTag]) -> Vec<FoundTag> {
        let part = self.part(picture, known);
        let mut found = vec![None; self.tags.len()];
        for tag in known.iter().map(|tag| part.of_picture(tag)) {
            keep_better(&mut found, Some(tag));
            let score = self.correlation(tag.index, &self.modules(&part.smooth.picture, &tag.corners));
            if score + ALIGNED > tag.score {
                keep_better(&mut found, self.verified(&part.smooth, tag.index, &tag.corners));
            }
        }
        let changed = |found: &[Option<FoundTag>]| -> Vec<FoundTag> {
            let is_known = |tag: &FoundTag| known.iter().any(|known| part.of_picture(known) == *tag);
            found.iter().flatten().filter(|tag| !is_known(tag)).copied().collect()
        };
        if known.len() < self.tags.len() {
            self.grow(&part.smooth, &mut found);
        }
        let tags = changed(&found);
        if tags.is_empty() {
            return tags;
        }
        self.sharpened(&part.picture, tags).iter().map(|tag| part.in_picture(tag)).collect()
    }

    /// Returns the part of a picture that contains the board whose `tags` are found, with a margin of a tag.
    fn part(&self, picture: &Picture, tags: &[FoundTag]) -> Part {
        let (low, high) = self.region(picture, tags);
        let (picture, first) = picture.part(low, high);
        Part { smooth: Smooth::new(&picture), picture, first: first.map(|place| place as f32) }
    }

    /// Returns the first and the last pixel of this part.
    pub(crate) fn region(&self, picture: &Picture, tags: &[FoundTag]) -> ([usize; 2], [usize; 2]) {
        let whole = ([0, 0], [picture.width() - 1, picture.height() - 1]);
        let Some(map) = self.map_of(tags).filter(|_| tags.len() >= ENOUGH.min(self.tags.len())) else { return whole };
        let margin = tags.iter().map(|tag| side_of(&tag.corners)).fold(LEAST_MARGIN_IN_PIXELS, f64::max);
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        let printed = self.tags.iter().flat_map(|tag| tag.corners).map(|corner| map.image(corner.into()));
        let seen = tags.iter().flat_map(|tag| tag.corners).map(|corner| Vector2::from(corner).cast());
        for place in printed.chain(seen) {
            if !(place.x.is_finite() && place.y.is_finite()) {
                return whole;
            }
            for (axis, value) in [place.x, place.y].into_iter().enumerate() {
                (low[axis], high[axis]) = (low[axis].min(value), high[axis].max(value));
            }
        }
        // Casts saturate.
        (low.map(|place| (place - margin).floor() as usize), high.map(|place| (place + margin).ceil() as usize))
    }

    /// Returns the tags with refined corners, if dark squares touch them, as on an AprilGrid. A corner is then a saddle
    /// too, and its position is the mean of the saddle's and the tag's, weighted by their uncertainties. The saddle is
    /// better in pictures without noise, because the lens bends the sides of a tag.
    fn sharpened(&self, picture: &Picture, tags: Vec<FoundTag>) -> Vec<FoundTag> {
        let test = SaddleTest::new(picture);
        let saddle = |corner: [f32; 2], side: f64| {
            let half = (WINDOW * side / self.side as f64).clamp(WINDOWS[0], WINDOWS[1]).round() as usize;
            refine_saddle(picture, corner, half).filter(|position| test.is_saddle(position.pixel))
        };
        let sharpened = |tag: &FoundTag| {
            let mut tag = *tag;
            let side = side_of(&tag.corners);
            let mut saddles = 0;
            for corner in &mut tag.corners {
                let Some(position) = saddle(*corner, side) else { continue };
                saddles += 1;
                let weight = SIGMA * SIGMA / (SIGMA * SIGMA + position.sigma * position.sigma);
                *corner = std::array::from_fn(|axis| corner[axis] + weight * (position.pixel[axis] - corner[axis]));
            }
            (tag, saddles)
        };
        let better: Vec<(FoundTag, usize)> = tags.iter().map(sharpened).collect();
        let saddles: usize = better.iter().map(|(_, saddles)| saddles).sum();
        // A smaller number may be a coincidence.
        if saddles > 2 * tags.len() { better.into_iter().map(|(tag, _)| tag).collect() } else { tags }
    }

    /// Returns the width of the border for which the inner modules correlate best.
    pub(crate) fn best_border(&self, picture: &Picture, found: &[FoundTag]) -> usize {
        let inner = self.side - 2 * self.border;
        let score = |border: usize| -> f32 {
            let score = |tag: &FoundTag| {
                let map = SquareMap::new(&tag.corners.map(|corner| corner.map(f64::from)));
                let place = |index: usize| ((index + border) as f64 + 0.5) / (inner + 2 * border) as f64;
                let (mut seen, mut printed) = (Vec::new(), Vec::new());
                for (row, column) in (0..inner).flat_map(|row| (0..inner).map(move |column| (row, column))) {
                    let [x, y] = map.at(place(column), place(row));
                    seen.push(picture.bilinear(x as f32, y as f32));
                    let module = (row + self.border) * self.side + column + self.border;
                    printed.push(if self.tags[tag.index].light[module] { 1.0 } else { 0.0 });
                }
                normalise(&mut seen);
                normalise(&mut printed);
                seen.iter().zip(&printed).map(|(seen, printed)| seen * printed).sum::<f32>()
            };
            found.iter().map(score).sum()
        };
        let own = score(self.border);
        let other = BORDERS.into_iter().filter(|border| *border != self.border).map(|border| (score(border), border));
        match other.max_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((other, border)) if other > own => border,
            _ => self.border,
        }
    }

    /// Returns the modules in a quadrilateral, normalised to mean 0 and norm 1.
    fn modules(&self, picture: &Picture, quad: &Quad) -> Vec<f32> {
        // Each module is the mean of four samples in it.
        const PLACES: [[f64; 2]; 4] = [[0.3, 0.3], [0.7, 0.3], [0.3, 0.7], [0.7, 0.7]];
        let map = SquareMap::new(&quad.map(|corner| corner.map(f64::from)));
        let mut values = Vec::with_capacity(self.side * self.side);
        for row in 0..self.side {
            for column in 0..self.side {
                let place = |[dx, dy]: [f64; 2]| {
                    let [u, v] = [column as f64 + dx, row as f64 + dy].map(|place| place / self.side as f64);
                    let [x, y] = map.at(u, v);
                    picture.bilinear(x as f32, y as f32)
                };
                values.push(PLACES.map(place).iter().sum());
            }
        }
        normalise(&mut values);
        values
    }

    /// Returns `true` if a candidate has a border that is at least slightly darker than its inside.
    pub(crate) fn has_border(&self, smooth: &Smooth, quad: &Quad) -> bool {
        let is_inner = |place: usize| (self.border..self.side - self.border).contains(&place);
        let mut inside: Vec<f32> = (0..self.side * self.side)
            .map(|module| if is_inner(module % self.side) && is_inner(module / self.side) { 1.0 } else { 0.0 })
            .collect();
        normalise(&mut inside);
        let modules = self.modules(&smooth.picture, quad);
        modules.iter().zip(&inside).map(|(a, b)| a * b).sum::<f32>() >= LEAST_BORDER
    }

    /// Returns `true` if the tag lies within the picture and has a light surround. (A tag with a wider border is dark
    /// there.)
    fn is_whole(&self, picture: &Picture, tag: &FoundTag) -> bool {
        if !is_inside(picture, &tag.corners) {
            return false;
        }
        let side = self.side as f64;
        let map = SquareMap::new(&tag.corners.map(|corner| corner.map(f64::from)));
        let at = |u: f64, v: f64| {
            let [x, y] = map.at(u / side, v / side);
            picture.bilinear(x as f32, y as f32)
        };
        // The mean of the modules along the four sides, at this distance outside.
        let around = |outside: f64| {
            let of_module = |index: usize| {
                let along = index as f64 + 0.5;
                at(along, -outside) + at(along, side + outside) + at(-outside, along) + at(side + outside, along)
            };
            (0..self.side).map(of_module).sum::<f32>() / (4.0 * self.side as f32)
        };
        let light = |index: &usize| self.tags.get(tag.index).is_some_and(|tag| tag.light.get(*index) == Some(&true));
        let inner: Vec<f32> = (0..self.side * self.side)
            .filter(light)
            .map(|index| at((index % self.side) as f64 + 0.5, (index / self.side) as f64 + 0.5))
            .collect();
        let border = around(-0.5);
        let bright = inner.iter().sum::<f32>() / inner.len().max(1) as f32;
        around(0.5) - border > LEAST_AROUND * (bright - border)
    }

    fn correlation(&self, tag: usize, modules: &[f32]) -> f32 {
        self.patterns.get(tag).map_or(0.0, |pattern| pattern.iter().zip(modules).map(|(a, b)| a * b).sum())
    }

    /// Returns the tag that correlates best with the modules, in any of the four rotations.
    fn best_match(&self, mut modules: Vec<f32>) -> Match {
        let mut best = Match { tag: 0, turn: 0, score: -1.0, other: -1.0 };
        for turn in 0..4 {
            for tag in 0..self.tags.len() {
                let score = self.correlation(tag, &modules);
                if score > best.score {
                    let other = if tag == best.tag { best.other } else { best.score };
                    best = Match { tag, turn, score, other };
                } else if tag != best.tag {
                    best.other = best.other.max(score);
                }
            }
            modules = turned(&modules, self.side);
        }
        best
    }

    /// Returns the tag in a candidate, if it is certain.
    pub(crate) fn recognised(&self, smooth: &Smooth, quad: &Quad) -> Option<FoundTag> {
        let first = self.best_match(self.modules(&smooth.picture, quad));
        if first.score < LEAST_AT_FIRST {
            return None;
        }
        let upright: Quad = std::array::from_fn(|corner| quad[(corner + first.turn) % 4]);
        let corners = self.aligned(smooth, first.tag, &upright)?;
        let second = self.best_match(self.modules(&smooth.picture, &corners));
        let certain = second.score >= LEAST && second.score - second.other >= LEAST_MARGIN;
        let found = FoundTag { index: second.tag, corners, score: second.score };
        let same = second.turn == 0 && second.tag == first.tag;
        (certain && same && self.is_whole(&smooth.picture, &found)).then_some(found)
    }

    /// Returns the tag at its predicted position, if it is there.
    fn verified(&self, smooth: &Smooth, tag: usize, predicted: &Quad) -> Option<FoundTag> {
        if !is_inside(&smooth.picture, predicted) {
            return None;
        }
        let corners = self.aligned(smooth, tag, predicted)?;
        let score = self.correlation(tag, &self.modules(&smooth.picture, &corners));
        let found = FoundTag { index: tag, corners, score };
        (score >= LEAST_PREDICTED && self.is_whole(&smooth.picture, &found)).then_some(found)
    }

    fn aligned(&self, smooth: &Smooth, tag: usize, start: &Quad) -> Option<Quad> {
        align(&smooth.slopes, &Pattern { side: self.side, light: &self.tags.get(tag)?.light }, start)
    }

    /// Keeps the largest group of tags that agree about the position of the board, and returns the number of others.
    fn leave_out_disagreeing(&self, found: &mut [Option<FoundTag>]) -> usize {
        let tags: Vec<FoundTag> = found.iter().flatten().copied().collect();
        let maps: Vec<Option<BoardMap>> = tags.iter().map(|tag| self.map_of(&[*tag])).collect();
        let agrees = |from: usize, to: usize| {
            let (a, b) = (&tags[from], &tags[to]);
            let Some(map) = &maps[from] else { return false };
            let distance =
                (self.places[a.index].middle - self.places[b.index].middle).norm() / self.places[a.index].side;
            let off = (map.image(self.places[b.index].middle) - middle(&b.corners)).norm();
            off <= AGREEMENT * distance * side_of(&b.corners)
        };
        let mut group: Vec<usize> = (0..tags.len()).collect();
        for a in 0..tags.len() {
            for b in 0..a {
                if group[a] != group[b] && agrees(a, b) && agrees(b, a) {
                    let (from, to) = (group[a], group[b]);
                    group.iter_mut().filter(|group| **group == from).for_each(|group| *group = to);
                }
            }
        }
        let weight = |name: usize| -> f32 {
            group.iter().zip(&tags).filter(|(group, _)| **group == name).map(|(_, tag)| 1.0 + 0.1 * tag.score).sum()
        };
        let Some(&largest) = group.iter().max_by(|a, b| weight(**a).total_cmp(&weight(**b)).then(b.cmp(a))) else {
            return 0;
        };
        for (tag, group) in tags.iter().zip(&group) {
            if *group != largest {
                found[tag.index] = None;
            }
        }
        group.iter().filter(|group| **group != largest).count()
    }

    /// Returns the tags.
    pub fn tags(&self) -> &[Tag] {
        &self.tags
    }

    /// Returns the tags found that are nearest to a position on the board, as many as a prediction uses; `None` if all
    /// are too far away.
    pub(crate) fn nearest(&self, found: &[FoundTag], place: Vector2<f64>) -> Option<Vec<FoundTag>> {
        let distance =
            |tag: &FoundTag| self.places.get(tag.index).map_or(f64::INFINITY, |known| (known.middle - place).norm());
        let mut near = found.to_vec();
        near.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
        near.truncate(PREDICTING);
        (distance(near.first()?) <= self.reach).then_some(near)
    }

    /// Returns the map from the board to the picture that fits the corners of some tags.
    pub(crate) fn map_of(&self, tags: &[FoundTag]) -> Option<BoardMap> {
        let plane: Vec<Vector2<f64>> = tags
            .iter()
            .filter_map(|tag| self.tags.get(tag.index))
            .flat_map(|tag| tag.corners.map(Vector2::from))
            .collect();
        let image: Vec<Vector2<f64>> =
            tags.iter().flat_map(|tag| tag.corners.map(|corner| Vector2::from(corner).cast())).collect();
        Some(BoardMap(homography(&plane, &image)?))
    }

    /// Searches for the tags next to those found, until no more are found. Returns the number of tags that are not at
    /// their predicted positions.
    fn grow(&self, smooth: &Smooth, found: &mut [Option<FoundTag>]) -> usize {
        let mut news = true;
        let mut missing = vec![false; found.len()];
        // The tags used in the last prediction, so that no prediction is repeated.
        let mut tried: Vec<Vec<usize>> = vec![Vec::new(); found.len()];
        while news {
            news = false;
            for tag in 0..found.len() {
                if found[tag].is_some() {
                    continue;
                }
                let known: Vec<FoundTag> = found.iter().flatten().copied().collect();
                let Some(near) = self.nearest(&known, self.places[tag].middle) else { continue };
                let from: Vec<usize> = near.iter().map(|tag| tag.index).collect();
                if from == tried[tag] {
                    continue;
                }
                tried[tag] = from;
                let Some(map) = self.map_of(&near) else { continue };
                let predicted = self.tags[tag].corners.map(|corner| map.pixel(corner.into()));
                found[tag] = self.verified(smooth, tag, &predicted);
                news |= found[tag].is_some();
                missing[tag] = found[tag].is_none() && is_inside(&smooth.picture, &predicted);
            }
        }
        missing.into_iter().filter(|missing| *missing).count()
    }

    /// Returns the number of tags that are mirror images of the board's; a single one may be a coincidence and does not
    /// count.
    fn mirrored(&self, picture: &Picture, quads: &[Quad]) -> usize {
        let mirror = |[x, y]: [f32; 2]| [(picture.width() - 1) as f32 - x, y];
        let is_mirrored = |quad: &&Quad| {
            let [a, b, c, d] = **quad;
            self.best_match(self.modules(picture, &[a, d, c, b])).score >= LEAST_AT_FIRST
        };
        let candidates: Vec<&Quad> = quads.iter().filter(is_mirrored).collect();
        if candidates.len() < 2 {
            return 0;
        }
        self.count(&picture.mirrored(), candidates.into_iter().map(|[a, b, c, d]| [*a, *d, *c, *b].map(mirror)))
    }

    /// Returns the number of tags that are negatives of the board's; a single one counts only if the board has one tag.
    fn inverted(&self, picture: &Picture) -> usize {
        let negative = picture.map(|value| -value);
        self.count(&negative, find_quads(&negative).into_iter())
    }

    /// Returns the number of tags in these quadrilaterals. It is 0 if they do not form the board, or if only one of
    /// several tags is found.
    fn count(&self, picture: &Picture, quads: impl Iterator<Item = Quad>) -> usize {
        let smooth = Smooth::new(picture);
        let mut found = vec![None; self.tags.len()];
        for quad in quads {
            keep_better(&mut found, self.recognised(&smooth, &quad));
        }
        self.leave_out_disagreeing(&mut found);
        let missing = self.grow(&smooth, &mut found);
        let tags: Vec<FoundTag> = found.into_iter().flatten().collect();
        if tags.len() >= 2.min(self.tags.len()) && is_board(&tags, missing) { tags.len() } else { 0 }
    }
}

/// Returns `true` if the tags are enough for certainty, with `missing` tags next to them.
fn is_board(tags: &[FoundTag], missing: usize) -> bool {
    match tags {
        [] => false,
        [tag] => tag.score >= LEAST_ALONE && missing <= MOST_MISSING,
        tags => missing <= MOST_MISSING * tags.len(),
    }
}

/// Returns `true` if two quadrilaterals have nearly the same middle.
pub(crate) fn is_same_place(a: &Quad, b: &Quad) -> bool {
    (middle(a) - middle(b)).norm() < SAME * side_of(b)
}

fn is_inside(picture: &Picture, quad: &Quad) -> bool {
    quad.iter().all(|&corner| picture.contains(corner, BORDER))
}

fn keep_better(found: &mut [Option<FoundTag>], tag: Option<FoundTag>) {
    let Some(tag) = tag else { return };
    if let Some(slot) = found.get_mut(tag.index)
        && slot.is_none_or(|known| known.score < tag.score)
    {
        *slot = Some(tag);
    }
}

/// Normalises to mean 0 and norm 1; all 0 if all values are equal.
pub(crate) fn normalise(values: &mut [f32]) {
    let mean = values.iter().sum::<f32>() / values.len() as f32;
    values.iter_mut().for_each(|value| *value -= mean);
    let norm = values.iter().map(|value| value * value).sum::<f32>().sqrt();
    let scale = if norm > 1e-9 && norm.is_finite() { 1.0 / norm } else { 0.0 };
    values.iter_mut().for_each(|value| *value *= scale);
}

/// Returns the modules of a candidate rotated so that its next corner becomes the first.
pub(crate) fn turned(modules: &[f32], side: usize) -> Vec<f32> {
    (0..side * side).map(|index| modules[index % side * side + side - 1 - index / side]).collect()
}

pub(crate) fn middle(quad: &Quad) -> Vector2<f64> {
    quad.iter().map(|corner| Vector2::from(*corner).cast::<f64>()).sum::<Vector2<f64>>() / 4.0
}

fn side_of(quad: &Quad) -> f64 {
    let side = |index: usize| (Vector2::from(quad[(index + 1) % 4]) - Vector2::from(quad[index])).cast::<f64>().norm();
    [0, 1, 2, 3].map(side).iter().sum::<f64>() / 4.0
}

#[cfg(test)]
mod tests {
    use evcal_core::camera::{Camera, ModelKind};
    use evcal_geometry::board::squares::SquareBoard;
    use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};

    use super::*;
    use crate::rendering::{Light, Random, Shot, TagGrid, View, noisy};

    /// An AprilGrid as Kalibr prints it.
    const KALIBR: TagGrid =
        TagGrid { rows: 4, columns: 5, border: 2, gap: 0.3, corner_squares: true, first_id: 0, upwards: true };
    /// Tags without squares at their corners.
    const SHEET: TagGrid =
        TagGrid { rows: 3, columns: 4, border: 1, gap: 0.25, corner_squares: false, first_id: 0, upwards: false };

    fn finder(grid: &TagGrid) -> TagFinder {
        TagFinder::new(&grid.tags()).unwrap()
    }

    /// Returns a view of the whole grid, upright even if y runs upwards.
    fn view(grid: &TagGrid, distance: f64, rotation: [f64; 3]) -> View {
        let [a, b, c] = rotation;
        View::new(grid.middle(), distance, if grid.upwards { [a + std::f64::consts::PI, b, c] } else { rotation })
    }

    /// Returns the root mean square distance of the corners from the ground truth in pixels.
    fn error(found: &[FoundTag], grid: &TagGrid, view: &View) -> f32 {
        let tags = grid.tags();
        let corners = found.iter().flat_map(|tag| tag.corners.into_iter().zip(tags[tag.index].corners));
        let squares: Vec<f32> = corners
            .map(|(pixel, corner)| (Vector2::from(pixel) - Vector2::from(view.pixel(corner.into()))).norm_squared())
            .collect();
        (squares.iter().sum::<f32>() / squares.len() as f32).sqrt()
    }

    #[test]
    fn tags_are_found_in_any_rotation_and_numbering() {
        for (grid, distance) in [(KALIBR, 10.5), (SHEET, 8.0)] {
            for turn in [0.1, 1.5, 3.0, -1.7] {
                for upwards in [true, false] {
                    let grid = TagGrid { upwards, ..grid };
                    let view = view(&grid, distance, [0.3, -0.35, turn]);
                    let picture = view.render(grid.brightness());
                    let found = finder(&grid).find(&picture, &[]).unwrap();
                    assert!(found.iter().map(|tag| tag.index).eq(0..grid.rows * grid.columns), "{turn} {upwards}");
                    let error = error(&found, &grid, &view);
                    assert!(error < 0.1, "{error} px");
                }
            }
        }
    }

    #[test]
    fn tags_of_three_pixels_per_module_are_found_in_noise() {
        let view = view(&KALIBR, 11.0, [0.2, 0.3, 0.2]);
        let picture = noisy(&view.render(KALIBR.brightness()), 0.25);
        let found = finder(&KALIBR).find(&picture, &[]).unwrap();
        assert_eq!(found.len(), 20);
        assert!(error(&found, &KALIBR, &view) < 0.4);
    }

    #[test]
    fn tags_are_found_that_nearly_fill_a_large_picture() {
        let grid = TagGrid { rows: 1, columns: 2, ..SHEET };
        let view = view(&grid, 2.6, [0.2, 0.3, 0.2]);
        let picture = view.render(grid.brightness()).enlarged(3);
        let found = finder(&grid).find(&picture, &[]).unwrap();
        let small = |pixel: [f32; 2]| pixel.map(|place| (place + 0.5) / 3.0 - 0.5);
        let found: Vec<FoundTag> =
            found.iter().map(|tag| FoundTag { corners: tag.corners.map(small), ..*tag }).collect();
        assert!(found.len() == 2 && error(&found, &grid, &view) < 0.1);
    }

    #[test]
    fn tags_are_found_at_their_expected_positions() {
        let view = view(&SHEET, 7.0, [0.2, 0.3, 0.2]);
        let picture = view.render(SHEET.brightness());
        let finder = finder(&SHEET);
        let first = finder.find(&picture, &[]).unwrap();
        let moved = |tag: &FoundTag| FoundTag { corners: tag.corners.map(|[x, y]| [x + 1.2, y - 0.8]), ..*tag };
        let expected: Vec<FoundTag> = first[..4].iter().map(moved).collect();
        let found = finder.find(&picture, &expected).unwrap();
        assert!(found.len() == 12 && error(&found, &SHEET, &view) < 0.1);
        // A wrong expectation does no harm.
        let wrong: Vec<FoundTag> = first.iter().map(|tag| FoundTag { index: 11 - tag.index, ..*tag }).collect();
        assert_eq!(finder.find(&picture, &wrong).unwrap().len(), 12);
    }

    #[test]
    fn pictures_of_one_moment_complete_each_other() {
        let view = view(&SHEET, 8.0, [0.2, 0.3, 0.2]);
        let brightness = SHEET.brightness();
        // Each of the pictures lacks a different part of the board.
        let hidden =
            |left: f64, right: f64| view.render(|x, y| if x > left && x < right { 0.5 } else { brightness(x, y) });
        let pictures = [hidden(-1.0, 1.1), hidden(2.4, 6.0), view.render(|_, _| 0.5)];
        let finder = finder(&SHEET);
        assert!(
            pictures
                .iter()
                .all(|picture| finder.find(picture, &[]).is_ok_and(|found| found.len() < 12)
                    == (picture != &pictures[2]))
        );
        let found = finder.find_in_any(&pictures, &[]).unwrap();
        assert!(found.len() == 12 && error(&found, &SHEET, &view) < 0.1);
        assert_eq!(finder.find_in_any(&pictures[2..], &[]), Err(NoTags::NoQuads));
    }

    #[test]
    fn the_visible_tags_of_a_board_partly_outside_are_found() {
        let view = view(&SHEET, 7.0, [0.2, 0.3, 0.2]).moved(-90.0, 0.0);
        let found = finder(&SHEET).find(&view.render(SHEET.brightness()), &[]).unwrap();
        assert!((4..12).contains(&found.len()) && error(&found, &SHEET, &view) < 0.1);
    }

    #[test]
    fn other_boards_are_rejected_with_their_reason() {
        let refused = |grid: &TagGrid, shown: &TagGrid| {
            let picture = view(shown, 8.0, [0.2, 0.3, 0.2]).render(shown.brightness());
            finder(grid).find(&picture, &[]).unwrap_err()
        };
        assert!(matches!(
            refused(&SHEET, &TagGrid { first_id: 12, ..SHEET }),
            NoTags::OtherTags { .. } | NoTags::OtherBoard { .. }
        ));
        assert!(matches!(refused(&SHEET, &TagGrid { border: 2, ..SHEET }), NoTags::OtherBorder { border: 2 }));
        // The same tags in another arrangement.
        assert!(matches!(refused(&SHEET, &TagGrid { gap: 0.8, ..SHEET }), NoTags::OtherBoard { .. }));
        // The tags within a row are at the right positions relative to each other, but not relative to other rows.
        let exchanged = TagGrid { rows: SHEET.columns, columns: SHEET.rows, ..SHEET };
        assert!(matches!(refused(&exchanged, &SHEET), NoTags::OtherBoard { found: 1..=4, missing: 8.. }));
        let brightness = SHEET.brightness();
        let mirrored = view(&SHEET, 7.0, [0.2, 0.3, 0.2]).render(|x, y| brightness(2.0 * SHEET.middle()[0] - x, y));
        assert!(matches!(finder(&SHEET).find(&mirrored, &[]), Err(NoTags::Mirrored { tags: 2.. })));
        let inverted = view(&SHEET, 7.0, [0.2, 0.3, 0.2]).render(|x, y| 1.0 - brightness(x, y));
        assert!(matches!(finder(&SHEET).find(&inverted, &[]), Err(NoTags::Inverted { tags: 2.. })));
        let blank = view(&SHEET, 7.0, [0.0; 3]).render(|_, _| 0.5);
        assert_eq!(finder(&SHEET).find(&blank, &[]), Err(NoTags::NoQuads));
    }

    #[test]
    fn tags_of_different_sizes_are_rejected() {
        let mut tags = SHEET.tags();
        tags[3].side = 7;
        assert_eq!(TagFinder::new(&tags).unwrap_err(), TagsError::Modules { id: 3, side: 8 });
        assert_eq!(TagFinder::new(&[]).unwrap_err(), TagsError::NoTags);
    }

    /// The tags of the first size were found, and those next to them were not where a homography predicted them; the other
    /// sizes were not searched.
    #[test]
    fn a_tilted_board_is_found_through_a_fisheye() {
        let board: SquareBoard = "charuco:5x7:30mm:22mm:DICT_5X5_100".parse().unwrap();
        let parameters = [150.0, 149.5, 174.0, 131.0, 0.02, -0.01, 0.004, -0.001];
        let camera = Camera::from_parameters(ModelKind::KannalaBrandt, &parameters).unwrap();
        let (raster, finder) = (board.raster(), TagFinder::new(&board.tags()).unwrap());
        let mut random = Random::new(3);
        let light = Light { noise: 0.0125, ..Light::EVEN };
        // Places of the camera, and its rotations as quaternions (i, j, k, w).
        let views = [
            ([0.1417, 0.1055, -0.0911], [0.2146, -0.4138, 0.3088, 0.829]),
            ([0.1211, 0.0940, -0.0921], [0.1229, -0.2108, 0.3584, 0.9011]),
            ([0.1000, 0.0901, -0.0918], [0.0976, 0.0099, 0.3689, 0.9243]),
            ([0.0696, 0.0779, -0.0998], [-0.1267, 0.3188, 0.2677, 0.9004]),
        ];
        for (place, [i, j, k, w]) in views {
            let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
            let pose = Isometry3::from_parts(Translation3::from(place), rotation).inverse();
            let shot = Shot { raster: &raster, camera, pose };
            let picture = shot.render(Vector2::new(172.5, 129.5), 180.0, &light, &mut random).picture;
            let found = finder.find(&picture, &[]);
            assert!(found.as_ref().is_ok_and(|found| found.len() >= 6), "{place:?}: {found:?}");
        }
    }
}
