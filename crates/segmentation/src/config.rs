//! Every parameter of segmentation, with its default, in one tree.

use std::fmt;
use std::str::FromStr;

use pfd_geometry::DepthNoise;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::result::SegmentationError;

/// Which method finds moving things.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// Rigid ego-motion, static model, depth-bounded regions carried through time: the default.
    #[default]
    Pfd,
    /// The published PFD-SLAM method as it stands.
    Paper,
    /// The published method restricted to one object (as MR-SLAM).
    Single,
    /// Features rejected by optical flow and epipolar distance, no regions (as OPF-SLAM).
    Flow,
    /// Everything is static (as ORB-SLAM2).
    None,
}

impl Mode {
    /// All modes.
    pub const ALL: [Self; 5] = [Self::Pfd, Self::Paper, Self::Single, Self::Flow, Self::None];

    /// The name used in parameters and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pfd => "pfd",
            Self::Paper => "paper",
            Self::Single => "single",
            Self::Flow => "flow",
            Self::None => "none",
        }
    }
}

impl fmt::Display for Mode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A mode that does not exist.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("mode '{0}' does not exist; use pfd, paper, single, flow or none")]
pub struct UnknownMode(pub String);

impl FromStr for Mode {
    type Err = UnknownMode;

    fn from_str(s: &str) -> Result<Self, Self::Err> {
        Self::ALL.into_iter().find(|m| m.name() == s).ok_or_else(|| UnknownMode(s.to_owned()))
    }
}

/// Parameters of segmentation.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SegmentationConfig {
    /// Noise of the depth sensor.
    pub depth_noise: DepthNoise,
    /// The particle filter (paper, section 3.2).
    pub particles: ParticleConfig,
    /// Mode `pfd`.
    pub pfd: PfdConfig,
    /// Modes `paper`, `single` and `flow`.
    pub paper: PaperConfig,
}

impl SegmentationConfig {
    /// Checks the ranges on which the computation relies.
    ///
    /// # Errors
    /// [`SegmentationError::Parameter`] names the parameter at fault.
    pub fn check(&self) -> Result<(), SegmentationError> {
        let positive = "a finite number above 0";
        let (noise, particles, pfd, paper) = (&self.depth_noise, &self.particles, &self.pfd, &self.paper);
        let (share, not_negative) = ("a share, 0 to 1", "0 or more");
        let is_share = |value: f64| (0.0..=1.0).contains(&value);
        let checks = [
            ("depth_noise.offset", noise.offset, noise.offset > 0.0, positive),
            ("depth_noise.quadratic", noise.quadratic, noise.quadratic >= 0.0, not_negative),
            ("depth_noise.max_depth", noise.max_depth, noise.max_depth > noise.min_depth, "above min_depth"),
            ("particles.count", particles.count as f64, (10..=100_000).contains(&particles.count), "10 to 100000"),
            ("particles.kernel_sigma", particles.kernel_sigma, particles.kernel_sigma > 0.0, positive),
            ("particles.position_sigma", particles.position_sigma, particles.position_sigma > 0.0, positive),
            ("particles.velocity_sigma", particles.velocity_sigma, particles.velocity_sigma >= 0.0, not_negative),
            ("particles.resample_below", particles.resample_below, is_share(particles.resample_below), share),
            ("pfd.threshold", pfd.threshold, is_share(pfd.threshold), share),
            ("pfd.min_area", pfd.min_area, is_share(pfd.min_area), share),
            ("pfd.max_mask_share", pfd.max_mask_share, is_share(pfd.max_mask_share), share),
            ("pfd.significance", pfd.significance, pfd.significance > 1.0, "above 1"),
            ("pfd.older_reference_age", pfd.older_reference_age, pfd.older_reference_age > 0.0, positive),
            ("pfd.rest_time", pfd.rest_time, pfd.rest_time > 0.0, positive),
            ("paper.features", paper.features as f64, paper.features > 0, "1 or more"),
            ("paper.depth_clusters", paper.depth_clusters as f64, paper.depth_clusters > 0, "1 or more"),
            ("paper.epipolar_distance", paper.epipolar_distance, paper.epipolar_distance > 0.0, positive),
            ("paper.flow_sigmas", paper.flow_sigmas, paper.flow_sigmas > 0.0, positive),
            ("paper.min_evidence", paper.min_evidence, paper.min_evidence >= 0.0, not_negative),
        ];
        for (name, value, holds, expected) in checks {
            if !holds || !value.is_finite() {
                return Err(SegmentationError::Parameter { name, value, expected });
            }
        }
        Ok(())
    }
}

