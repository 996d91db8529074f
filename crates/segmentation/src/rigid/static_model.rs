//! A model of the static scene, kept in the current camera's view.
//!
//! Each working pixel holds at most one surface point (its exact position, so that repeated warping does not blur it), its luma
//! and how often it was confirmed. What stands in front of the model has come in; what the model holds in front of the
//! measurement is gone.

use pfd_geometry::{DepthNoise, Image};

use super::view::{Motion, Pinhole, ViewFrame, along};

/// One surface point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct ModelPoint {
    /// Position in the camera frame, metres; z = 0 where the model is empty.
    pub(crate) position: [f32; 3],
    /// Luma, a running mean.
    pub(crate) gray: f32,
    /// Times confirmed, at most [`MAX_HITS`].
    pub(crate) hits: f32,
}

impl ModelPoint {
    /// Whether this point rather than `other` is what a pixel shows onto which both fall: the nearer one, or, of two of the same
    /// surface, that which was confirmed more often.
    fn replaces(&self, other: &Self) -> bool {
        let (z, occupied) = (self.position[2], other.position[2]);
        if occupied > 0.0 && (z - occupied).abs() < MAX_GAP_STEP * z.min(occupied) {
            return self.hits > other.hits;
        }
        occupied == 0.0 || z < occupied
    }

    /// Whether it was confirmed often enough to say anything of what is seen.
    pub(crate) fn is_believed(&self) -> bool {
        self.hits >= MIN_HITS
    }

    /// How surely it is there, 0 to 1.
    pub(crate) fn certainty(&self) -> f32 {
        (self.hits / SURE_HITS).min(1.0)
    }

    /// Whether it is what a pixel shows where `z` metres are measured. Depths differ from `significance` standard deviations on.
    pub(crate) fn agrees_with(&self, z: f32, noise: &DepthNoise, significance: f32) -> bool {
        self.is_known() && (z - self.position[2]).abs() <= significance * noise.difference_sigma(z) + EDGE_SLACK * z
    }

    /// Takes in a luma value by a share of `rate`.
    fn update_gray(&mut self, gray: f32, rate: f32) {
        self.gray += (gray - self.gray) * rate;
    }

    /// A point that was seen once, at `position`.
    pub(crate) fn new(position: [f32; 3], gray: f32) -> Self {
        Self { position, gray, hits: 1.0 }
    }

    /// It was seen again, at `position`.
    pub(crate) fn confirm(&mut self, position: [f32; 3], gray: f32) {
        let share = 1.0 / (self.hits + 1.0);
        for (p, q) in self.position.iter_mut().zip(position) {
            *p += (q - *p) * share;
        }
        self.update_gray(gray, GRAY_RATE.max(share));
        self.hits = (self.hits + 1.0).min(MAX_HITS);
    }

    /// Another surface was seen instead, at `position`: what was confirmed often needs several such measurements to be replaced.
    pub(crate) fn contradict(&mut self, position: [f32; 3], gray: f32) {
        self.hits *= KEPT_CONTRADICTED;
        if self.hits < 1.0 {
            *self = Self::new(position, gray);
        }
    }

    /// Whether a surface is known here.
    pub(crate) fn is_known(&self) -> bool {
        self.position[2] > 0.0
    }
}

/// Confirmations from which a point is believed.
const MIN_HITS: f32 = 3.0;
/// Confirmations from which a point is certain.
const SURE_HITS: f32 = 10.0;
/// Confirmations counted at most: about a second, after which a new measurement weighs a thirtieth of the old ones.
pub(crate) const MAX_HITS: f32 = 30.0;
/// Weight of a new luma value: follows exposure drift within a few frames.
const GRAY_RATE: f32 = 0.3;
/// The same where nothing is measured: a screen, say, is seen in front of what the model holds there, and would look other for ever. A
/// mover that has not been found yet must not become what is expected before it is.
const UNMEASURED_GRAY_RATE: f32 = 0.1;
/// Points that come closer than this (metres) leave the model.
const MIN_Z: f32 = 0.1;

