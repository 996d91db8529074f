//! Where the camera is in a known map: association and pose optimisation together.

use nalgebra::Matrix6;
use pfd_geometry::{Camera, Pose};
use rand_pcg::Pcg32;

use crate::config::TrackingConfig;
use crate::image_features::ImageFeatures;
use crate::map::{KeyframeId, Map, MapPointId};
use crate::matching::{Match, match_by_projection, match_descriptors, predict};
use crate::pose_optimization::{PoseObservation, PosePrior, optimize_pose};

/// A pose with the map points that support it.
#[derive(Clone, Debug)]
#[allow(non_snake_case)]
pub struct Localized {
    /// World to camera.
    pub T_camera_world: Pose,
    /// Inliers only.
    pub matches: Vec<Match>,
    /// Of a perturbation in the camera frame (tx ty tz rx ry rz).
    pub covariance: Matrix6<f64>,
    /// Share of the associations that agreed with the pose: after refinement, of those that agreed with the pose before it.
    pub consensus: f64,
    /// Points that were sought by projection, associated or not.
    pub sought: Vec<MapPointId>,
}

impl Localized {
    /// Whether most associations agree: a pose that follows from wrong ones gathers few others.
    fn is_clear(&self) -> bool {
        self.consensus >= MIN_CONSENSUS
    }

    /// Whether the agreeing ones are also most of what was sought: after a wrong prediction, points at one depth can agree on a pose
    /// that trades translation for rotation, while those nearer or farther are not found at all.
    fn is_complete(&self) -> bool {
        self.is_clear() && self.matches.len() as f64 >= MIN_FOUND * self.sought.len() as f64
    }

    /// Whether this attempt is better than an earlier one, which started from a likelier place.
    pub(crate) fn surpasses(&self, earlier: &Self) -> bool {
        match (self.is_clear(), earlier.is_clear()) {
            (true, true) => self.matches.len() as f64 > SURPASSING * earlier.matches.len() as f64,
            (false, false) => self.matches.len() > earlier.matches.len(),
            (clear, _) => clear,
        }
    }
}

/// What is known of the camera before a frame is seen; poses are world to camera.
#[derive(Clone, Copy, Debug)]
pub struct Expectation<'a> {
    /// By constant velocity.
    pub predicted: Pose,
    /// Of the last frame.
    pub last: Pose,
    /// Map points that the last frame showed.
    pub last_points: &'a [MapPointId],
    /// The keyframe that shares most points with the last frame.
    pub reference: KeyframeId,
}

/// Keyframes that make up the local map at most.
const LOCAL_KEYFRAMES: usize = 40;
/// Neighbours of each directly covisible keyframe that join the local map.
const NEIGHBOURS: usize = 5;
/// The search radius of the second, wider attempt, as a multiple of the first.
const WIDER: f64 = 2.5;
/// Share of agreeing associations that makes a pose clear. Where the search is in the right place two of three and more
/// agree; beside it, on repeated texture, a third still finds a pose to agree on.
const MIN_CONSENSUS: f64 = 0.65;
/// Share of the points of the last frame that should be in view and must be found, or other starts are tried as well. From one frame to
/// the next two thirds and more are found.
const MIN_FOUND: f64 = 0.5;

/// The first of several attempts, likeliest first, that is complete; if there is none, the best.
fn first_complete<const N: usize>(attempts: [&dyn Fn() -> Option<Localized>; N]) -> Option<Localized> {
    let mut best: Option<Localized> = None;
    for found in attempts.into_iter().filter_map(|attempt| attempt()) {
        if found.is_complete() {
            return Some(found);
        }
        if best.as_ref().is_none_or(|b| found.surpasses(b)) {
            best = Some(found);
        }
    }
    best
}

/// A clear pose gives way to another when that finds this many times its points: a few more say nothing.
const SURPASSING: f64 = 1.2;

