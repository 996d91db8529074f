//! Bundle adjustment beside a general solver that knows nothing of its structure: L-BFGS (argmin) on the same cost, with differences for
//! a gradient.

// Tests fail by panicking, and so may their helpers.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, non_snake_case)]

use argmin::core::{CostFunction, Error, Executor, Gradient, State};
use argmin::solver::linesearch::MoreThuenteLineSearch;
use argmin::solver::quasinewton::LBFGS;
use nalgebra::{Point2, Point3, Vector3, Vector6};
use pfd_geometry::{Camera, Distortion, Pose, Stamp, pose};
use pfd_tracking::bundle_adjustment::BundleProblem;
use pfd_tracking::config::BundleAdjustmentConfig;
use pfd_tracking::image_features::ImageFeatures;
use pfd_tracking::map::{Keyframe, Map, Observation};
use pfd_tracking::residual::Measurement;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;

const VIEWS: usize = 4;
const POINTS: usize = 16;
/// Largest error of a measured position (pixels) and depth (metres): small enough that nothing is an outlier.
const PIXEL_NOISE: f64 = 0.8;
const DEPTH_NOISE: f64 = 0.02;

/// Error of a point behind the camera: a line search may try it, and must turn back.
const BEHIND_CAMERA: f64 = 1e9;
/// Unit of the general solver's unknowns (metres, radians): about the accuracy of the result, so that its first steps are of the right
/// size.
const UNIT: f64 = 1e-3;

fn camera() -> Camera {
    Camera::new((640, 480), [520.0, 520.0, 320.0, 240.0], Distortion::default()).unwrap()
}

/// Where views and points are taken to be, or are.
#[derive(Clone)]
struct Scene {
    /// World to camera.
    poses: Vec<Pose>,
    points: Vec<Point3<f64>>,
}

impl Scene {
    fn true_one(rng: &mut Pcg32) -> Self {
        let pose = |i: usize| pose::exp(&(Vector6::new(-0.1, 0.02, 0.03, 0.01, 0.04, -0.01) * i as f64));
        let mut draw = |low: f64, high: f64| rng.random_range(low..high);
        let mut point = || Point3::new(draw(-0.7, 0.9), draw(-0.6, 0.6), draw(1.5, 4.0));
        Self { poses: (0..VIEWS).map(pose).collect(), points: (0..POINTS).map(|_| point()).collect() }
    }

    /// The first view stays, all else moves by steps from a box of the given size (metres, radians).
    fn disturbed(&self, size: f64, rng: &mut Pcg32) -> Self {
        let steps: Vec<f64> = (0..Self::unknowns()).map(|_| rng.random_range(-size..size) / UNIT).collect();
        self.moved(&steps)
    }

    const fn unknowns() -> usize {
        6 * (VIEWS - 1) + 3 * POINTS
    }

    /// Steps in [`UNIT`]s: first those of all poses but the first, then those of the points.
    fn moved(&self, steps: &[f64]) -> Self {
        let (of_poses, of_points) = steps.split_at(6 * (VIEWS - 1));
        let in_units = |step: &[f64]| step.iter().map(|s| UNIT * s).collect::<Vec<_>>();
        let mut moved = self.clone();
        for (pose, step) in moved.poses.iter_mut().skip(1).zip(of_poses.chunks(6)) {
            *pose = pose::exp(&Vector6::from_vec(in_units(step))) * *pose;
        }
        for (point, step) in moved.points.iter_mut().zip(of_points.chunks(3)) {
            *point += Vector3::from_vec(in_units(step));
        }
        moved
    }

    /// Half the sum of squared errors in units of their standard deviations.
    fn cost(&self, measured: &[Vec<Measurement>]) -> f64 {
        let camera = camera();
        let error = |pose: &Pose, point: &Point3<f64>, m: &Measurement| {
            let seen = pose * point;
            let Some(pixel) = camera.project(&seen) else { return BEHIND_CAMERA };
            let (depth, sigma) = m.depth.unwrap();
            (pixel - m.pixel).norm_squared() / (m.sigma * m.sigma) + ((seen.z - depth) / sigma).powi(2)
        };
        let of_view = |(pose, view): (&Pose, &Vec<Measurement>)| -> f64 {
            self.points.iter().zip(view).map(|(point, m)| error(pose, point, m)).sum()
        };
        0.5 * self.poses.iter().zip(measured).map(of_view).sum::<f64>()
    }
}