/// Points are kept up to this share of the image beside it, …
const MARGIN: f32 = 0.5;
/// … and keep this share of their confirmations per frame there: the estimate of the camera motion drifts, so that after some
/// three seconds they would no longer lie where they were.
const KEPT_OUTSIDE: f32 = 0.975;
/// Depth difference per metre that a pixel's offset makes on slanted surfaces.
const EDGE_SLACK: f32 = 0.01;
/// A measurement that contradicts a point leaves this share of its confirmations.
const KEPT_CONTRADICTED: f32 = 0.8;
/// The same where the model has what was found to be a mover: it was taken for a part of the room before it was found, and would be
/// explained by where it has been. What is masked wrongly for ten frames keeps a third.
const KEPT_ON_MOVER: f32 = 0.9;
/// Depth step per metre of depth across a gap of one pixel up to which its sides are one surface, and so are two points on one pixel.
const MAX_GAP_STEP: f32 = 0.04;

/// The model and its spare buffer.
#[derive(Debug, Default)]
pub(crate) struct StaticModel {
    points: Image<ModelPoint>,
    spare: Image<ModelPoint>,
    /// Points that lie beside the view: the camera may turn back.
    outside: Vec<ModelPoint>,
}

impl StaticModel {
    /// An empty model for a view.
    pub(crate) fn new(camera: &Pinhole) -> Self {
        let empty = Image::filled(camera.width, camera.height, ModelPoint::default());
        Self { points: empty.clone(), spare: empty, outside: Vec::new() }
    }

    /// Forgets everything.
    pub(crate) fn clear(&mut self) {
        self.points.pixels_mut().fill(ModelPoint::default());
        self.outside.clear();
    }

    /// The points, one per working pixel.
    pub(crate) fn points(&self) -> &[ModelPoint] {
        self.points.pixels()
    }

    /// The same to change.
    pub(crate) fn points_mut(&mut self) -> &mut [ModelPoint] {
        self.points.pixels_mut()
    }

    /// Carries the model into the next camera frame; of two points on one pixel the nearer survives. Pixels that get none are
    /// filled between neighbours on one surface: without that the model would thin out by each warp.
    pub(crate) fn advance(&mut self, camera: &Pinhole, motion: &Motion) {
        let target = self.spare.pixels_mut();
        target.fill(ModelPoint::default());
        self.outside.retain_mut(|point| {
            point.position = motion.apply(point.position);
            point.hits *= KEPT_OUTSIDE;
            point.is_believed() && splat(camera, point, target) == Place::Beside
        });
        for point in self.points.pixels().iter().filter(|p| p.is_known()) {
            let moved = ModelPoint { position: motion.apply(point.position), ..*point };
            let is_beside = splat(camera, &moved, target) == Place::Beside;
            if is_beside && moved.is_believed() && self.outside.len() < camera.pixels() {
                self.outside.push(moved);
            }
        }
        fill_gaps(camera, target);
        std::mem::swap(&mut self.points, &mut self.spare);
    }

    /// Takes in a frame. Pixels outside the `dynamic` mask (0 there) confirm the model or contradict it, by luma alone where depth is
    /// missing; those inside only clear what they see through, and make it doubtful where its depth is that of one of the `movers`, of which
    /// `dynamic` is a wider mask. Depths differ from `significance` standard deviations on.
    pub(crate) fn observe(
        &mut self,
        rays: &[[f32; 2]],
        (noise, significance): (&DepthNoise, f32),
        frame: &ViewFrame,
        (movers, dynamic): (&[u8], &[u8]),
    ) {
        let pixels = frame.depth.pixels().iter().zip(frame.gray.pixels()).zip(rays);
        let masks = movers.iter().zip(dynamic);
        for ((point, ((&z, &gray), ray)), (&mover, &dynamic)) in
            self.points.pixels_mut().iter_mut().zip(pixels).zip(masks)
        {
            let gray = f32::from(gray);
            if !noise.is_usable(f64::from(z)) {
                if dynamic == 0 {
                    point.update_gray(gray, UNMEASURED_GRAY_RATE);
                }
                continue;
            }
            let differs = point.is_known() && !point.agrees_with(z, noise, significance);
            if dynamic != 0 {
                if differs && z > point.position[2] {
                    *point = ModelPoint::default();
                } else if !differs && mover != 0 {
                    point.hits *= KEPT_ON_MOVER;
                }
                continue;
            }
            let position = along(*ray, z);
            if !point.is_known() {
                *point = ModelPoint::new(position, gray);
            } else if differs {
                point.contradict(position, gray);
            } else {
                point.confirm(position, gray);
            }
        }
    }
}

