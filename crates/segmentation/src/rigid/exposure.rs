//! Sudden changes of brightness: a lamp that is switched on or off, or a step of the camera's exposure. Corners cannot be followed through
//! one, and all texture changes with it, so that everything would seem to move. The frames after it are brought to the brightness of those
//! before, and from there slowly back to their own.

use pfd_geometry::GrayImage;

use super::objects::median;

/// Every how many pixels brightness is compared.
const SAMPLING: usize = 37;
/// Mean of two grey levels from which their ratio says something: dark pixels are mostly noise.
const DARK: f32 = 20.0;
/// Logarithm of a ratio of brightness from which on it is a jump, an eighth. Smaller steps disturb little.
const JUMP: f32 = 0.12;
/// At least three quarters of the pixels change by this share of the jump: otherwise the image has moved, or something in it.
const COMMON: f32 = 0.5;
/// Share of the compensation that is left in the next frame: nothing is left after some two seconds.
const KEPT: f32 = 0.95;
/// Logarithm of a compensation that makes no difference.
const NEGLIGIBLE: f32 = 0.005;

/// What the brightness of frames is multiplied by, as a logarithm.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Exposure {
    log_gain: f32,
}

impl Exposure {
    /// Brings `current` to the brightness of `previous`, which this has done to as well, if it differs suddenly.
    pub(crate) fn compensate(&mut self, previous: &GrayImage, current: &mut GrayImage) {
        self.log_gain *= KEPT;
        if self.log_gain.abs() < NEGLIGIBLE {
            self.log_gain = 0.0;
        }
        self.log_gain += jump(previous, current, self.log_gain.exp());
        if self.log_gain != 0.0 {
            let gain = self.log_gain.exp();
            current.pixels_mut().iter_mut().for_each(|g| *g = (f32::from(*g) * gain + 0.5) as u8);
        }
    }
}

/// Logarithm of the ratio by which `current` is darker than `previous` after it has been multiplied by `gain`, or 0 if it has not jumped.
fn jump(previous: &GrayImage, current: &GrayImage, gain: f32) -> f32 {
    let pairs = previous.pixels().iter().zip(current.pixels()).step_by(SAMPLING);
    let levels = pairs.map(|(&p, &c)| (f32::from(p), f32::from(c) * gain)).filter(|(p, c)| p + c > 2.0 * DARK);
    let mut ratios: Vec<f32> = levels.map(|(p, c)| ((p + 1.0) / (c + 1.0)).ln()).collect();
    let Some(middle) = median(&mut ratios).filter(|middle| middle.abs() > JUMP) else { return 0.0 };
    let common = ratios.iter().filter(|&&ratio| ratio * middle.signum() > COMMON * middle.abs()).count();
    if 4 * common > 3 * ratios.len() { middle } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pfd_geometry::Image;

    /// Stripes of width 8 from 20 to 116 grey levels, displaced by `shift` pixels, in a light of `light`.
    fn stripes(shift: usize, light: f32) -> GrayImage {
        let mut image = Image::filled(160, 120, 0);
        let level = |u: usize| 20.0 + 32.0 * ((u + shift) / 8 % 4) as f32;
        image.pixels_mut().iter_mut().enumerate().for_each(|(i, g)| *g = (level(i % 160) * light) as u8);
        image
    }

    /// Mean difference from a first frame of a second one.
    fn difference(exposure: &mut Exposure, first: &GrayImage, mut second: GrayImage) -> f32 {
        exposure.compensate(first, &mut second);
        let differences = first.pixels().iter().zip(second.pixels()).map(|(&a, &b)| f32::from(a.abs_diff(b)));
        differences.sum::<f32>() / first.pixels().len() as f32
    }

    #[test]
    fn a_lamp_that_goes_off_or_on_leaves_the_frame_as_bright_as_before() {
        for light in [0.45, 0.8, 1.3, 2.0] {
            let mut exposure = Exposure::default();
            let left = difference(&mut exposure, &stripes(0, 1.0), stripes(0, light));
            assert!(left < 4.0, "{light}: {left}");
        }
    }

    #[test]
    fn small_changes_and_images_that_move_are_left_alone() {
        for (shift, light) in [(0, 0.95), (0, 1.05), (8, 1.0), (16, 1.0)] {
            let mut exposure = Exposure::default();
            let mut frame = stripes(shift, light);
            exposure.compensate(&stripes(0, 1.0), &mut frame);
            assert_eq!(frame, stripes(shift, light), "{shift} {light}");
        }
    }

    #[test]
    fn brightness_returns_slowly_to_that_of_the_camera() {
        let mut exposure = Exposure::default();
        let mut last = stripes(0, 1.0);
        for _ in 0..120 {
            let before = last.clone();
            last = stripes(0, 0.5);
            exposure.compensate(&before, &mut last);
            let (a, b) = (f32::from(before.pixels()[24]), f32::from(last.pixels()[24]));
            assert!((a / b - 1.0).abs() < 0.07, "{a} {b}");
        }
        assert_eq!(last, stripes(0, 0.5));
    }
}