/// A pose that the motion so far leads to needs this share of the points that support one to which it hardly does: nearly as many, as the
/// other was free to find the most.
const GUIDED: f64 = 0.8;

/// What localisation works with.
#[derive(Clone, Copy)]
pub struct Localizer<'a> {
    /// The camera model.
    pub camera: &'a Camera,
    /// Parameters.
    pub config: &'a TrackingConfig,
    /// The map.
    pub map: &'a Map,
    /// What is known of the pose beside what is seen.
    prior: Option<PosePrior>,
}

impl<'a> Localizer<'a> {
    /// One that goes by what is seen alone.
    pub fn new(camera: &'a Camera, config: &'a TrackingConfig, map: &'a Map) -> Self {
        Self { camera, config, map, prior: None }
    }

    /// Follows the camera from the last frame, or failing that from the reference keyframe, and refines in the local map.
    pub fn follow(&self, features: &ImageFeatures, known: &Expectation<'_>, rng: &mut Pcg32) -> Option<Localized> {
        let near = |pose| self.from_prediction(features, known.last_points, pose);
        let refine = |first: Localized| {
            self.in_local_map(features, &first, self.config.matching.local_map_radius).or(Some(first))
        };
        let expected = first_complete([&|| near(&known.predicted), &|| near(&known.last)]);
        if expected.as_ref().is_some_and(Localized::is_clear) {
            return expected.and_then(refine);
        }
        match (expected, self.from_keyframe(features, known.reference, &known.last, rng)) {
            (Some(expected), Some(anywhere)) if anywhere.matches.len() <= expected.matches.len() => refine(expected),
            (_, Some(anywhere)) => self.settle(features, &anywhere).or(Some(anywhere)),
            (expected, None) => expected.and_then(refine),
        }
    }

    /// The pose that was `found`, which the motion so far hardly leads to, or that from the reference keyframe, without regard to motion, if
    /// more of the map supports it: points of a far wall can agree on a pose that trades translation for rotation.
    pub fn reconsider(
        &self,
        features: &ImageFeatures,
        known: &Expectation<'_>,
        found: Localized,
        rng: &mut Pcg32,
    ) -> Localized {
        let anywhere = self.from_keyframe(features, known.reference, &known.last, rng);
        let other = anywhere.and_then(|anywhere| self.settle(features, &anywhere));
        other.filter(|other| other.matches.len() > found.matches.len()).unwrap_or(found)
    }

    /// The pose by what is seen and by the `prior`, instead of one that was `found`, to which the motion so far hardly leads: if that is not
    /// clear, and this explains nearly as much of what is seen.
    pub fn guided(
        &self,
        features: &ImageFeatures,
        known: &Expectation<'_>,
        prior: PosePrior,
        found: Localized,
    ) -> Localized {
        if found.is_clear() {
            return found;
        }
        let guided = Self { prior: Some(prior), ..*self };
        let first = guided.from_prediction(features, known.last_points, &prior.T_camera_world);
        let radius = self.config.matching.local_map_radius;
        let pose = first.and_then(|first| guided.in_local_map(features, &first, radius).or(Some(first)));
        pose.filter(|pose| pose.matches.len() as f64 >= GUIDED * found.matches.len() as f64).unwrap_or(found)
    }

    /// Tracks the points of the last frame from a predicted pose (Mur-Artal et al., T-RO 2015, section V-B).
    pub fn from_prediction(
        &self,
        features: &ImageFeatures,
        last_points: &[MapPointId],
        predicted: &Pose,
    ) -> Option<Localized> {
        let radius = self.config.matching.motion_radius;
        let shows = |id: &MapPointId| {
            self.map.point(*id).is_some_and(|p| predict(self.camera, predicted, p, self.config).is_some())
        };
        let in_view: Vec<_> = last_points.iter().copied().filter(shows).collect();
        let within = |radius: f64| {
            let matches = self.project(features, &in_view, predicted, radius);
            let found = self.solve(features, matches, predicted, self.config.pose.min_inliers)?;
            Some(Localized { sought: in_view.clone(), ..found })
        };
        first_complete([&|| within(radius), &|| within(WIDER * radius)])
    }

