//! What segmentation hands on.

use std::fmt;

use nalgebra::{Matrix4, Vector2, Vector4};
use pfd_geometry::{FrameError, Mask, StageTimes, Stamp};
use pfd_vision::VisionError;

/// An axis-aligned rectangle, pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BoundingBox {
    /// Left column.
    pub x: u32,
    /// Top row.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// One moving thing.
#[derive(Clone, Debug, PartialEq)]
pub struct DynamicRegion {
    /// Stays the same while the thing is followed.
    pub id: u32,
    /// Around its pixels.
    pub bounding_box: BoundingBox,
    /// Nearest and farthest depth, metres.
    pub depth_interval: [f32; 2],
    /// Pixels of the mask that belong to it.
    pub pixel_count: u32,
    /// Mean of its particles: x, y (pixels), vx, vy (pixels per second).
    pub particle_mean: Vector4<f64>,
    /// Covariance of its particles.
    pub particle_covariance: Matrix4<f64>,
    /// Velocity in the image, pixels per second.
    pub image_velocity: Vector2<f64>,
}

/// Something that may be a mover and continues none that was known, as it was judged.
#[derive(Clone, Debug, PartialEq)]
pub struct NewRegion {
    /// Its places in the camera image, pixels: one for each pixel of the working view.
    pub pixels: Vec<[f32; 2]>,
    /// How strong each cue is on it, 0 to 1: free space that is occupied, what stands before the static model, other luma where
    /// depth is missing or the same, corners that move on their own, other texture; the same texture, the same place, the same
    /// luma where depth is missing.
    pub cues: [f32; Self::CUES],
    /// Whether it reaches the border of the image.
    pub at_border: bool,
    /// Whether it was taken for a mover.
    pub believed: bool,
}

impl NewRegion {
    /// Kinds of evidence by which it is judged.
    pub const CUES: usize = 8;
}

/// Why a mask was not believed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FailOpenReason {
    /// Too few corners agree on a camera motion.
    FewInliers {
        /// Corners that agree.
        inliers: usize,
        /// Corners needed.
        needed: usize,
    },
    /// The corners that agree lie in one part of the image.
    NarrowSupport {
        /// Share of the image that holds them.
        share: f64,
    },
    /// Nearly everything would be masked.
    MaskTooLarge {
        /// Share of the image.
        share: f64,
    },
}

impl fmt::Display for FailOpenReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::FewInliers { inliers, needed } => {
                write!(f, "camera motion uncertain: {inliers} corners agree, {needed} needed")
            }
            Self::NarrowSupport { share } => {
                write!(f, "camera motion uncertain: agreeing corners cover {:.0} % of the image", share * 100.0)
            }
            Self::MaskTooLarge { share } => write!(f, "the mask would cover {:.0} % of the image", share * 100.0),
        }
    }
}

/// How the result came about.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Status {
    /// Nothing to compare with yet: the mask is empty.
    FirstFrame,
    /// The mask holds what moves.
    Segmented,
    /// The mask was not believed and is empty.
    FailedOpen(FailOpenReason),
}

/// What moves in one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Segmentation {
    /// Stamp of the colour image.
    pub stamp: Stamp,
    /// 255 = dynamic, size of the frame.
    pub mask: Mask,
    /// One per moving thing.
    pub regions: Vec<DynamicRegion>,
    /// Positions (pixels) of the particles of each region.
    pub particles: Vec<Vec<[f32; 2]>>,
    /// How the result came about.
    pub status: Status,
    /// What took how long.
    pub timing: StageTimes,
}

/// A frame that cannot be segmented.
#[derive(Debug, thiserror::Error)]
pub enum SegmentationError {
    /// The frame is not of the size that the camera model describes.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// A parameter is out of range.
    #[error("segmentation.{name} = {value} is out of range: {expected}")]
    Parameter {
        /// Dotted name below `segmentation`.
        name: &'static str,
        /// The value.
        value: f64,
        /// What it should be.
        expected: &'static str,
    },
    /// An image operation failed.
    #[error(transparent)]
    Vision(#[from] VisionError),
}
