//! A landmark.

use nalgebra::{Point3, Vector3};
use pfd_geometry::Pose;
use pfd_vision::features::Descriptor;
use slotmap::SlotMap;

use super::{Keyframe, KeyframeId, Observation};

/// How a map point fared since it was created: the memory that votes moved things out of the map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Frames that should have seen it.
    pub visible: u32,
    /// Frames that did, as an inlier.
    pub found: u32,
    /// Frames whose depth shows free space where it should be.
    pub contradicted: u32,
}

impl Counts {
    /// Of one frame that saw it.
    pub(crate) const FOUND: Self = Self { visible: 1, found: 1, contradicted: 0 };
    /// Of one frame that should have seen it.
    pub(crate) const MISSED: Self = Self { visible: 1, found: 0, contradicted: 0 };
    /// Of one frame that sees through its place.
    pub(crate) const CONTRADICTED: Self = Self { visible: 1, found: 0, contradicted: 1 };

    pub(crate) fn add(&mut self, other: Self) {
        self.visible = self.visible.saturating_add(other.visible);
        self.found = self.found.saturating_add(other.found);
        self.contradicted = self.contradicted.saturating_add(other.contradicted);
    }
}

/// A landmark: a point in the world with its appearance and everybody who saw it.
#[derive(Clone, Debug)]
pub struct MapPoint {
    /// Position in the world, metres.
    pub position: Point3<f64>,
    /// Colour where it was first seen.
    pub color: [u8; 3],
    /// What happened to it in the frames since.
    pub counts: Counts,
    observations: Vec<Observation>,
    descriptor: Descriptor,
    viewing_direction: Vector3<f64>,
    reference: Scale,
}

/// Distance at which a point was seen on a pyramid level.
#[derive(Clone, Copy, Debug, Default)]
struct Scale {
    distance: f64,
    level: u8,
}

/// Frames that must have found a point until it has full standing: two thirds of a second of a camera at 30 Hz, by which
/// somebody who walks is a step farther.
const FULL_STANDING_AFTER: u32 = 20;
/// Standing of a point that only the frame has found which made it. Where all are new, all count alike.
const NEWCOMER: f64 = 0.1;

impl MapPoint {
    pub(super) fn new(position: Point3<f64>, color: [u8; 3]) -> Self {
        Self {
            position,
            color,
            counts: Counts::FOUND,
            observations: Vec::new(),
            descriptor: Descriptor::default(),
            viewing_direction: Vector3::zeros(),
            reference: Scale::default(),
        }
    }

    /// Everybody who saw it, oldest first.
    pub fn observations(&self) -> &[Observation] {
        &self.observations
    }

    /// The feature of `keyframe` that shows it.
    pub fn observed_in(&self, keyframe: KeyframeId) -> Option<usize> {
        self.observations.iter().find(|seen| seen.keyframe == keyframe).map(|seen| seen.feature)
    }

    /// How far it is to be trusted beside other points, 0 to 1: the more, the more frames found it where it should be. What no mask shows
    /// yet that it moves enters the map like anything else; it must not outvote what has stood there all along.
    pub fn standing(&self) -> f64 {
        let again = self.counts.found.clamp(1, FULL_STANDING_AFTER) - 1;
        NEWCOMER + (1.0 - NEWCOMER) * f64::from(again) / f64::from(FULL_STANDING_AFTER - 1)
    }

    /// The descriptor that differs least from the others.
    pub fn descriptor(&self) -> &Descriptor {
        &self.descriptor
    }

    /// Mean direction from the cameras to the point, in the world, unit length.
    pub fn viewing_direction(&self) -> &Vector3<f64> {
        &self.viewing_direction
    }

    /// Direction from a camera to the point, in the world, unit length; zero in the camera itself.
    #[allow(non_snake_case)]
    pub fn direction_from(&self, T_camera_world: &Pose) -> Vector3<f64> {
        let centre = T_camera_world.inverse_transform_point(&Point3::origin());
        (self.position - centre).try_normalize(f64::EPSILON).unwrap_or_default()
    }

    /// The pyramid level on which it should appear at `distance` metres.
    pub fn predict_level(&self, distance: f64, scale: f64, levels: usize) -> u8 {
        let steps = (self.reference.distance / distance.max(f64::EPSILON)).ln() / scale.ln();
        (f64::from(self.reference.level) + steps).round().clamp(0.0, levels as f64 - 1.0) as u8
    }

    pub(super) fn add_observation(&mut self, seen: Observation) {
        self.observations.push(seen);
    }

    pub(super) fn remove_observation(&mut self, keyframe: KeyframeId) -> Option<usize> {
        let index = self.observations.iter().position(|seen| seen.keyframe == keyframe)?;
        Some(self.observations.remove(index).feature)
    }

    pub(super) fn update(&mut self, keyframes: &SlotMap<KeyframeId, Keyframe>) {
        let seen: Vec<_> =
            self.observations.iter().filter_map(|s| Some((keyframes.get(s.keyframe)?, s.feature))).collect();
        let Some(&(latest, feature)) = seen.last() else { return };
        let descriptors: Vec<_> = seen.iter().map(|(k, f)| k.features.feature(*f).descriptor).collect();
        self.descriptor = medoid(&descriptors);
        self.viewing_direction = seen
            .iter()
            .map(|(k, _)| self.direction_from(&k.T_camera_world))
            .sum::<Vector3<f64>>()
            .try_normalize(1e-9)
            .unwrap_or_default();
        self.reference = Scale {
            distance: (latest.T_camera_world * self.position).coords.norm(),
            level: latest.features.feature(feature).level,
        };
    }
}

/// The descriptor with the least median distance to the others.
fn medoid(descriptors: &[Descriptor]) -> Descriptor {
    // The newest observations say enough about the appearance, and the search is quadratic.
    const NEWEST: usize = 8;
    let recent = &descriptors[descriptors.len().saturating_sub(NEWEST)..];
    let spread = |candidate: &Descriptor| {
        let mut distances: Vec<_> = recent.iter().map(|d| candidate.distance(d)).collect();
        distances.sort_unstable();
        distances[distances.len() / 2]
    };
    recent.iter().min_by_key(|d| spread(d)).copied().unwrap_or_default()
}
