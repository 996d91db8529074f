//! Pixels without depth: too near, in the projector's shadow, on dark or shiny surfaces. Each goes to whatever its grey levels
//! connect it with, the label of the measured pixel at the shortest geodesic distance, found by raster scans (Toivanen, "New geodesic
//! distance transforms for gray-scale images", Pattern Recognition Letters 1996).

use super::regions::{BACKGROUND, neighbours};
use super::view::{Pinhole, ViewFrame};

/// Length that a difference of one grey level adds to a step of one pixel: a contrast of 30 levels is worth a path of 15 pixels.
const PER_LEVEL: f32 = 0.5;
/// Pairs of scans; each turn of a path against both scan directions takes another.
const SCANS: usize = 2;

/// A step through a pixel that contradicts the label is this many times as long: "background" where it looks other than the static
/// model, a mover where it looks the same.
const CONTRADICTED: f32 = 4.0;

/// Sensors measure nothing that is much nearer than this, metres: an object that reaches up to here goes on where depth ends.
const NEAR: f32 = 0.6;
/// Share of an object's measured pixels that make it such an object.
const NEAR_SHARE: f32 = 0.2;
/// Distance at which a pixel without depth that already is such an object's stands from it: that of a step of sixty grey levels.
const OF_NEAR_OBJECT: f32 = 30.0;

/// Labels of pixels without depth.
#[derive(Debug, Default)]
pub(crate) struct Unmeasured {
    distances: Vec<f32>,
    labels: Vec<u16>,
    /// The pixels without depth.
    pixels: Vec<u32>,
}

impl Unmeasured {
    /// Labels for all pixels: those given where depth was measured, the nearest along the grey levels elsewhere. `changed` says
    /// whether a pixel looks other than the static scene, where that is known. Where an object is too near to be measured,
    /// the label that a pixel without depth was given by its odds counts as well.
    pub(crate) fn assign(
        &mut self,
        camera: &Pinhole,
        frame: &ViewFrame,
        labels: &[u16],
        changed: &[Option<bool>],
    ) -> &[u16] {
        let (depth, gray) = (frame.depth.pixels(), frame.gray.pixels());
        self.labels.clear();
        self.labels.extend_from_slice(labels);
        self.distances.clear();
        let near = near_objects(depth, labels);
        let start = |i: usize| match depth[i] {
            z if z > 0.0 => 0.0,
            _ if near[labels[i] as usize] && changed[i] != Some(false) => OF_NEAR_OBJECT,
            _ => f32::INFINITY,
        };
        self.distances.extend((0..depth.len()).map(start));
        let mut pixels = std::mem::take(&mut self.pixels);
        pixels.clear();
        pixels.extend((0..depth.len()).filter(|&i| depth[i] == 0.0).map(|i| i as u32));
        for _ in 0..SCANS {
            for i in pixels.iter().map(|&i| i as usize) {
                let [left, _, above, _] = neighbours(camera, i);
                self.relax(i, left, gray, changed[i]);
                self.relax(i, above, gray, changed[i]);
            }
            for i in pixels.iter().rev().map(|&i| i as usize) {
                let [_, right, _, below] = neighbours(camera, i);
                self.relax(i, right, gray, changed[i]);
                self.relax(i, below, gray, changed[i]);
            }
        }
        self.pixels = pixels;
        &self.labels
    }

    /// Takes the label of the pixel `from` for the pixel `i` if the way through it is shorter.
    #[inline]
    fn relax(&mut self, i: usize, from: Option<usize>, gray: &[u8], changed: Option<bool>) {
        let Some(j) = from else { return };
        let step = 1.0 + PER_LEVEL * f32::from(gray[i].abs_diff(gray[j]));
        let contradicted = changed == Some(self.labels[j] == BACKGROUND);
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
    use pfd_geometry::Image;

    const CAMERA: Pinhole = Pinhole { width: 7, height: 1, fx: 7.0, fy: 7.0, cx: 3.0, cy: 0.0 };

    /// Labels of a row whose ends are measured: label 1 on the left, background on the right.
    fn row(gray: [u8; 7], changed: Option<bool>) -> Vec<u16> {
        let mut frame = ViewFrame { gray: Image::filled(7, 1, 0), depth: Image::filled(7, 1, 0.0) };
        frame.gray.pixels_mut().copy_from_slice(&gray);
        (frame.depth.pixels_mut()[0], frame.depth.pixels_mut()[6]) = (1.0, 2.0);
        let labels = [1, BACKGROUND, BACKGROUND, BACKGROUND, BACKGROUND, BACKGROUND, BACKGROUND];
        Unmeasured::default().assign(&CAMERA, &frame, &labels, &[changed; 7]).to_vec()
    }

    #[test]
    fn a_gap_is_parted_at_the_edge() {
        assert_eq!(row([9, 9, 9, 9, 9, 80, 80], None), [1, 1, 1, 1, 1, 0, 0]);
        assert_eq!(row([9, 9, 80, 80, 80, 80, 80], None), [1, 1, 0, 0, 0, 0, 0]);
    }

    #[test]
    fn what_the_static_scene_explains_is_background() {
        assert_eq!(row([9; 7], None), [1, 1, 1, 1, 0, 0, 0]);
        assert_eq!(row([9; 7], Some(false)), [1, 1, 0, 0, 0, 0, 0]);
        assert_eq!(row([9; 7], Some(true)), [1, 1, 1, 1, 1, 0, 0]);
    }

    #[test]
    fn an_object_goes_on_where_it_is_too_near_to_be_measured() {
        // Something at `z` on the left that was found to move over five pixels, bright where it has no depth.
        let labels_for = |z: f32, changed| {
            let mut frame = ViewFrame { gray: Image::filled(7, 1, 0), depth: Image::filled(7, 1, 0.0) };
            frame.gray.pixels_mut().copy_from_slice(&[9, 80, 80, 80, 80, 9, 9]);
            (frame.depth.pixels_mut()[0], frame.depth.pixels_mut()[6]) = (z, 2.0);
            let labels = [1, 1, 1, 1, 1, BACKGROUND, BACKGROUND];
            Unmeasured::default().assign(&CAMERA, &frame, &labels, &[changed; 7]).to_vec()
        };
        assert_eq!(labels_for(1.0, None), [1, 1, 1, 1, 0, 0, 0]);
        assert_eq!(labels_for(0.5, None), [1, 1, 1, 1, 1, 0, 0]);
        assert_eq!(labels_for(0.5, Some(false)), [1, 0, 0, 0, 0, 0, 0], "it looks like the static scene");
    }
}
