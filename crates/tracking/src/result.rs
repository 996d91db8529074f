//! What tracking returns.

use nalgebra::{Matrix6, Point3, Vector6};
use pfd_geometry::{FrameError, Pose, StageTimes, Stamp};
use pfd_vision::VisionError;

/// A frame that could not be processed. The map is unchanged.
#[derive(Debug, thiserror::Error)]
pub enum TrackingError {
    /// The frame does not fit the camera model.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// Feature extraction failed, or the mask does not fit the image.
    #[error(transparent)]
    Vision(#[from] VisionError),
    /// The stamp is not later than that of the last frame.
    #[error("stamp {stamp} is not after {last}, the stamp of the last frame; the frame is skipped")]
    OutOfOrder {
        /// Of this frame.
        stamp: Stamp,
        /// Of the last frame.
        last: Stamp,
    },
}

/// Whether the pose is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrackingState {
    /// No frame yet that a map could start from.
    NotInitialized,
    /// The pose is known.
    Ok,
    /// The pose is not known.
    Lost,
    /// The pose is known again since this frame.
    Relocalized,
}

impl std::fmt::Display for TrackingState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::NotInitialized => "NOT_INITIALIZED",
            Self::Ok => "OK",
            Self::Lost => "LOST",
            Self::Relocalized => "RELOCALIZED",
        })
    }
}

/// The outcome for one frame.
#[derive(Clone, Debug, PartialEq)]
#[allow(non_snake_case)]
pub struct TrackedFrame {
    /// Of the colour image.
    pub stamp: Stamp,
    /// Whether the pose is known.
    pub state: TrackingState,
    /// Camera to map, when the pose is known. Jumps when the map is corrected.
    pub T_world_camera: Option<Pose>,
    /// Camera to odometry frame, when the pose is known. Continuous; drifts.
    pub T_odom_camera: Option<Pose>,
    /// Covariance of a perturbation on the right of the pose, in the camera frame (tx ty tz rx ry rz; m², rad²).
    pub covariance: Matrix6<f64>,
    /// Whether the camera is in a part of the map whose place with respect to the rest is only guessed: it was lost for long, and has
    /// shown nothing known since. The covariance says so as well.
    pub is_apart: bool,
    /// Velocity of the camera in its own frame (vx vy vz wx wy wz; m/s, rad/s).
    pub twist: Vector6<f64>,
    /// Covariance of the twist (m²/s², rad²/s²); large while nothing is known of the velocity.
    pub twist_covariance: Matrix6<f64>,
    /// Whether there was a mask that was not given up.
    pub mask_used: bool,
    /// Features outside the mask, or all where the mask was given up.
    pub features: u32,
    /// Features that agree with the map.
    pub inliers: u32,
    /// Keyframes in the map.
    pub keyframes: u32,
    /// Points in the map.
    pub map_points: u32,
    /// Whether this frame became a keyframe.
    pub is_keyframe: bool,
    /// How long the stages took.
    pub timing: StageTimes,
}

/// A map point for display.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapPointView {
    /// In the world, metres.
    pub position: Point3<f64>,
    /// As first seen.
    pub color: [u8; 3],
}
