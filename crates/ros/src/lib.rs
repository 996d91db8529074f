//! ROS 2 for the nodes: messages, names, command line, quality of service, time, transforms, logging, parameters, and a node that
//! survives its middleware. The only crate that knows ros2-client and RustDDS.

pub mod args;
pub mod clock;
pub mod convert;
pub mod diagnostics;
pub mod error;
pub mod graph;
pub mod messages;
pub mod names;
pub mod network;
pub mod node;
pub mod parameter_server;
pub mod qos;
pub mod rosout;
pub mod runtime;
pub mod slot;
pub mod synchronizer;
pub mod tf;
pub mod watchdog;

pub use args::{Arguments, LogLevel};
pub use clock::Clock;
pub use diagnostics::{Level, Throttle, TopicStatistics};
pub use error::RosError;
pub use graph::Graph;
pub use names::Names;
pub use node::{Node, Publisher};
pub use parameter_server::{ParameterServer, ParameterServerOptions};
pub use qos::Qos;
pub use runtime::{Setup, run};
pub use slot::Slot;
pub use synchronizer::{SyncCounters, Synchronizer};
pub use tf::{StaticTransforms, upright_map};
