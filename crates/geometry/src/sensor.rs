//! Noise of the depth sensor.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Standard deviation of a structured-light depth measurement as a function of depth.
///
/// `sigma(z) = offset + quadratic · z²` (Khoshelham and Oude Elberink, Sensors 2012, eq. 10; Nguyen et al., 3DIMPVT 2012,
/// eq. 2: disparity has constant noise, so depth noise grows with the square of depth).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DepthNoise {
    /// Noise floor, metres.
    #[schemars(range(min = 0.0001, max = 0.1))]
    pub offset: f64,
    /// Growth with the square of depth, 1/metre.
    #[schemars(range(min = 0.0, max = 0.1))]
    pub quadratic: f64,
    /// Depth below which the sensor does not measure, metres.
    #[schemars(range(min = 0.0, max = 2.0))]
    pub min_depth: f64,
    /// Depth beyond which measurements are ignored, metres.
    #[schemars(range(min = 0.5, max = 100.0))]
    pub max_depth: f64,
}

impl Default for DepthNoise {
    /// Kinect and Xtion: 1.2 mm at close range, 2.85 mm·(z/1 m)² growth, usable from 0.3 to 6 m.
    fn default() -> Self {
        Self { offset: 0.0012, quadratic: 0.00285, min_depth: 0.3, max_depth: 6.0 }
    }
}

impl DepthNoise {
    /// Standard deviation in metres of a measurement at `depth` metres.
    pub fn sigma(&self, depth: f64) -> f64 {
        self.offset + self.quadratic * depth * depth
    }

    /// Standard deviation in metres of the difference of two measurements at `depth` metres.
    pub fn difference_sigma(&self, depth: f32) -> f32 {
        std::f32::consts::SQRT_2 * self.sigma(f64::from(depth)) as f32
    }

    /// Whether `depth` (metres) lies in the usable range; 0 stands for no measurement.
    pub fn is_usable(&self, depth: f64) -> bool {
        depth > 0.0 && depth >= self.min_depth && depth <= self.max_depth
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_measured_is_not_usable_even_without_a_lower_limit() {
        let noise = DepthNoise { min_depth: 0.0, ..DepthNoise::default() };
        let usable = |depth: f64| noise.is_usable(depth);
        assert_eq!([0.0, 0.1, 6.0, 6.1, f64::NAN].map(usable), [false, true, true, false, false]);
    }
}
