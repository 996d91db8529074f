//! Spreads evidence within surfaces: an edge-aware recursive filter (Gastal and Oliveira, SIGGRAPH 2011, section 4.2: the
//! recursive domain transform), applied to evidence and its weight alike, so that their ratio is a normalised convolution.

use pfd_geometry::DepthNoise;

use super::view::{Pinhole, ViewFrame};

/// How easily evidence passes between neighbouring pixels, 0 (an edge) to 1.
#[derive(Debug, Default)]
pub(crate) struct Conductance {
    /// From the pixel on the left, column by column of each strip of [`ROWS`] rows.
    horizontal: Vec<[f32; ROWS]>,
    /// From the pixel above to `i`.
    vertical: Vec<f32>,
    /// A strip that is being filtered, column by column.
    strip: Vec<[[f32; 2]; ROWS]>,
}

/// What stops the diffusion.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EdgeScales {
    /// Spatial standard deviation, working pixels.
    pub(crate) radius: f32,
    /// Depth step between neighbours, in units of noise plus slope, that counts as one standard deviation.
    pub(crate) depth: f32,
    /// Luma step between neighbours that counts as one standard deviation.
    pub(crate) gray: f32,
}

/// Depth change per metre of depth between neighbouring pixels of a surface seen at a grazing angle (75° and more, by the focal length).
const SLOPE: f32 = 0.015;
/// Rows that are filtered together: each value waits for the one beside it, and other rows fill the wait.
const ROWS: usize = 8;
/// Distance in standard deviations that a border between measured and missing depth stands for.
const MISSING_STEP: f32 = 1.0;

impl Conductance {
    /// Recomputes the conductance for a frame.
    pub(crate) fn update(&mut self, camera: &Pinhole, noise: &DepthNoise, frame: &ViewFrame, scales: &EdgeScales) {
        let (width, count) = (camera.width, camera.pixels());
        self.horizontal.resize(width * camera.height.div_ceil(ROWS), [0.0; ROWS]);
        self.vertical.resize(count, 0.0);
        let (depth, gray) = (frame.depth.pixels(), frame.gray.pixels());
        let passage = Passage::new(noise, scales);
        for (v, (d, g)) in depth.chunks_exact(width).zip(gray.chunks_exact(width)).enumerate() {
            let columns = &mut self.horizontal[v / ROWS * width..][1..width];
            for ((a, d), g) in columns.iter_mut().zip(d.windows(2)).zip(g.windows(2)) {
                a[v % ROWS] = passage.between((d[0], d[1]), (g[0], g[1]));
            }
        }
        self.vertical[..width.min(count)].fill(0.0);
        let below = depth.iter().zip(gray).skip(width);
        for ((a, upper), lower) in self.vertical[width.min(count)..].iter_mut().zip(depth.iter().zip(gray)).zip(below) {
            *a = passage.between((*upper.0, *lower.0), (*upper.1, *lower.1));
        }
    }

    /// Diffuses evidence and weight, interleaved as `[evidence, weight]`.
    pub(crate) fn diffuse(&mut self, width: usize, field: &mut [[f32; 2]], iterations: usize) {
        for _ in 0..iterations {
            self.rows(width, field);
            self.columns(width, field);
        }
    }

    fn rows(&mut self, width: usize, field: &mut [[f32; 2]]) {
        let strip = &mut self.strip;
        strip.resize(width, [[0.0; 2]; ROWS]);
        for (rows, conductance) in field.chunks_mut(ROWS * width).zip(self.horizontal.chunks_exact(width)) {
            for (k, row) in rows.chunks_exact(width).enumerate() {
                strip.iter_mut().zip(row).for_each(|(column, cell)| column[k] = *cell);
            }
            filter_strip(strip, conductance);
            for (k, row) in rows.chunks_exact_mut(width).enumerate() {
                row.iter_mut().zip(&*strip).for_each(|(cell, column)| *cell = column[k]);
            }
        }
    }

    fn columns(&self, width: usize, field: &mut [[f32; 2]]) {
        for i in width..field.len() {
            field[i] = blend(field[i], field[i - width], self.vertical[i]);
        }
        for i in (width..field.len()).rev() {
            field[i - width] = blend(field[i - width], field[i], self.vertical[i]);
        }
    }
}

/// Feedback coefficient of the recursive filter between two pixels.
struct Passage {
    radius: f32,
    depth: f32,
    gray: f32,
    offset: f32,
    quadratic: f32,
}

impl Passage {
    fn new(noise: &DepthNoise, scales: &EdgeScales) -> Self {
        let root = std::f32::consts::SQRT_2;
        Self {
            radius: scales.radius,
            depth: 1.0 / scales.depth,
            gray: 1.0 / scales.gray,
            offset: root * noise.offset as f32,
            quadratic: root * noise.quadratic as f32,
        }
    }

