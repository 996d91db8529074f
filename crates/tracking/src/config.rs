//! Parameters of tracking and mapping, with their defaults.

use pfd_geometry::DepthNoise;
use pfd_vision::features::FeatureOptions;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Everything that can be set about tracking.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TrackingConfig {
    /// Feature extraction.
    pub features: FeatureConfig,
    /// Error of depth at a feature. Beside the sensor's noise it holds what does not average out: registration to colour,
    /// calibration, and the camera's motion between the two exposures.
    pub depth_noise: DepthNoise,
    /// Data association.
    pub matching: MatchingConfig,
    /// Positions of corners by grey levels.
    pub alignment: AlignmentConfig,
    /// Rows that are exposed one after the other.
    pub rolling_shutter: RollingShutterConfig,
    /// When a frame counts as tracked.
    pub pose: PoseConfig,
    /// When a frame becomes a keyframe, and what is kept.
    pub mapping: MappingConfig,
    /// Bundle adjustment of the local map.
    pub bundle_adjustment: BundleAdjustmentConfig,
    /// Place recognition, relocalisation and loop closing.
    pub places: PlaceConfig,
}

impl Default for TrackingConfig {
    fn default() -> Self {
        // Depth and colour of a Kinect are up to half a frame apart: 16 ms at a hand-held 0.5 m/s are 8 mm, and calibration is
        // off by one or two centimetres at 2 m (Khoshelham and Oude Elberink 2012, section 5). All corners of a frame share these
        // errors, which therefore count twice what they are.
        const SYSTEMATIC: f64 = 0.04;
        Self {
            features: FeatureConfig::default(),
            depth_noise: DepthNoise { offset: SYSTEMATIC, ..DepthNoise::default() },
            matching: MatchingConfig::default(),
            alignment: AlignmentConfig::default(),
            rolling_shutter: RollingShutterConfig::default(),
            pose: PoseConfig::default(),
            mapping: MappingConfig::default(),
            bundle_adjustment: BundleAdjustmentConfig::default(),
            places: PlaceConfig::default(),
        }
    }
}

/// ORB features (Rublee et al., ICCV 2011).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FeatureConfig {
    /// Features wanted in an image.
    #[schemars(range(min = 100, max = 5000))]
    pub count: usize,
    /// Pyramid levels.
    #[schemars(range(min = 1, max = 12))]
    pub levels: usize,
    /// Ratio of the sizes of two levels.
    #[schemars(range(min = 1.05, max = 2.0))]
    pub scale: f64,
    /// FAST threshold, grey levels.
    #[schemars(range(min = 2, max = 100))]
    pub threshold: i32,
    /// FAST threshold for cells in which the first finds nothing, grey levels.
    #[schemars(range(min = 1, max = 100))]
    pub low_threshold: i32,
    /// Standard deviation of a corner's position on the finest level, pixels.
    #[schemars(range(min = 0.1, max = 5.0))]
    pub sigma: f64,
    /// Features this close to the dynamic mask are dropped, pixels: the mask's outline is not exact.
    #[schemars(range(min = 0, max = 30))]
    pub mask_margin: usize,
}

impl Default for FeatureConfig {
    fn default() -> Self {
        Self { count: 1000, levels: 8, scale: 1.2, threshold: 20, low_threshold: 7, sigma: 0.7, mask_margin: 2 }
    }
}

impl FeatureConfig {
    /// The part that the extractor needs.
    pub fn options(&self) -> FeatureOptions {
        FeatureOptions {
            count: self.count,
            levels: self.levels,
            scale: self.scale,
            threshold: self.threshold,
            low_threshold: self.low_threshold,
        }
    }
}

/// Association of map points with features.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MatchingConfig {
    /// Descriptors of the same point differ by at most this many of 256 bits.
    #[schemars(range(min = 10, max = 128))]
    pub max_distance: u32,
    /// The best match must be better than this share of the second best.
    #[schemars(range(min = 0.5, max = 1.0))]
    pub max_ratio: f64,
    /// Search radius around the prediction by the motion model, pixels of the finest level.
    #[schemars(range(min = 2.0, max = 100.0))]
    pub motion_radius: f64,
    /// Search radius once the pose is known from the last frame, pixels of the finest level.
    #[schemars(range(min = 1.0, max = 50.0))]
    pub local_map_radius: f64,
}

impl Default for MatchingConfig {
    fn default() -> Self {
        Self { max_distance: 80, max_ratio: 0.85, motion_radius: 15.0, local_map_radius: 8.0 }
    }
}

/// Alignment of grey levels: a corner that shows a known point is placed where its surroundings look like those in the first
/// keyframe that saw the point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct AlignmentConfig {
    /// Off: corners stay where the detector puts them.
    pub enabled: bool,
    /// Standard deviation of an aligned corner's position, pixels of its pyramid level.
    #[schemars(range(min = 0.05, max = 5.0))]
    pub sigma: f64,
    /// Surroundings that correlate less are not the same.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub min_correlation: f64,
}

impl Default for AlignmentConfig {
    fn default() -> Self {
        Self { enabled: true, sigma: 0.35, min_correlation: 0.8 }
    }
}

