//! Local bundle adjustment: keyframe poses and map points together (Mur-Artal and Tardós, T-RO 2017, section III-C), with the
//! depth of every observation as a third residual.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{Matrix3, Point3};
use pfd_geometry::{Camera, Pose, pose};
use pfd_optimization::{LeastSquares, NormalEquations, Options, RobustKernel, Step, Summary, minimize};

use crate::config::BundleAdjustmentConfig;
use crate::map::{KeyframeId, Map, MapPointId};
use crate::residual::{Measurement, linearize, residual};

/// Sizes of the parameter blocks: a pose and a point.
const POSE: usize = 6;
const POINT: usize = 3;

/// A pose in the problem.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum View {
    Free(usize),
    Fixed(usize),
}

/// A point seen in a view.
#[derive(Clone, Copy, Debug)]
struct Sighting {
    view: View,
    point: usize,
    measured: Measurement,
}

/// A part of the map, copied, so that it can be optimised while tracking goes on.
#[derive(Clone, Debug)]
pub struct BundleProblem {
    camera: Camera,
    keyframes: Arc<Vec<KeyframeId>>,
    fixed_keyframes: Arc<Vec<KeyframeId>>,
    point_ids: Arc<Vec<MapPointId>>,
    poses: Vec<Pose>,
    fixed: Arc<Vec<Pose>>,
    points: Vec<Point3<f64>>,
    sightings: Arc<Vec<Sighting>>,
}

/// What bundle adjustment found.
#[derive(Clone, Debug)]
pub struct BundleResult {
    /// New poses (world to camera).
    pub poses: Vec<(KeyframeId, Pose)>,
    /// New positions.
    pub points: Vec<(MapPointId, Point3<f64>)>,
    /// Observations that do not agree with the result.
    pub outliers: Vec<(MapPointId, KeyframeId)>,
    /// Of the last pass.
    pub summary: Summary,
}

impl BundleProblem {
    /// The local window around `center`: the keyframes that share most points with it are free, others that see the same
    /// points are fixed.
    pub fn local(map: &Map, camera: &Camera, center: KeyframeId, config: &BundleAdjustmentConfig) -> Self {
        let neighbours = map.covisible(center).into_iter().map(|(id, _)| id).take(config.window.saturating_sub(1));
        let mut free: Vec<_> = std::iter::once(center).chain(neighbours).collect();
        let seen = |id: &KeyframeId| map.keyframe(*id).into_iter().flat_map(|k| k.observed().map(|(_, p)| p));
        let mut points: Vec<_> = free.iter().flat_map(seen).collect();
        points.sort_unstable();
        points.dedup();
        let observers = map.observers(points.iter().copied());
        let mut fixed: Vec<_> = observers.iter().map(|(id, _)| *id).filter(|id| !free.contains(id)).collect();
        fixed.truncate(config.max_fixed);
        if fixed.is_empty() {
            fix_oldest(map, &mut free, &mut fixed);
        }
        Self::new(map, camera, free, fixed, &points)
    }

    /// The whole map; the oldest keyframe is fixed.
    pub fn global(map: &Map, camera: &Camera) -> Self {
        let mut free: Vec<_> = map.keyframes().map(|(id, _)| id).collect();
        let mut fixed = Vec::new();
        fix_oldest(map, &mut free, &mut fixed);
        let points: Vec<_> = map.points().map(|(id, _)| id).collect();
        Self::new(map, camera, free, fixed, &points)
    }

    fn new(
        map: &Map,
        camera: &Camera,
        free: Vec<KeyframeId>,
        fixed: Vec<KeyframeId>,
        candidates: &[MapPointId],
    ) -> Self {
        let free_views = free.iter().enumerate().map(|(i, id)| (*id, View::Free(i)));
        let fixed_views = fixed.iter().enumerate().map(|(i, id)| (*id, View::Fixed(i)));
        let views: BTreeMap<_, _> = free_views.chain(fixed_views).collect();
        let pose = |id: &KeyframeId| map.keyframe(*id).map(|k| k.T_camera_world).unwrap_or_default();
        let mut problem = Self {
            camera: *camera,
            poses: free.iter().map(pose).collect(),
            fixed: Arc::new(fixed.iter().map(pose).collect()),
            keyframes: Arc::new(free),
            fixed_keyframes: Arc::new(fixed),
            point_ids: Arc::default(),
            points: Vec::new(),
            sightings: Arc::default(),
        };
        problem.add_points(map, &views, candidates);
        problem
    }