/// What each view measures of each point.
fn measure(scene: &Scene, rng: &mut Pcg32) -> Vec<Vec<Measurement>> {
    let mut see = |pose: &Pose, point: &Point3<f64>| {
        let seen = pose * point;
        let mut noise = |size: f64| rng.random_range(-size..size);
        let pixel = camera().project(&seen).unwrap();
        let pixel = Point2::new(pixel.x + noise(PIXEL_NOISE), pixel.y + noise(PIXEL_NOISE));
        Measurement { pixel, sigma: 1.0, depth: Some((seen.z + noise(DEPTH_NOISE), DEPTH_NOISE)) }
    };
    scene.poses.iter().map(|pose| scene.points.iter().map(|point| see(pose, point)).collect()).collect()
}

fn map_of(scene: &Scene, measured: &[Vec<Measurement>]) -> Map {
    let mut map = Map::default();
    let views: Vec<_> = (0..VIEWS)
        .map(|i| {
            let seen = ImageFeatures::from_measurements((640, 480), measured[i].clone());
            map.add_keyframe(Keyframe::new(Stamp::from_nanos(i as i64), i, scene.poses[i], seen))
        })
        .collect();
    for (feature, point) in scene.points.iter().enumerate() {
        let id = map.add_point(*point, Observation { keyframe: views[0], feature }).unwrap();
        for &keyframe in &views[1..] {
            map.add_observation(id, Observation { keyframe, feature });
        }
    }
    map
}

/// The same problem for a solver of anything.
struct General<'a> {
    start: &'a Scene,
    measured: &'a [Vec<Measurement>],
}

impl CostFunction for General<'_> {
    type Param = Vec<f64>;
    type Output = f64;

    fn cost(&self, steps: &Vec<f64>) -> Result<f64, Error> {
        Ok(self.start.moved(steps).cost(self.measured))
    }
}

impl Gradient for General<'_> {
    type Param = Vec<f64>;
    type Gradient = Vec<f64>;

    fn gradient(&self, steps: &Vec<f64>) -> Result<Vec<f64>, Error> {
        const H: f64 = 1e-3;
        let at = |k: usize, h: f64| {
            let mut moved = steps.clone();
            moved[k] += h;
            self.cost(&moved)
        };
        (0..steps.len()).map(|k| Ok((at(k, H)? - at(k, -H)?) / (2.0 * H))).collect()
    }
}

#[test]
fn a_general_solver_finds_nothing_better() {
    let mut rng = Pcg32::seed_from_u64(5);
    let truth = Scene::true_one(&mut rng);
    let measured = measure(&truth, &mut rng);
    let start = truth.disturbed(0.02, &mut rng);

    let config = BundleAdjustmentConfig { iterations: 30, ..BundleAdjustmentConfig::default() };
    let result = BundleProblem::global(&map_of(&start, &measured), &camera()).solve(&config);
    assert!(result.outliers.is_empty());
    let mut ours = start.clone();
    result.poses.iter().zip(&mut ours.poses[1..]).for_each(|((_, pose), to)| *to = *pose);
    result.points.iter().zip(&mut ours.points).for_each(|((_, position), to)| *to = *position);

    let problem = General { start: &start, measured: &measured };
    let solver = LBFGS::new(MoreThuenteLineSearch::new(), 20);
    let begin = vec![0.0; Scene::unknowns()];
    let found = Executor::new(problem, solver).configure(|s| s.param(begin).max_iters(2000)).run().unwrap();
    let theirs = start.moved(found.state().get_best_param().unwrap());

    let (cost, other, at_start) = (ours.cost(&measured), theirs.cost(&measured), start.cost(&measured));
    assert!(at_start > 100.0 * other, "the start is far from the optimum: {at_start}, {other}");
    assert!(cost < other * (1.0 + 1e-6), "{cost} beside {other}");
    for (i, (a, b)) in ours.poses.iter().zip(&theirs.poses).enumerate() {
        let difference = pose::log(&(a * b.inverse())).norm();
        assert!(difference < 1e-4, "view {i} differs by {difference}");
    }
}
