//! Oriented FAST corners with rotated BRIEF descriptors (ORB: Rublee et al., ICCV 2011), spread evenly over the image.

use opencv::core::{KeyPoint, Mat, MatTraitConst, MatTraitConstManual, Rect, Size, Vector};
use opencv::prelude::KeyPointTraitConst;
use pfd_geometry::{GrayImage, Mask};

use crate::convert::{VisionError, gray_as_mat};
use crate::orb_pattern::{BITS, DIRECTIONS, PATCH_SIDE, PATTERN, RADIUS};
use crate::patch::Patch;

/// A 256-bit binary descriptor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Descriptor(pub [u64; BITS / 64]);

impl Descriptor {
    /// Number of differing bits, 0 to 256.
    // For the sake of `Search`.
    #[allow(clippy::inline_always)]
    #[inline(always)]
    pub fn distance(&self, other: &Self) -> u32 {
        self.0.iter().zip(&other.0).map(|(a, b)| (a ^ b).count_ones()).sum()
    }

    /// The nearest of `candidates`; `None` without any.
    pub fn nearest(&self, candidates: &[Self]) -> Option<Nearest> {
        pulp::Arch::new().dispatch(Search { wanted: self, candidates })
    }
}

/// The nearest of several descriptors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Nearest {
    /// Its index; of equally near ones the first.
    pub index: usize,
    /// Bits in which it differs.
    pub distance: u32,
    /// Those of the second nearest; `u32::MAX` where there is none.
    pub second: u32,
}

/// A search through all of `candidates`, compiled for several processors: some count the bits of a word in one step. Only what is inlined
/// may use that.
struct Search<'a> {
    wanted: &'a Descriptor,
    candidates: &'a [Descriptor],
}

impl pulp::NullaryFnOnce for Search<'_> {
    type Output = Option<Nearest>;

    #[allow(clippy::inline_always)]
    #[inline(always)]
    fn call(self) -> Option<Nearest> {
        let mut nearest = Nearest { index: 0, distance: u32::MAX, second: u32::MAX };
        for (index, candidate) in self.candidates.iter().enumerate() {
            let distance = self.wanted.distance(candidate);
            if distance < nearest.distance {
                nearest = Nearest { index, distance, second: nearest.distance };
            } else {
                nearest.second = nearest.second.min(distance);
            }
        }
        (!self.candidates.is_empty()).then_some(nearest)
    }
}

/// A corner with its descriptor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Feature {
    /// Column in the full-size image, pixels.
    pub u: f32,
    /// Row in the full-size image, pixels.
    pub v: f32,
    /// Direction of the intensity centroid, radians.
    pub angle: f32,
    /// Pyramid level on which it was found; 0 is the full-size image.
    pub level: u8,
    /// FAST score.
    pub response: f32,
    /// Binary descriptor.
    pub descriptor: Descriptor,
}

/// How features are extracted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeatureOptions {
    /// Features wanted in an image.
    pub count: usize,
    /// Pyramid levels.
    pub levels: usize,
    /// Ratio of the sizes of two levels, above 1.
    pub scale: f64,
    /// FAST threshold in grey levels.
    pub threshold: i32,
    /// FAST threshold for cells in which the first finds nothing.
    pub low_threshold: i32,
}

impl FeatureOptions {
    /// Size of a pixel of `level` in pixels of the full-size image.
    pub fn level_scale(&self, level: u8) -> f64 {
        self.scale.powi(i32::from(level))
    }

    /// From a column or row of the full-size image to one of `level`, pixels.
    pub fn to_level(&self, image: f64, level: u8) -> f64 {
        (image + 0.5) / self.level_scale(level) - 0.5
    }

    /// From a column or row of `level` to one of the full-size image, pixels.
    pub fn from_level(&self, on_level: f64, level: u8) -> f64 {
        (on_level + 0.5) * self.level_scale(level) - 0.5
    }
}

/// Corners closer to the border than this have no complete descriptor patch (pixels of their level).
const BORDER: i32 = RADIUS + 4;
/// Side of the cells over which corners are spread (pixels of the level).
const CELL: i32 = 32;
/// Smoothing before the binary tests (Calonder et al., section 3.1: kernel 9, here 7 as ORB has it).
const BLUR_KERNEL: i32 = 7;
const BLUR_SIGMA: f64 = 2.0;

