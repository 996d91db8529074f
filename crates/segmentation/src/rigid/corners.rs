//! Corners followed from the previous frame to the current one.

use pfd_geometry::{Image, Pose};
use pfd_vision::VisionError;
use pfd_vision::corners::GridCorners;
use pfd_vision::optical_flow::{FlowOptions, FlowPyramid, track_points};

use super::ego_motion::Track;
use super::view::{Motion, Pinhole, ViewFrame};

/// Side of a cell that holds at most one corner, working pixels: about 300 corners at 320×240.
pub(crate) const CELL: usize = 16;
/// Weakest corner (smaller eigenvalue of the structure tensor).
const MIN_STRENGTH: f32 = 4e-4;
/// Corners keep this distance from the image border, working pixels.
const BORDER: usize = 4;
/// Forward and backward tracking must agree within this, working pixels.
const ROUND_TRIP: f32 = 0.6;

/// Pyramid levels above the image on the way back, which starts where it should end. More of them lose corners where the image turns or
/// is blurred; without any, wrong ones pass.
const BACKWARD_LEVELS: i32 = 1;

/// A corner found again.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Correspondence {
    /// Pixel in the previous frame.
    pub(crate) from: [f32; 2],
    /// Pixel in the current frame.
    pub(crate) to: [f32; 2],
}

/// Finds and follows corners; keeps the pyramids of two frames.
#[derive(Debug)]
pub(crate) struct CornerTracker {
    options: FlowOptions,
    grid: GridCorners,
    previous: FlowPyramid,
    current: FlowPyramid,
    corners: Vec<[f32; 2]>,
}

impl CornerTracker {
    pub(crate) fn new() -> Self {
        Self {
            options: FlowOptions { window: 11, levels: 3, iterations: 10, precision: 0.03 },
            grid: GridCorners::new(CELL, MIN_STRENGTH),
            previous: FlowPyramid::default(),
            current: FlowPyramid::default(),
            corners: Vec::new(),
        }
    }

    /// Loads the current frame.
    pub(crate) fn load(&mut self, frame: &ViewFrame) -> Result<(), VisionError> {
        self.current.rebuild(&frame.gray, &self.options)
    }

    /// Follows the corners of the previous frame, whose depth is `depth`, into the current one.
    pub(crate) fn follow(
        &self,
        camera: &Pinhole,
        depth: &Image<f32>,
        guess: &Pose,
    ) -> Result<Vec<Correspondence>, VisionError> {
        let motion = Motion::from(guess);
        let predicted: Vec<[f32; 2]> = self.corners.iter().map(|&c| predict(camera, depth, &motion, c)).collect();
        let forward = track_points(&self.previous, &self.current, &self.corners, Some(&predicted), &self.options)?;
        let pairs = self.corners.iter().zip(&forward);
        let (from, to): (Vec<_>, Vec<_>) = pairs.filter_map(|(&f, t)| t.map(|t| (f, t))).unzip();
        let back = FlowOptions { levels: BACKWARD_LEVELS, ..self.options };
        let backward = track_points(&self.current, &self.previous, &to, Some(&from), &back)?;
        let found = from.iter().zip(&to).zip(&backward).filter_map(|((&from, &to), back)| {
            let back = (*back)?;
            let near = (back[0] - from[0]).hypot(back[1] - from[1]) < ROUND_TRIP;
            (near && camera.nearest(to).is_some()).then_some(Correspondence { from, to })
        });
        Ok(found.collect())
    }

    /// Corners of the previous frame.
    pub(crate) fn count(&self) -> usize {
        self.corners.len()
    }

    /// Makes the current frame the previous one and finds its corners.
    pub(crate) fn advance(&mut self, frame: &ViewFrame) -> Result<(), VisionError> {
        std::mem::swap(&mut self.previous, &mut self.current);
        self.corners = self.grid.find(&frame.gray, BORDER, None)?;
        Ok(())
    }
}

fn predict(camera: &Pinhole, depth: &Image<f32>, motion: &Motion, [u, v]: [f32; 2]) -> [f32; 2] {
    let z = camera.nearest([u, v]).map_or(0.0, |i| depth.pixels()[i]);
    if z <= 0.0 {
        return [u, v];
    }
    let moved = motion.apply(camera.unproject(u, v, z));
    let pixel = camera.project(moved);
    if moved[2] > 0.0 && camera.nearest(pixel).is_some() { pixel } else { [u, v] }
}

/// The correspondences with depth, as tracks for ego-motion; `weight` judges a pixel of the previous frame.
pub(crate) fn with_depth(
    camera: &Pinhole,
    found: &[Correspondence],
    previous: &Image<f32>,
    current: &Image<f32>,
    weight: impl Fn(usize) -> f32,
) -> Vec<(usize, Track)> {
    let tracks = found.iter().enumerate().filter_map(|(k, c)| {
        let (i, j) = (camera.nearest(c.from)?, camera.nearest(c.to)?);
        let (z, depth, weight) = (previous.pixels()[i], current.pixels()[j], weight(i));
        let point = camera.unproject(c.from[0], c.from[1], z);
        (z > 0.0 && weight > 0.0).then_some((k, Track { point, pixel: c.to, depth, weight }))
    });
    tracks.collect()
}
