//! Camera motion between two frames from tracked corners with depth, robust against movers.
//!
//! Hypotheses from small samples compete by how much of the (evenly sampled) image they explain; the winner is refined with a
//! redescending loss (Geman-McClure). Errors are pixels of reprojection, and the depth difference in units of sensor noise.

use nalgebra::{Matrix6, Vector6};
use pfd_geometry::{DepthNoise, Pose, pose};
use rand::seq::index::sample;
use rand_pcg::Pcg64Mcg;

use super::view::{Motion, Pinhole};

/// A corner of the previous frame with its depth, found again in the current one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Track {
    /// Point in the previous camera frame, metres.
    pub(crate) point: [f32; 3],
    /// Pixel in the current working view.
    pub(crate) pixel: [f32; 2],
    /// Depth measured there, metres; 0 = none.
    pub(crate) depth: f32,
    /// How much the point counts: points long known to be static count more.
    pub(crate) weight: f32,
}

/// The estimate.
#[derive(Clone, Debug)]
#[allow(non_snake_case)]
pub(crate) struct EgoMotion {
    /// Previous camera coordinates to current ones.
    pub(crate) T_current_previous: Pose,
    /// Tracks that agree.
    pub(crate) inliers: usize,
    /// Share of the image (cells of a 4×4 grid) that holds inliers.
    pub(crate) spread: f64,
}

/// Standard deviation of a tracked corner, working pixels: what Lucas-Kanade reaches between neighbouring frames, including
/// what rolling shutter and blur add.
const PIXEL_SIGMA: f32 = 0.35;
/// Squared normalised residual (3 degrees of freedom, 99 %) up to which a track agrees.
pub(crate) const INLIER_CHI2: f32 = 11.3;
/// Agreement within this share of it counts twice: corners of a camera at rest do not move at all, which few other motions explain.
const SHARP: f32 = 0.05;
/// Points in a sample: three fix a rigid motion, the fourth damps noise.
const SAMPLE: usize = 4;
/// Samples drawn; with 40 % inliers one in forty samples of four is clean.
const HYPOTHESES: usize = 60;
/// Gauss-Newton steps on a sample: motions between frames are small.
const SAMPLE_STEPS: usize = 3;
/// Scale of the loss where hypotheses compete: what few corners say counts as well. …
const BROAD: f32 = INLIER_CHI2 / 2.0;
/// … Of the one that is chosen most corners lie within half of [`PIXEL_SIGMA`]: a narrow loss keeps out slow movers and outlines.
const NARROW: f32 = INLIER_CHI2 / 8.0;
/// Scale at which the loss starts where the motion is not known (squared normalised residual).
const WIDE: f32 = 8.0 * INLIER_CHI2;
/// Reweighted steps of the final refinement.
const REFINE_STEPS: usize = 10;
/// Below this many tracks no motion is estimated.
const MIN_TRACKS: usize = 6;
/// Cells per side of the grid that measures spread.
const SPREAD_CELLS: usize = 4;

/// Estimates the motion; `guess` is the constant-velocity prediction.
pub(crate) fn estimate(
    camera: &Pinhole,
    noise: &DepthNoise,
    tracks: &[Track],
    guess: &Pose,
    rng: &mut Pcg64Mcg,
) -> Option<EgoMotion> {
    if tracks.len() < MIN_TRACKS {
        return None;
    }
    let problem = Problem { camera, noise, tracks };
    let mut best = (f32::NEG_INFINITY, Pose::identity());
    let everything: Vec<usize> = (0..tracks.len()).collect();
    // A wide loss slides from a camera at rest to a mixture of camera and movers, hence also the narrow one.
    let starts = [(*guess, WIDE), (Pose::identity(), WIDE), (Pose::identity(), INLIER_CHI2)]
        .map(|(start, scale)| problem.refine(start, &everything, (scale, BROAD)));
    let sampled = (0..HYPOTHESES).map(|_| {
        let subset = sample(rng, tracks.len(), SAMPLE).into_vec();
        problem.fit_sample(*guess, &subset)
    });
    for hypothesis in starts.into_iter().chain(sampled).flatten() {
        let score = problem.score(&hypothesis);
        if score > best.0 {
            best = (score, hypothesis);
        }
    }
    let refined = problem.refine(best.1, &everything, (INLIER_CHI2, NARROW))?;
    Some(problem.summarise(refined))
}

/// Squared normalised residual (column, row, depth) of one track under a motion.
pub(crate) fn squared_residual(camera: &Pinhole, noise: &DepthNoise, motion: &Motion, track: &Track) -> f32 {
    Problem { camera, noise, tracks: &[] }.squared(motion, track)
}

struct Problem<'a> {
    camera: &'a Pinhole,
    noise: &'a DepthNoise,
    tracks: &'a [Track],
}

/// Whitened residual (column, row, depth) of one track; the depth part is 0 where depth is unknown.
type Residual = [f32; 3];