/// Rolling shutter of the colour camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RollingShutterConfig {
    /// Learn the readout time from the images. Off: it is `readout`.
    pub estimate: bool,
    /// Time from the first row to the last, seconds, as far as it is known: 0 for a global shutter, some 0.02 for a Kinect or an
    /// Xtion; negative for an image that was turned upside down.
    #[schemars(range(min = -0.05, max = 0.05))]
    pub readout: f64,
}

impl Default for RollingShutterConfig {
    fn default() -> Self {
        Self { estimate: true, readout: 0.0 }
    }
}

/// Acceptance of a pose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PoseConfig {
    /// Fewer inliers than this and the frame is lost.
    #[schemars(range(min = 6, max = 500))]
    pub min_inliers: usize,
    /// Features with depth needed to start a map.
    #[schemars(range(min = 20, max = 2000))]
    pub min_initial_points: usize,
    /// With fewer inliers outside the mask than this, the frame is tracked a second time without the mask.
    #[schemars(range(min = 6, max = 500))]
    pub min_unmasked_inliers: usize,
    /// A mask that covers more than this share of the image is given up where the map is seen behind it.
    #[schemars(range(min = 0.1, max = 1.0))]
    pub doubtful_mask: f64,
}

impl Default for PoseConfig {
    fn default() -> Self {
        Self { min_inliers: 20, min_initial_points: 80, min_unmasked_inliers: 40, doubtful_mask: 0.4 }
    }
}

/// Keyframes and map points.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MappingConfig {
    /// Off: only localise in the map that was loaded, and leave it as it is.
    pub enabled: bool,
    /// A keyframe is due when the inliers fall below this share of the points of the reference keyframe.
    #[schemars(range(min = 0.1, max = 1.0))]
    pub keyframe_inlier_ratio: f64,
    /// Time between two keyframes at least, seconds: every third frame at 30 Hz, every frame at 10 Hz.
    #[schemars(range(min = 0.0, max = 10.0))]
    pub min_keyframe_interval: f64,
    /// A keyframe is also due when it would add this many points while fewer than as many are tracked.
    #[schemars(range(min = 10, max = 1000))]
    pub wanted_points: usize,
    /// A keyframe is redundant when this share of its points is seen by at least three others.
    #[schemars(range(min = 0.5, max = 1.0))]
    pub redundant_share: f64,
    /// A point is dropped when it is found in less than this share of the frames that should see it.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub min_found_ratio: f64,
    /// Depth beyond which a single measurement does not start a map point, metres.
    #[schemars(range(min = 0.5, max = 20.0))]
    pub max_new_point_depth: f64,
    /// When the mask shows that something moves this many frames after a first one without mask, the map starts anew there and the
    /// frames before are tracked again in it: segmentation needs some frames to tell movers from the room. Until four times as many have
    /// passed, the same happens once more when the mask covers a tenth of the points in view. 0 = off.
    #[schemars(range(min = 0, max = 60))]
    pub first_frames: usize,
}

impl Default for MappingConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            keyframe_inlier_ratio: 0.75,
            min_keyframe_interval: 0.09,
            wanted_points: 100,
            redundant_share: 0.9,
            min_found_ratio: 0.25,
            max_new_point_depth: 6.0,
            first_frames: 6,
        }
    }
}

/// Local bundle adjustment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct BundleAdjustmentConfig {
    /// Off for comparison only.
    pub enabled: bool,
    /// Keyframes whose poses are free.
    #[schemars(range(min = 1, max = 100))]
    pub window: usize,
    /// Keyframes outside the window that hold it in place.
    #[schemars(range(min = 0, max = 200))]
    pub max_fixed: usize,
    /// Iterations of each of the two passes (with and without outliers).
    #[schemars(range(min = 1, max = 50))]
    pub iterations: usize,
    /// The result is taken over this many frames after the keyframe, or with the next keyframe if that comes earlier, so that every
    /// run gives the same trajectory. Beside a live camera (`queue: newest`) a result that is late then is not waited for.
    #[schemars(range(min = 0, max = 30))]
    pub delay_frames: usize,
}

impl Default for BundleAdjustmentConfig {
    fn default() -> Self {
        Self { enabled: true, window: 12, max_fixed: 20, iterations: 5, delay_frames: 3 }
    }
}

/// Recognition of places seen before.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PlaceConfig {
    /// Whether a lost camera is looked for in the whole map.
    pub relocalization: bool,
    /// Whether loops are closed.
    pub loop_closing: bool,
    /// Keyframes that are checked geometrically at most.
    #[schemars(range(min = 1, max = 50))]
    pub candidates: usize,
    /// Inliers that a recognised place must have.
    #[schemars(range(min = 10, max = 500))]
    pub min_inliers: usize,
    /// Keyframes between two visits of a place that make it a loop. A camera that turns round once leaves a dozen.
    #[schemars(range(min = 5, max = 1000))]
    pub min_loop_gap: usize,
    /// A camera that was lost for this long in view of something starts a new segment of the map at its last known pose, seconds.
    /// The segment moves to its true place once it shows a place that is known.
    #[schemars(range(min = 0.1, max = 3600.0))]
    pub new_segment_after: f64,
}

impl Default for PlaceConfig {
    fn default() -> Self {
        Self {
            relocalization: true,
            loop_closing: true,
            candidates: 8,
            min_inliers: 40,
            min_loop_gap: 5,
            new_segment_after: 3.0,
        }
    }
}
