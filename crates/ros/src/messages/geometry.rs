//! `geometry_msgs` and `tf2_msgs`.

use serde::{Deserialize, Serialize};

use super::{messages, standard::Header};

/// `geometry_msgs/Point` and `geometry_msgs/Vector3`, which look the same on the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Vector3 {
    /// First coordinate.
    pub x: f64,
    /// Second coordinate.
    pub y: f64,
    /// Third coordinate.
    pub z: f64,
}

/// `geometry_msgs/Quaternion`
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Quaternion {
    /// i
    pub x: f64,
    /// j
    pub y: f64,
    /// k
    pub z: f64,
    /// Real part.
    pub w: f64,
}

impl Default for Quaternion {
    fn default() -> Self {
        Self { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }
    }
}

/// `geometry_msgs/Pose`
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Metres.
    pub position: Vector3,
    /// Unit quaternion.
    pub orientation: Quaternion,
}

/// `geometry_msgs/PoseStamped`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseStamped {
    /// Stamp and frame.
    pub header: Header,
    /// The pose.
    pub pose: Pose,
}

/// `geometry_msgs/PoseWithCovariance`
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseWithCovariance {
    /// The pose.
    pub pose: Pose,
    /// Covariance of x y z and rotation about X Y Z, by rows.
    pub covariance: [[f64; 6]; 6],
}

/// `geometry_msgs/Twist`
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Twist {
    /// m/s
    pub linear: Vector3,
    /// rad/s
    pub angular: Vector3,
}

/// `geometry_msgs/TwistWithCovariance`
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TwistWithCovariance {
    /// The twist.
    pub twist: Twist,
    /// Covariance of linear and angular velocity, by rows.
    pub covariance: [[f64; 6]; 6],
}

/// `geometry_msgs/Transform`
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Transform {
    /// Metres.
    pub translation: Vector3,
    /// Unit quaternion.
    pub rotation: Quaternion,
}

/// `geometry_msgs/TransformStamped`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TransformStamped {
    /// Stamp and parent frame.
    pub header: Header,
    /// Child frame.
    pub child_frame_id: String,
    /// `T_parent_child`.
    pub transform: Transform,
}

/// `tf2_msgs/TFMessage`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TfMessage {
    /// The transforms.
    pub transforms: Vec<TransformStamped>,
}

messages!("geometry_msgs": PoseStamped);

impl super::Message for TfMessage {
    const PACKAGE: &'static str = "tf2_msgs";
    const NAME: &'static str = "TFMessage";
}
