//! Which neighbouring pixels lie on one surface.

use pfd_geometry::DepthNoise;

/// Depth steps of more than this many standard deviations of the sensor, on top of the slope, separate surfaces.
const STEP_SIGMAS: f32 = 3.0;
/// Depth change per metre of depth between neighbouring pixels of a surface seen at a grazing angle (79° at a focal length of 262 pixels).
const SLOPE: f32 = 0.02;

/// A test of depths at a fixed distance in the image.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Continuity {
    offset: f32,
    quadratic: f32,
    slope: f32,
}

impl Continuity {
    /// For depths that were measured `spacing` pixels apart.
    pub(crate) fn new(noise: &DepthNoise, spacing: usize) -> Self {
        Self { offset: noise.offset as f32, quadratic: noise.quadratic as f32, slope: SLOPE * spacing as f32 }
    }

    /// Whether no depth step lies between two depths, metres; never where one is missing (0).
    #[inline]
    pub(crate) fn connects(&self, a: f32, b: f32) -> bool {
        let z = if a < b { a } else { b };
        let sigma = std::f32::consts::SQRT_2 * (self.offset + self.quadratic * z * z);
        z > 0.0 && (a - b).abs() < STEP_SIGMAS * sigma + self.slope * z
    }
}