/// Where a point lies after a camera motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    Inside,
    /// Outside of the view, near enough to come back.
    Beside,
    Gone,
}

/// Puts a point onto its pixel, unless what is there stays, and says where it lies.
#[inline]
fn splat(camera: &Pinhole, point: &ModelPoint, target: &mut [ModelPoint]) -> Place {
    if point.position[2] < MIN_Z {
        return Place::Gone;
    }
    let pixel = camera.project(point.position);
    let Some(index) = camera.nearest(pixel) else { return place_outside(camera, pixel) };
    if point.replaces(&target[index]) {
        target[index] = *point;
    }
    Place::Inside
}

fn place_outside(camera: &Pinhole, [x, y]: [f32; 2]) -> Place {
    let near = |p: f32, size: usize| {
        let (size, margin) = (size as f32, MARGIN * size as f32);
        p > -margin && p < size + margin
    };
    if near(x, camera.width) && near(y, camera.height) { Place::Beside } else { Place::Gone }
}

/// Fills each empty pixel between two neighbours of the same surface (left and right, or above and below) by their mean.
fn fill_gaps(camera: &Pinhole, points: &mut [ModelPoint]) {
    let width = camera.width;
    for v in 1..camera.height.saturating_sub(1) {
        for u in 1..width.saturating_sub(1) {
            let i = v * width + u;
            if points[i].is_known() {
                continue;
            }
            let across = between(&points[i - 1], &points[i + 1]);
            if let Some((depth, gray, hits)) = across.or_else(|| between(&points[i - width], &points[i + width])) {
                let position = camera.unproject(u as f32, v as f32, depth);
                points[i] = ModelPoint { position, gray, hits };
            }
        }
    }
}

