//! Segmentation and tracking composed: one frame in, mask and pose out. No middleware, no files.

mod config;
mod pipeline;

pub use config::{CameraConfig, SlamConfig};
pub use pfd_segmentation::Mode;
pub use pipeline::{Pipeline, PipelineError, PipelineOutput};