    /// `exp(-√2 d / radius)` (Gastal and Oliveira, eq. 21) of the distance `d = 1 + radius · steps`, the exponential by the
    /// first terms of its series in the denominator: positive, monotonic, and cheap.
    #[inline]
    fn between(&self, (a, b): (f32, f32), (g, h): (u8, u8)) -> f32 {
        let near = a.min(b);
        let sigma = self.offset + self.quadratic * near * near + SLOPE * near;
        let depth_step = if near > 0.0 {
            (a - b).abs() * self.depth / sigma
        } else if a.max(b) > 0.0 {
            MISSING_STEP
        } else {
            0.0
        };
        let gray_step = f32::from(g.abs_diff(h)) * self.gray;
        let x = std::f32::consts::SQRT_2 * (1.0 / self.radius + depth_step * depth_step + gray_step);
        1.0 / (1.0 + x * (1.0 + x * (0.5 + x * (1.0 / 6.0 + x / 24.0))))
    }
}

/// Filters the rows of a strip, there and back.
fn filter_strip(strip: &mut [[[f32; 2]; ROWS]], conductance: &[[f32; ROWS]]) {
    let Some(&(mut last)) = strip.first() else { return };
    let mut pass = |column: &mut [[f32; 2]; ROWS], a: &[f32; ROWS]| {
        last = std::array::from_fn(|k| blend(column[k], last[k], a[k]));
        *column = last;
    };
    strip.iter_mut().zip(conductance).skip(1).for_each(|(column, a)| pass(column, a));
    strip.iter_mut().zip(&conductance[1..]).rev().for_each(|(column, a)| pass(column, a));
}

fn blend(own: [f32; 2], other: [f32; 2], a: f32) -> [f32; 2] {
    [own[0] + a * (other[0] - own[0]), own[1] + a * (other[1] - own[1])]
}

#[cfg(test)]
mod tests {
    use super::*;
    use pfd_geometry::Image;

    const CAMERA: Pinhole = Pinhole { width: 60, height: 40, fx: 50.0, fy: 50.0, cx: 29.5, cy: 19.5 };

    #[test]
    fn evidence_fills_its_surface_and_stops_at_the_depth_edge() {
        let mut depth = Image::filled(60, 40, 2.0_f32);
        for v in 0..40 {
            for u in 30..60 {
                depth[(u, v)] = 1.0;
            }
        }
        let frame = ViewFrame { gray: Image::filled(60, 40, 128), depth };
        let mut conductance = Conductance::default();
        let scales = EdgeScales { radius: 20.0, depth: 2.0, gray: 60.0 };
        conductance.update(&CAMERA, &DepthNoise::default(), &frame, &scales);
        let mut field = vec![[0.0, 0.01]; 60 * 40];
        for v in 15..25 {
            field[v * 60 + 45] = [1.0, 1.0];
        }
        conductance.diffuse(60, &mut field, 2);
        let ratio = |u: usize, v: usize| field[v * 60 + u][0] / field[v * 60 + u][1];
        // Ten units of evidence over a prior of 0.01 on each of 30×40 pixels: 10 / (10 + 12) if it spread evenly.
        assert!(ratio(40, 20) > 0.3, "{}", ratio(40, 20));
        assert!(ratio(31, 20) > 0.1, "{}", ratio(31, 20));
        assert!(ratio(28, 20) < 0.2 * ratio(31, 20), "{} across the edge", ratio(28, 20));
    }

    #[test]
    fn rows_are_filtered_one_by_one_although_together() {
        // The last strip is not full.
        let (width, height) = (CAMERA.width, ROWS + 3);
        let camera = Pinhole { height, ..CAMERA };
        let noise = |i: usize| (i as u32).wrapping_mul(2_654_435_761) >> 24;
        let pixels = || 0..width * height;
        let frame = ViewFrame {
            gray: Image::from_vec(width, height, pixels().map(|i| noise(i) as u8).collect()).unwrap(),
            depth: Image::from_vec(width, height, pixels().map(|i| 1.0 + noise(i + 7) as f32 * 1e-3).collect())
                .unwrap(),
        };
        let scales = EdgeScales { radius: 20.0, depth: 2.0, gray: 60.0 };
        let mut conductance = Conductance::default();
        conductance.update(&camera, &DepthNoise::default(), &frame, &scales);
        let field: Vec<[f32; 2]> = pixels().map(|i| [noise(i + 3) as f32, 1.0]).collect();
        let passage = Passage::new(&DepthNoise::default(), &scales);
        let (depth, gray) = (frame.depth.pixels(), frame.gray.pixels());
        let between = |i: usize, j: usize| passage.between((depth[i], depth[j]), (gray[i], gray[j]));
        let mut expected = field.clone();
        for start in (0..field.len()).step_by(width) {
            for i in start + 1..start + width {
                expected[i] = blend(expected[i], expected[i - 1], between(i - 1, i));
            }
            for i in (start + 1..start + width).rev() {
                expected[i - 1] = blend(expected[i - 1], expected[i], between(i - 1, i));
            }
        }
        let mut filtered = field;
        conductance.rows(width, &mut filtered);
        assert_eq!(filtered, expected);
    }
}
