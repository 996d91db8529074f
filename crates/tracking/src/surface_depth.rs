//! Depth at a feature, from the surface that it lies on.
//!
//! Neighbouring pixels share most of their noise, that of the matching window of the sensor: of the noise of one pixel the mean of 3×3
//! has .87 to .89, the plane through each second of 9×9 .64 to .68 (residuals of planes through 31×31 pixels of freiburg1 and
//! freiburg3). A plane is linear in the image where depth is inverse.

use nalgebra::{Matrix3, Vector3};
use pfd_geometry::{DepthImage, DepthNoise};

/// Depth differences beyond this many standard deviations belong to different surfaces: neighbours share the systematic part.
const SURFACE_GAP_SIGMAS: f64 = 2.0;
/// Relative depth difference that a slanted surface may have between neighbouring pixels: about 75 degrees of slant.
const SURFACE_SLOPE: f64 = 0.008;
/// With fewer pixels of 3×3 on the surface a feature sits on an edge or a hole.
const MIN_NEIGHBOURS: usize = 5;
/// The plane goes through pixels up to this many steps to each side, …
const STEPS: i32 = 2;
/// … of so many pixels: the noise of those in between is nearly the same.
const STRIDE: i32 = 2;
/// Pixels that a plane may go through.
const SAMPLES: usize = (2 * STEPS as usize + 1).pow(2);
/// A plane needs this many of them: three fifths.
const MIN_SAMPLES: usize = SAMPLES * 3 / 5;
/// Deviations from the first plane beyond this many standard deviations have no part in the second.
const OUTLIER_SIGMAS: f64 = 2.5;

/// Depth and standard deviation (metres) at the position `[u, v]` (pixels): that of the plane through the surroundings or, where these
/// are no plane, the mean of 3×3 pixels.
///
/// `None` at depth edges, where colour and depth may belong to different surfaces. The standard deviation is that of a single pixel
/// throughout: what is left of the error after averaging is systematic, and grows with depth in the same way.
pub(crate) fn surface_depth(depth: &DepthImage, [u, v]: [f32; 2], noise: &DepthNoise) -> Option<(f64, f64)> {
    let mean = mean_around(depth, [u.round() as usize, v.round() as usize], noise)?;
    let sigma = noise.sigma(mean);
    let plane = plane_depth(depth, [u, v], mean, sigma).filter(|&z| noise.is_usable(z));
    Some((plane.unwrap_or(mean), sigma))
}

/// The mean of the pixels of 3×3 that lie on one surface with the middle one, if these are enough.
fn mean_around(depth: &DepthImage, [u, v]: [usize; 2], noise: &DepthNoise) -> Option<f64> {
    let centre = f64::from(depth.at(u, v)?);
    if !noise.is_usable(centre) {
        return None;
    }
    let tolerance = (SURFACE_GAP_SIGMAS * noise.sigma(centre)).max(SURFACE_SLOPE * centre);
    let (mut sum, mut count) = (0.0, 0);
    for y in v.saturating_sub(1)..=v + 1 {
        for x in u.saturating_sub(1)..=u + 1 {
            if let Some(d) = depth.at(x, y).map(f64::from).filter(|d| (d - centre).abs() <= tolerance) {
                sum += d;
                count += 1;
            }
        }
    }
    (count >= MIN_NEIGHBOURS).then(|| sum / count as f64)
}

/// A pixel of the surroundings.
#[derive(Clone, Copy, Default)]
struct Sample {
    /// Columns and rows from the middle.
    x: f32,
    y: f32,
    /// By how much its inverse depth is more than the mean, 1/metre.
    more: f32,
}

/// Depth at `[u, v]` by the plane of inverse depth through the surroundings, where the depth is `mean` with the standard deviation
/// `sigma`; what lies beside the first such plane has no part in it.
fn plane_depth(depth: &DepthImage, [u, v]: [f32; 2], mean: f64, sigma: f64) -> Option<f64> {
    let (middle, inverse_sigma) = ([u.round(), v.round()], (sigma / (mean * mean)) as f32);
    let mut samples = [Sample::default(); SAMPLES];
    let on_surface = gather(depth, middle.map(|p| p as i32), [mean as f32, inverse_sigma], &mut samples);
    let first = fit(on_surface.iter())?;
    let limit = OUTLIER_SIGMAS as f32 * inverse_sigma;
    let fits = |s: &&Sample| (s.more - (first.x + first.y * s.x + first.z * s.y)).abs() <= limit;
    let plane = fit(on_surface.iter().filter(fits))?;
    let more = plane.x + plane.y * (u - middle[0]) + plane.z * (v - middle[1]);
    Some(1.0 / (1.0 / mean + f64::from(more)))
}

/// The pixels around the `middle` that may lie on a surface there, of which depth and standard deviation of inverse depth are given.
fn gather<'a>(
    depth: &DepthImage,
    middle: [i32; 2],
    [mean, inverse_sigma]: [f32; 2],
    samples: &'a mut [Sample; SAMPLES],
) -> &'a [Sample] {
    let inverse = 1.0 / mean;
    let gap = SURFACE_GAP_SIGMAS as f32 * std::f32::consts::SQRT_2 * inverse_sigma;
    let slant = SURFACE_SLOPE as f32 * inverse;
    let mut count = 0;
    for y in (-STEPS..=STEPS).map(|step| step * STRIDE) {
        for x in (-STEPS..=STEPS).map(|step| step * STRIDE) {
            let place = (usize::try_from(middle[0] + x), usize::try_from(middle[1] + y));
            let (Ok(column), Ok(row)) = place else { continue };
            let Some(z) = depth.at(column, row) else { continue };
            let more = 1.0 / z - inverse;
            if more.abs() <= gap + slant * x.abs().max(y.abs()) as f32 {
                samples[count] = Sample { x: x as f32, y: y as f32, more };
                count += 1;
            }
        }
    }
    &samples[..count]
}

