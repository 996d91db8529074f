//! The ROS 2 nodes. A callback decodes, calls the algorithms, publishes; the algorithms know nothing of ROS.
//!
//! Messages come in on two threads of the middleware's runtime ([`camera_input`]), the work is done on a named thread a node
//! ([`worker`]) that takes the newest frame (or every frame, parameter `queue`); in `slam_node` on two, so that a frame is segmented
//! while the one before it is tracked.

pub mod app;
pub mod camera_health;
pub mod camera_input;
pub mod first_stage;
pub mod mask_box;
pub mod mask_input;
pub mod node_diagnostics;
pub mod outlet;
pub mod overlay;
pub mod recorder;
pub mod replay;
pub mod replay_output;
pub mod segmentation;
pub mod segmentation_stage;
pub mod settings;
pub mod slam;
pub mod slam_processor;
pub mod startup;
pub mod tracking_output;
pub mod worker;
