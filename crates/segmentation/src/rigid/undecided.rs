//! Pixels without depth (too near, in the projector's shadow, on dark or shiny surfaces). Each goes to whatever its grey levels
//! connect it with, the label of the decided pixel at the shortest geodesic distance, found by raster scans (Toivanen, "New geodesic
//! distance transforms for gray-scale images", Pattern Recognition Letters 1996).

use super::regions::BACKGROUND;
use super::view::{Pinhole, ViewFrame};

/// Length that a difference of one grey level adds to a step of one pixel: a contrast of 30 levels is worth a path of 15 pixels.
const PER_LEVEL: f32 = 0.5;
/// Pairs of scans; each turn of a path against both scan directions takes another.
const SCANS: usize = 2;

/// A step through a pixel that contradicts the label is this many times as long: "background" where it looks other than the static
/// model, a mover where it looks the same.
const CONTRADICTED: f32 = 4.0;

/// A Kinect or Xtion measures nothing that is much nearer than this, metres, whatever the sensor's data sheet says: an object that
/// reaches up to here goes on where depth ends. Sensors that see nearer things have depth there, so that the rule finds nothing to do.
const NEAR: f32 = 0.6;
/// Share of an object's measured pixels that make it such an object.
const NEAR_SHARE: f32 = 0.2;
/// Log-odds below which a pixel without depth is the background's if the static model says nothing of it, …
const CLEARLY_STATIC: f32 = -1.0;
/// … and if it looks like that.
const LIKELY_STATIC: f32 = -0.3;
/// Log-odds above which such a pixel that looks other than the static model is the object's, if nothing of that is measured.
const CLEARLY_DYNAMIC: f32 = 1.0;
/// Distance at which a pixel without depth stands from what it was found to be, if such an object's or clearly static: that of a step of
/// sixty grey levels.
const AS_FOUND: f32 = 30.0;

/// What else is known of each pixel and object.
#[derive(Clone, Copy)]
pub(crate) struct Findings<'a> {
    /// Log-odds of motion per pixel.
    pub(crate) odds: &'a [f32],
    /// Whether a pixel is other than in the static scene, where that is known.
    pub(crate) changed: &'a [Option<bool>],
    /// For each label whether its object goes on without depth.
    pub(crate) unmeasured: &'a [bool],
}

/// Labels of pixels that depth does not decide.
#[derive(Debug, Default)]
pub(crate) struct Undecided {
    distances: Vec<f32>,
    labels: Vec<u16>,
    /// Column and row of the pixels to decide.
    pixels: Vec<[u16; 2]>,
}

impl Undecided {
    /// Labels for all pixels: those given where depth is measured, the nearest along the grey levels elsewhere. The label given counts as
    /// well where an object is too near to be measured, where the odds of motion are low, or where they are high and the object is
    /// unmeasured: no pixel of it could give them its label.
    pub(crate) fn assign(
        &mut self,
        camera: &Pinhole,
        frame: &ViewFrame,
        labels: &[u16],
        Findings { odds, changed, unmeasured }: Findings<'_>,
    ) -> &[u16] {
        let (width, depth) = (camera.width, frame.depth.pixels());
        self.labels.clear();
        self.labels.extend_from_slice(labels);
        let near = near_objects(depth, labels);
        let start = |i: usize| {
            let label = usize::from(labels[i]);
            let stands = (near[label] && changed[i] != Some(false))
                || (labels[i] == BACKGROUND && is_static(odds[i], changed[i]))
                || (odds[i] > CLEARLY_DYNAMIC && changed[i] == Some(true) && unmeasured[label]);
            if stands { AS_FOUND } else { f32::INFINITY }
        };
        self.pixels.clear();
        for (v, row) in depth.chunks_exact(width.max(1)).enumerate() {
            let open = row.iter().enumerate().filter(|(_, z)| **z == 0.0);
            self.pixels.extend(open.map(|(u, _)| [u as u16, v as u16]));
        }
        self.distances.clear();
        self.distances.resize(depth.len(), 0.0);
        for i in self.pixels.iter().map(|&[u, v]| usize::from(v) * width + usize::from(u)) {
            self.distances[i] = start(i);
        }
        let (distances, labels) = (&mut self.distances[..], &mut self.labels[..]);
        let mut paths = Paths { gray: frame.gray.pixels(), changed, distances, labels };
        for _ in 0..SCANS {
            paths.scan(&self.pixels, (width, camera.height));
        }
        &self.labels
    }
}

