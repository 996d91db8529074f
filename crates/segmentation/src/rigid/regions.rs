//! From a belief per pixel to connected regions.

use std::ops::Range;

use super::disjoint_sets::{join, root};
use super::view::Pinhole;

/// Label of pixels that belong to no region.
pub(crate) const BACKGROUND: u16 = 0;

/// A connected set of dynamic pixels.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Component {
    /// Working pixels.
    pub(crate) pixels: Vec<u32>,
}

/// Connected components (4 neighbours) of pixels above `low` that hold at least one pixel above `high` and `min_pixels` pixels.
pub(crate) fn components(
    camera: &Pinhole,
    belief: &[f32],
    (low, high): (f32, f32),
    min_pixels: usize,
    visited: &mut Vec<bool>,
) -> Vec<Component> {
    visited.clear();
    visited.resize(belief.len(), false);
    let mut found = Vec::new();
    for seed in 0..belief.len() {
        if visited[seed] || belief[seed] < high {
            continue;
        }
        let pixels = flood(camera, seed, visited, |i| belief[i] >= low);
        if pixels.len() >= min_pixels {
            found.push(Component { pixels });
        }
    }
    found
}

/// All pixels that connect to `seed` through pixels for which `inside` holds.
fn flood(camera: &Pinhole, seed: usize, visited: &mut [bool], inside: impl Fn(usize) -> bool) -> Vec<u32> {
    let mut pixels = vec![seed as u32];
    visited[seed] = true;
    let mut next = 0;
    while let Some(&i) = pixels.get(next) {
        next += 1;
        for j in neighbours((camera.width, camera.height), i as usize).into_iter().flatten() {
            if !visited[j] && inside(j) {
                visited[j] = true;
                pixels.push(j as u32);
            }
        }
    }
    pixels
}

/// The pixels left, right, above and below.
pub(crate) fn neighbours((width, height): (usize, usize), i: usize) -> [Option<usize>; 4] {
    let u = i % width;
    [
        (u > 0).then(|| i - 1),
        (u + 1 < width).then(|| i + 1),
        i.checked_sub(width),
        (i + width < width * height).then(|| i + width),
    ]
}

/// Fills small holes of masks.
#[derive(Debug, Default)]
pub(crate) struct HoleFiller {
    /// Runs of static pixels in the rows of the mask, in order.
    runs: Vec<Range<usize>>,
    /// For each run an earlier one that it connects with, or itself.
    parents: Vec<u32>,
    /// Pixels of all runs that connect, by the first of them.
    areas: Vec<usize>,
}

impl HoleFiller {
    /// Sets every hole of `mask` (0 enclosed by 255, or by 255 and the border of the image) of at most `max_pixels` pixels.
    pub(crate) fn fill(&mut self, width: usize, mask: &mut [u8], max_pixels: usize) {
        self.find_runs(width, mask);
        self.areas.clear();
        self.areas.resize(self.runs.len(), 0);
        for (k, run) in self.runs.iter().enumerate() {
            self.areas[root(&mut self.parents, k as u32) as usize] += run.len();
        }
        for (k, run) in self.runs.iter().enumerate() {
            if self.areas[root(&mut self.parents, k as u32) as usize] <= max_pixels {
                mask[run.clone()].fill(255);
            }
        }
    }

    /// Finds the runs and joins those of neighbouring rows that touch.
    fn find_runs(&mut self, width: usize, mask: &[u8]) {
        self.runs.clear();
        self.parents.clear();
        let mut above = 0..0;
        for (v, row) in mask.chunks_exact(width.max(1)).enumerate() {
            let first = self.runs.len();
            let mut end = 0;
            while let Some(start) = row[end..].iter().position(|&m| m == 0).map(|n| end + n) {
                end = row[start..].iter().position(|&m| m != 0).map_or(width, |n| start + n);
                self.join_above(width, &above, v * width + start..v * width + end);
            }
            above = first..self.runs.len();
        }
    }

    /// Adds a run and joins it with those of the row `above` that it touches.
    fn join_above(&mut self, width: usize, above: &Range<usize>, run: Range<usize>) {
        let k = self.runs.len() as u32;
        self.parents.push(k);
        for other in above.clone() {
            let Range { start, end } = self.runs[other];
            if start + width < run.end && run.start < end + width {
                join(&mut self.parents, other as u32, k);
            }
        }
        self.runs.push(run);
    }
}

/// Grows a mask by one pixel in every direction.
pub(crate) fn dilate(width: usize, mask: &[u8], out: &mut Vec<u8>) {
    out.clear();
    out.extend_from_slice(mask);
    for i in 0..mask.len() {
        if mask[i] == 0 {
            continue;
        }
        let u = i % width;
        if u > 0 {
            out[i - 1] = 255;
        }
        if u + 1 < width {
            out[i + 1] = 255;
        }
        if i >= width {
            out[i - width] = 255;
        }
        if i + width < mask.len() {
            out[i + width] = 255;
        }
    }
}

/// Sets the bounding rectangle of `pixels`.
pub(crate) fn fill_rectangle(width: usize, pixels: &[u32], mask: &mut [u8]) {
    let columns = pixels.iter().map(|&i| i as usize % width);
    let rows = pixels.iter().map(|&i| i as usize / width);
    let (Some(left), Some(right)) = (columns.clone().min(), columns.max()) else { return };
    let (Some(top), Some(bottom)) = (rows.clone().min(), rows.max()) else { return };
    for v in top..=bottom {
        mask[v * width + left..=v * width + right].fill(255);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Pinhole = Pinhole { width: 6, height: 4, fx: 6.0, fy: 6.0, cx: 2.5, cy: 1.5 };

    #[test]
    fn weak_pixels_join_strong_ones_only() {
        let mut belief = [0.0_f32; 24];
        belief[0] = 0.6;
        belief[1] = 0.9;
        belief[5] = 0.6;
        let found = components(&CAMERA, &belief, (0.5, 0.8), 1, &mut Vec::new());
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].pixels, [1, 0]);
        assert!(components(&CAMERA, &belief, (0.5, 0.8), 3, &mut Vec::new()).is_empty());
    }

    #[test]
    fn holes_are_filled_up_to_a_size() {
        let mut mask = [255_u8; 24];
        mask[7] = 0;
        let mut open = mask;
        let mut filler = HoleFiller::default();
        filler.fill(CAMERA.width, &mut mask, 1);
        assert_eq!(mask[7], 255);
        open[8] = 0;
        filler.fill(CAMERA.width, &mut open, 1);
        assert_eq!((open[7], open[8]), (0, 0));
    }

    #[test]
    fn a_hole_that_goes_round_a_corner_is_one() {
        // Two columns that meet at the bottom: seven pixels.
        let hole = [7, 9, 13, 15, 19, 20, 21];
        let mask: [u8; 24] = std::array::from_fn(|i| if hole.contains(&i) { 0 } else { 255 });
        let filled = |max_pixels| {
            let mut mask = mask;
            HoleFiller::default().fill(CAMERA.width, &mut mask, max_pixels);
            mask.iter().all(|m| *m == 255)
        };
        assert_eq!([6, 7].map(filled), [false, true]);
    }
}
