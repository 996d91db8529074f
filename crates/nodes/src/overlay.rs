//! What the segmentation saw, drawn on the image: mask, particles, rectangles.

use pfd_geometry::{Mask, RgbImage};
use pfd_segmentation::{BoundingBox, Segmentation};

/// Colour of masked pixels.
const MASK: [u8; 3] = [230, 40, 40];
/// Colour of particles.
const PARTICLE: [u8; 3] = [255, 220, 0];
/// Colour of rectangles.
const RECTANGLE: [u8; 3] = [40, 220, 60];

/// The image with everything drawn on it.
pub fn draw(image: &RgbImage, segmentation: &Segmentation) -> RgbImage {
    let mut out = image.clone();
    tint(&mut out, &segmentation.mask);
    for [x, y] in segmentation.particles.iter().flatten() {
        set(&mut out, x.round() as i64, y.round() as i64, PARTICLE);
    }
    segmentation.regions.iter().for_each(|region| rectangle(&mut out, region.bounding_box));
    out
}

/// Half the picture, half the colour.
fn tint(image: &mut RgbImage, mask: &Mask) {
    for (pixel, &masked) in image.pixels_mut().iter_mut().zip(mask.image().pixels()) {
        if masked != Mask::STATIC {
            pixel.iter_mut().zip(MASK).for_each(|(channel, tint)| *channel = channel.midpoint(tint));
        }
    }
}

fn rectangle(image: &mut RgbImage, bounds: BoundingBox) {
    if bounds.width == 0 || bounds.height == 0 {
        return;
    }
    let (left, top) = (i64::from(bounds.x), i64::from(bounds.y));
    let (right, bottom) = (left + i64::from(bounds.width) - 1, top + i64::from(bounds.height) - 1);
    for x in left..=right.min(image.width() as i64) {
        set(image, x, top, RECTANGLE);
        set(image, x, bottom, RECTANGLE);
    }
    for y in top..=bottom.min(image.height() as i64) {
        set(image, left, y, RECTANGLE);
        set(image, right, y, RECTANGLE);
    }
}

/// Ignored outside the image.
fn set(image: &mut RgbImage, x: i64, y: i64, colour: [u8; 3]) {
    let (width, height) = (image.width() as i64, image.height() as i64);
    if (0..width).contains(&x) && (0..height).contains(&y) {
        image[(x as usize, y as usize)] = colour;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pfd_geometry::{Image, StageTimes, Stamp};
    use pfd_segmentation::Status;

    #[test]
    fn drawing_outside_is_ignored() {
        let mut mask = Mask::empty(4, 3);
        mask.set(1, 1, true);
        let particles = vec![vec![[-3.0, 1.0], [3.0, 2.0], [f32::NAN, 1e30]]];
        let segmentation = Segmentation {
            stamp: Stamp::default(),
            mask,
            regions: vec![],
            particles,
            status: Status::Segmented,
            timing: StageTimes::default(),
        };
        let mut out = draw(&Image::filled(4, 3, [0; 3]), &segmentation);
        assert_eq!(out[(1, 1)], [115, 20, 20]);
        assert_eq!(out[(3, 2)], PARTICLE);
        rectangle(&mut out, BoundingBox { x: 2, y: 0, width: u32::MAX, height: 2 });
        assert_eq!(out[(3, 0)], RECTANGLE);
    }
}
