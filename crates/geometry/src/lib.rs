//! Geometry vocabulary shared by every crate: stamps, images, cameras, poses, RGB-D frames.
//!
//! # Frames and conventions
//! * `T_a_b` maps coordinates in frame `b` to coordinates in frame `a`: `p_a = T_a_b * p_b`.
//! * The camera frame is the optical frame of REP-103: x right, y down, z forward, metres.
//! * Pixel coordinates are `(u, v)` = (column, row); the centre of the top-left pixel is `(0, 0)`.
//! * Depth is the z coordinate in the camera frame in metres; `0.0` means "no measurement".

pub mod alignment;
pub mod association;
pub mod camera;
pub mod encoded;
pub mod frame;
pub mod image;
pub mod pose;
pub mod sensor;
pub mod stamp;
pub mod timing;
pub mod trajectory;

pub use camera::{Camera, CameraError, Distortion};
pub use frame::{FrameError, RgbdFrame};
pub use image::{DepthImage, GrayImage, Image, ImageError, Mask, RgbImage};
pub use pose::{Pose, StampedPose};
pub use sensor::DepthNoise;
pub use stamp::{Stamp, StampError};
pub use timing::StageTimes;
pub use trajectory::TrajectoryError;
