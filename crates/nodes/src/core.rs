//! The algorithms of a node: tracking alone, or segmentation and tracking composed.

use pfd_geometry::{Camera, Mask, RgbdFrame};
use pfd_pipeline::{Pipeline, SlamConfig};
use pfd_segmentation::Segmentation;
use pfd_tracking::{TrackedFrame, Tracker};

/// Which of the two.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Masks come from another node.
    Tracking,
    /// Masks are made here.
    Composed,
}

/// The algorithms for one camera.
pub enum Core {
    /// Masks come from another node.
    Tracking(Box<Tracker>),
    /// Masks are made here.
    Composed(Box<Pipeline>),
}

/// The outcome for a frame.
pub struct Outcome {
    /// What moves, where it was found here.
    pub segmentation: Option<Segmentation>,
    /// Where the camera is.
    pub tracked: TrackedFrame,
    /// Time for segmentation, ms.
    pub segmentation_ms: f64,
    /// Time for tracking, ms.
    pub tracking_ms: f64,
}

impl Core {
    /// The algorithms as configured.
    ///
    /// # Errors
    /// When a parameter is out of range.
    pub fn new(kind: Kind, camera: Camera, config: &SlamConfig) -> anyhow::Result<Self> {
        Ok(match kind {
            Kind::Tracking => Self::Tracking(Box::new(Tracker::new(camera, &config.tracking, config.seed)?)),
            Kind::Composed => Self::Composed(Box::new(Pipeline::new(camera, config)?)),
        })
    }

    /// Works on a frame; `mask` is that of another node.
    ///
    /// # Errors
    /// When the frame cannot be used.
    pub fn process(&mut self, frame: &RgbdFrame, mask: Option<&Mask>) -> anyhow::Result<Outcome> {
        match self {
            Self::Tracking(tracker) => {
                let tracked = tracker.track(frame, mask)?;
                let tracking_ms = tracked.timing.total();
                Ok(Outcome { segmentation: None, tracked, segmentation_ms: 0.0, tracking_ms })
            }
            Self::Composed(pipeline) => {
                let output = pipeline.process(frame)?;
                Ok(Outcome {
                    segmentation: Some(output.segmentation),
                    tracked: output.tracked,
                    segmentation_ms: output.segmentation_ms,
                    tracking_ms: output.tracking_ms,
                })
            }
        }
    }

    /// The tracker.
    pub fn tracker(&self) -> &Tracker {
        match self {
            Self::Tracking(tracker) => tracker,
            Self::Composed(pipeline) => pipeline.tracker(),
        }
    }

    /// The tracker, to change.
    pub fn tracker_mut(&mut self) -> &mut Tracker {
        match self {
            Self::Tracking(tracker) => tracker,
            Self::Composed(pipeline) => pipeline.tracker_mut(),
        }
    }

    /// Forgets everything, as at the start.
    pub fn reset(&mut self) {
        match self {
            Self::Tracking(tracker) => tracker.reset(),
            Self::Composed(pipeline) => pipeline.reset(),
        }
    }

    /// Waits for background work.
    pub fn finish(&mut self) {
        match self {
            Self::Tracking(tracker) => tracker.finish(),
            Self::Composed(pipeline) => pipeline.finish(),
        }
    }
}
