//! Positions of corners to a fraction of a pixel, by the grey levels around them.
//!
//! A detector places a corner anew in every image, half a pixel off now and then. Aligned with the first keyframe that saw its map
//! point, it keeps its place (Forster et al., T-RO 2017, section V; Lindenberger et al., ICCV 2021, for what that is worth).

use nalgebra::{Matrix2, Point2, Vector2};
use pfd_geometry::Pose;

use crate::image_features::ImageFeatures;
use crate::localization::Localizer;
use crate::map::{Keyframe, MapPoint};
use crate::matching::Match;

/// Cosine of the largest angle between two views of a point whose surroundings are compared: 25 degrees.
const MIN_VIEWING_COSINE: f64 = 0.9;
/// Surroundings on levels further apart than this differ in resolution.
const MAX_LEVELS: u8 = 2;
/// Half the side of the square that is projected to find the deformation, pixels of the corner's level: that of the window.
const REACH: f64 = 4.0;

/// Corrects the positions of the features in `matches` that look like the first view of their map point.
#[allow(non_snake_case)]
pub(crate) fn align(localizer: &Localizer<'_>, T_camera_world: &Pose, matches: &[Match], features: &mut ImageFeatures) {
    let config = localizer.config;
    for m in matches {
        let Some(point) = localizer.map.point(m.point) else { continue };
        if let Some(pixel) = find(localizer, T_camera_world, features, m.feature, point) {
            let scale = config.features.options().level_scale(features.feature(m.feature).level);
            features.set_position(m.feature, pixel, config.alignment.sigma * scale);
        }
    }
}

/// Where `feature` shows what the first view of `point` shows, pixels of the full-size image.
#[allow(non_snake_case)]
fn find(
    localizer: &Localizer<'_>,
    T_camera_world: &Pose,
    features: &ImageFeatures,
    feature: usize,
    point: &MapPoint,
) -> Option<Point2<f64>> {
    let level = features.feature(feature).level;
    let (keyframe, reference) = first_view(localizer, T_camera_world, level, point)?;
    let options = localizer.config.features.options();
    let here = options.level_scale(level);
    let there = options.level_scale(keyframe.features.feature(reference).level);
    let warp = deformation(localizer, T_camera_world, keyframe, point, REACH * here)? * (here / there);
    let on_level = |p: &Point2<f64>, level: u8| p.coords.map(|c| options.to_level(c, level) as f32);
    let start = on_level(&features.raw(feature).pixel, level);
    let at = on_level(&keyframe.features.raw(reference).pixel, keyframe.features.feature(reference).level);
    let warp = warp.map(|x| x as f32);
    let found = features.patch(feature)?.align(start, keyframe.features.patch(reference)?, at, &warp)?;
    let similar = f64::from(found.correlation) >= localizer.config.alignment.min_correlation;
    similar.then(|| Point2::from(found.position.map(|c| options.from_level(c.into(), level))))
}

/// The oldest keyframe that saw the point from about this direction and distance, and its feature.
#[allow(non_snake_case)]
fn first_view<'a>(
    localizer: &Localizer<'a>,
    T_camera_world: &Pose,
    level: u8,
    point: &MapPoint,
) -> Option<(&'a Keyframe, usize)> {
    let direction = point.direction_from(T_camera_world);
    let mut views = point.observations().iter().filter_map(|o| Some((localizer.map.keyframe(o.keyframe)?, o.feature)));
    views.find(|(keyframe, feature)| {
        direction.dot(&point.direction_from(&keyframe.T_camera_world)) > MIN_VIEWING_COSINE
            && keyframe.features.feature(*feature).level.abs_diff(level) <= MAX_LEVELS
            && keyframe.features.patch(*feature).is_some()
    })
}

/// Pixels of the keyframe per pixel of this image around `point`, over `reach` pixels, for a surface parallel to the image.
#[allow(non_snake_case)]
fn deformation(
    localizer: &Localizer<'_>,
    T_camera_world: &Pose,
    keyframe: &Keyframe,
    point: &MapPoint,
    reach: f64,
) -> Option<Matrix2<f64>> {
    let camera = localizer.camera;
    let in_camera = T_camera_world * point.position;
    let pixel = camera.project(&in_camera)?;
    let T_keyframe_camera = keyframe.T_camera_world * T_camera_world.inverse();
    let seen = |offset| camera.project(&(T_keyframe_camera * camera.unproject(&(pixel + offset), in_camera.z)));
    let across = |offset: Vector2<f64>| Some(seen(offset)? - seen(-offset)?);
    let columns = [across(Vector2::new(reach, 0.0))?, across(Vector2::new(0.0, reach))?];
    Some(Matrix2::from_columns(&columns) / (2.0 * reach))
}