    fn add_points(&mut self, map: &Map, views: &BTreeMap<KeyframeId, View>, candidates: &[MapPointId]) {
        let (mut ids, mut sightings) = (Vec::new(), Vec::new());
        for (&id, point) in candidates.iter().filter_map(|id| Some((id, map.point(*id)?))) {
            let index = self.points.len();
            let before = sightings.len();
            for seen in point.observations() {
                let (Some(view), Some(keyframe)) = (views.get(&seen.keyframe), map.keyframe(seen.keyframe)) else {
                    continue;
                };
                let measured = *keyframe.features.measurement(seen.feature);
                sightings.push(Sighting { view: *view, point: index, measured });
            }
            // One view without depth leaves the point free to slide along its ray.
            let alone = sightings.len() == before + 1 && sightings[before].measured.depth.is_none();
            if sightings.len() == before || alone {
                sightings.truncate(before);
                continue;
            }
            ids.push(id);
            self.points.push(point.position);
        }
        self.point_ids = Arc::new(ids);
        self.sightings = Arc::new(sightings);
    }

    /// Optimises, drops the outliers, and optimises again.
    pub fn solve(mut self, config: &BundleAdjustmentConfig) -> BundleResult {
        let options = Options { max_iterations: config.iterations, ..Options::default() };
        minimize(&mut self, &options);
        let (inliers, outliers): (Vec<Sighting>, Vec<Sighting>) = self.sightings.iter().partition(|s| self.agrees(s));
        let outliers = outliers.iter().map(|s| (self.point_ids[s.point], self.keyframe_of(s.view))).collect();
        self.sightings = Arc::new(inliers);
        self.drop_unseen_points();
        let summary = minimize(&mut self, &options);
        BundleResult {
            poses: self.keyframes.iter().copied().zip(self.poses).collect(),
            points: self.point_ids.iter().copied().zip(self.points).collect(),
            outliers,
            summary,
        }
    }

    /// Points that lost their observations would make the equations singular.
    fn drop_unseen_points(&mut self) {
        let mut support = vec![(0_usize, false); self.points.len()];
        for sighting in self.sightings.iter() {
            let (count, depth) = &mut support[sighting.point];
            *count += 1;
            *depth |= sighting.measured.depth.is_some();
        }
        let kept = |i: usize| support[i].0 > 1 || support[i].1;
        let mut renumbered = vec![None; self.points.len()];
        let order = (0..self.points.len()).filter(|&i| kept(i));
        order.enumerate().for_each(|(new, old)| renumbered[old] = Some(new));
        self.points = (0..self.points.len()).filter(|&i| kept(i)).map(|i| self.points[i]).collect();
        self.point_ids = Arc::new((0..support.len()).filter(|&i| kept(i)).map(|i| self.point_ids[i]).collect());
        let renumber = |s: &Sighting| Some(Sighting { point: renumbered[s.point]?, ..*s });
        self.sightings = Arc::new(self.sightings.iter().filter_map(renumber).collect());
    }

    fn keyframe_of(&self, view: View) -> KeyframeId {
        match view {
            View::Free(i) => self.keyframes[i],
            View::Fixed(i) => self.fixed_keyframes[i],
        }
    }

    fn pose_of(&self, view: View) -> &Pose {
        match view {
            View::Free(i) => &self.poses[i],
            View::Fixed(i) => &self.fixed[i],
        }
    }

    fn agrees(&self, sighting: &Sighting) -> bool {
        residual(&self.camera, self.pose_of(sighting.view), &self.points[sighting.point], &sighting.measured)
            .is_some_and(|r| r.norm_squared() <= sighting.measured.chi2_threshold())
    }
}

/// Moves the oldest keyframe from `free` to `fixed`: it holds the gauge.
fn fix_oldest(map: &Map, free: &mut Vec<KeyframeId>, fixed: &mut Vec<KeyframeId>) {
    let age = |id: &KeyframeId| map.keyframe(*id).map(|k| k.frame_index);
    if let Some(oldest) = free.iter().copied().min_by_key(age) {
        free.retain(|id| *id != oldest);
        fixed.push(oldest);
    }
}

