//! Features of one image with depth, and where to find them.

use nalgebra::{Point2, Point3};
use pfd_geometry::{Camera, RgbdFrame};
use pfd_vision::features::{Descriptor, Feature};
use pfd_vision::patch::Patch;

use crate::config::TrackingConfig;
use crate::residual::Measurement;
use crate::rolling_shutter::Shutter;
use crate::surface_depth::surface_depth;

/// Side of the cells of the spatial index, pixels.
const CELL: usize = 16;
/// Features of an image.
#[derive(Clone, Debug, Default)]
pub struct ImageFeatures {
    size: (usize, usize),
    features: Vec<Feature>,
    /// As in the image.
    raw: Vec<Measurement>,
    /// As at the time of the middle row.
    measurements: Vec<Measurement>,
    colors: Vec<[u8; 3]>,
    patches: Vec<Option<Patch>>,
    shutter: Shutter,
    grid: Grid,
}

/// Depth (metres) that is assumed where no feature has any, to correct for the motion during the readout.
const TYPICAL_DEPTH: f64 = 2.0;

impl ImageFeatures {
    /// Adds depth and an index to extracted features.
    pub fn new(features: Vec<Feature>, frame: &RgbdFrame, config: &TrackingConfig) -> Self {
        let options = config.features.options();
        let measurements: Vec<_> = features
            .iter()
            .map(|feature| Measurement {
                pixel: Point2::new(f64::from(feature.u), f64::from(feature.v)),
                sigma: config.features.sigma * options.level_scale(feature.level),
                depth: surface_depth(frame.depth(), [feature.u, feature.v], &config.depth_noise),
            })
            .collect();
        let color = |f: &Feature| frame.rgb().nearest(f.u.into(), f.v.into()).copied().unwrap_or_default();
        let colors = features.iter().map(color).collect();
        Self::from_parts(frame.rgb().size(), features, measurements, colors)
    }

    /// Adds the surroundings of the features, in their order.
    #[must_use]
    pub fn with_patches(mut self, patches: Vec<Option<Patch>>) -> Self {
        self.patches = patches;
        self.patches.resize(self.features.len(), None);
        self
    }

    /// Rebuilds the index over stored features, for maps read from files.
    pub fn from_parts(
        size: (usize, usize),
        features: Vec<Feature>,
        measurements: Vec<Measurement>,
        colors: Vec<[u8; 3]>,
    ) -> Self {
        let grid = Grid::new(size, &measurements);
        let (patches, raw) = (vec![None; features.len()], measurements.clone());
        Self { size, features, raw, measurements, colors, patches, shutter: Shutter::default(), grid }
    }

    /// Features of which only the place is known, as in simulations.
    pub fn from_measurements(size: (usize, usize), measurements: Vec<Measurement>) -> Self {
        let feature = |m: &Measurement| Feature {
            u: m.pixel.x as f32,
            v: m.pixel.y as f32,
            angle: 0.0,
            level: 0,
            response: 1.0,
            descriptor: Descriptor::default(),
        };
        let (features, count) = (measurements.iter().map(feature).collect(), measurements.len());
        Self::from_parts(size, features, measurements, vec![[0; 3]; count])
    }

    /// Number of features.
    pub fn len(&self) -> usize {
        self.features.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.features.is_empty()
    }

    /// Feature `index`.
    pub fn feature(&self, index: usize) -> &Feature {
        &self.features[index]
    }

    /// Position, depth and uncertainty of feature `index`, as a camera sees it that exposes all rows with the middle one.
    pub fn measurement(&self, index: usize) -> &Measurement {
        &self.measurements[index]
    }

    /// Position, depth and uncertainty of feature `index` as they are in the image.
    pub fn raw(&self, index: usize) -> &Measurement {
        &self.raw[index]
    }

    /// How the camera moved while it read out the image.
    pub fn shutter(&self) -> &Shutter {
        &self.shutter
    }

    /// Refers all measurements to the time of the middle row.
    pub fn set_shutter(&mut self, camera: &Camera, shutter: Shutter) {
        self.shutter = shutter;
        let depth = self.median_depth().unwrap_or(TYPICAL_DEPTH);
        self.measurements.clear();
        self.measurements.extend(self.raw.iter().map(|raw| shutter.at_middle_row(camera, raw, depth)));
        self.grid = Grid::new(self.size, &self.measurements);
    }

    fn median_depth(&self) -> Option<f64> {
        let mut depths: Vec<f64> = self.raw.iter().filter_map(|m| m.depth.map(|d| d.0)).collect();
        let middle = depths.len().checked_sub(1)? / 2;
        Some(*depths.select_nth_unstable_by(middle, f64::total_cmp).1)
    }