/// Extracts features; keeps its buffers from frame to frame.
pub struct FeatureExtractor {
    options: FeatureOptions,
    levels: Vec<Level>,
}

/// One level of the pyramid.
#[derive(Default)]
struct Level {
    image: Mat,
    blurred: Mat,
    /// All that were detected; none where the level is too small for descriptors.
    corners: Vec<Corner>,
}

/// A corner in the coordinates of its level.
#[derive(Clone, Copy)]
struct Corner {
    x: i32,
    y: i32,
    response: f32,
}

impl FeatureExtractor {
    /// An extractor with empty buffers.
    pub fn new(options: FeatureOptions) -> Self {
        let levels = (0..options.levels.max(1)).map(|_| Level::default()).collect();
        Self { options, levels }
    }

    /// The options it was made with.
    pub fn options(&self) -> &FeatureOptions {
        &self.options
    }

    /// Takes an image: all of the work that does not depend on a mask.
    ///
    /// # Errors
    /// When OpenCV fails.
    pub fn load(&mut self, image: &GrayImage) -> Result<(), VisionError> {
        self.build_pyramid(image)?;
        let kernel = Size::new(BLUR_KERNEL, BLUR_KERNEL);
        for Level { image, blurred, corners } in &mut self.levels {
            corners.clear();
            if image.cols() > 2 * BORDER && image.rows() > 2 * BORDER {
                *corners = detect(image, &self.options)?;
                opencv::imgproc::gaussian_blur_def(image, blurred, kernel, BLUR_SIGMA)?;
            }
        }
        Ok(())
    }

    /// Features of the last image that lie outside the dynamic pixels of `mask`, at least `margin` pixels from them.
    ///
    /// # Errors
    /// When the sizes of image and mask differ, or OpenCV fails.
    pub fn extract(&self, mask: Option<&Mask>, margin: usize) -> Result<Vec<Feature>, VisionError> {
        let image = self.levels[0].image.size()?;
        let size = (image.width as usize, image.height as usize);
        if let Some(mask) = mask.filter(|mask| mask.image().size() != size) {
            return Err(VisionError::SizeMismatch(size, mask.image().size()));
        }
        let mut features = Vec::with_capacity(self.options.count + self.options.count / 4);
        for level in 0..self.levels.len() {
            self.extract_level(level, mask.map(|m| (m, margin)), &mut features)?;
        }
        Ok(features)
    }

    /// The surroundings of features of the last image.
    ///
    /// # Errors
    /// When OpenCV fails.
    pub fn patches(&self, features: &[Feature]) -> Result<Vec<Option<Patch>>, VisionError> {
        let levels = self.levels.iter().map(|l| Ok((l.image.data_typed::<u8>()?, l.image.cols() as usize)));
        let levels = levels.collect::<Result<Vec<_>, VisionError>>()?;
        let cut = |feature: &Feature| {
            let (pixels, stride) = *levels.get(usize::from(feature.level))?;
            let on_level = |c: f32| self.options.to_level(c.into(), feature.level).round() as i32;
            Patch::cut(pixels, stride, [on_level(feature.u), on_level(feature.v)])
        };
        Ok(features.iter().map(cut).collect())
    }

    fn build_pyramid(&mut self, image: &GrayImage) -> Result<(), VisionError> {
        gray_as_mat(image)?.copy_to(&mut self.levels[0].image)?;
        // By factor and not by size: that would be rounded, and pixels at the far border would lie up to a pixel beside their place.
        let factor = 1.0 / self.options.scale;
        for level in 1..self.levels.len() {
            let (finer, coarser) = self.levels.split_at_mut(level);
            let (source, target) = (&finer[level - 1].image, &mut coarser[0].image);
            if f64::from(source.cols().min(source.rows())) * factor < 1.0 {
                *target = Mat::default();
                continue;
            }
            opencv::imgproc::resize(source, target, Size::default(), factor, factor, opencv::imgproc::INTER_LINEAR)?;
        }
        Ok(())
    }

