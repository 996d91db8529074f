//! `pfd_slam_msgs`: the messages of this project; the `.msg` files are in `msgs/pfd_slam_msgs`.

use serde::{Deserialize, Serialize};

use super::{messages, service};
use super::{sensor::RegionOfInterest, standard::Header};

/// `pfd_slam_msgs/DynamicRegion`: a moving object in the image.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DynamicRegion {
    /// Stays the same while the object is followed.
    pub id: u32,
    /// Rectangle around the object, pixels.
    pub bounding_box: RegionOfInterest,
    /// Depth of its nearest part, metres.
    pub depth_min: f32,
    /// Depth of its farthest part, metres.
    pub depth_max: f32,
    /// Pixels of the mask that belong to it.
    pub pixel_count: u32,
    /// Mean of the particles: x, y (pixels), vx, vy (pixels/s).
    pub particle_mean: [f64; 4],
    /// Covariance of the particles, row by row.
    pub particle_covariance: [f64; 16],
    /// Velocity in the image, pixels/s: x, y.
    pub image_velocity: [f64; 2],
}

/// `pfd_slam_msgs/DynamicRegions`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DynamicRegions {
    /// Stamp and frame of the colour image.
    pub header: Header,
    /// The moving objects.
    pub regions: Vec<DynamicRegion>,
}

/// `pfd_slam_msgs/StageTime`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StageTime {
    /// Stage.
    pub name: String,
    /// How long it took.
    pub milliseconds: f64,
}

/// `pfd_slam_msgs/TrackingState`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TrackingState {
    /// Stamp and frame of the colour image.
    pub header: Header,
    /// One of the constants.
    pub state: u8,
    /// Features in the image outside the mask.
    pub features: u32,
    /// Features that agree with the pose.
    pub inliers: u32,
    /// Keyframes in the map.
    pub keyframes: u32,
    /// Points in the map.
    pub map_points: u32,
    /// Whether this image became a keyframe.
    pub is_keyframe: bool,
    /// Whether the mask of this image was used.
    pub mask_used: bool,
    /// Share of the image that is masked, 0 to 1.
    pub mask_fraction: f32,
    /// Time for segmentation, ms; 0 where another node segments.
    pub segmentation_ms: f64,
    /// Time for tracking, ms.
    pub tracking_ms: f64,
    /// Times of the stages of tracking.
    pub stages: Vec<StageTime>,
}

impl TrackingState {
    /// No map yet.
    pub const NOT_INITIALIZED: u8 = 0;
    /// The pose is known.
    pub const OK: u8 = 1;
    /// The pose is not known.
    pub const LOST: u8 = 2;
    /// The pose is known again.
    pub const RELOCALIZED: u8 = 3;
}

messages!("pfd_slam_msgs": DynamicRegions, TrackingState);

/// Request of `pfd_slam_msgs/FilePath`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FilePathRequest {
    /// A file on the machine of the node.
    pub path: String,
}

/// Response of `pfd_slam_msgs/FilePath`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FilePathResponse {
    /// Whether it was done.
    pub success: bool,
    /// What was done, or why not.
    pub message: String,
}

service!("pfd_slam_msgs", FilePath: FilePathRequest => FilePathResponse);
