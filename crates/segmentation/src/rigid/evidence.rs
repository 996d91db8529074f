//! Evidence for and against motion, pixel by pixel.
//!
//! Every cue is a test of the hypothesis "this surface is static" against what the hypothesis predicts, in units of the noise
//! of that prediction. Evidence is a pair (evidence, weight); the ratio after diffusion is the share of the information nearby
//! that speaks for motion.

use pfd_geometry::{DepthNoise, GrayImage};

use super::luma;
use super::objects::{median, quantile};
use super::reference::{Appearance, RANGE_RADIUS, Warp};
use super::regions::BACKGROUND;
use super::static_model::ModelPoint;
use super::unchanged;
use super::view::{Pinhole, ViewFrame, floor};

/// The surface stands where an earlier frame saw free space: it has come in.
const FREE_SPACE: f32 = 1.0;
/// The surface stands in front of the static model.
const BEFORE_MODEL: f32 = 1.5;
/// Texture differs although depth agrees.
const TEXTURE_CHANGED: f32 = 0.35;
/// Strong texture agrees.
const TEXTURE_SAME: f32 = 0.4;
/// Depth agrees: says little, because a surface that slides along itself agrees as well.
const DEPTH_SAME: f32 = 0.01;
/// Depth agrees with a surface of the static model that was confirmed often.
const MODEL_SAME: f32 = 0.05;
/// Depth agrees along a depth edge, which a surface that slides along itself cannot do.
const OUTLINE_SAME: f32 = 0.4;

/// Depth step, relative to depth, from which an edge is the outline of something.
const EDGE: f32 = 0.05;
/// Systematic error of depth relative to depth: calibration of the sensor, and stamps of colour and depth that differ.
const RELATIVE_ERROR: f32 = 0.015;
/// The surface lies behind what was there: the background that something uncovered.
const UNCOVERED: f32 = 0.15;
/// Other luma than the static model, where depth is missing or the same.
const OTHER_LUMA: f32 = 0.4;
/// The same luma there: many a mover is as bright as what it hides.
const SAME_LUMA: f32 = 0.2;

/// Spacing of the pixels that are compared with earlier frames.
pub(crate) const STRIDE: usize = 2;

/// Each compared pixel stands for this many.
const SAMPLED: f32 = (STRIDE * STRIDE) as f32;

/// Noise of the texture image, grey levels: shot noise and JPEG coding.
const TEXTURE_NOISE: f32 = 4.0;
/// Gradient (grey levels per pixel) from which agreeing texture counts fully.
const STRONG_GRADIENT: f32 = 12.0;
/// Luma difference (grey levels) that a static surface shows by shadows of movers and exposure.
const LUMA_TOLERANCE: f32 = 20.0;
/// How many times darker than the static model a shadow can make a surface, in grey levels: by the usual gamma of 2.2 it then has a third of
/// the light. What is darker still, or brighter by as much where a shadow has left, is another surface in the same place.
const DEEPEST_SHADOW: f32 = 1.6;

/// Certainty of the static model from which it says whether a pixel has changed.
const CERTAIN: f32 = 0.5;

/// A kind of evidence by which new regions are judged (`credibility.rs`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Cue {
    /// Occupies what an earlier frame saw to be free.
    FreeSpace,
    /// Stands before the static model.
    BeforeModel,
    /// Has other luma than the static model, and no depth or the same.
    OtherLuma,
    /// Corners move on their own.
    OwnMotion,
    /// Other texture than in an earlier frame.
    OtherTexture,
    /// The same, strong texture.
    SameTexture,
    /// The same depth as in an earlier frame or in the static model.
    SamePlace,
    /// Has no depth and the same luma as the static model.
    SameLuma,
}

impl Cue {
    /// How many there are.
    pub(crate) const COUNT: usize = Self::SameLuma as usize + 1;

    /// Share of its weight that speaks for motion.
    fn evidence(self) -> f32 {
        if matches!(self, Self::SameTexture | Self::SamePlace | Self::SameLuma) { 0.0 } else { 1.0 }
    }
}