    fn extract_level(
        &self,
        level: usize,
        mask: Option<(&Mask, usize)>,
        out: &mut Vec<Feature>,
    ) -> Result<(), VisionError> {
        let quota = self.quota(level);
        let scale = self.options.level_scale(level as u8);
        let Level { image, blurred, corners } = &self.levels[level];
        let kept = |corner: &&Corner| mask.is_none_or(|(mask, margin)| !is_masked(mask, margin, corner, scale));
        let corners = spread(corners.iter().filter(kept).copied().collect(), image.size()?, quota);
        if corners.is_empty() {
            return Ok(());
        }
        let (pixels, smooth) = (image.data_typed::<u8>()?, blurred.data_typed::<u8>()?);
        let stride = image.cols() as usize;
        out.extend(corners.iter().map(|corner| {
            let centre = corner.y as usize * stride + corner.x as usize;
            let angle = centroid_angle(&surroundings(pixels, stride, centre));
            let (dx, dy) = refine(pixels, stride, centre);
            Feature {
                u: self.options.from_level((corner.x as f32 + dx).into(), level as u8) as f32,
                v: self.options.from_level((corner.y as f32 + dy).into(), level as u8) as f32,
                angle,
                level: level as u8,
                response: corner.response,
                descriptor: describe(&surroundings(smooth, stride, centre), angle),
            }
        }));
        Ok(())
    }

    /// Features wanted on `level`: proportional to its side, as in ORB.
    fn quota(&self, level: usize) -> usize {
        let share = |l: usize| self.options.scale.powi(-(l as i32));
        let total: f64 = (0..self.levels.len()).map(share).sum();
        (self.options.count as f64 * share(level) / total).round() as usize
    }
}

/// Whether a pixel of the full-size image under `corner`, or `margin` away in one of eight directions, is dynamic.
fn is_masked(mask: &Mask, margin: usize, corner: &Corner, scale: f64) -> bool {
    let centre = |c: i32| ((f64::from(c) + 0.5) * scale - 0.5).round() as isize;
    let reach = margin as isize;
    let dynamic = |u: isize, v: isize| u >= 0 && v >= 0 && mask.is_dynamic(u as usize, v as usize);
    [-reach, 0, reach]
        .into_iter()
        .any(|dy| [-reach, 0, reach].into_iter().any(|dx| dynamic(centre(corner.x) + dx, centre(corner.y) + dy)))
}

/// FAST corners away from the border; cells without any are searched again with the low threshold.
fn detect(image: &Mat, options: &FeatureOptions) -> Result<Vec<Corner>, VisionError> {
    let inner = Rect::new(BORDER, BORDER, image.cols() - 2 * BORDER, image.rows() - 2 * BORDER);
    let mut corners = fast(image, inner, options.threshold)?;
    let columns = cells(inner.width);
    let mut occupied = vec![false; (columns * cells(inner.height)) as usize];
    for corner in &corners {
        occupied[((corner.y - inner.y) / CELL * columns + (corner.x - inner.x) / CELL) as usize] = true;
    }
    for (index, _) in occupied.iter().enumerate().filter(|(_, occupied)| !**occupied) {
        let (column, row) = (index as i32 % columns, index as i32 / columns);
        let cell = Rect::new(inner.x + column * CELL, inner.y + row * CELL, CELL, CELL) & inner;
        corners.extend(fast(image, cell, options.low_threshold)?);
    }
    Ok(corners)
}

/// Cells needed to cover `length` pixels.
fn cells(length: i32) -> i32 {
    (length + CELL - 1) / CELL
}

/// FAST corners inside `area`. The detector needs three pixels around a corner, which the border provides.
fn fast(image: &Mat, area: Rect, threshold: i32) -> Result<Vec<Corner>, VisionError> {
    const RING: i32 = 3;
    // One more pixel on each side, so that non-maximum suppression sees the neighbours across the cell's edge.
    const MARGIN: i32 = RING + 1;
    let grown = Rect::new(area.x - MARGIN, area.y - MARGIN, area.width + 2 * MARGIN, area.height + 2 * MARGIN);
    let mut keypoints = Vector::<KeyPoint>::new();
    opencv::features2d::fast(&Mat::roi(image, grown)?, &mut keypoints, threshold, true)?;
    Ok(keypoints
        .iter()
        .map(|k| Corner { x: k.pt().x as i32 + grown.x, y: k.pt().y as i32 + grown.y, response: k.response() })
        .filter(|c| area.contains(opencv::core::Point::new(c.x, c.y)))
        .collect())
}