    /// Matches the descriptors of a keyframe, without regard to position (section V-D). The pose that most of them agree on is the
    /// start; `initial` where too few have depth to tell.
    pub fn from_keyframe(
        &self,
        features: &ImageFeatures,
        keyframe: KeyframeId,
        initial: &Pose,
        rng: &mut Pcg32,
    ) -> Option<Localized> {
        let matches = self.match_keyframe(features, keyframe);
        let start = self.sample_consensus(features, &matches, rng).unwrap_or(*initial);
        self.solve(features, matches, &start, self.config.pose.min_inliers)
    }

    /// Points of `keyframe` and the features with like descriptors.
    pub fn match_keyframe(&self, features: &ImageFeatures, keyframe: KeyframeId) -> Vec<Match> {
        let Some(keyframe) = self.map.keyframe(keyframe) else { return Vec::new() };
        let known: Vec<_> =
            keyframe.observed().map(|(index, _)| (index, keyframe.features.feature(index).descriptor)).collect();
        let seen: Vec<_> = features.descriptors().copied().enumerate().collect();
        match_descriptors(&known, &seen, self.config)
            .into_iter()
            .filter_map(|(index, feature)| Some(Match { point: keyframe.points()[index]?, feature, distance: 0 }))
            .collect()
    }

    /// Refines a pose with all points of the local map (section V-D).
    pub fn in_local_map(&self, features: &ImageFeatures, initial: &Localized, radius: f64) -> Option<Localized> {
        let points = self.local_points(initial.matches.iter().map(|m| m.point));
        let matches = self.project(features, &points, &initial.T_camera_world, radius);
        let found = self.solve(features, matches, &initial.T_camera_world, self.config.pose.min_inliers)?;
        Some(Localized { sought: points, ..found })
    }

    /// Refines a pose of which only a few points are sure: with a wide search first, so that near and far points join in.
    pub fn settle(&self, features: &ImageFeatures, first: &Localized) -> Option<Localized> {
        let wide = self.in_local_map(features, first, self.config.matching.motion_radius)?;
        self.in_local_map(features, &wide, self.config.matching.local_map_radius)
    }

    /// The points of all keyframes that see some of `seen`, and of those keyframes' neighbours.
    pub fn local_points(&self, seen: impl Iterator<Item = MapPointId>) -> Vec<MapPointId> {
        let mut keyframes: Vec<_> = self.map.observers(seen).into_iter().map(|(id, _)| id).collect();
        keyframes.truncate(LOCAL_KEYFRAMES);
        for index in 0..keyframes.len() {
            if keyframes.len() >= LOCAL_KEYFRAMES {
                break;
            }
            let neighbours = self.map.covisible(keyframes[index]).into_iter().take(NEIGHBOURS).map(|(id, _)| id);
            let new: Vec<_> = neighbours.filter(|id| !keyframes.contains(id)).collect();
            keyframes.extend(new);
        }
        let keyframes = keyframes.iter().filter_map(|id| self.map.keyframe(*id));
        let mut points: Vec<_> = keyframes.flat_map(|k| k.observed().map(|(_, point)| point)).collect();
        points.sort_unstable();
        points.dedup();
        points
    }

    fn project(&self, features: &ImageFeatures, points: &[MapPointId], pose: &Pose, radius: f64) -> Vec<Match> {
        let candidates = points.iter().filter_map(|&id| {
            let point = self.map.point(id)?;
            Some((id, point, predict(self.camera, pose, point, self.config)?))
        });
        match_by_projection(candidates, features, radius, self.config)
    }

