//! RGB-D tracking and mapping: a pose for every frame, against a map of keyframes and points that is built on the way.
//!
//! [`Tracker::track`] takes a frame and the mask of what moves in it (from wherever), and returns the pose. Nothing here knows
//! how masks are made, or ROS.

mod active;
mod agreement;
mod alignment;
mod background;
pub mod bundle_adjustment;
mod clarity;
pub mod config;
mod first_frames;
pub mod image_features;
mod keyframe_decision;
pub mod local_mapping;
pub mod localization;
mod loop_closing;
pub mod map;
pub mod map_file;
mod mapper;
mod mask_check;
pub mod matching;
mod motion;
mod motion_filter;
pub mod places;
pub mod pose_graph;
pub mod pose_optimization;
mod refinement;
mod relocalization;
pub mod residual;
mod result;
pub mod rolling_shutter;
mod segments;
mod surface_depth;
mod tracker;
mod trajectory;

pub use config::TrackingConfig;
pub use map_file::{MapFileError, MapSnapshot};
pub use result::{MapPointView, TrackedFrame, TrackingError, TrackingState};
pub use tracker::{Located, Tracker};