/// Accumulated evidence.
#[derive(Debug, Default)]
pub(crate) struct Field {
    /// `[evidence, weight]` per working pixel.
    pub(crate) cells: Vec<[f32; 2]>,
    /// Evidence for motion between frames alone (no model, no memory).
    pub(crate) motion: Vec<f32>,
    /// How surely the static model explains the pixel, 0 to 1.
    pub(crate) explained: Vec<f32>,
    /// How surely the pixel stands before the static model, 0 to 1.
    pub(crate) intruding: Vec<f32>,
    /// Whether a pixel is other than the static model: by depth or much other luma where the model is certain, by luma where depth is
    /// missing.
    pub(crate) changed: Vec<Option<bool>>,
    /// Whether a pixel [shows](unchanged::shows) just what the static model has there.
    pub(crate) unchanged: Vec<bool>,
    /// Weight of each [`Cue`] per working pixel, before diffusion.
    pub(crate) cues: Vec<[f32; Cue::COUNT]>,
}

impl Field {
    /// Forgets everything; `pixels` cells.
    pub(crate) fn clear(&mut self, pixels: usize) {
        self.cells.clear();
        self.cells.resize(pixels, [0.0; 2]);
        self.motion.clear();
        self.motion.resize(pixels, 0.0);
        self.explained.clear();
        self.explained.resize(pixels, 0.0);
        self.intruding.clear();
        self.intruding.resize(pixels, 0.0);
        self.changed.clear();
        self.changed.resize(pixels, None);
        self.unchanged.clear();
        self.unchanged.resize(pixels, false);
        self.cues.clear();
        self.cues.resize(pixels, [0.0; Cue::COUNT]);
    }

    /// Adds `weight` of what `cue` says.
    pub(crate) fn observe(&mut self, index: usize, cue: Cue, weight: f32) {
        self.add(index, cue.evidence(), weight);
        self.cues[index][cue as usize] += weight;
    }

    /// Adds `weight` of information against motion that no new region is judged by.
    pub(crate) fn add_static(&mut self, index: usize, weight: f32) {
        self.add(index, 0.0, weight);
    }

    /// Adds `weight` of information, of which the share `evidence` speaks for motion.
    fn add(&mut self, index: usize, evidence: f32, weight: f32) {
        let cell = &mut self.cells[index];
        cell[0] += evidence * weight;
        cell[1] += weight;
    }

    /// Adds evidence for motion that agreement with earlier frames cannot weaken: standing still does not make a thing part of
    /// the static scene.
    fn insist(&mut self, index: usize, cue: Cue, weight: f32) {
        let cell = &mut self.cells[index];
        cell[0] += weight;
        cell[1] = cell[0];
        let cues = &mut self.cues[index];
        cues[cue as usize] += weight;
        (cues[Cue::SameTexture as usize], cues[Cue::SamePlace as usize]) = (0.0, 0.0);
    }

    /// Adds `weight` of what corners that move on their own say of a pixel near them. Where it may be `behind` them what the static model
    /// explains is no part of what they lie on.
    pub(crate) fn blame(&mut self, index: usize, weight: f32, behind: bool) {
        let share = if behind { 1.0 - self.explained[index] } else { 1.0 };
        self.observe(index, Cue::OwnMotion, share * weight);
    }

    /// Whether a pixel is known to show other than the static model.
    pub(crate) fn stands_apart(&self, index: usize) -> bool {
        self.changed[index] == Some(true)
    }

    /// Adds `weight` of what `cue` says of motion between frames.
    pub(crate) fn add_motion(&mut self, index: usize, cue: Cue, weight: f32) {
        self.observe(index, cue, weight);
        self.motion[index] += weight;
    }
}

/// What all comparisons of one frame share.
pub(crate) struct Scene<'a> {
    pub(crate) camera: &'a Pinhole,
    /// Ray through each pixel.
    pub(crate) rays: &'a [[f32; 2]],
    /// Whether each pixel lies within the camera image.
    pub(crate) inside: &'a [bool],
    pub(crate) noise: &'a DepthNoise,
    pub(crate) frame: &'a ViewFrame,
    pub(crate) appearance: &'a Appearance,
    /// Length of the luma gradient per working pixel.
    pub(crate) gradient: &'a [f32],
    /// Depth with holes filled from their borders.
    pub(crate) filled: &'a [f32],
    /// Labels of known movers carried into this frame: where an earlier frame saw a mover, other texture now says nothing unless
    /// it is a mover that is seen now.
    pub(crate) carried: &'a [u16],
    /// Standard deviations from which a difference counts.
    pub(crate) significance: f32,
    pub(crate) tolerance: Tolerance,
}

/// Significant differences of two depths.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tolerance {
    sigmas: f32,
    offset: f32,
    quadratic: f32,
}

impl Tolerance {
    /// From so many standard deviations on.
    pub(crate) fn new(noise: &DepthNoise, significance: f32) -> Self {
        let (offset, quadratic) = (noise.offset as f32, noise.quadratic as f32);
        Self { sigmas: significance * std::f32::consts::SQRT_2, offset, quadratic }
    }