/// The plane by least squares, if there are enough samples: value in the middle, and slopes.
fn fit<'a>(samples: impl Iterator<Item = &'a Sample>) -> Option<Vector3<f32>> {
    let (mut information, mut right, mut count) = (Matrix3::zeros(), Vector3::zeros(), 0);
    for s in samples {
        let at = Vector3::new(1.0, s.x, s.y);
        information += at * at.transpose();
        right += at * s.more;
        count += 1;
    }
    (count >= MIN_SAMPLES).then(|| information.cholesky())?.map(|cholesky| cholesky.solve(&right))
}

#[cfg(test)]
mod tests {
    use super::*;
    use pfd_geometry::Image;
    use proptest::prelude::*;

    fn image(depth: impl Fn(usize, usize) -> f32) -> DepthImage {
        let pixels = (0..64 * 64).map(|i| depth(i % 64, i / 64)).collect();
        DepthImage::from_metres(Image::from_vec(64, 64, pixels).unwrap())
    }

    fn at(depth: &DepthImage, place: [f32; 2]) -> Option<f64> {
        surface_depth(depth, place, &DepthNoise::default()).map(|(z, _)| z)
    }

    #[test]
    fn depth_is_refused_at_edges_and_holes() {
        let step = image(|u, _| if u < 32 { 1.0 } else { 2.0 });
        assert_eq!(at(&step, [10.0, 10.0]), Some(1.0));
        assert_eq!(at(&step, [40.0, 10.0]), Some(2.0));
        let holes = image(|u, v| if (u + v) % 2 == 0 { 1.0 } else { 0.0 });
        assert_eq!(at(&holes, [11.0, 10.0]), None, "on a hole");
        assert_eq!(at(&image(|_, _| 0.0), [10.0, 10.0]), None);
        let ramp = image(|u, _| 1.0 + 0.2 * u as f32);
        assert_eq!(at(&ramp, [10.0, 10.0]), None, "20 cm a pixel is no surface");
    }

    #[test]
    fn another_surface_beside_it_does_not_bend_the_plane() {
        let step = image(|u, _| if u < 32 { 1.5 } else { 1.6 });
        for u in [20.0, 28.0, 29.3, 30.0] {
            assert!((at(&step, [u, 20.0]).unwrap() - 1.5).abs() < 0.002, "{u}");
        }
        let one_off = image(|u, v| if (u, v) == (22, 20) { 2.25 } else { 2.0 });
        assert!((at(&one_off, [20.0, 20.0]).unwrap() - 2.0).abs() < 0.001);
    }

    #[test]
    fn what_is_no_plane_has_the_mean_of_its_neighbours() {
        let few = image(|u, v| if u.abs_diff(20) < 2 && v.abs_diff(20) < 2 { 1.0 } else { 0.0 });
        assert_eq!(at(&few, [20.0, 20.0]), Some(1.0));
        assert_eq!(at(&few, [0.0, 0.0]), None);
    }

    proptest! {
        #[test]
        fn a_slanted_plane_is_found_between_pixels(
            (z, du, dv) in (0.5..5.0_f64, -0.003..0.003_f64, -0.003..0.003_f64),
            (u, v) in (4.0..58.0_f32, 4.0..58.0_f32),
        ) {
            let inverse = |x: f64, y: f64| (1.0 + du * (x - 32.0) + dv * (y - 32.0)) / z;
            let found = at(&image(|x, y| (1.0 / inverse(x as f64, y as f64)) as f32), [u, v]);
            let expected = 1.0 / inverse(f64::from(u), f64::from(v));
            prop_assert!((found.unwrap() - expected).abs() < 1e-5 * expected);
        }

        #[test]
        fn depth_is_within_that_of_all_pixels_whatever_they_show(
            pixels in prop::collection::vec(prop_oneof![Just(0.0_f32), 0.2..8.0_f32, 1.0..1.1_f32], 16 * 16),
            quadratic in 0.0..0.1_f64,
            place in prop::array::uniform2(0.0..15.9_f32),
        ) {
            let depth = DepthImage::from_metres(Image::from_vec(16, 16, pixels).unwrap());
            let noise = DepthNoise { quadratic, ..DepthNoise::default() };
            if let Some((z, sigma)) = surface_depth(&depth, place, &noise) {
                prop_assert!((0.2..8.0).contains(&z) && sigma > 0.0, "{z} {sigma}");
            }
        }

        #[test]
        fn noise_of_pixels_is_averaged(seed in 0_u64..20) {
            use rand::{RngExt, SeedableRng};
            let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
            let noise = DepthNoise::default();
            let spread = noise.sigma(3.0) as f32;
            let pixels: Vec<f32> = (0..64 * 64).map(|_| 3.0 + spread * rng.random_range(-1.0..1.0)).collect();
            let depth = image(|u, v| pixels[v * 64 + u]);
            let places = (2..14).flat_map(|y| (2..14).map(move |x| [4.0 * x as f32, 4.0 * y as f32]));
            let errors: Vec<f64> = places.filter_map(|p| at(&depth, p)).map(|z| z - 3.0).collect();
            let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
            // Uniform noise of this width has 0.58 of its standard deviation, a fifth of which 25 pixels leave.
            prop_assert!(rms < 0.15 * f64::from(spread), "{rms}");
        }
    }
}