impl Problem<'_> {
    fn residual(&self, track: &Track, moved: [f32; 3]) -> Residual {
        let p = self.camera.project(moved);
        let depth = if track.depth > 0.0 { (moved[2] - track.depth) / self.depth_sigma(moved[2]) } else { 0.0 };
        [(p[0] - track.pixel[0]) / PIXEL_SIGMA, (p[1] - track.pixel[1]) / PIXEL_SIGMA, depth]
    }

    /// Noise of the difference of two measurements, plus a pixel's worth of slope.
    fn depth_sigma(&self, z: f32) -> f32 {
        self.noise.difference_sigma(z) + 2.0 * z / self.camera.fx
    }

    fn squared(&self, motion: &Motion, track: &Track) -> f32 {
        let moved = motion.apply(track.point);
        if moved[2] <= 0.0 {
            return f32::INFINITY;
        }
        self.residual(track, moved).iter().map(|r| r * r).sum()
    }

    fn score(&self, hypothesis: &Pose) -> f32 {
        let motion = Motion::from(hypothesis);
        let share = |squared: f32, limit: f32| (1.0 - squared / limit).max(0.0);
        let fit = |squared| share(squared, INLIER_CHI2) + share(squared, SHARP * INLIER_CHI2);
        self.tracks.iter().map(|t| t.weight * fit(self.squared(&motion, t))).sum()
    }

    /// Unweighted Gauss-Newton on a minimal sample.
    fn fit_sample(&self, start: Pose, subset: &[usize]) -> Option<Pose> {
        let mut pose = start;
        for _ in 0..SAMPLE_STEPS {
            pose = self.step(&pose, subset, |_| 1.0)?;
        }
        Some(pose)
    }

    /// Iteratively reweighted Gauss-Newton with the Geman-McClure loss, whose scale is halved from step to step.
    fn refine(&self, start: Pose, subset: &[usize], (mut scale, last): (f32, f32)) -> Option<Pose> {
        let mut pose = start;
        for _ in 0..REFINE_STEPS {
            pose = self.step(&pose, subset, |squared| {
                let k = scale / (scale + squared);
                k * k
            })?;
            scale = (scale * 0.5).max(last);
        }
        Some(pose)
    }

    fn step(&self, pose: &Pose, subset: &[usize], weight: impl Fn(f32) -> f32) -> Option<Pose> {
        let motion = Motion::from(pose);
        let mut hessian = Matrix6::<f64>::identity() * DAMPING;
        let mut gradient = Vector6::<f64>::zeros();
        for &i in subset {
            let track = &self.tracks[i];
            let moved = motion.apply(track.point);
            if moved[2] <= MIN_Z {
                continue;
            }
            let residual = self.residual(track, moved);
            let squared: f32 = residual.iter().map(|r| r * r).sum();
            let w = f64::from(weight(squared) * track.weight);
            for (r, j) in residual.iter().zip(self.jacobian(track, moved)) {
                let j = Vector6::from(j.map(f64::from));
                hessian.ger(w, &j, &j, 1.0);
                gradient.axpy(w * f64::from(*r), &j, 1.0);
            }
        }
        let delta = hessian.cholesky()?.solve(&gradient);
        let next = pose::exp(&-delta) * pose;
        pose::is_finite(&next).then_some(next)
    }

    /// Derivative of the residual by a left perturbation (translation first) of the motion.
    fn jacobian(&self, track: &Track, p: [f32; 3]) -> [[f32; 6]; 3] {
        let [x, y, z] = p;
        let (a, b) = (self.camera.fx / z / PIXEL_SIGMA, self.camera.fy / z / PIXEL_SIGMA);
        let (sx, sy) = (x / z, y / z);
        let d = if track.depth > 0.0 { 1.0 / self.depth_sigma(z) } else { 0.0 };
        [
            [a, 0.0, -a * sx, -a * sx * y, a * (z + sx * x), -a * y],
            [0.0, b, -b * sy, -b * (z + sy * y), b * sy * x, b * x],
            [0.0, 0.0, d, d * y, -d * x, 0.0],
        ]
    }

    fn summarise(&self, pose: Pose) -> EgoMotion {
        let motion = Motion::from(&pose);
        let mut occupied = [false; SPREAD_CELLS * SPREAD_CELLS];
        let mut inliers = 0;
        for track in self.tracks.iter().filter(|t| self.squared(&motion, t) < INLIER_CHI2) {
            inliers += 1;
            let cell = |x: f32, size: usize| ((x / size as f32 * SPREAD_CELLS as f32) as usize).min(SPREAD_CELLS - 1);
            let [u, v] = track.pixel;
            occupied[cell(v, self.camera.height) * SPREAD_CELLS + cell(u, self.camera.width)] = true;
        }
        let spread = occupied.iter().filter(|&&o| o).count() as f64 / occupied.len() as f64;
        EgoMotion { T_current_previous: pose, inliers, spread }
    }
}