    /// Around `z`; metres.
    #[inline]
    pub(crate) fn at(&self, z: f32) -> f32 {
        self.sigmas * (self.offset + self.quadratic * z * z) + RELATIVE_ERROR * z
    }
}

/// An earlier frame to compare with.
pub(crate) struct Earlier<'a> {
    pub(crate) appearance: &'a Appearance,
    /// Where current pixels lie in it.
    pub(crate) warp: Warp,
    /// Uncertainty of the warp, pixels (see [`Scene::warp_sigma`]).
    pub(crate) pixel_sigma: f32,
    /// See [`depth_shift`].
    pub(crate) shift: f32,
    /// By how much the image has become brighter since, grey levels (see [`Scene::exposure_since`]).
    pub(crate) exposure: f32,
    /// How much agreement says, 0 to 1: after a short time everything still looks the same.
    pub(crate) trust: f32,
}

/// Pixels by which depth may be displaced against colour when the image moves by `flow` pixels per frame now and moved by
/// `flow_then` in the frame of comparison: the two are not taken at the same instant.
pub(crate) fn depth_shift(flow: f32, flow_then: f32) -> f32 {
    LAG * (flow + flow_then)
}

/// Time between depth and colour in frames: unsynchronised streams are paired with up to half a frame between them.
const LAG: f32 = 0.5;
/// Depth change per pixel and metre of depth beyond which a neighbourhood holds an edge and not a slope.
pub(crate) const MAX_SLOPE: f32 = 0.02;

/// Where a depth lies relative to what was seen before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Relation {
    Nearer,
    Same,
    Farther,
}

