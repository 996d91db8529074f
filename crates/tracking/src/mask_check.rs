//! Whether the map contradicts a mask: points of the static scene that are seen where the mask says that something moves.

use nalgebra::Point2;
use pfd_geometry::{Camera, DepthImage, Mask};

use crate::config::TrackingConfig;
use crate::image_features::ImageFeatures;
use crate::localization::Localized;
use crate::map::{Map, MapPointId};
use crate::matching::{Match, predict};

/// Points that must be seen behind the mask.
const MIN_SEEN: usize = 5;
/// Points behind the mask must be seen this often as compared with those beside it: in a static scene equally often, behind a mover hardly
/// ever.
const MIN_RATIO: f64 = 0.5;

/// Pixels by which two poses may displace a point and be the same.
const MAX_DISPLACEMENT: f64 = 3.0;

/// A surface shows a point that lies nearer or farther by no more than this, relative to depth, where a mover may have taken the pose along.
const SAME_SURFACE: f64 = 0.1;

/// How many points should be seen, and are.
#[derive(Clone, Copy, Debug, Default)]
struct Sight {
    expected: usize,
    seen: usize,
}

impl Sight {
    fn share(self) -> f64 {
        self.seen as f64 / self.expected.max(1) as f64
    }
}

/// Whether the pose that was found without a mask leaves most of what was found with it where it is. A mover that stands in the map draws
/// the pose along, and is then what is seen behind the mask.
pub(crate) fn agree(map: &Map, camera: &Camera, masked: &Localized, unmasked: &Localized) -> bool {
    let displacement = |m: &Match| {
        let position = map.point(m.point)?.position;
        let pixel = |found: &Localized| camera.project(&(found.T_camera_world * position));
        Some((pixel(masked)? - pixel(unmasked)?).norm())
    };
    let displacements: Vec<f64> = masked.matches.iter().filter_map(displacement).collect();
    let small = displacements.iter().filter(|d| **d < MAX_DISPLACEMENT).count();
    2 * small > displacements.len()
}

/// Share of the points in view that lie on what the mask covers.
pub(crate) fn covered_share(
    map: &Map,
    (camera, config): (&Camera, &TrackingConfig),
    mask: &Mask,
    depth: &DepthImage,
    found: &Localized,
) -> f64 {
    let is_covered = |id: &MapPointId| {
        let expected = predict(camera, &found.T_camera_world, map.point(*id)?, config)?;
        let (u, v) = (expected.pixel.x.max(0.0) as usize, expected.pixel.y.max(0.0) as usize);
        let shows_it = |z: f32| (f64::from(z) - expected.depth).abs() < SAME_SURFACE * expected.depth;
        Some(mask.is_dynamic(u, v) && depth.at(u, v).is_some_and(shows_it))
    };
    let covered: Vec<bool> = found.sought.iter().filter_map(is_covered).collect();
    covered.iter().filter(|covered| **covered).count() as f64 / covered.len().max(1) as f64
}

/// Whether a frame that was localised without its mask shows the static scene behind the mask.
pub(crate) fn is_contradicted(
    map: &Map,
    (camera, config): (&Camera, &TrackingConfig),
    mask: &Mask,
    features: &ImageFeatures,
    found: &Localized,
) -> bool {
    let is_masked = |p: &Point2<f64>| mask.is_dynamic(p.x.max(0.0) as usize, p.y.max(0.0) as usize);
    let (mut behind, mut beside) = (Sight::default(), Sight::default());
    for &id in &found.sought {
        let Some(point) = map.established(id) else { continue };
        let Some(expected) = predict(camera, &found.T_camera_world, point, config) else { continue };
        let sight = if is_masked(&expected.pixel) { &mut behind } else { &mut beside };
        sight.expected += 1;
    }
    for m in found.matches.iter().filter(|m| map.established(m.point).is_some()) {
        let sight = if is_masked(&features.measurement(m.feature).pixel) { &mut behind } else { &mut beside };
        sight.seen += 1;
    }
    behind.seen >= MIN_SEEN && behind.share() > MIN_RATIO * beside.share()
}