/// Whether a pixel without depth is the background's, by its log-odds of motion and by how it looks beside the static model.
fn is_static(odds: f32, changed: Option<bool>) -> bool {
    match changed {
        Some(true) => false,
        Some(false) => odds < LIKELY_STATIC,
        None => odds < CLEARLY_STATIC,
    }
}

/// The shortest ways found so far.
struct Paths<'a> {
    gray: &'a [u8],
    changed: &'a [Option<bool>],
    distances: &'a mut [f32],
    labels: &'a mut [u16],
}

impl Paths<'_> {
    /// One scan from above and one from below over pixels in order, each a column and a row.
    fn scan(&mut self, pixels: &[[u16; 2]], (width, height): (usize, usize)) {
        let place = |&[u, v]: &[u16; 2]| (usize::from(u), usize::from(v), usize::from(v) * width + usize::from(u));
        for (u, v, i) in pixels.iter().map(place) {
            if u > 0 {
                self.relax(i, i - 1);
            }
            if v > 0 {
                self.relax(i, i - width);
            }
        }
        for (u, v, i) in pixels.iter().rev().map(place) {
            if u + 1 < width {
                self.relax(i, i + 1);
            }
            if v + 1 < height {
                self.relax(i, i + width);
            }
        }
    }

    /// Takes the label of the pixel `j` for the pixel `i` if the way through it is shorter.
    #[inline]
    fn relax(&mut self, i: usize, j: usize) {
        // Mostly it is not, even if the pixels are alike.
        if self.distances[j] + 1.0 >= self.distances[i] {
            return;
        }
        let step = 1.0 + PER_LEVEL * f32::from(self.gray[i].abs_diff(self.gray[j]));
        let contradicted = self.changed[i] == Some(self.labels[j] == BACKGROUND);
        let through = self.distances[j] + if contradicted { CONTRADICTED * step } else { step };
        if through < self.distances[i] {
            self.distances[i] = through;
            self.labels[i] = self.labels[j];
        }
    }
}