/// Keeps about `quota` corners, the strongest of each cell, cells taking turns: first every cell's best, then every cell's
/// second best, and so on.
fn spread(mut corners: Vec<Corner>, size: Size, quota: usize) -> Vec<Corner> {
    if corners.len() <= quota {
        return corners;
    }
    let columns = cells(size.width);
    let cell_of = |c: &Corner| (c.y / CELL * columns + c.x / CELL) as usize;
    // A total order, so that equal scores do not make the result depend on the detector's order.
    corners.sort_by(|a, b| b.response.total_cmp(&a.response).then((a.y, a.x).cmp(&(b.y, b.x))));
    let mut rank_in_cell = vec![0_u32; (columns * cells(size.height)) as usize];
    let mut ranked: Vec<(u32, Corner)> = corners
        .into_iter()
        .map(|corner| {
            let rank = &mut rank_in_cell[cell_of(&corner)];
            *rank += 1;
            (*rank, corner)
        })
        .collect();
    ranked.sort_by_key(|(rank, _)| *rank);
    ranked.into_iter().take(quota).map(|(_, corner)| corner).collect()
}

/// Sub-pixel offset of the corner: the peak of a parabola through the smoothed gradient energy along each axis would need a
/// corner measure per pixel, so the Förstner least-squares intersection of edge normals in a small window is used instead
/// (Förstner and Gülch 1987).
fn refine(pixels: &[u8], stride: usize, centre: usize) -> (f32, f32) {
    const HALF_WINDOW: isize = 3;
    // Beyond this the window was not centred on one corner.
    const MAX_SHIFT: f32 = 1.0;
    let (mut a, mut b, mut c, mut p, mut q) = (0.0_f32, 0.0_f32, 0.0_f32, 0.0_f32, 0.0_f32);
    for y in -HALF_WINDOW..=HALF_WINDOW {
        for x in -HALF_WINDOW..=HALF_WINDOW {
            let at = (centre as isize + y * stride as isize + x) as usize;
            let gx = f32::from(pixels[at + 1]) - f32::from(pixels[at - 1]);
            let gy = f32::from(pixels[at + stride]) - f32::from(pixels[at - stride]);
            let (x, y) = (x as f32, y as f32);
            a += gx * gx;
            b += gx * gy;
            c += gy * gy;
            p += gx * gx * x + gx * gy * y;
            q += gx * gy * x + gy * gy * y;
        }
    }
    let determinant = a * c - b * b;
    // Reject an edge: its normals do not intersect in a point.
    if determinant <= 0.05 * (0.5 * (a + c)).powi(2) {
        return (0.0, 0.0);
    }
    let (dx, dy) = ((c * p - b * q) / determinant, (a * q - b * p) / determinant);
    if dx.abs() > MAX_SHIFT || dy.abs() > MAX_SHIFT { (0.0, 0.0) } else { (dx, dy) }
}

/// The square around a corner, row by row.
type Surroundings = [[u8; PATCH_SIDE]; PATCH_SIDE];

fn surroundings(pixels: &[u8], stride: usize, centre: usize) -> Surroundings {
    let first = centre - RADIUS as usize * (stride + 1);
    std::array::from_fn(|row| std::array::from_fn(|column| pixels[first + row * stride..][..PATCH_SIDE][column]))
}

/// For each row of the surroundings, -1 (all bits) within the disc and 0 beside it.
const DISC: [[i16; PATCH_SIDE]; PATCH_SIDE] = {
    let mut disc = [[0; PATCH_SIDE]; PATCH_SIDE];
    let (mut row, mut column) = (0, 0);
    while row < PATCH_SIDE {
        let (x, y) = (column as i32 - RADIUS, row as i32 - RADIUS);
        disc[row][column] = if x * x + y * y <= RADIUS * RADIUS { -1 } else { 0 };
        (row, column) = if column + 1 < PATCH_SIDE { (row, column + 1) } else { (row + 1, 0) };
    }
    disc
};