    /// The surroundings of feature `index`, where they are known.
    pub fn patch(&self, index: usize) -> Option<&Patch> {
        self.patches[index].as_ref()
    }

    /// Corrects the position of feature `index` in the image. It counts from the next [`Self::set_shutter`] on.
    pub fn set_position(&mut self, index: usize, pixel: Point2<f64>, sigma: f64) {
        let raw = &mut self.raw[index];
        (raw.pixel, raw.sigma) = (pixel, sigma);
    }

    /// Colour at feature `index`.
    pub fn color(&self, index: usize) -> [u8; 3] {
        self.colors[index]
    }

    /// All descriptors, in order.
    pub fn descriptors(&self) -> impl Iterator<Item = &Descriptor> {
        self.features.iter().map(|f| &f.descriptor)
    }

    /// Number of features with depth.
    pub fn with_depth(&self) -> usize {
        self.measurements.iter().filter(|m| m.depth.is_some()).count()
    }

    /// The point of feature `index` in the camera frame, if it has depth.
    pub fn point_in_camera(&self, index: usize, camera: &Camera) -> Option<Point3<f64>> {
        let measured = &self.measurements[index];
        measured.depth.map(|(z, _)| camera.unproject(&measured.pixel, z))
    }

    /// Features within `radius` pixels of `pixel`.
    pub fn near(&self, pixel: &Point2<f64>, radius: f64) -> impl Iterator<Item = usize> + '_ {
        let (centre, limit) = (*pixel, radius * radius);
        self.grid
            .cells_around(centre, radius)
            .flat_map(|cell| cell.iter())
            .map(|&index| index as usize)
            .filter(move |&index| (self.measurements[index].pixel - centre).norm_squared() <= limit)
    }
}

/// Indices of features by cell.
#[derive(Clone, Debug, Default)]
struct Grid {
    columns: usize,
    rows: usize,
    cells: Vec<Vec<u32>>,
}

impl Grid {
    fn new((width, height): (usize, usize), measurements: &[Measurement]) -> Self {
        let (columns, rows) = (width.div_ceil(CELL).max(1), height.div_ceil(CELL).max(1));
        let mut cells = vec![Vec::new(); columns * rows];
        for (index, measured) in measurements.iter().enumerate() {
            let column = (measured.pixel.x.max(0.0) as usize / CELL).min(columns - 1);
            let row = (measured.pixel.y.max(0.0) as usize / CELL).min(rows - 1);
            cells[row * columns + column].push(index as u32);
        }
        Self { columns, rows, cells }
    }

    fn cells_around(&self, pixel: Point2<f64>, radius: f64) -> impl Iterator<Item = &Vec<u32>> {
        let range = |centre: f64, count: usize| {
            let low = ((centre - radius) / CELL as f64).floor().max(0.0) as usize;
            let high = ((centre + radius) / CELL as f64).floor();
            low..if high < 0.0 { low } else { (high as usize + 1).min(count) }
        };
        let columns = range(pixel.x, self.columns);
        range(pixel.y, self.rows)
            .flat_map(move |row| columns.clone().map(move |column| &self.cells[row * self.columns + column]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pfd_geometry::{DepthImage, Image, Stamp};
    use proptest::prelude::*;

    fn feature(u: f32, v: f32) -> Feature {
        Feature { u, v, angle: 0.0, level: 0, response: 1.0, descriptor: Descriptor::default() }
    }

    fn frame(depth: impl Fn(usize, usize) -> f32) -> RgbdFrame {
        let pixels = (0..64 * 64).map(|i| depth(i % 64, i / 64)).collect();
        let depth = DepthImage::from_metres(Image::from_vec(64, 64, pixels).unwrap());
        RgbdFrame::new(Stamp::default(), Image::filled(64, 64, [1, 2, 3]), depth).unwrap()
    }

    proptest! {
        #[test]
        fn the_index_finds_what_a_scan_finds(
            places in prop::collection::vec((0.0..64.0_f32, 0.0..64.0_f32), 0..60),
            (x, y, radius) in (-20.0..84.0_f64, -20.0..84.0_f64, 0.0..40.0_f64),
        ) {
            let features: Vec<_> = places.iter().map(|&(u, v)| feature(u, v)).collect();
            let indexed = ImageFeatures::new(features, &frame(|_, _| 1.0), &TrackingConfig::default());
            let mut found: Vec<usize> = indexed.near(&Point2::new(x, y), radius).collect();
            found.sort_unstable();
            let near = |&i: &usize| {
                let (u, v) = places[i];
                (f64::from(u) - x).powi(2) + (f64::from(v) - y).powi(2) <= radius * radius
            };
            let expected: Vec<usize> = (0..places.len()).filter(near).collect();
            prop_assert_eq!(found, expected);
        }
    }
}
