//! Surfaces of a depth image: pixels that connect without a depth step, as candidates for whole things. A large plane and what touches
//! it are surfaces of their own.

use pfd_geometry::DepthNoise;

use super::continuity::Continuity;
use super::disjoint_sets::join;
use super::large_planes::NO_PLANE;
use super::view::Pinhole;

/// Label of pixels without depth.
pub(crate) const NO_SURFACE: u32 = u32::MAX;

/// Connected surfaces of one frame.
#[derive(Debug, Default)]
pub(crate) struct Surfaces {
    /// Index of the surface per working pixel, [`NO_SURFACE`] without depth.
    pub(crate) labels: Vec<u32>,
    /// What is known of each.
    pub(crate) list: Vec<Surface>,
    /// For each run of connected pixels of a row, an earlier run of the same surface, or itself.
    parents: Vec<u32>,
    surface_of_run: Vec<u32>,
    /// Last pixel with depth of each column.
    above: Vec<Option<usize>>,
}

/// A depth image and the large plane of each of its pixels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Relief<'a> {
    /// Metres; 0 = none.
    pub(crate) depth: &'a [f32],
    /// Equal on one plane, [`NO_PLANE`] on none.
    pub(crate) planes: &'a [u16],
    /// Which depths of neighbours no step parts.
    continuity: Continuity,
}

impl<'a> Relief<'a> {
    pub(crate) fn new(noise: &DepthNoise, depth: &'a [f32], planes: &'a [u16]) -> Self {
        Self { depth, planes, continuity: Continuity::new(noise, 1) }
    }

    /// Whether two neighbours lie on one surface.
    #[inline]
    fn connects(&self, i: usize, j: usize) -> bool {
        self.planes[i] == self.planes[j] && self.touches(i, j)
    }

    /// Whether no depth step parts two pixels.
    #[inline]
    fn touches(&self, i: usize, j: usize) -> bool {
        self.continuity.connects(self.depth[i], self.depth[j])
    }
}

/// One connected surface. Counts with "still" in the name leave out the pixels that are known to move: they tell what the rest is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Surface {
    /// Its pixels.
    pub(crate) pixels: u32,
    /// Sum of their depths, metres.
    depth: f32,
    /// Sum of the squares of their depths.
    squares: f32,
    /// Left- and rightmost column.
    columns: [u32; 2],
    /// Still border pixels at which it hides what is behind it.
    hides: u32,
    /// Still border pixels at which it is hidden.
    hidden: u32,
    /// Still border pixels at which no depth step parts it from another surface: one of both is a large plane, or depth is missing between
    /// them.
    touching: u32,
    /// Whether it is part of a large plane.
    pub(crate) on_plane: bool,
    /// Still pixels.
    still: u32,
    /// Sum of the shares of evidence for motion of still pixels.
    doubt: f32,
}

/// About so many points of a surface are sampled.
const SAMPLE: usize = 500;
/// Things are not wider than this, metres: two people side by side.
const MAX_WIDTH: f32 = 1.2;
/// Things are not deeper than this along the viewing direction, metres: a desk that a mover touches is.
const MAX_EXTENT: f32 = 0.5;
/// How freely a thing stands.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Standing {
    /// Share of its border, what touches aside, on which it stands before its surroundings at least.
    pub(crate) front: f32,
    /// Share of its border on which it touches large planes at most.
    pub(crate) touching: f32,
}

/// Mean share of evidence for motion that the still part of a thing shows at least; what surely is static has less.
const MIN_DOUBT: f32 = 0.12;

impl Surface {
    /// Whether it may be a thing (a person, a box) of which a part is known to move, and not a thing's surroundings that connect
    /// with it.
    pub(crate) fn is_thing(&self, camera: &Pinhole, standing: Standing) -> bool {
        let [hides, hidden, touching] = [self.hides, self.hidden, self.touching].map(|n| n as f32);
        hides > standing.front * (hides + hidden)
            && touching <= standing.touching * (hides + hidden + touching)
            && self.is_narrow(camera)
            && self.extent() < MAX_EXTENT
            && self.doubt >= MIN_DOUBT * self.still as f32
    }

