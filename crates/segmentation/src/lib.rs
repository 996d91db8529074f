//! Dynamic-region segmentation without a learned prior (PFD-SLAM, sections 3.1 and 3.2)

pub mod clustering;
mod config;
pub mod inter_frame;
pub mod kmeans;
mod paper;
pub mod particle_filter;
mod result;
mod rigid;
mod segmenter;

pub use config::{
    Compensation, MissingDepth, Mode, PaperConfig, ParticleConfig, PfdConfig, RegionShape, SegmentationConfig,
    UnknownMode,
};
pub use result::{BoundingBox, DynamicRegion, FailOpenReason, NewRegion, Segmentation, SegmentationError, Status};
pub use segmenter::Segmenter;
