//! `std_msgs`, `builtin_interfaces`, `rosgraph_msgs`, `std_srvs`.

use pfd_geometry::Stamp;
use serde::{Deserialize, Serialize};

use super::{messages, service};

/// `builtin_interfaces/Time`
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Time {
    /// Seconds since the epoch.
    pub sec: i32,
    /// Nanoseconds of the second.
    pub nanosec: u32,
}

impl From<Stamp> for Time {
    fn from(stamp: Stamp) -> Self {
        let (sec, nanosec) = stamp.to_sec_nanosec();
        Self { sec, nanosec }
    }
}

impl From<Time> for Stamp {
    fn from(time: Time) -> Self {
        Self::from_sec_nanosec(time.sec, time.nanosec)
    }
}

/// `builtin_interfaces/Duration`
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Duration {
    /// Seconds.
    pub sec: i32,
    /// Nanoseconds of the second.
    pub nanosec: u32,
}

/// `std_msgs/Header`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// When the data was taken.
    pub stamp: Time,
    /// Frame in which the data is given.
    pub frame_id: String,
}

impl Header {
    /// A header from a stamp and a frame.
    pub fn new(stamp: Stamp, frame_id: &str) -> Self {
        Self { stamp: stamp.into(), frame_id: frame_id.to_owned() }
    }
}

/// `std_msgs/ColorRGBA`
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ColorRgba {
    /// Red, 0 to 1.
    pub r: f32,
    /// Green, 0 to 1.
    pub g: f32,
    /// Blue, 0 to 1.
    pub b: f32,
    /// Opacity, 0 to 1.
    pub a: f32,
}

/// `rosgraph_msgs/Clock`
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Clock {
    /// The simulated time.
    pub clock: Time,
}

messages!("rosgraph_msgs": Clock);

/// Request of `std_srvs/Trigger`. An empty ROS 2 message has one byte on the wire.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct TriggerRequest {
    /// Padding that rosidl puts into empty structures.
    pub structure_needs_at_least_one_member: u8,
}

/// Response of `std_srvs/Trigger`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TriggerResponse {
    /// Whether it was done.
    pub success: bool,
    /// What was done, or why not.
    pub message: String,
}

service!("std_srvs", Trigger: TriggerRequest => TriggerResponse);
