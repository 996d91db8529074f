//! Sampling pattern of the binary descriptor: pairs of points drawn once from a Gaussian, rotated in steps of 12 degrees.

use std::sync::LazyLock;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;

/// Bits of a descriptor.
pub(crate) const BITS: usize = 256;
/// Samples stay within this radius (pixels), so that a rotated pattern fits into the border that feature detection keeps free.
pub(crate) const RADIUS: i32 = 15;
/// Side of the square that holds all samples, its centre at `[RADIUS, RADIUS]`. One more than is needed: a power of two.
pub(crate) const PATCH_SIDE: usize = 2 * RADIUS as usize + 2;
/// Directions for which the pattern is tabulated (12 degrees apart: Rublee et al., ICCV 2011, section 4.1).
pub(crate) const DIRECTIONS: usize = 30;

/// Spread of the samples: patch size / 5, which the authors of BRIEF found best (Calonder et al., ECCV 2010, section 3.2, G II).
const SIGMA: f64 = (2 * RADIUS + 1) as f64 / 5.0;
/// Any fixed number: descriptors in saved maps depend on it.
const SEED: u64 = 0x5eed_0fb1;
/// Each point of a pair, as an index into the square.
pub(crate) type Pair = [u16; 2];

/// `PATTERN[direction][bit]`.
pub(crate) static PATTERN: LazyLock<Vec<[Pair; BITS]>> = LazyLock::new(|| {
    let base = draw_pairs();
    (0..DIRECTIONS).map(|d| rotate(&base, d as f64 * std::f64::consts::TAU / DIRECTIONS as f64)).collect()
});

fn draw_pairs() -> [[[f64; 2]; 2]; BITS] {
    let mut rng = Pcg32::seed_from_u64(SEED);
    std::array::from_fn(|_| [draw_point(&mut rng), draw_point(&mut rng)])
}

/// A point from an isotropic Gaussian (Box–Muller), redrawn until it lies within the radius.
fn draw_point(rng: &mut Pcg32) -> [f64; 2] {
    loop {
        let length = SIGMA * (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
        let angle = std::f64::consts::TAU * rng.random::<f64>();
        if length <= f64::from(RADIUS) - 1.0 {
            return [length * angle.cos(), length * angle.sin()];
        }
    }
}

fn rotate(base: &[[[f64; 2]; 2]; BITS], angle: f64) -> [Pair; BITS] {
    let (sin, cos) = angle.sin_cos();
    let from_corner = |offset: f64| (offset.round() as i32 + RADIUS) as usize;
    let turn = |[x, y]: [f64; 2]| (from_corner(sin * x + cos * y) * PATCH_SIDE + from_corner(cos * x - sin * y)) as u16;
    std::array::from_fn(|bit| [turn(base[bit][0]), turn(base[bit][1])])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_sample_is_inside_the_patch_and_pairs_differ() {
        for pairs in PATTERN.iter() {
            for index in pairs.as_flattened().iter().map(|&index| i32::from(index)) {
                let (x, y) = (index % PATCH_SIDE as i32 - RADIUS, index / PATCH_SIDE as i32 - RADIUS);
                assert!(x * x + y * y <= RADIUS * RADIUS);
            }
            let degenerate = pairs.iter().filter(|[a, b]| a == b).count();
            assert!(degenerate <= BITS / 32, "{degenerate} pairs compare a pixel with itself");
        }
    }
}