/// For each label, whether it is that of an object which reaches up to where measurements end.
fn near_objects(depth: &[f32], labels: &[u16]) -> Vec<bool> {
    let count = labels.iter().max().map_or(0, |most| *most as usize) + 1;
    let (mut near, mut measured) = (vec![0_u32; count], vec![0_u32; count]);
    for (&z, &label) in depth.iter().zip(labels).filter(|(z, label)| **z > 0.0 && **label != BACKGROUND) {
        measured[label as usize] += 1;
        near[label as usize] += u32::from(z < NEAR);
    }
    near.iter().zip(measured).map(|(&near, measured)| near as f32 > NEAR_SHARE * measured as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::ops::Range;

    use pfd_geometry::Image;

    const fn findings<'a>(odds: &'a [f32], changed: &'a [Option<bool>]) -> Findings<'a> {
        Findings { odds, changed, unmeasured: &[false; 2] }
    }

    const CAMERA: Pinhole = Pinhole { width: 15, height: 1, fx: 15.0, fy: 15.0, cx: 7.0, cy: 0.0 };

    /// How many pixels go to the object on the left of a row: it has depth `z` on five pixels, five have none, and on the right there is
    /// background. Only the pixels `bright` are bright; `labels` is how many pixels the object had before.
    fn assigned(z: f32, bright: Range<usize>, changed: Option<bool>, labels: usize) -> usize {
        let mut frame = ViewFrame { gray: Image::filled(15, 1, 9), depth: Image::filled(15, 1, 0.0) };
        frame.gray.pixels_mut()[bright].fill(80);
        frame.depth.pixels_mut()[..5].fill(z);
        frame.depth.pixels_mut()[10..].fill(2.0);
        let mut given = [BACKGROUND; 15];
        given[..labels].fill(1);
        let found = Undecided::default().assign(&CAMERA, &frame, &given, findings(&[0.0; 15], &[changed; 15])).to_vec();
        let object = found.iter().take_while(|l| **l == 1).count();
        assert!(found[object..].iter().all(|l| *l == BACKGROUND), "{found:?}");
        object
    }

    #[test]
    fn a_gap_is_parted_at_the_edge() {
        assert_eq!([6, 7, 9].map(|edge| assigned(1.0, edge..15, None, 5)), [6, 7, 9]);
    }

    #[test]
    fn what_the_static_scene_explains_is_background() {
        let without_edge = |changed| assigned(1.0, 15..15, changed, 5);
        assert_eq!([None, Some(false), Some(true)].map(without_edge), [8, 6, 9]);
    }

    #[test]
    fn what_is_clearly_static_stays_background_behind_an_edge() {
        // The object has depth on five pixels; the rest of the row has none and changes its brightness half-way.
        let mut frame = ViewFrame { gray: Image::filled(15, 1, 9), depth: Image::filled(15, 1, 0.0) };
        frame.depth.pixels_mut()[..5].fill(1.0);
        frame.gray.pixels_mut()[10..].fill(80);
        let mut given = [BACKGROUND; 15];
        given[..5].fill(1);
        let objects = |odds: f32| {
            let odds = [odds; 15];
            Undecided::default()
                .assign(&CAMERA, &frame, &given, findings(&odds, &[None; 15]))
                .iter()
                .filter(|l| **l == 1)
                .count()
        };
        assert_eq!([0.0, -2.0].map(objects), [15, 10]);
    }

    #[test]
    fn an_object_goes_on_where_it_is_too_near_to_be_measured() {
        // It was found to move over eight pixels, but where it has no depth it differs in brightness, as much as the background does.
        let gap = |z, changed| assigned(z, 5..10, changed, 8);
        assert_eq!([1.0, 0.5].map(|z| gap(z, None)), [8, 10]);
        assert_eq!(gap(0.5, Some(false)), 5, "it looks like the static scene");
    }

    #[test]
    fn what_looks_like_the_static_scene_stays_background_though_a_mover_surrounds_it() {
        let mut frame = ViewFrame { gray: Image::filled(15, 1, 9), depth: Image::filled(15, 1, 1.0) };
        frame.depth.pixels_mut()[5..10].fill(0.0);
        frame.gray.pixels_mut()[5..10].fill(80);
        let given: Vec<u16> = (0..15).map(|i| u16::from(!(5..10).contains(&i))).collect();
        let background = |odds: f32, changed: Option<bool>| {
            let (odds, changed) = ([odds; 15], [changed; 15]);
            let labels = Undecided::default().assign(&CAMERA, &frame, &given, findings(&odds, &changed)).to_vec();
            labels.iter().filter(|l| **l == BACKGROUND).count()
        };
        assert_eq!([background(-0.5, Some(false)), background(-0.5, None), background(-0.1, Some(false))], [5, 0, 0]);
    }

    #[test]
    fn an_object_that_is_no_longer_measured_keeps_what_surely_moves_and_looks_other_than_the_static_scene() {
        let mut frame = ViewFrame { gray: Image::filled(15, 1, 9), depth: Image::filled(15, 1, 2.0) };
        frame.depth.pixels_mut()[..6].fill(0.0);
        frame.gray.pixels_mut()[..6].fill(80);
        let mut given = [BACKGROUND; 15];
        given[..6].fill(1);
        let kept = |odds: f32, changed: bool, unmeasured: bool| {
            let found = Findings { odds: &[odds; 15], changed: &[Some(changed); 15], unmeasured: &[false, unmeasured] };
            Undecided::default().assign(&CAMERA, &frame, &given, found).iter().filter(|l| **l == 1).count()
        };
        assert_eq!(kept(2.0, true, true), 6);
        assert_eq!([kept(0.5, true, true), kept(2.0, false, true), kept(2.0, true, false)], [0; 3]);
    }
}
