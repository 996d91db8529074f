//! Objects of the working view as regions of the camera image, with the particles that gather on them.

use nalgebra::Vector2;
use pfd_geometry::Image;

use super::objects::Object;
use super::view::View;
use crate::particle_filter::{Particle, statistics};
use crate::result::{BoundingBox, DynamicRegion};

/// Share of depths cut off at either end of the interval: flying pixels at the edges.
const TRIM: f64 = 0.02;

/// The region of an object, given the particles that lie on it. Where there are none, the object's own pixels speak for it.
pub(crate) fn region(view: &View, depth: &Image<f32>, object: &Object, particles: &[Particle]) -> DynamicRegion {
    let scale = view.scale();
    let own = || object.pixels.iter().map(|&i| particle_at(view.to_camera(i as usize), object, scale));
    let (mean, covariance) =
        if particles.is_empty() { statistics(&own().collect::<Vec<_>>()) } else { statistics(particles) };
    let velocity = Vector2::new(object.velocity[0] * scale, object.velocity[1] * scale).map(f64::from);
    DynamicRegion {
        id: object.id,
        bounding_box: bounding_box(view, &object.pixels),
        depth_interval: depth_interval(depth, &object.pixels),
        pixel_count: (object.pixels.len() as f32 * scale * scale) as u32,
        particle_mean: mean,
        particle_covariance: covariance,
        image_velocity: velocity,
    }
}

fn particle_at([x, y]: [f32; 2], object: &Object, scale: f32) -> Particle {
    Particle { x, y, vx: object.velocity[0] * scale, vy: object.velocity[1] * scale }
}

fn bounding_box(view: &View, pixels: &[u32]) -> BoundingBox {
    let (width, height) = view.source_size();
    let half = view.scale() / 2.0;
    let (mut low, mut high) = ([f32::INFINITY; 2], [0.0_f32; 2]);
    for [x, y] in pixels.iter().map(|&i| view.to_camera(i as usize)) {
        low = [low[0].min(x - half), low[1].min(y - half)];
        high = [high[0].max(x + half), high[1].max(y + half)];
    }
    let clip = |value: f32, size: usize| (value.max(0.0).round() as u32).min(size as u32);
    let (x, y) = (clip(low[0], width), clip(low[1], height));
    let (right, bottom) = (clip(high[0], width), clip(high[1], height));
    BoundingBox { x, y, width: right.saturating_sub(x), height: bottom.saturating_sub(y) }
}

fn depth_interval(depth: &Image<f32>, pixels: &[u32]) -> [f32; 2] {
    let mut depths: Vec<f32> = pixels.iter().map(|&i| depth.pixels()[i as usize]).filter(|&z| z > 0.0).collect();
    if depths.is_empty() {
        return [0.0; 2];
    }
    let cut = (depths.len() as f64 * TRIM) as usize;
    let last = depths.len() - 1 - cut;
    let (_, &mut far, _) = depths.select_nth_unstable_by(last, f32::total_cmp);
    let (_, &mut near, _) = depths.select_nth_unstable_by(cut, f32::total_cmp);
    [near, far]
}