impl Scene<'_> {
    /// `shift`: pixels by which depth may be displaced beyond the neighbourhood of which `near` and `far` are the range. On a
    /// surface seen at a grazing angle each of them is a centimetre and more.
    fn relation(&self, z: f32, [near, far]: [f32; 2], shift: f32) -> Relation {
        let slope = (far - near) / (2 * RANGE_RADIUS) as f32;
        let slack = shift * slope.min(MAX_SLOPE * near);
        if z < near - self.tolerance.at(near) - slack {
            Relation::Nearer
        } else if z > far + self.tolerance.at(far) + slack {
            Relation::Farther
        } else {
            Relation::Same
        }
    }

    /// Whether the pixel lies on the near side of a depth edge: where agreeing depth pins the surface down.
    fn is_outline(&self, i: usize) -> bool {
        let (near, far) = (self.appearance.near.pixels()[i], self.appearance.far.pixels()[i]);
        self.has_edge(near, far) && self.frame.depth.pixels()[i] - near < 0.5 * (far - near)
    }

    fn has_edge(&self, near: f32, far: f32) -> bool {
        far - near > self.tolerance.at(near) + EDGE * near
    }

    fn is_usable(&self, z: f32) -> bool {
        self.noise.is_usable(f64::from(z))
    }

    /// Compares the current frame with earlier ones, the oldest first, on every [`STRIDE`]th pixel of every [`STRIDE`]th row,
    /// starting at `phase`; the diffusion fills in the rest. Each pixel is judged by the oldest frame that saw its place:
    /// there a mover has left its own silhouette the farthest behind.
    pub(crate) fn compare_earlier(&self, earlier: &[Earlier<'_>], phase: usize, field: &mut Field) {
        let width = self.camera.width;
        for v in (phase / STRIDE % STRIDE..self.camera.height).step_by(STRIDE) {
            for i in (v * width + phase % STRIDE..(v + 1) * width).step_by(STRIDE) {
                let measured = self.frame.depth.pixels()[i];
                let has_depth = self.is_usable(measured);
                let z = if has_depth { measured } else { self.filled[i] };
                if z > 0.0 && self.inside[i] {
                    let _ = earlier.iter().any(|e| self.compare_pixel(i, (z, has_depth), e, field));
                }
            }
        }
    }

    /// Whether the earlier frame could judge the pixel.
    #[inline]
    fn compare_pixel(&self, i: usize, (z, has_depth): (f32, bool), earlier: &Earlier<'_>, field: &mut Field) -> bool {
        let Some((p, z)) = earlier.warp.apply(self.camera, self.rays[i], z) else { return false };
        let Some(j) = self.camera.nearest(p).filter(|&j| self.inside[j]) else { return false };
        let (near, far) = (earlier.appearance.near.pixels()[j], earlier.appearance.far.pixels()[j]);
        if has_depth && near > 0.0 {
            match self.relation(z, [near, far], earlier.shift) {
                Relation::Nearer => {
                    field.add_motion(i, Cue::FreeSpace, FREE_SPACE * SAMPLED);
                    return true;
                }
                Relation::Farther => return false,
                Relation::Same => {
                    let outline = self.is_outline(i) && self.has_edge(near, far);
                    let weight = if outline { OUTLINE_SAME } else { DEPTH_SAME };
                    field.observe(i, Cue::SamePlace, weight * SAMPLED * earlier.trust);
                }
            }
        }
        self.compare_texture(i, earlier, (p, j, z), field)
    }

    /// The difference of texture in units of what noise and an uncertain warp explain: below one it speaks for "static", the
    /// more the stronger the texture; towards [`Self::significance`] for motion.
    fn compare_texture(
        &self,
        i: usize,
        earlier: &Earlier<'_>,
        (p, j, z): ([f32; 2], usize, f32),
        field: &mut Field,
    ) -> bool {
        let Some(expected) = bilinear(earlier.appearance.texture.pixels(), self.camera, p) else { return false };
        let difference = (self.appearance.texture.pixels()[i] - expected).abs();
        let gradient = self.gradient[i];
        let slip = gradient * earlier.pixel_sigma;
        let sigma = (TEXTURE_NOISE * TEXTURE_NOISE + slip * slip).sqrt();
        let significant = |difference: f32| ((difference / sigma - 1.0) / (self.significance - 1.0)).clamp(0.0, 1.0);
        let mut evidence = significant(difference);
        if evidence > 0.0 && self.is_beside_silhouette(i, earlier, (j, z)) {
            // Where the silhouette has moved the mean that is taken off changes, and nothing else does.
            let gray = |image: &GrayImage, at: usize| f32::from(image.pixels()[at]);
            let luma = gray(&self.frame.gray, i) - gray(&earlier.appearance.gray, j) - earlier.exposure;
            evidence = evidence.min(significant(luma.abs()));
        }
        let texture = (gradient / STRONG_GRADIENT).min(1.0);
        let same = (1.0 - evidence) * TEXTURE_SAME * texture * texture;
        field.observe(i, Cue::SameTexture, same * SAMPLED * earlier.trust);
        let meaningful = earlier.appearance.mask[j] == 0 || self.carried[i] != BACKGROUND;
        if meaningful {
            field.add_motion(i, Cue::OtherTexture, evidence * TEXTURE_CHANGED * SAMPLED);
        }
        meaningful
    }

    /// Whether something nearer is beside pixel `i`, or was beside pixel `j` of an earlier frame, where its surface lies at depth `z`.
    fn is_beside_silhouette(&self, i: usize, earlier: &Earlier<'_>, (j, z): (usize, f32)) -> bool {
        let beside = |near: f32, z: f32| near > 0.0 && self.has_edge(near, z);
        beside(self.appearance.near.pixels()[i], self.frame.depth.pixels()[i])
            || beside(earlier.appearance.near.pixels()[j], z)
    }

    /// Compares the current frame with the static model, of which `near` and `far` are the depth range.
    pub(crate) fn compare_model(&self, model: &[ModelPoint], [near, far]: [&[f32]; 2], shift: f32, field: &mut Field) {
        let offset = self.luma_offset(model);
        for (i, &z) in self.frame.depth.pixels().iter().enumerate() {
            if near[i] <= 0.0 || !model[i].is_believed() || !self.inside[i] {
                continue;
            }
            if !self.is_usable(z) {
                self.compare_luma(i, &model[i], offset, field);
                continue;
            }
            let certainty = model[i].certainty();
            match self.relation(z, [near[i], far[i]], shift) {
                Relation::Nearer => {
                    field.intruding[i] = certainty;
                    field.changed[i] = (certainty > CERTAIN).then_some(true);
                    field.insist(i, Cue::BeforeModel, BEFORE_MODEL);
                }
                Relation::Same if self.is_other_surface(i, model, offset) => {
                    field.changed[i] = (certainty > CERTAIN).then_some(true);
                    field.observe(i, Cue::OtherLuma, OTHER_LUMA * certainty);
                }
                Relation::Same => {
                    field.explained[i] = certainty;
                    let luma = f32::from(self.frame.gray.pixels()[i]) - model[i].gray - offset;
                    field.unchanged[i] = unchanged::shows(&model[i], z, luma);
                    field.changed[i] = (certainty > CERTAIN).then_some(false);
                    let outline = self.is_outline(i) && self.has_edge(near[i], far[i]);
                    let weight = if outline { OUTLINE_SAME } else { MODEL_SAME };
                    field.observe(i, Cue::SamePlace, weight * field.explained[i]);
                }
                Relation::Farther => field.add_static(i, UNCOVERED),
            }
        }
    }

    /// Whether a pixel shows another surface than the static model: no shadow that falls on it or leaves it explains its luma, nor does one
    /// on what the model has a pixel beside it.
    fn is_other_surface(&self, i: usize, model: &[ModelPoint], offset: f32) -> bool {
        let now = f32::from(self.frame.gray.pixels()[i]);
        let differs = |expected: f32| {
            let then = expected.max(0.0);
            now.max(then) > DEEPEST_SHADOW * now.min(then) + LUMA_TOLERANCE
        };
        // Most pixels do not, and need no look at their neighbours.
        if !differs(model[i].gray + offset) {
            return false;
        }
        let believed = |j: usize| model[j].is_believed().then_some(model[j].gray + offset);
        luma::range(self.camera, i, believed).is_some_and(|[low, high]| differs(now.clamp(low, high)))
    }

    fn compare_luma(&self, i: usize, point: &ModelPoint, offset: f32, field: &mut Field) {
        let difference = (f32::from(self.frame.gray.pixels()[i]) - point.gray - offset).abs();
        let slip = self.gradient[i];
        field.changed[i] = Some(difference > LUMA_TOLERANCE + slip);
        if difference > LUMA_TOLERANCE + slip {
            field.insist(i, Cue::OtherLuma, OTHER_LUMA);
        } else {
            field.observe(i, Cue::SameLuma, SAME_LUMA * point.certainty());
        }
    }

    /// Median luma difference between this frame and an earlier one where depth agrees: the change of exposure.
    pub(crate) fn exposure_since(&self, earlier: &Earlier<'_>) -> f32 {
        let seen = self.seen_again(earlier, (0..self.rays.len()).step_by(EXPOSURE_SAMPLING));
        let luma = |image: &GrayImage, i: usize| f32::from(image.pixels()[i]);
        let difference = |(i, j, _)| luma(&self.frame.gray, i) - luma(&earlier.appearance.gray, j);
        median(&mut seen.map(difference).collect::<Vec<_>>()).unwrap_or(0.0)
    }

    /// How precisely an earlier frame is warped onto this one, pixels, by how much texture differs where it is strong and depth agrees;
    /// no worse than [`Earlier::pixel_sigma`].
    pub(crate) fn warp_sigma(&self, earlier: &Earlier<'_>) -> f32 {
        let strong = |i: &usize| self.inside[*i] && self.gradient[*i] >= STRONG_GRADIENT;
        let seen = self.seen_again(earlier, (0..self.rays.len()).step_by(WARP_SAMPLING).filter(strong));
        let texture = (self.appearance.texture.pixels(), earlier.appearance.texture.pixels());
        let slip = |(i, _, p): (usize, usize, [f32; 2])| {
            let expected = bilinear(texture.1, self.camera, p)?;
            Some((texture.0[i] - expected).abs() / self.gradient[i])
        };
        let mut slips: Vec<f32> = seen.filter_map(slip).collect();
        if slips.len() < MIN_SLIPS {
            return earlier.pixel_sigma;
        }
        let measured = quantile(&mut slips, MOST_SLIPS).map_or(f32::INFINITY, |slip| SLIP_TO_SIGMA * slip);
        measured.max(LEAST_WARP_SIGMA).min(earlier.pixel_sigma)
    }

    /// Those of the `pixels` that an earlier frame saw at the same depth, with the pixel and the position there.
    fn seen_again(
        &self,
        earlier: &Earlier<'_>,
        pixels: impl Iterator<Item = usize>,
    ) -> impl Iterator<Item = (usize, usize, [f32; 2])> {
        let usable = pixels.filter(|&i| self.is_usable(self.frame.depth.pixels()[i]));
        usable.filter_map(|i| {
            let (p, z) = earlier.warp.apply(self.camera, self.rays[i], self.frame.depth.pixels()[i])?;
            let j = self.camera.nearest(p)?;
            let (near, far) = (earlier.appearance.near.pixels()[j], earlier.appearance.far.pixels()[j]);
            let same = near > 0.0 && self.relation(z, [near, far], earlier.shift) == Relation::Same;
            same.then_some((i, j, p))
        })
    }

    /// Mean luma difference between frame and model where depth agrees: the change of exposure.
    fn luma_offset(&self, model: &[ModelPoint]) -> f32 {
        let (mut sum, mut count) = (0.0, 1.0);
        let pixels = self.frame.depth.pixels().iter().zip(self.frame.gray.pixels());
        for (point, (&z, &gray)) in model.iter().zip(pixels).step_by(LUMA_SAMPLING) {
            let difference = f32::from(gray) - point.gray;
            let same = point.is_known() && (z - point.position[2]).abs() < self.tolerance.at(z);
            if same && difference.abs() < LUMA_TOLERANCE * 2.0 {
                sum += difference;
                count += 1.0;
            }
        }
        sum / count
    }
}