/// Squared normalised residual charged for a point behind the camera, which has no projection: far beyond any threshold.
const BEHIND_CAMERA: f64 = 1e4;

impl LeastSquares<POSE, POINT> for BundleProblem {
    fn sizes(&self) -> (usize, usize) {
        (self.poses.len(), self.points.len())
    }

    fn linearize(&self, equations: &mut NormalEquations<POSE, POINT>) {
        for sighting in self.sightings.iter() {
            let pose = self.pose_of(sighting.view);
            let Some(linear) = linearize(&self.camera, pose, &self.points[sighting.point], &sighting.measured) else {
                continue;
            };
            let kernel = RobustKernel::Huber(sighting.measured.huber_width());
            let weight = kernel.weight(linear.residual.norm_squared());
            let by_pose = match sighting.view {
                View::Free(i) => Some((i, &linear.by_pose)),
                View::Fixed(_) => None,
            };
            let by_point: Option<(usize, &Matrix3<f64>)> = Some((sighting.point, &linear.by_point));
            equations.add(by_pose, by_point, &linear.residual, weight);
        }
    }

    fn cost(&self) -> f64 {
        let cost = |s: &Sighting| {
            let squared = residual(&self.camera, self.pose_of(s.view), &self.points[s.point], &s.measured)
                .map_or(BEHIND_CAMERA, |r| r.norm_squared());
            RobustKernel::Huber(s.measured.huber_width()).cost(squared)
        };
        self.sightings.iter().map(cost).sum()
    }

    fn apply(&mut self, step: &Step<POSE, POINT>) {
        for (pose, delta) in self.poses.iter_mut().zip(&step.a) {
            *pose = pose::exp(delta) * *pose;
        }
        for (point, delta) in self.points.iter_mut().zip(&step.b) {
            *point += delta;
        }
    }
}