    /// Whether it is no wider than a thing.
    pub(crate) fn is_narrow(&self, camera: &Pinhole) -> bool {
        self.width(camera) < MAX_WIDTH
    }

    /// Extent along the viewing direction, metres: that of a uniform distribution of the same variance.
    fn extent(&self) -> f32 {
        let count = self.pixels.max(1) as f32;
        let mean = self.depth / count;
        (12.0 * (self.squares / count - mean * mean).max(0.0)).sqrt()
    }

    /// Width at the mean depth, metres.
    fn width(&self, camera: &Pinhole) -> f32 {
        let z = self.depth / self.pixels.max(1) as f32;
        (self.columns[1] - self.columns[0] + 1) as f32 * z / camera.fx
    }

    /// Adds pixels of a row, from column `first` on, of these depths.
    fn add(&mut self, first: u32, depths: &[f32]) {
        let count = depths.len() as u32;
        let last = (first + count).saturating_sub(1);
        let [left, right] = if self.pixels == 0 { [first, last] } else { self.columns };
        self.columns = [left.min(first), right.max(last)];
        self.pixels += count;
        for z in depths {
            self.depth += z;
            self.squares += z * z;
        }
    }

    fn forget_standing(&mut self) {
        let Self { pixels, depth, squares, columns, on_plane, .. } = *self;
        *self = Self { pixels, depth, squares, columns, on_plane, ..Self::default() };
    }
}

impl Surfaces {
    /// Finds the surfaces of a frame and their extent. How they stand follows by [`Self::describe`].
    pub(crate) fn find(&mut self, camera: &Pinhole, relief: &Relief<'_>) {
        self.connect(camera.width, relief);
        self.number(camera.width, relief);
    }

    /// Finds how those surfaces stand that are `asked` for. `doubt` is the share of evidence for motion, `None` for pixels that are known to
    /// move.
    pub(crate) fn describe(
        &mut self,
        camera: &Pinhole,
        relief: &Relief<'_>,
        asked: &[bool],
        doubt: impl Fn(usize) -> Option<f32>,
    ) {
        for surface in &mut self.list {
            surface.forget_standing();
        }
        for (i, &label) in self.labels.iter().enumerate() {
            if !asked.get(label as usize).is_some_and(|asked| *asked) {
                continue;
            }
            if let Some(doubt) = doubt(i) {
                self.list[label as usize].still += 1;
                self.list[label as usize].doubt += doubt;
            }
        }
        self.judge_borders(camera.width, relief, asked, &|i| doubt(i).is_some());
    }

    /// The surface's pixels.
    pub(crate) fn pixels(&self, surface: u32) -> Vec<u32> {
        (0..self.labels.len() as u32).filter(|&i| self.labels[i as usize] == surface).collect()
    }

    /// Some of the surface's points (camera frame, metres) for which `wanted` holds.
    pub(crate) fn sample(
        &self,
        surface: u32,
        wanted: impl Fn(usize) -> bool,
        camera: &Pinhole,
        depth: &[f32],
    ) -> Vec<[f32; 3]> {
        let here = |&i: &usize| self.labels[i] == surface && wanted(i);
        let point = |i: usize| camera.point(i, depth[i]);
        let step = (self.list[surface as usize].still as usize / SAMPLE).max(1);
        (0..depth.len()).filter(here).step_by(step).map(point).collect()
    }

    /// Gives every run of connected pixels of a row an index, and joins the indices of runs that connect with the row above.
    fn connect(&mut self, width: usize, relief: &Relief<'_>) {
        let depth = relief.depth;
        self.parents.clear();
        self.labels.clear();
        self.labels.resize(depth.len(), NO_SURFACE);
        let mut joined = (NO_SURFACE, NO_SURFACE);
        for first in (0..depth.len()).step_by(width.max(1)) {
            for i in (first..first + width).filter(|i| depth[*i] > 0.0) {
                let run = if i > first && relief.connects(i, i - 1) {
                    self.labels[i - 1]
                } else {
                    self.parents.push(self.parents.len() as u32);
                    self.parents.len() as u32 - 1
                };
                self.labels[i] = run;
                if i >= width {
                    let contact = (run, self.labels[i - width]);
                    // Two runs mostly touch along many pixels.
                    if contact != joined && relief.connects(i, i - width) {
                        join(&mut self.parents, contact.0, contact.1);
                        joined = contact;
                    }
                }
            }
        }
    }

