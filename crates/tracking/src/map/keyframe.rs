//! A frame that the map keeps.

use std::collections::BTreeMap;

use pfd_geometry::{Pose, Stamp, pose};

use super::{KeyframeId, MapPointId};
use crate::image_features::ImageFeatures;

/// A frame that the map keeps: its features, its pose, and which map points it sees.
#[derive(Clone, Debug)]
#[allow(non_snake_case)]
pub struct Keyframe {
    /// When it was taken.
    pub stamp: Stamp,
    /// Number of the frame since the start.
    pub frame_index: usize,
    /// World to camera.
    pub T_camera_world: Pose,
    /// What it shows.
    pub features: ImageFeatures,
    points: Vec<Option<MapPointId>>,
    /// How many map points each other keyframe shares with this one; at least one.
    covisible: BTreeMap<KeyframeId, usize>,
}

impl Keyframe {
    /// A keyframe that sees no map points yet.
    #[allow(non_snake_case)]
    pub fn new(stamp: Stamp, frame_index: usize, T_camera_world: Pose, features: ImageFeatures) -> Self {
        let points = vec![None; features.len()];
        let T_camera_world = pose::renormalized(T_camera_world);
        Self { stamp, frame_index, T_camera_world, features, points, covisible: BTreeMap::new() }
    }

    /// Changes the pose (world to camera).
    #[allow(non_snake_case)]
    pub fn move_to(&mut self, T_camera_world: &Pose) {
        self.T_camera_world = pose::renormalized(*T_camera_world);
    }

    /// The map point that each feature shows.
    pub fn points(&self) -> &[Option<MapPointId>] {
        &self.points
    }

    /// Features that show a map point.
    pub fn observed(&self) -> impl Iterator<Item = (usize, MapPointId)> + '_ {
        self.points.iter().enumerate().filter_map(|(feature, point)| Some((feature, (*point)?)))
    }

    /// How many map points each other keyframe shares with this one.
    pub(super) fn covisible(&self) -> &BTreeMap<KeyframeId, usize> {
        &self.covisible
    }

    /// One more point is shared with `other`.
    pub(super) fn share_point_with(&mut self, other: KeyframeId) {
        *self.covisible.entry(other).or_insert(0) += 1;
    }

    /// One point less is shared with `other`.
    pub(super) fn unshare_point_with(&mut self, other: KeyframeId) {
        if let Some(count) = self.covisible.get_mut(&other) {
            *count -= 1;
            if *count == 0 {
                self.covisible.remove(&other);
            }
        }
    }

    pub(super) fn set_point(&mut self, feature: usize, point: Option<MapPointId>) {
        if let Some(slot) = self.points.get_mut(feature) {
            *slot = point;
        }
    }
}