/// Direction from the corner to the intensity centroid of the disc around it (Rosin 1999; Rublee et al., section 3.2).
fn centroid_angle(surroundings: &Surroundings) -> f32 {
    let (mut m01, mut m10) = (0_i32, 0_i32);
    for ((line, disc), y) in surroundings.iter().zip(&DISC).zip(-RADIUS..) {
        let (mut sum, mut moment) = (0_i32, 0_i32);
        for (x, (&value, &inside)) in line.iter().zip(disc).enumerate() {
            let value = i32::from(i16::from(value) & inside);
            sum += value;
            moment += value * (x as i32 - RADIUS);
        }
        m10 += moment;
        m01 += y * sum;
    }
    (m01 as f32).atan2(m10 as f32)
}

/// The 256 intensity comparisons of the pattern turned to `angle`, on the smoothed surroundings.
fn describe(smooth: &Surroundings, angle: f32) -> Descriptor {
    let turns = f64::from(angle) / std::f64::consts::TAU;
    let direction = ((turns * DIRECTIONS as f64).round() as i64).rem_euclid(DIRECTIONS as i64) as usize;
    // No index lies outside: the remainder only tells the compiler.
    let at = |index: u16| smooth.as_flattened()[usize::from(index) % (PATCH_SIDE * PATCH_SIDE)];
    let mut words = [0_u64; BITS / 64];
    for (word, pairs) in words.iter_mut().zip(PATTERN[direction].as_chunks::<64>().0) {
        for (bit, &[a, b]) in pairs.iter().enumerate() {
            *word |= u64::from(at(a) < at(b)) << bit;
        }
    }
    Descriptor(words)
}

