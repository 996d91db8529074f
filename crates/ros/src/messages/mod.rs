//! Messages as they go over the wire: field for field the `.msg` files of ROS 2 (humble to kilted), serialised by serde as CDR.
//!
//! Byte arrays are [`bytes::Bytes`], which are read and written in one piece. Fixed arrays longer than 32 are arrays of rows,
//! which CDR lays out the same way.

pub mod diagnostic;
pub mod geometry;
pub mod nav;
pub mod pfd;
pub mod rcl;
pub mod sensor;
pub mod standard;
pub mod visualization;

use serde::{Serialize, de::DeserializeOwned};

/// A message with its ROS 2 type name.
pub trait Message: Serialize + DeserializeOwned + Send + Sync + 'static {
    /// Package, such as `sensor_msgs`.
    const PACKAGE: &'static str;
    /// Name, such as `Image`.
    const NAME: &'static str;
}

/// A service type: its request and response.
pub trait Service {
    /// Package, such as `std_srvs`.
    const PACKAGE: &'static str;
    /// Name, such as `Trigger`.
    const NAME: &'static str;
    /// What the client sends.
    type Request: ros2_client::Message + Clone + Send + Sync + 'static;
    /// What the server answers.
    type Response: ros2_client::Message + Clone + Send + Sync + 'static;
}

macro_rules! messages {
    ($package:literal: $($message:ident),* $(,)?) => {
        $(impl $crate::messages::Message for $message {
            const PACKAGE: &'static str = $package;
            const NAME: &'static str = stringify!($message);
        })*
    };
}

macro_rules! service {
    ($package:literal, $name:ident: $request:ident => $response:ident) => {
        /// Type of the service.
        #[derive(Clone, Copy, Debug)]
        pub struct $name;
        impl ros2_client::Message for $request {}
        impl ros2_client::Message for $response {}
        impl $crate::messages::Service for $name {
            const PACKAGE: &'static str = $package;
            const NAME: &'static str = stringify!($name);
            type Request = $request;
            type Response = $response;
        }
    };
}

pub(crate) use {messages, service};
