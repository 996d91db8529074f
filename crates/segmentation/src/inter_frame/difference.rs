//! The difference image (Eq. 1) after compensating the camera's motion.

use nalgebra::{Matrix3, Vector3};
use pfd_geometry::GrayImage;
use pfd_vision::VisionError;
use pfd_vision::warp::warp_by_homography;

/// Pixels this close to the border of the warped image do not count: interpolation mixes them with black.
const MARGIN: f64 = 2.0;

/// Draws `|I_current − H I_previous|` into `out`, all three of one size: 0 below `noise_floor` and where the previous image does not reach.
pub(crate) fn difference(
    previous: &GrayImage,
    current: &GrayImage,
    homography: &Matrix3<f64>,
    noise_floor: u8,
    out: &mut GrayImage,
) -> Result<(), VisionError> {
    let (width, height) = current.size();
    let Some(inverse) = homography.try_inverse() else {
        out.pixels_mut().fill(0);
        return Ok(());
    };
    warp_by_homography(previous, homography, out)?;
    for v in 0..height {
        for u in 0..width {
            let (warped, now) = (out[(u, v)], current[(u, v)]);
            let p = inverse * Vector3::new(u as f64, v as f64, 1.0);
            let (x, y) = (p.x / p.z, p.y / p.z);
            let inside = x >= MARGIN && y >= MARGIN && x < width as f64 - MARGIN && y < height as f64 - MARGIN;
            let difference = now.abs_diff(warped);
            out[(u, v)] = if inside && difference >= noise_floor { difference } else { 0 };
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use pfd_geometry::Image;

    #[test]
    fn a_compensated_shift_leaves_nothing_but_the_mover() {
        let (mut a, mut b) = (Image::filled(40, 30, 0_u8), Image::filled(40, 30, 0_u8));
        for v in 0..30 {
            for u in 0..40 {
                a[(u, v)] = (u * 5) as u8;
                b[(u, v)] = (u.saturating_sub(4) * 5) as u8;
            }
        }
        b[(20, 15)] = 255;
        let shift = Matrix3::new_translation(&nalgebra::Vector2::new(4.0, 0.0));
        let mut found = Image::filled(40, 30, 77);
        difference(&a, &b, &shift, 10, &mut found).unwrap();
        let marked: Vec<usize> = (0..1200).filter(|&i| found.pixels()[i] > 0).collect();
        assert_eq!(marked, [15 * 40 + 20]);
        difference(&a, &b, &Matrix3::zeros(), 10, &mut found).unwrap();
        assert!(found.pixels().iter().all(|&d| d == 0), "no transformation, no difference");
    }
}