/// Every how many pixels exposure is compared with the static model, …
const LUMA_SAMPLING: usize = 7;
/// … and with earlier frames.
const EXPOSURE_SAMPLING: usize = 163;

/// Every how many pixels texture is compared to measure a warp.
const WARP_SAMPLING: usize = 23;
/// So many must have been compared.
const MIN_SLIPS: usize = 20;
/// Share of them that is hardly ever on movers, …
const MOST_SLIPS: f32 = 0.7;
/// … and standard deviations per slip that is the largest of such a share. Normally distributed ones have nearly 1; large ones are more
/// frequent, as depth errs along with the motion.
const SLIP_TO_SIGMA: f32 = 1.5;
/// Least uncertainty of a warp, pixels: images are interpolated.
const LEAST_WARP_SIGMA: f32 = 0.1;

/// The image at a position between pixels; `None` at the border.
fn bilinear(image: &[f32], camera: &Pinhole, [x, y]: [f32; 2]) -> Option<f32> {
    let inside = x >= 0.0 && y >= 0.0 && x < (camera.width - 1) as f32 && y < (camera.height - 1) as f32;
    if !inside {
        return None;
    }
    let (u, v) = (floor(x), floor(y));
    let (a, b) = (x - u as f32, y - v as f32);
    let i = v * camera.width + u;
    let (top, bottom) = (&image[i..i + 2], &image[i + camera.width..i + camera.width + 2]);
    let (upper, lower) = (top[0] + (top[1] - top[0]) * a, bottom[0] + (bottom[1] - bottom[0]) * a);
    Some(upper + (lower - upper) * b)
}