/// The particle filter: state [x y vx vy] (Eq. 2), Gaussian motion (Eq. 5), Gaussian-kernel weights (Eq. 3 and 4).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ParticleConfig {
    /// Particles per filter (paper, table 1: 1000 is best).
    #[schemars(range(min = 10, max = 100_000))]
    pub count: usize,
    /// Standard deviation σ of the weight kernel (Eq. 3), pixels of the camera image.
    #[schemars(range(min = 0.5, max = 50.0))]
    pub kernel_sigma: f64,
    /// Standard deviation of a particle's position per frame beyond its own velocity (Eq. 5), pixels.
    #[schemars(range(min = 0.1, max = 100.0))]
    pub position_sigma: f64,
    /// Standard deviation of the change of a particle's velocity per frame (Eq. 5), pixels per second.
    #[schemars(range(min = 0.0, max = 2000.0))]
    pub velocity_sigma: f64,
    /// Resample when the effective number of particles falls below this share of all (step 4 of algorithm 2).
    #[schemars(range(min = 0.0, max = 1.0))]
    pub resample_below: f64,
}

impl Default for ParticleConfig {
    fn default() -> Self {
        Self { count: 1000, kernel_sigma: 4.0, position_sigma: 6.0, velocity_sigma: 90.0, resample_below: 0.5 }
    }
}

/// How camera motion is taken out of image differences.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Compensation {
    /// Rigid motion with depth: right for every static scene.
    #[default]
    Se3,
    /// One homography: right for one plane or a pure rotation (the published method).
    Homography,
}

/// Where pixels without depth are looked for in earlier frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum MissingDepth {
    /// As far away as what is beside them in their row, the farther side of the gap.
    #[default]
    Background,
    /// On the plane that most of the frame lies on: by the homography of this plane under the camera motion.
    Homography,
}

/// What of an object's surroundings belongs to it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RegionShape {
    /// The surface, up to its depth edges.
    #[default]
    DepthEdges,
    /// The bounding rectangle (the published method).
    Rectangle,
}

/// Mode `pfd`. Each element is a switch, so that its effect can be measured.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
#[allow(clippy::struct_excessive_bools)]
pub struct PfdConfig {
    /// How camera motion is compensated.
    pub compensation: Compensation,
    /// How pixels without depth are compared.
    pub missing_depth: MissingDepth,
    /// Compare with an older frame as well, not only with the previous one.
    pub older_reference: bool,
    /// Keep a model of the static scene and compare with it.
    pub static_model: bool,
    /// Correct the camera motion by the model of the static scene, so that what it remembers stays in its place.
    pub anchored_motion: bool,
    /// Extent of a moving region.
    pub region: RegionShape,
    /// Extend what moves over the rest of the thing that it is a part of: a gesturing person is more than arms.
    pub whole_things: bool,
    /// Large planes move as a whole or not at all, and what touches one is no part of it.
    pub rigid_planes: bool,
    /// Corners that move together speak for the surface around them.
    pub moving_corners: bool,
    /// Give what lies along the outlines of what moves, and in gaps of the depth there, to the side that has its colours: depth is ragged.
    pub refined_outlines: bool,
    /// Carry regions through time.
    pub temporal: bool,
    /// Ignore changes of brightness that leave the local texture as it is.
    pub shadow_rejection: bool,
    /// Ask for more evidence of a new region on which no particles gather.
    pub particle_support: bool,
    /// Return an empty mask, and say so, when the camera motion is uncertain or nearly everything would be masked.
    pub fail_open: bool,
    /// Age of the older reference, seconds: long enough for slow movers to leave their place.
    #[schemars(range(min = 0.05, max = 2.0))]
    pub older_reference_age: f64,
    /// Differences count from this many standard deviations.
    #[schemars(range(min = 1.0, max = 10.0))]
    pub significance: f64,
    /// Share of evidence from which a pixel is dynamic.
    #[schemars(range(min = 0.05, max = 0.95))]
    pub threshold: f64,
    /// Regions smaller than this share of the image are noise.
    #[schemars(range(min = 0.0, max = 0.1))]
    pub min_area: f64,
    /// Something that moved belongs to the static scene again after this long without motion, seconds.
    #[schemars(range(min = 0.1, max = 60.0))]
    pub rest_time: f64,
    /// Mask share beyond which the result is not believed.
    #[schemars(range(min = 0.1, max = 1.0))]
    pub max_mask_share: f64,
    /// Fewest corners that must agree on the camera motion; half as many if most surfaces are seen where they put them.
    #[schemars(range(min = 6, max = 1000))]
    pub min_inliers: usize,
}