    /// From indices of runs to surfaces, in the order of their first pixels.
    fn number(&mut self, width: usize, relief: &Relief<'_>) {
        self.list.clear();
        self.surface_of_run.clear();
        for run in 0..self.parents.len() as u32 {
            // Only the first run of a surface is its own.
            let before = self.parents[run as usize];
            if before == run {
                self.surface_of_run.push(self.list.len() as u32);
                self.list.push(Surface::default());
            } else {
                self.surface_of_run.push(self.surface_of_run[before as usize]);
            }
        }
        for (v, labels) in self.labels.chunks_exact_mut(width.max(1)).enumerate() {
            let mut u = 0;
            for run in labels.chunk_by_mut(|a, b| a == b) {
                let pixels = v * width + u..v * width + u + run.len();
                if run[0] != NO_SURFACE {
                    run.fill(self.surface_of_run[run[0] as usize]);
                    let surface = &mut self.list[run[0] as usize];
                    surface.on_plane = relief.planes[pixels.start] != NO_PLANE;
                    surface.add(u as u32, &relief.depth[pixels]);
                }
                u += run.len();
            }
        }
    }

    /// Counts who is in front along every row and column; pixels without depth in between are skipped.
    fn judge_borders(&mut self, width: usize, relief: &Relief<'_>, asked: &[bool], still: &impl Fn(usize) -> bool) {
        let depth = relief.depth;
        self.above.clear();
        self.above.resize(width, None);
        for v in 0..depth.len() / width.max(1) {
            let mut left = None;
            for u in 0..width {
                let i = v * width + u;
                if depth[i] > 0.0 {
                    for before in [left.replace(i), self.above[u].replace(i)].into_iter().flatten() {
                        let [one, other] = [before, i].map(|i| self.labels[i]);
                        if one != other && (asked[one as usize] || asked[other as usize]) {
                            self.judge_step(before, i, relief, still);
                        }
                    }
                }
            }
        }
    }

    /// Counts for two surfaces what two pixels of them, with nothing measured in between, say of which one is in front.
    fn judge_step(&mut self, before: usize, i: usize, relief: &Relief<'_>, still: &impl Fn(usize) -> bool) {
        if relief.touches(before, i) {
            for j in [before, i] {
                self.list[self.labels[j] as usize].touching += u32::from(still(j));
            }
        } else if relief.depth[before] < relief.depth[i] {
            self.count_border(before, i, still);
        } else {
            self.count_border(i, before, still);
        }
    }

    fn count_border(&mut self, near: usize, far: usize, still: &impl Fn(usize) -> bool) {
        self.list[self.labels[near] as usize].hides += u32::from(still(near));
        self.count_hidden(far, still);
    }