/// Largest gradient (grey levels per pixel) in the 3×3 neighbourhood: what a warp that is off by a pixel may run into.
pub(crate) fn steepest_gradient(camera: &Pinhole, gray: &[u8], spare: &mut Vec<f32>, out: &mut Vec<f32>) {
    let (width, height) = (camera.width, camera.height);
    for buffer in [&mut *spare, &mut *out] {
        buffer.clear();
        buffer.resize(gray.len(), 0.0);
    }
    if width < 3 || height < 3 {
        return;
    }
    for v in 1..height - 1 {
        let [above, here, below] = [v - 1, v, v + 1].map(|r| &gray[r * width..(r + 1) * width]);
        let row = &mut out[v * width..(v + 1) * width];
        for u in 1..width - 1 {
            let dx = f32::from(here[u + 1]) - f32::from(here[u - 1]);
            let dy = f32::from(below[u]) - f32::from(above[u]);
            row[u] = 0.5 * (dx * dx + dy * dy).sqrt();
        }
    }
    for (to, from) in spare.chunks_exact_mut(width).zip(out.chunks_exact(width)) {
        for (t, w) in to[1..].iter_mut().zip(from.windows(3)) {
            *t = w[0].max(w[1]).max(w[2]);
        }
    }
    for v in 1..height - 1 {
        let [above, here, below] = [v - 1, v, v + 1].map(|r| &spare[r * width..(r + 1) * width]);
        for (u, t) in out[v * width..(v + 1) * width].iter_mut().enumerate() {
            *t = above[u].max(here[u]).max(below[u]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rigid::view::Motion;
    use pfd_geometry::{Image, Pose};

    const CAMERA: Pinhole = Pinhole { width: 40, height: 30, fx: 30.0, fy: 30.0, cx: 19.5, cy: 14.5 };

    /// A wall at 2 m of this texture and luma, and something before it if it is `beside` something.
    fn wall(beside: bool, [texture, luma]: [f32; 2]) -> Appearance {
        let flat = |value: f32| Image::filled(CAMERA.width, CAMERA.height, value);
        Appearance {
            texture: flat(texture),
            gray: Image::filled(CAMERA.width, CAMERA.height, luma as u8),
            near: flat(if beside { 1.2 } else { 2.0 }),
            far: flat(2.0),
            mask: vec![0; CAMERA.pixels()],
        }
    }

    /// What a camera at rest learns from how things look and looked while everything has become brighter by 10.
    fn learn<T>(now: &Appearance, then: &Appearance, what: impl FnOnce(&Scene<'_>, &Earlier<'_>) -> T) -> T {
        learn_within(&[true; CAMERA.width * CAMERA.height], now, then, what)
    }

    /// The same where only pixels `inside` are within the camera image.
    fn learn_within<T>(
        inside: &[bool],
        now: &Appearance,
        then: &Appearance,
        what: impl FnOnce(&Scene<'_>, &Earlier<'_>) -> T,
    ) -> T {
        let frame = ViewFrame { gray: now.gray.clone(), depth: now.far.clone() };
        let rays: Vec<_> = (0..CAMERA.pixels()).map(|i| CAMERA.ray(i)).collect();
        let scene = Scene {
            inside,
            camera: &CAMERA,
            rays: &rays,
            noise: &DepthNoise::default(),
            frame: &frame,
            appearance: now,
            gradient: &vec![0.0; CAMERA.pixels()],
            filled: frame.depth.pixels(),
            carried: &vec![BACKGROUND; CAMERA.pixels()],
            significance: 3.5,
            tolerance: Tolerance::new(&DepthNoise::default(), 3.5),
        };
        let warp = Warp::Rigid(Motion::from(&Pose::identity()));
        let earlier = Earlier { appearance: then, warp, pixel_sigma: 0.4, shift: 0.0, exposure: 10.0, trust: 1.0 };
        what(&scene, &earlier)
    }

    /// Evidence of other texture on a wall, `beside` something or not, of which texture and luma were `[texture, luma]` before.
    fn other_texture(beside: bool, before: [f32; 2], now: [f32; 2]) -> f32 {
        learn(&wall(beside, now), &wall(beside, before), |scene, earlier| {
            let mut field = Field::default();
            field.clear(CAMERA.pixels());
            scene.compare_earlier(std::slice::from_ref(earlier), 0, &mut field);
            field.cues.iter().map(|c| c[Cue::OtherTexture as usize]).sum()
        })
    }

    #[test]
    fn what_lies_outside_of_the_camera_image_is_no_evidence() {
        let inside: Vec<bool> = (0..CAMERA.pixels()).map(|i| i % CAMERA.width < 20).collect();
        learn_within(&inside, &wall(false, [40.0, 200.0]), &wall(false, [0.0, 90.0]), |scene, earlier| {
            let mut field = Field::default();
            field.clear(CAMERA.pixels());
            scene.compare_earlier(std::slice::from_ref(earlier), 0, &mut field);
            let point = ModelPoint { position: CAMERA.unproject(19.5, 14.5, 2.0), gray: 200.0, hits: 10.0 };
            let depth = vec![2.0; CAMERA.pixels()];
            scene.compare_model(&vec![point; CAMERA.pixels()], [&depth, &depth], 0.0, &mut field);
            let compared = |i: usize| field.cues[i].iter().any(|weight| *weight > 0.0);
            assert!((0..CAMERA.pixels()).all(|i| compared(i) == inside[i]));
        });
    }

    #[test]
    fn beside_a_silhouette_other_texture_is_other_luma_too() {
        for beside in [true, false] {
            assert!(other_texture(beside, [0.0, 90.0], [40.0, 140.0]) > 1.0);
            assert_eq!(other_texture(beside, [0.0, 90.0], [0.0, 140.0]), 0.0, "a shadow");
        }
        assert_eq!(other_texture(true, [0.0, 90.0], [40.0, 100.0]), 0.0, "the silhouette has moved");
        assert!(other_texture(false, [0.0, 90.0], [40.0, 100.0]) > 1.0);
    }

    #[test]
    fn a_warp_is_as_precise_as_the_texture_of_most_pixels_says() {
        let gradient = vec![20.0; CAMERA.pixels()];
        let then = wall(false, [0.0, 90.0]);
        let sigma_where = |slip: f32| {
            let mut now = wall(false, [20.0 * slip, 90.0]);
            now.texture.pixels_mut()[..CAMERA.pixels() / 4].fill(100.0);
            learn(&now, &then, |scene, earlier| Scene { gradient: &gradient, ..*scene }.warp_sigma(earlier))
        };
        assert!((sigma_where(0.12) - 0.18).abs() < 1e-4, "{}", sigma_where(0.12));
        assert_eq!(sigma_where(0.01), LEAST_WARP_SIGMA);
        assert_eq!(sigma_where(1.0), 0.4, "as much as the image motion lets expect");
        let plain = |scene: &Scene<'_>, earlier: &Earlier<'_>| scene.warp_sigma(earlier);
        assert_eq!(learn(&then, &then, plain), 0.4, "nothing tells without texture");
    }

    #[test]
    fn the_change_of_exposure_is_that_of_most_pixels() {
        let mut now = wall(false, [0.0, 117.0]);
        now.gray.pixels_mut()[..400].fill(250);
        learn(&now, &wall(false, [0.0, 100.0]), |scene, earlier| assert_eq!(scene.exposure_since(earlier), 17.0));
    }

    /// Pixels of half a wall that the static model knows on which luma is other when it goes from `before` to `now`.
    fn other_luma(before: f32, now: f32) -> usize {
        let look = wall(false, [0.0, now]);
        learn(&look, &look, |scene, _| {
            let mut field = Field::default();
            field.clear(CAMERA.pixels());
            // All else has stayed as it was, so that exposure has.
            let half = CAMERA.pixels() / 2;
            let point = |i: usize| ModelPoint {
                position: CAMERA.unproject((i % CAMERA.width) as f32, (i / CAMERA.width) as f32, 2.0),
                gray: if i < half { before } else { now },
                hits: 10.0,
            };
            let model: Vec<ModelPoint> = (0..CAMERA.pixels()).map(point).collect();
            let depth = vec![2.0; CAMERA.pixels()];
            scene.compare_model(&model, [&depth, &depth], 0.0, &mut field);
            assert!((0..half).all(|i| (field.changed[i] == Some(true)) == (field.explained[i] == 0.0)));
            field.cues[..half].iter().filter(|c| c[Cue::OtherLuma as usize] == OTHER_LUMA).count()
        })
    }

    #[test]
    fn a_shadow_is_no_other_surface_and_what_is_darker_still_is_one() {
        assert_eq!([other_luma(200.0, 200.0), other_luma(200.0, 130.0), other_luma(130.0, 200.0)], [0; 3]);
        // Where the halves touch it may be the other half that is seen.
        let all_but_a_row = CAMERA.pixels() / 2 - CAMERA.width;
        assert_eq!([other_luma(200.0, 60.0), other_luma(60.0, 200.0)], [all_but_a_row; 2]);
        assert_eq!(other_luma(25.0, 5.0), 0, "noise of a dark surface");
    }

    #[test]
    fn what_shows_the_static_model_to_within_noise_is_unchanged() {
        let look = wall(false, [0.0, 100.0]);
        learn(&look, &look, |scene, _| {
            let mut field = Field::default();
            field.clear(CAMERA.pixels());
            let point = |i: usize| ModelPoint {
                position: CAMERA.unproject((i % CAMERA.width) as f32, (i / CAMERA.width) as f32, 2.0),
                gray: if i == 7 { 140.0 } else { 100.0 },
                hits: if i == 8 { 9.0 } else { 10.0 },
            };
            let model: Vec<ModelPoint> = (0..CAMERA.pixels()).map(point).collect();
            let depth = vec![2.0; CAMERA.pixels()];
            scene.compare_model(&model, [&depth, &depth], 0.0, &mut field);
            assert!((0..CAMERA.pixels()).all(|i| field.unchanged[i] != [7, 8].contains(&i)));
            field.clear(CAMERA.pixels());
            assert!(!field.unchanged.contains(&true));
        });
    }

    #[test]
    fn what_the_static_model_explains_is_not_blamed_on_what_is_before_it() {
        let mut field = Field::default();
        field.clear(1);
        let mut blamed = |explained: f32, behind: bool| {
            field.explained[0] = explained;
            field.cues[0][Cue::OwnMotion as usize] = 0.0;
            field.blame(0, 0.3, behind);
            field.cues[0][Cue::OwnMotion as usize]
        };
        assert_eq!([blamed(0.0, true), blamed(1.0, true), blamed(1.0, false)], [0.3, 0.0, 0.3]);
    }

    #[test]
    fn gradient_of_a_ramp() {
        let camera = Pinhole { width: 5, height: 3, fx: 5.0, fy: 5.0, cx: 2.0, cy: 1.0 };
        let gray: Vec<u8> = (0..15).map(|i| (i % 5) * 10).collect();
        let mut out = Vec::new();
        steepest_gradient(&camera, &gray, &mut Vec::new(), &mut out);
        assert_eq!(out[7], 10.0);
    }
}
