//! What happens in `slam_node` before tracking: segmentation, on a thread of its own.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;

use anyhow::Context;
use crossbeam_channel::{Sender, bounded};
use pfd_ros::diagnostics::Level;

use crate::camera_input::RawFrame;
use crate::segmentation_stage::SegmentationStage;
use crate::slam::Shared;
use crate::slam_processor::{Segmented, TrackingJob};
use crate::worker::{Frame, Health, Processor};

/// Hands frames to tracking and segments them meanwhile: what moves follows.
pub struct FirstStage {
    stage: SegmentationStage,
    shared: Arc<Shared>,
    resets: u64,
    /// Waits while tracking is behind. Dropped at the end, which ends tracking.
    next: Option<Sender<TrackingJob>>,
    /// How tracking goes, which does not see frames while it is paused.
    tracking: Health,
}

impl FirstStage {
    /// A stage that hands over to `next`; `tracking` is how that goes.
    pub fn new(stage: SegmentationStage, shared: Arc<Shared>, next: Sender<TrackingJob>, tracking: Health) -> Self {
        Self { stage, shared, resets: 0, next: Some(next), tracking }
    }

    fn segment(&mut self, frame: &Frame) -> anyhow::Result<Segmented> {
        let start = Instant::now();
        let segmentation = self.stage.segment(frame).context("segmentation")?;
        Ok(Segmented { segmentation, milliseconds: start.elapsed().as_secs_f64() * 1e3 })
    }

    fn hand_over(&self, job: TrackingJob) -> anyhow::Result<()> {
        self.next.as_ref().is_some_and(|next| next.send(job).is_ok()).then_some(()).context("tracking has ended")
    }
}

impl Processor for FirstStage {
    type Job = RawFrame;

    fn process(&mut self, raw: RawFrame) -> anyhow::Result<()> {
        let resets = self.shared.resets.load(Ordering::Relaxed);
        if std::mem::replace(&mut self.resets, resets) != resets {
            self.stage.reset();
        }
        if self.shared.paused.load(Ordering::Relaxed) {
            self.tracking.report(Level::Warn, "paused".into(), Vec::new());
            return Ok(());
        }
        match Frame::decode(&raw).map(Arc::new) {
            Ok(frame) => {
                let (found, segmented) = bounded(1);
                self.hand_over(TrackingJob::new(&raw, Ok(frame.clone()), Some(segmented)))?;
                // Where tracking could not use the frame it does not listen any more.
                drop(found.send(self.segment(&frame)));
                Ok(())
            }
            // A frame that cannot be used goes on as well: tracking says on its topics what became of it.
            Err(error) => self.hand_over(TrackingJob::new(&raw, Err(error.into()), None)),
        }
    }

    fn finish(&mut self) -> anyhow::Result<()> {
        self.next = None;
        Ok(())
    }
}
