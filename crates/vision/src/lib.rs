//! Image operations over the types of [`pfd_geometry`]. The only crate that links OpenCV.
//!
//! Nothing here knows segmentation, tracking or ROS; no OpenCV type appears in a public signature.

pub mod contours;
mod convert;
pub mod corners;
pub mod features;
pub mod optical_flow;
mod orb_pattern;
pub mod patch;
pub mod two_view;
pub mod warp;

pub use convert::{VisionError, use_single_thread};