/// Depth, luma and confirmations between two points, if they are known and lie on one surface.
fn between(a: &ModelPoint, b: &ModelPoint) -> Option<(f32, f32, f32)> {
    let (za, zb) = (a.position[2], b.position[2]);
    let connected = a.is_known() && b.is_known() && (za - zb).abs() < MAX_GAP_STEP * za.min(zb);
    connected.then(|| (0.5 * (za + zb), 0.5 * (a.gray + b.gray), a.hits.max(b.hits)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;
    use pfd_geometry::pose;

    const CAMERA: Pinhole = Pinhole { width: 32, height: 24, fx: 26.0, fy: 26.0, cx: 15.5, cy: 11.5 };

    fn rays() -> Vec<[f32; 2]> {
        (0..CAMERA.pixels()).map(|i| CAMERA.ray(i)).collect()
    }

    #[test]
    fn warping_there_and_back_changes_no_position() {
        let mut model = StaticModel::new(&CAMERA);
        let position = CAMERA.unproject(10.3, 8.4, 2.0);
        model.points_mut()[CAMERA.nearest([10.3, 8.4]).unwrap()] = ModelPoint::new(position, 90.0);
        let motion = pose::exp(&Vector6::new(0.1, 0.05, -0.1, 0.02, 0.01, 0.05));
        model.advance(&CAMERA, &Motion::from(&motion));
        model.advance(&CAMERA, &Motion::from(&motion.inverse()));
        let found = model.points()[CAMERA.nearest([10.3, 8.4]).unwrap()];
        assert!(found.position.iter().zip(position).all(|(a, b)| (a - b).abs() < 1e-5));
    }

    #[test]
    fn the_nearer_point_hides_the_farther() {
        let mut model = StaticModel::new(&CAMERA);
        model.points_mut()[0] = ModelPoint::new(CAMERA.unproject(12.0, 8.0, 3.0), 1.0);
        model.points_mut()[1] = ModelPoint::new(CAMERA.unproject(12.0, 8.0, 1.0), 2.0);
        model.advance(&CAMERA, &Motion::from(&pfd_geometry::Pose::identity()));
        assert_eq!(model.points()[CAMERA.nearest([12.0, 8.0]).unwrap()].gray, 2.0);
    }

    #[test]
    fn what_a_mover_hides_is_remembered_while_the_camera_moves() {
        let mut model = StaticModel::new(&CAMERA);
        for i in 0..CAMERA.pixels() {
            let position = CAMERA.unproject((i % CAMERA.width) as f32, (i / CAMERA.width) as f32, 2.0);
            // Here and there somebody stood before it.
            let times = if i % 16 == 3 { 2 } else { 20 };
            (0..times).for_each(|_| model.points_mut()[i].confirm(position, 70.0));
        }
        // To and fro by less than a pixel: two points of the wall fall on one pixel and none on another, each time elsewhere.
        for frame in 0..60 {
            let way = 0.011 * f64::from(frame).sin();
            model.advance(&CAMERA, &Motion::from(&pose::exp(&Vector6::new(way, 0.7 * way, way, 0.0, 0.0, 2.0 * way))));
        }
        let kept = model.points().iter().filter(|p| p.hits >= 10.0).count();
        assert!(kept as f32 > 0.9 * CAMERA.pixels() as f32, "{kept} of {}", CAMERA.pixels());
    }

    #[test]
    fn of_two_points_of_a_surface_the_more_often_confirmed_one_stays() {
        let still = Motion::from(&pfd_geometry::Pose::identity());
        for (near_hits, far_hits, expected) in [(2, 9, 9.0), (9, 2, 9.0)] {
            let mut model = StaticModel::new(&CAMERA);
            let (near, far) = (CAMERA.unproject(12.1, 8.0, 1.99), CAMERA.unproject(11.9, 8.0, 2.0));
            (0..near_hits).for_each(|_| model.points_mut()[0].confirm(near, 1.0));
            (0..far_hits).for_each(|_| model.points_mut()[1].confirm(far, 2.0));
            model.advance(&CAMERA, &still);
            assert_eq!(model.points()[CAMERA.nearest([12.0, 8.0]).unwrap()].hits, expected);
        }
    }

    #[test]
    fn a_gap_of_one_pixel_is_filled_on_a_surface_and_not_across_an_edge() {
        let fill = |left: f32, right: f32| {
            let mut model = StaticModel::new(&CAMERA);
            let row = 5 * CAMERA.width;
            for (u, z) in [(9, left), (11, right)] {
                model.points_mut()[row + u] = ModelPoint::new(CAMERA.unproject(u as f32, 5.0, z), 50.0);
            }
            model.advance(&CAMERA, &Motion::from(&pfd_geometry::Pose::identity()));
            model.points()[row + 10].position[2]
        };
        assert!((fill(2.0, 2.02) - 2.01).abs() < 1e-5);
        assert_eq!(fill(1.0, 2.0), 0.0);
    }

    #[test]
    fn what_leaves_the_view_comes_back_unless_it_stays_away_for_long() {
        let turn = Motion::from(&pose::exp(&Vector6::new(0.0, 0.0, 0.0, 0.0, 0.2, 0.0)));
        let back = Motion::from(&pose::exp(&Vector6::new(0.0, 0.0, 0.0, 0.0, -0.2, 0.0)));
        let still = Motion::from(&pfd_geometry::Pose::identity());
        for (frames, expected) in [(5, true), (400, false)] {
            let mut model = StaticModel::new(&CAMERA);
            let (index, position) = (12 * CAMERA.width + 30, CAMERA.unproject(30.0, 12.0, 2.0));
            (0..20).for_each(|_| model.points_mut()[index].confirm(position, 70.0));
            model.advance(&CAMERA, &turn);
            assert!(model.points().iter().all(|p| !p.is_known()), "out of view");
            (0..frames).for_each(|_| model.advance(&CAMERA, &still));
            model.advance(&CAMERA, &back);
            assert_eq!(model.points()[index].is_known(), expected, "after {frames} frames");
        }
    }

    #[test]
    fn a_single_contradiction_does_not_replace_what_was_confirmed() {
        let mut model = StaticModel::new(&CAMERA);
        (0..10).for_each(|_| model.points_mut()[5].confirm([0.0, 0.0, 1.0], 100.0));
        model.points_mut()[5].contradict([0.0, 0.0, 2.0], 100.0);
        assert_eq!(model.points()[5].position[2], 1.0);
        (0..20).for_each(|_| model.points_mut()[5].contradict([0.0, 0.0, 2.0], 100.0));
        assert_eq!(model.points()[5].position[2], 2.0);
    }

    #[test]
    fn luma_is_seen_where_nothing_is_measured_but_not_that_of_a_mover() {
        let seen = |dynamic: u8, z: f32, frames: usize| {
            let mut model = StaticModel::new(&CAMERA);
            let frame = ViewFrame {
                gray: Image::filled(CAMERA.width, CAMERA.height, 20),
                depth: Image::filled(CAMERA.width, CAMERA.height, z),
            };
            (0..10).for_each(|_| model.points_mut()[5].confirm(CAMERA.unproject(5.0, 0.0, 2.0), 100.0));
            let dynamic = vec![dynamic; CAMERA.pixels()];
            (0..frames)
                .for_each(|_| model.observe(&rays(), (&DepthNoise::default(), 3.0), &frame, (&dynamic, &dynamic)));
            model.points()[5].gray
        };
        assert!((90.0..95.0).contains(&seen(0, 0.0, 1)), "a mover that has not been found yet is not learned at once");
        assert!(seen(0, 0.0, 60) < 21.0);
        assert_eq!(seen(255, 0.0, 60), 100.0);
        assert!(seen(0, 2.0, 1) < 80.0, "where depth agrees it is followed fast");
    }

    #[test]
    fn what_looks_like_a_mover_becomes_doubtful_and_what_lies_beside_it_does_not() {
        let hits = |mover: u8, z: f32| {
            let mut model = StaticModel::new(&CAMERA);
            let frame = ViewFrame {
                gray: Image::filled(CAMERA.width, CAMERA.height, 100),
                depth: Image::filled(CAMERA.width, CAMERA.height, z),
            };
            (0..10).for_each(|_| model.points_mut()[5].confirm(CAMERA.unproject(5.0, 0.0, 2.0), 100.0));
            let masks = (vec![mover; CAMERA.pixels()], vec![255; CAMERA.pixels()]);
            (0..12).for_each(|_| model.observe(&rays(), (&DepthNoise::default(), 3.0), &frame, (&masks.0, &masks.1)));
            model.points()[5].hits
        };
        assert!(hits(255, 2.0) < MIN_HITS);
        assert_eq!(hits(0, 2.0), 10.0, "beside it");
        assert_eq!(hits(255, 1.0), 10.0, "what it hides is remembered");
    }

    #[test]
    fn a_point_agrees_with_what_is_as_far_away_by_the_noise_of_the_sensor() {
        let point = ModelPoint { position: [0.0, 0.0, 2.0], gray: 0.0, hits: 5.0 };
        let agrees = |z: f32| point.agrees_with(z, &DepthNoise::default(), 3.5);
        assert_eq!([2.0, 2.07, 2.1, 1.93, 1.9, 0.0].map(agrees), [true, true, false, true, false, false]);
        assert!(!ModelPoint::default().agrees_with(0.0, &DepthNoise::default(), 3.5), "nothing is known");
    }

    #[test]
    fn confirming_averages() {
        let mut model = StaticModel::new(&CAMERA);
        model.points_mut()[5] = ModelPoint::new([0.0, 0.0, 1.0], 100.0);
        model.points_mut()[5].confirm([0.0, 0.0, 1.2], 100.0);
        assert!((model.points()[5].position[2] - 1.1).abs() < 1e-6);
    }
}