    fn count_hidden(&mut self, i: usize, still: &impl Fn(usize) -> bool) {
        self.list[self.labels[i] as usize].hidden += u32::from(still(i));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Pinhole = Pinhole { width: 8, height: 2, fx: 8.0, fy: 8.0, cx: 3.5, cy: 0.5 };

    const STANDING: Standing = Standing { front: 0.5, touching: 0.3 };

    /// Surfaces of two such rows.
    fn on_planes(row: [f32; 8], planes: [u16; 8], doubt: f32) -> Surfaces {
        let mut surfaces = Surfaces::default();
        let (depth, planes) = ([row, row].concat(), [planes, planes].concat());
        let relief = Relief::new(&DepthNoise::default(), &depth, &planes);
        surfaces.find(&CAMERA, &relief);
        let all = vec![true; surfaces.list.len()];
        surfaces.describe(&CAMERA, &relief, &all, |_| Some(doubt));
        surfaces
    }

    fn surfaces(row: [f32; 8], doubt: f32) -> Surfaces {
        on_planes(row, [NO_PLANE; 8], doubt)
    }

    #[test]
    fn a_step_separates_and_a_slope_does_not() {
        let surfaces = surfaces([1.0, 1.01, 1.02, 1.03, 2.0, 2.0, 0.0, 2.0], 0.0);
        let sizes: Vec<u32> = surfaces.list.iter().map(|s| s.pixels).collect();
        assert_eq!(sizes, [8, 4, 2]);
        assert_eq!(surfaces.labels[6], NO_SURFACE);
        assert_eq!(surfaces.labels[8], 0);
        assert!((surfaces.list[1].width(&CAMERA) - 0.5).abs() < 1e-6);
    }

    #[test]
    fn a_thing_stands_before_its_surroundings() {
        // Something in the middle at 1 m, a wall at 2 m that shows on both sides.
        let row = [2.0, 2.0, 2.0, 1.0, 1.0, 2.0, 2.0, 2.0];
        let found = surfaces(row, 0.5);
        // Two rows, left and right border of each.
        assert_eq!((found.list[1].hides, found.list[1].hidden), (4, 0));
        assert_eq!(found.list[0].hides, 0);
        assert!(!found.list[0].is_thing(&CAMERA, STANDING), "the wall is behind");
        assert!(!surfaces([1.0; 8], 0.5).list[0].is_thing(&CAMERA, STANDING), "nothing behind it");
    }

    #[test]
    fn how_a_surface_stands_does_not_depend_on_which_others_are_asked_for() {
        let depth = [2.0, 2.0, 1.0, 1.0, 0.0, 3.0, 1.5, 1.5].repeat(2);
        let planes = [0, 0, 0, 1, 0, 0, 0, 0].repeat(2);
        let relief = Relief::new(&DepthNoise::default(), &depth, &planes);
        let described = |asked: &[bool]| {
            let mut surfaces = Surfaces::default();
            surfaces.find(&CAMERA, &relief);
            surfaces.describe(&CAMERA, &relief, asked, |i| (i != 2).then_some(0.5));
            surfaces.list
        };
        let all = described(&[true; 5]);
        assert_eq!(all.len(), 5);
        assert!(all.iter().all(|s| s.still > 0 && s.hides + s.hidden + s.touching > 0));
        for one in 0..5 {
            let mut asked = [false; 5];
            asked[one] = true;
            assert_eq!(described(&asked)[one], all[one]);
        }
    }

    #[test]
    fn what_surely_is_static_is_no_thing() {
        let thing = Surface {
            pixels: 100,
            depth: 100.0,
            squares: 101.0,
            columns: [3, 5],
            hides: 30,
            hidden: 10,
            touching: 5,
            on_plane: false,
            still: 80,
            doubt: 20.0,
        };
        assert!(thing.is_thing(&CAMERA, STANDING));
        assert!(!Surface { doubt: 1.0, ..thing }.is_thing(&CAMERA, STANDING));
        assert!(
            !Surface { depth: 500.0, squares: 2501.0, ..thing }.is_thing(&CAMERA, STANDING),
            "almost two metres wide"
        );
        assert!(!Surface { squares: 103.0, ..thing }.is_thing(&CAMERA, STANDING), "0.6 metres deep");
        assert!(!Surface { hidden: 40, ..thing }.is_thing(&CAMERA, STANDING));
        assert!(!Surface { touching: 25, ..thing }.is_thing(&CAMERA, STANDING));
    }

    #[test]
    fn a_large_plane_and_what_touches_it_are_two_surfaces() {
        // Something before a wall rises from a desk that is as near.
        let found = on_planes([2.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0], [1, 1, 0, 0, 2, 2, 2, 2], 0.5);
        let on_planes: Vec<bool> = found.list.iter().map(|s| s.on_plane).collect();
        assert_eq!(on_planes, [true, false, true]);
        let thing = found.list[1];
        assert_eq!((thing.pixels, thing.hides, thing.hidden, thing.touching), (4, 2, 0, 2));
    }
}