/// Keeps the normal equations solvable when a sample is degenerate; far below the information of one track.
const DAMPING: f64 = 1e-3;
/// Points closer than this (metres) carry no usable projection.
const MIN_Z: f32 = 0.05;

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;
    use rand::{RngExt, SeedableRng};

    const CAMERA: Pinhole = Pinhole { width: 320, height: 240, fx: 262.0, fy: 262.0, cx: 159.5, cy: 119.5 };

    /// Tracks of a static cloud under `truth`; of every ten the first `moving` belong to something that moves on its own.
    fn tracks(truth: &Pose, moving: usize, rng: &mut Pcg64Mcg) -> Vec<Track> {
        tracks_beside(&Vector6::new(0.06, 0.01, 0.02, 0.0, 0.01, 0.0), truth, moving, rng)
    }

    /// The same, with the twist of what moves.
    fn tracks_beside(own: &Vector6<f64>, truth: &Pose, moving: usize, rng: &mut Pcg64Mcg) -> Vec<Track> {
        let own = pose::exp(own) * truth;
        (0..300)
            .map(|i| {
                let (u, v) = (rng.random_range(5.0..315.0), rng.random_range(5.0..235.0));
                let point = CAMERA.unproject(u, v, rng.random_range(0.8..4.0));
                let motion = if i % 10 < moving { Motion::from(&own) } else { Motion::from(truth) };
                let moved = motion.apply(point);
                let p = CAMERA.project(moved);
                let jitter = |rng: &mut Pcg64Mcg| rng.random_range(-0.2..0.2);
                Track { point, pixel: [p[0] + jitter(rng), p[1] + jitter(rng)], depth: moved[2], weight: 1.0 }
            })
            .collect()
    }

    #[test]
    fn movers_do_not_bend_the_camera_motion() {
        let mut rng = Pcg64Mcg::seed_from_u64(7);
        let truth = pose::exp(&Vector6::new(0.01, -0.02, 0.03, 0.01, -0.02, 0.015));
        for moving in [0, 2, 4] {
            let tracks = tracks(&truth, moving, &mut rng);
            let found = estimate(&CAMERA, &DepthNoise::default(), &tracks, &Pose::identity(), &mut rng).unwrap();
            let error = pose::log(&(found.T_current_previous * truth.inverse()));
            assert!(error.norm() < 2e-3, "{moving} of 10 moving: {error}");
            let expected = 300 * (10 - moving) / 10;
            assert!(found.inliers.abs_diff(expected) < 15, "{} inliers of {expected}", found.inliers);
        }
    }

    #[test]
    fn nor_do_those_that_move_by_a_pixel() {
        let mut rng = Pcg64Mcg::seed_from_u64(11);
        let truth = pose::exp(&Vector6::new(0.01, -0.02, 0.03, 0.01, -0.02, 0.015));
        let slow = Vector6::new(0.01, 0.0, 0.0, 0.0, 0.0, 0.0);
        let tracks = tracks_beside(&slow, &truth, 4, &mut rng);
        let found = estimate(&CAMERA, &DepthNoise::default(), &tracks, &Pose::identity(), &mut rng).unwrap();
        let error = pose::log(&(found.T_current_previous * truth.inverse()));
        assert!(error.norm() < 5e-4, "{error}");
    }

    /// A person before a plain wall (person-standing of joint-vo-sf): most corners move, each part of the body on its own. Those of
    /// the room lie far away at one side, where a motion that carries the hips along hardly shows.
    #[test]
    fn a_camera_at_rest_is_recognised_behind_a_mover_with_most_corners() {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        let hips = Vector6::new(-0.049, -0.029, -0.034, -0.009, 0.007, -0.007);
        let mut tracks = Vec::new();
        let mut add = |count: usize, columns: [f32; 2], depths: [f32; 2], mean: Vector6<f64>, spread: f64| {
            for _ in 0..count {
                let (u, v) = (rng.random_range(columns[0]..columns[1]), rng.random_range(120.0..235.0));
                let point = CAMERA.unproject(u, v, rng.random_range(depths[0]..depths[1]));
                let twist = mean + Vector6::from_fn(|_, _| spread * rng.random_range(-1.0..1.0));
                let moved = Motion::from(&pose::exp(&twist)).apply(point);
                tracks.push(Track { point, pixel: CAMERA.project(moved), depth: moved[2], weight: 1.0 });
            }
        };
        add(22, [255.0, 315.0], [2.6, 3.6], Vector6::zeros(), 0.0);
        add(10, [160.0, 230.0], [1.1, 1.2], hips, 0.0);
        add(60, [90.0, 230.0], [1.1, 1.5], hips, 0.04);
        let found = estimate(&CAMERA, &DepthNoise::default(), &tracks, &Pose::identity(), &mut rng).unwrap();
        let error = pose::log(&found.T_current_previous);
        // A lone side of far corners leaves translation and rotation to stand for each other within a centimetre.
        assert!(error.norm() < 0.012, "{error}");
    }

    #[test]
    fn too_few_tracks_have_no_motion() {
        let mut rng = Pcg64Mcg::seed_from_u64(7);
        assert!(estimate(&CAMERA, &DepthNoise::default(), &[], &Pose::identity(), &mut rng).is_none());
    }
}