    /// Optimises the pose over `matches`; `None` with fewer than `min_inliers`.
    pub fn solve(
        &self,
        features: &ImageFeatures,
        matches: Vec<Match>,
        initial: &Pose,
        min_inliers: usize,
    ) -> Option<Localized> {
        if matches.len() < min_inliers {
            return None;
        }
        let observe = |m: &Match| {
            let point = self.map.point(m.point)?;
            let measured = *features.measurement(m.feature);
            Some(PoseObservation { point: point.position, measured, weight: point.standing() })
        };
        let (matches, observations): (Vec<_>, Vec<_>) =
            matches.into_iter().filter_map(|m| Some((m, observe(&m)?))).unzip();
        let estimate = optimize_pose(self.camera, &observations, initial, self.prior.as_ref())?;
        let consensus = estimate.inlier_count() as f64 / matches.len().max(1) as f64;
        let agreed = matches.into_iter().zip(&estimate.inliers).filter_map(|(m, &inlier)| inlier.then_some(m));
        let matches: Vec<_> = agreed.collect();
        (matches.len() >= min_inliers).then_some(Localized {
            T_camera_world: estimate.T_camera_world,
            matches,
            covariance: estimate.covariance,
            consensus,
            sought: Vec::new(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point2, Point3, Vector6};
    use pfd_geometry::{Distortion, Stamp, pose};
    use pfd_vision::features::{Descriptor, Feature};
    use rand::{RngExt, SeedableRng};

    use crate::local_mapping::insert_keyframe;
    use crate::map::Keyframe;
    use crate::residual::Measurement;

    fn camera() -> Camera {
        Camera::new((640, 480), [520.0, 520.0, 320.0, 240.0], Distortion::default()).unwrap()
    }

    /// What a camera at `T_camera_world` sees of points, each with a descriptor of its own.
    #[allow(non_snake_case)]
    fn look(points: &[(Point3<f64>, Descriptor)], T_camera_world: &Pose) -> ImageFeatures {
        let seen = points.iter().filter_map(|(point, descriptor)| {
            let point = T_camera_world * point;
            let pixel = camera().project(&point).filter(|p| camera().contains(p, 1.0))?;
            let (u, v) = (pixel.x as f32, pixel.y as f32);
            let feature = Feature { u, v, angle: 0.0, level: 0, response: 1.0, descriptor: *descriptor };
            Some((feature, Measurement { pixel, sigma: 0.7, depth: Some((point.z, 0.05)) }))
        });
        let (features, measurements): (Vec<_>, Vec<_>) = seen.unzip();
        let colors = vec![[0; 3]; features.len()];
        ImageFeatures::from_parts((640, 480), features, measurements, colors)
    }

    /// A wall at 4 m with so many points, a desk at 1.5 m with so many, and the map of a camera at the origin that sees both.
    fn wall_and_desk(on_wall: usize, on_desk: usize) -> (Vec<(Point3<f64>, Descriptor)>, Map) {
        let mut rng = Pcg32::seed_from_u64(1);
        let mut point = |i: usize| {
            let z = if i < on_wall { 4.0 } else { 1.5 };
            let pixel = Point2::new(rng.random_range(40.0..600.0), rng.random_range(40.0..440.0));
            (camera().unproject(&pixel, z), Descriptor(std::array::from_fn(|_| rng.random())))
        };
        let points: Vec<_> = (0..on_wall + on_desk).map(&mut point).collect();
        let features = look(&points, &Pose::identity());
        let keyframe = Keyframe::new(Stamp::default(), 0, Pose::identity(), features);
        let mut map = Map::default();
        insert_keyframe(&mut map, &camera(), &TrackingConfig::default(), keyframe, &[]);
        (points, map)
    }

    /// A camera that has moved before a wall and a desk.
    #[allow(non_snake_case)]
    struct Moved {
        camera: Camera,
        config: TrackingConfig,
        map: Map,
        T_camera_world: Pose,
        features: ImageFeatures,
        reference: KeyframeId,
        last_points: Vec<MapPointId>,
    }

    impl Moved {
        #[allow(non_snake_case)]
        fn new() -> Self {
            let (points, map) = wall_and_desk(60, 60);
            let T_camera_world = pose::exp(&Vector6::new(0.05, 0.0, 0.02, 0.0, 0.01, 0.0));
            let features = look(&points, &T_camera_world);
            let (reference, _) = map.keyframes().next().unwrap();
            let last_points = map.points().map(|(id, _)| id).collect();
            Self {
                camera: camera(),
                config: TrackingConfig::default(),
                map,
                T_camera_world,
                features,
                reference,
                last_points,
            }
        }

        /// With its last pose, which is the one predicted as well.
        fn known(&self, last: Pose) -> Expectation<'_> {
            Expectation { predicted: last, last, last_points: &self.last_points, reference: self.reference }
        }

        fn localizer(&self) -> Localizer<'_> {
            Localizer::new(&self.camera, &self.config, &self.map)
        }
    }

    #[test]
    fn a_doubtful_pose_gives_way_to_one_with_more_support_and_to_no_other() {
        let moved = Moved::new();
        let (localizer, known) = (moved.localizer(), moved.known(Pose::identity()));
        let (features, truth) = (&moved.features, moved.T_camera_world);
        let mut rng = Pcg32::seed_from_u64(2);
        let right = localizer.follow(features, &known, &mut rng).unwrap();
        assert!(pose::log(&(right.T_camera_world * truth.inverse())).norm() < 1e-3);
        // The points of the wall alone, by a translation with the opposite rotation.
        let traded = pose::exp(&Vector6::new(-0.12, 0.0, 0.0, 0.0, -0.03, 0.0)) * truth;
        let wrong = Localized { T_camera_world: traded, matches: right.matches[..60].to_vec(), ..right.clone() };
        let found = localizer.reconsider(features, &known, wrong, &mut rng);
        assert!(pose::log(&(found.T_camera_world * truth.inverse())).norm() < 1e-3);
        let jolted = localizer.reconsider(features, &known, right.clone(), &mut rng);
        assert_eq!(jolted.T_camera_world, right.T_camera_world, "nothing has more support");
    }

    #[test]
    #[allow(non_snake_case)]
    fn an_unlikely_pose_gives_way_to_one_that_the_motion_leads_to_unless_much_less_is_seen_from_there() {
        let moved = Moved::new();
        let (localizer, known) = (moved.localizer(), moved.known(moved.T_camera_world));
        let (features, truth) = (&moved.features, moved.T_camera_world);
        let right = localizer.follow(features, &known, &mut Pcg32::seed_from_u64(2)).unwrap();
        let leap = pose::exp(&Vector6::new(-0.23, 0.0, 0.0, 0.0, -0.05, 0.0)) * truth;
        let supported_by = |count: usize| {
            let matches = right.matches[..count].to_vec();
            Localized { T_camera_world: leap, matches, consensus: 0.4, ..right.clone() }
        };
        let prior = |T_camera_world| PosePrior { T_camera_world, information: Matrix6::identity() * 1e5 };
        let choice = |prior, found| localizer.guided(features, &known, prior, found).T_camera_world;
        let near_truth = pose::exp(&Vector6::new(0.004, 0.0, 0.0, 0.0, 0.002, 0.0)) * truth;
        for count in [60, 120] {
            let chosen = choice(prior(near_truth), supported_by(count));
            assert!(pose::log(&(chosen * truth.inverse())).norm() < 2e-3, "{count} points support the leap");
        }
        let beside = pose::exp(&Vector6::new(0.1, 0.1, 0.0, 0.0, 0.0, 0.0)) * truth;
        assert_eq!(choice(prior(beside), supported_by(120)), leap, "the camera was jolted");
        let clear = Localized { consensus: 0.9, ..supported_by(60) };
        assert_eq!(choice(prior(near_truth), clear), leap, "what most associations agree on is believed");
    }
}
