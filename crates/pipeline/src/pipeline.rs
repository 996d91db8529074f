//! Frame → mask → pose.

use std::time::Instant;

use pfd_geometry::{Camera, Mask, RgbdFrame, StageTimes};
use pfd_segmentation::{Segmentation, SegmentationError, Segmenter, Status};
use pfd_tracking::{TrackedFrame, Tracker, TrackingError};

use crate::config::SlamConfig;

/// A frame that could not be processed.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// In segmentation.
    #[error("segmentation")]
    Segmentation(#[from] SegmentationError),
    /// In tracking.
    #[error("tracking")]
    Tracking(#[from] TrackingError),
}

/// Mask and pose of a frame, and how long they took.
#[derive(Clone, Debug)]
pub struct PipelineOutput {
    /// What moves.
    pub segmentation: Segmentation,
    /// Where the camera is.
    pub tracked: TrackedFrame,
    /// Wall-clock time of segmentation, milliseconds.
    pub segmentation_ms: f64,
    /// Wall-clock time of tracking, milliseconds.
    pub tracking_ms: f64,
}

/// Segmentation and tracking in one.
pub struct Pipeline {
    segmenter: Segmenter,
    tracker: Tracker,
}

impl Pipeline {
    /// Both stages for one camera.
    ///
    /// # Errors
    /// When a stage refuses its configuration.
    pub fn new(camera: Camera, config: &SlamConfig) -> Result<Self, PipelineError> {
        Ok(Self {
            segmenter: Segmenter::new(camera, config.mode, &config.segmentation, config.seed)?,
            tracker: Tracker::new(camera, &config.tracking, config.seed)?,
        })
    }

    /// Finds what moves and then the pose.
    ///
    /// # Errors
    /// When the frame does not fit the camera or is out of order.
    pub fn process(&mut self, frame: &RgbdFrame) -> Result<PipelineOutput, PipelineError> {
        let start = Instant::now();
        let segmentation = self.segmenter.segment(frame)?;
        let segmentation_ms = milliseconds_since(start);
        self.track(frame, segmentation, segmentation_ms)
    }

    /// The pose with a given mask, such as the ground truth's.
    ///
    /// # Errors
    /// When frame or mask do not fit the camera, or the frame is out of order.
    pub fn process_with_mask(&mut self, frame: &RgbdFrame, mask: &Mask) -> Result<PipelineOutput, PipelineError> {
        let segmentation = Segmentation {
            stamp: frame.stamp(),
            mask: mask.clone(),
            regions: Vec::new(),
            particles: Vec::new(),
            status: Status::Segmented,
            timing: StageTimes::default(),
        };
        self.track(frame, segmentation, 0.0)
    }

    fn track(
        &mut self,
        frame: &RgbdFrame,
        segmentation: Segmentation,
        segmentation_ms: f64,
    ) -> Result<PipelineOutput, PipelineError> {
        let start = Instant::now();
        let tracked = self.tracker.track(frame, Some(&segmentation.mask))?;
        Ok(PipelineOutput { segmentation, tracked, segmentation_ms, tracking_ms: milliseconds_since(start) })
    }

    /// The tracker with its map.
    pub fn tracker(&self) -> &Tracker {
        &self.tracker
    }

    /// The tracker, to save or load its map.
    pub fn tracker_mut(&mut self) -> &mut Tracker {
        &mut self.tracker
    }

    /// Waits for background work.
    pub fn finish(&mut self) {
        self.tracker.finish();
    }

    /// Forgets masks and map.
    pub fn reset(&mut self) {
        self.segmenter.reset();
        self.tracker.reset();
    }
}

fn milliseconds_since(start: Instant) -> f64 {
    start.elapsed().as_secs_f64() * 1e3
}
