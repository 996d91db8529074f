//! `nav_msgs`.

use serde::{Deserialize, Serialize};

use super::geometry::{PoseStamped, PoseWithCovariance, TwistWithCovariance};
use super::{messages, standard::Header};

/// `nav_msgs/Odometry`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Odometry {
    /// Stamp and frame of the pose.
    pub header: Header,
    /// Frame of the twist.
    pub child_frame_id: String,
    /// Pose of the child frame.
    pub pose: PoseWithCovariance,
    /// Velocity of the child frame in itself.
    pub twist: TwistWithCovariance,
}

/// `nav_msgs/Path`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Path {
    /// Stamp and frame.
    pub header: Header,
    /// Poses in the order of time.
    pub poses: Vec<PoseStamped>,
}

messages!("nav_msgs": Odometry, Path);