/// Writes a result into the map. What was removed meanwhile is skipped.
pub fn apply(map: &mut Map, result: &BundleResult) {
    for (id, pose) in result.poses.iter().filter(|(_, pose)| pose::is_finite(pose)) {
        if let Some(keyframe) = map.keyframe_mut(*id) {
            keyframe.move_to(pose);
        }
    }
    for (id, position) in &result.points {
        if let Some(point) = map.point_mut(*id) {
            point.position = *position;
        }
    }
    for (point, keyframe) in &result.outliers {
        map.remove_observation(*point, *keyframe);
    }
    for (id, _) in &result.points {
        map.update_point(*id);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image_features::ImageFeatures;
    use crate::map::{Keyframe, Observation};
    use nalgebra::{Point2, Vector3, Vector6};
    use pfd_geometry::{Distortion, Stamp};
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg32;

    const VIEWS: usize = 5;
    const POINTS: usize = 80;

    fn camera() -> Camera {
        Camera::new((640, 480), [520.0, 520.0, 320.0, 240.0], Distortion::default()).unwrap()
    }

    /// World to camera of view `i`: a sideways motion with some rotation.
    fn true_pose(i: usize) -> Pose {
        let s = i as f64;
        pose::exp(&Vector6::new(-0.1 * s, 0.02 * s, 0.03 * s, 0.01 * s, 0.04 * s, -0.01 * s))
    }

    fn true_points() -> Vec<Point3<f64>> {
        let mut rng = Pcg32::seed_from_u64(11);
        let mut draw = |low: f64, high: f64| rng.random_range(low..high);
        (0..POINTS).map(|_| Point3::new(draw(-0.7, 0.9), draw(-0.6, 0.6), draw(1.5, 4.0))).collect()
    }

    fn keyframe(i: usize, pose: Pose, with_depth: bool) -> Keyframe {
        let see = |point: &Point3<f64>| {
            let in_camera = true_pose(i) * point;
            let pixel = camera().project(&in_camera).unwrap();
            let depth = with_depth.then_some((in_camera.z, 0.02));
            Measurement { pixel: Point2::new(pixel.x, pixel.y), sigma: 1.0, depth }
        };
        let measurements = true_points().iter().map(see).collect();
        let features = ImageFeatures::from_measurements((640, 480), measurements);
        Keyframe::new(Stamp::from_nanos(i as i64), i, pose, features)
    }

    /// A map whose poses (but the first) and points are off by a few centimetres and degrees.
    fn disturbed_map(with_depth: bool) -> (Map, Vec<KeyframeId>) {
        let mut rng = Pcg32::seed_from_u64(12);
        let mut noise = |scale: f64| Vector6::from_fn(|_, _| rng.random_range(-scale..scale));
        let mut map = Map::default();
        let views: Vec<_> = (0..VIEWS)
            .map(|i| {
                let off = if i == 0 { Vector6::zeros() } else { noise(0.03) };
                map.add_keyframe(keyframe(i, pose::exp(&off) * true_pose(i), with_depth))
            })
            .collect();
        for (feature, point) in true_points().into_iter().enumerate() {
            let shift = noise(0.05);
            let start = point + Vector3::new(shift[0], shift[1], shift[2]);
            let id = map.add_point(start, Observation { keyframe: views[0], feature }).unwrap();
            for &view in &views[1..] {
                map.add_observation(id, Observation { keyframe: view, feature });
            }
        }
        (map, views)
    }

    fn config() -> BundleAdjustmentConfig {
        BundleAdjustmentConfig { iterations: 20, ..BundleAdjustmentConfig::default() }
    }

    #[test]
    fn finds_the_known_optimum_and_leaves_the_gauge_alone() {
        let (mut map, views) = disturbed_map(true);
        let result = BundleProblem::local(&map, &camera(), views[VIEWS - 1], &config()).solve(&config());
        assert!(result.summary.final_cost < 1e-6, "{:?}", result.summary);
        apply(&mut map, &result);
        assert_eq!(map.check(), Ok(()));
        for (i, id) in views.iter().enumerate() {
            let error = map.keyframe(*id).unwrap().T_camera_world * true_pose(i).inverse();
            assert!(pose::log(&error).norm() < 1e-5, "view {i}");
        }
    }

    #[test]
    fn without_depth_the_shape_is_right_up_to_scale() {
        let (mut map, views) = disturbed_map(false);
        let result = BundleProblem::global(&map, &camera()).solve(&config());
        assert!(result.summary.final_cost < 1e-3, "{:?}", result.summary);
        apply(&mut map, &result);
        let centre = |id: KeyframeId| map.keyframe(id).unwrap().T_camera_world.inverse().translation.vector;
        let truth = |i: usize| true_pose(i).inverse().translation.vector;
        let scale = centre(views[4]).norm() / truth(4).norm();
        for (i, view) in views.iter().enumerate().skip(1) {
            assert!((centre(*view) - truth(i) * scale).norm() < 1e-3, "view {i}");
        }
    }

    #[test]
    fn a_wrong_observation_is_named_and_does_not_pull() {
        let (mut map, views) = disturbed_map(true);
        let mut wrong = keyframe(VIEWS, true_pose(VIEWS), true);
        let mut measurements: Vec<_> = (0..POINTS).map(|i| *wrong.features.measurement(i)).collect();
        measurements[7].pixel.x += 60.0;
        let features: Vec<_> = (0..POINTS).map(|i| *wrong.features.feature(i)).collect();
        wrong.features = ImageFeatures::from_parts((640, 480), features, measurements, vec![[0; 3]; POINTS]);
        let id = map.add_keyframe(wrong);
        let points: Vec<_> = map.keyframe(views[0]).unwrap().observed().collect();
        for (feature, point) in points {
            map.add_observation(point, Observation { keyframe: id, feature });
        }
        let moved = map.keyframe(views[0]).unwrap().points()[7].unwrap();
        let result = BundleProblem::local(&map, &camera(), id, &config()).solve(&config());
        assert_eq!(result.outliers, vec![(moved, id)]);
        assert!(result.summary.final_cost < 1e-6);
    }

    #[test]
    fn a_single_keyframe_has_nothing_to_adjust() {
        let mut map = Map::default();
        let only = map.add_keyframe(keyframe(0, Pose::identity(), true));
        let result = BundleProblem::local(&map, &camera(), only, &config()).solve(&config());
        assert!(result.poses.is_empty() && result.points.is_empty() && result.outliers.is_empty());
    }
}
