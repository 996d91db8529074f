//! Dynamic-region segmentation without a learned prior (PFD-SLAM, sections 3.1 and 3.2)

mod config;
pub mod particle_filter;
mod result;
mod rigid;
mod segmenter;

pub use config::{
    Compensation, Mode, PaperConfig, ParticleConfig, PfdConfig, RegionShape, SegmentationConfig, UnknownMode,
};
pub use result::{BoundingBox, DynamicRegion, FailOpenReason, Segmentation, SegmentationError, Status};
pub use segmenter::Segmenter;