#[cfg(test)]
mod tests {
    use super::*;
    use pfd_geometry::Image;
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};

    const OPTIONS: FeatureOptions =
        FeatureOptions { count: 500, levels: 4, scale: 1.2, threshold: 20, low_threshold: 7 };

    /// Bright squares on a dark ground, at pseudo-random places.
    fn squares(width: usize, height: usize) -> GrayImage {
        let mut rng = rand_pcg::Pcg32::seed_from_u64(7);
        let mut image = Image::filled(width, height, 30_u8);
        for _ in 0..width * height / 1500 {
            let (x, y) = (rng.random_range(0..width - 12), rng.random_range(0..height - 12));
            let value = rng.random_range(80..250);
            for v in y..y + 11 {
                for u in x..x + 11 {
                    image[(u, v)] = value;
                }
            }
        }
        // Without noise neighbouring corner scores tie, and non-maximum suppression drops both.
        image.pixels_mut().iter_mut().for_each(|p| *p += rng.random_range(0..6));
        image
    }

    #[test]
    fn features_avoid_the_mask_and_fill_the_rest() {
        let image = squares(320, 240);
        let mut mask = Mask::empty(320, 240);
        for v in 0..240 {
            for u in 0..160 {
                mask.set(u, v, true);
            }
        }
        let mut extractor = FeatureExtractor::new(OPTIONS);
        extractor.load(&image).unwrap();
        let features = extractor.extract(Some(&mask), 4).unwrap();
        assert!(features.len() > 100);
        assert!(features.iter().all(|f| f.u > 160.0), "corners move by a pixel of their level at most");
    }

    proptest! {
        #[test]
        fn the_nearest_is_that_of_the_sorted_distances(
            all in prop::collection::vec(prop::array::uniform4(0..8_u64), 1..40),
        ) {
            let all: Vec<_> = all.into_iter().map(Descriptor).collect();
            let (wanted, candidates) = all.split_first().unwrap();
            let mut expected: Vec<_> = candidates.iter().map(|c| wanted.distance(c)).enumerate().collect();
            expected.sort_by_key(|&(index, distance)| (distance, index));
            let second = expected.get(1).map_or(u32::MAX, |(_, distance)| *distance);
            let expected = expected.first().map(|&(index, distance)| Nearest { index, distance, second });
            prop_assert_eq!(wanted.nearest(candidates), expected);
        }
    }

    #[test]
    fn opposite_descriptors_differ_in_every_bit() {
        assert_eq!(Descriptor([0; 4]).distance(&Descriptor([u64::MAX; 4])), BITS as u32);
    }

    #[test]
    fn descriptor_survives_a_shift() {
        let image = squares(320, 240);
        let shifted_pixels = (0..240).flat_map(|v| (0..320).map(move |u| (u, v)));
        let shifted: Vec<u8> = shifted_pixels.map(|(u, v)| image[((u + 315) % 320, v)]).collect();
        let shifted = Image::from_vec(320, 240, shifted).unwrap();
        let mut extractor = FeatureExtractor::new(FeatureOptions { levels: 1, ..OPTIONS });
        let mut features = |image: &GrayImage| {
            extractor.load(image).unwrap();
            extractor.extract(None, 0).unwrap()
        };
        let (a, b) = (features(&image), features(&shifted));
        let found = a
            .iter()
            .filter(|f| f.u > 40.0 && f.u < 280.0)
            .filter(|f| b.iter().any(|g| (g.u - f.u - 5.0).abs() < 0.1 && g.descriptor == f.descriptor))
            .count();
        assert!(found * 10 >= a.len() * 7, "{found} of {} features came back after the shift", a.len());
    }

    #[test]
    fn a_spot_lies_at_the_same_place_on_all_levels() {
        // In the corner that is farthest from the origin, where an error of scale shows most.
        let (x, y) = (600.0, 450.0);
        let brightness =
            |u: usize, v: usize| 200.0 * (-((u as f64 - x).powi(2) + (v as f64 - y).powi(2)) / 128.0).exp();
        let pixels = (0..480).flat_map(|v| (0..640).map(move |u| brightness(u, v).round() as u8)).collect();
        let options = FeatureOptions { levels: 8, ..OPTIONS };
        let mut extractor = FeatureExtractor::new(options);
        extractor.build_pyramid(&Image::from_vec(640, 480, pixels).unwrap()).unwrap();
        for (level, Level { image, .. }) in extractor.levels.iter().enumerate() {
            let pixels = image.data_typed::<u8>().unwrap().iter().enumerate();
            let (mut sum, mut u, mut v) = (0.0, 0.0, 0.0);
            for (i, value) in pixels.map(|(i, value)| (i as i32, f64::from(*value))) {
                (sum, u, v) =
                    (sum + value, u + value * f64::from(i % image.cols()), v + value * f64::from(i / image.cols()));
            }
            let place = [u, v].map(|c| options.from_level(c / sum, level as u8));
            let error = (place[0] - x).hypot(place[1] - y);
            assert!(error < 0.1, "level {level}: {place:?}");
        }
    }

    #[test]
    fn refinement_finds_the_corner_between_pixels() {
        // A quadrant corner at (10.3, 9.8): pixels are covered in proportion.
        let cover = |i: usize, edge: f64| (edge - i as f64 + 0.5).clamp(0.0, 1.0);
        let pixels: Vec<u8> = (0..20 * 20).map(|i| (200.0 * cover(i % 20, 10.3) * cover(i / 20, 9.8)) as u8).collect();
        let (dx, dy) = refine(&pixels, 20, 10 * 20 + 10);
        assert!((dx - 0.3).abs() < 0.15 && (dy + 0.2).abs() < 0.15, "({dx}, {dy})");
    }

    #[test]
    fn tiny_and_flat_images_have_no_features() {
        for (width, height) in [(1, 1), (8, 8), (40, 39), (64, 64)] {
            let mut extractor = FeatureExtractor::new(OPTIONS);
            extractor.load(&squares(320, 240)).unwrap();
            extractor.load(&Image::filled(width, height, 100_u8)).unwrap();
            assert!(extractor.extract(None, 0).unwrap().is_empty());
        }
    }

    #[test]
    fn wrong_mask_size_is_an_error() {
        let mut extractor = FeatureExtractor::new(OPTIONS);
        extractor.load(&squares(320, 240)).unwrap();
        let result = extractor.extract(Some(&Mask::empty(10, 10)), 0);
        assert!(matches!(result, Err(VisionError::SizeMismatch(..))));
    }
}