impl Default for PfdConfig {
    fn default() -> Self {
        Self {
            compensation: Compensation::Se3,
            missing_depth: MissingDepth::Background,
            older_reference: true,
            static_model: true,
            anchored_motion: true,
            region: RegionShape::DepthEdges,
            whole_things: true,
            rigid_planes: true,
            moving_corners: true,
            refined_outlines: true,
            temporal: true,
            shadow_rejection: true,
            particle_support: true,
            fail_open: true,
            older_reference_age: 0.3,
            significance: 3.5,
            threshold: 0.47,
            min_area: 0.002,
            rest_time: 2.5,
            max_mask_share: 0.9,
            min_inliers: 12,
        }
    }
}

/// The published method (modes `paper`, `single` and `flow`).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PaperConfig {
    /// Features per frame (algorithm 1, step 0).
    #[schemars(range(min = 100, max = 20_000))]
    pub features: usize,
    /// Largest distance to the epipolar line, pixels (section 3.1).
    #[schemars(range(min = 0.1, max = 10.0))]
    pub epipolar_distance: f64,
    /// Differences between matched and tracked positions beyond this many standard deviations are outliers (the 3σ test).
    #[schemars(range(min = 1.0, max = 10.0))]
    pub flow_sigmas: f64,
    /// Objects searched for at most (algorithm 2, step 9).
    #[schemars(range(min = 1, max = 10))]
    pub max_objects: usize,
    /// Differences of grey levels below this are noise and count as 0.
    #[schemars(range(min = 0, max = 255))]
    pub noise_floor: u8,
    /// Mean smoothed difference (grey levels) under the weighted particles below which there is no further object: less than half of
    /// `noise_floor` is scattered noise.
    #[schemars(range(min = 0.0, max = 255.0))]
    pub min_evidence: f64,
    /// Depth clusters of K-means (algorithm 2, step 6).
    #[schemars(range(min = 1, max = 10))]
    pub depth_clusters: usize,
    /// Points within this many pixels of a region's border are decided by K-means (last step of section 3.2).
    #[schemars(range(min = 0, max = 100))]
    pub border: u32,
}

impl Default for PaperConfig {
    fn default() -> Self {
        Self {
            features: 1500,
            epipolar_distance: 1.0,
            flow_sigmas: 3.0,
            max_objects: 3,
            noise_floor: 25,
            min_evidence: 10.0,
            depth_clusters: 3,
            border: 10,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mode_names_round_trip() {
        for mode in Mode::ALL {
            assert_eq!(mode.to_string().parse(), Ok(mode));
        }
        assert_eq!("PFD".parse::<Mode>(), Err(UnknownMode("PFD".into())));
    }
}
