//! Segmentation of frame after frame, in `segmentation_node` and as the first stage of `slam_node`.

use std::sync::Arc;

use pfd_geometry::{Camera, Stamp};
use pfd_pipeline::SlamConfig;
use pfd_segmentation::{Mode, Segmentation, SegmentationConfig, Segmenter};

use crate::outlet::Outlet;
use crate::segmentation::{MaskOutput, figures, judge};
use crate::settings::{LiveSettings, is_set_back};
use crate::worker::{Frame, Health};

/// Segments frames and publishes what it finds.
pub struct SegmentationStage {
    settings: LiveSettings,
    segmenter: Option<(Segmenter, Plan)>,
    last_stamp: Option<Stamp>,
    output: Arc<Outlet<MaskOutput>>,
    health: Health,
}

/// What a segmenter is made for.
#[derive(Clone, PartialEq)]
struct Plan {
    camera: Camera,
    mode: Mode,
    config: SegmentationConfig,
    seed: u64,
}

impl Plan {
    fn new(camera: Camera, slam: SlamConfig) -> Self {
        Self { camera, mode: slam.mode, config: slam.segmentation, seed: slam.seed }
    }
}

impl SegmentationStage {
    /// A stage that has not seen a frame yet.
    pub fn new(settings: LiveSettings, output: Arc<Outlet<MaskOutput>>, health: Health) -> Self {
        Self { settings, segmenter: None, last_stamp: None, output, health }
    }

    /// Finds what moves in a frame and publishes it.
    ///
    /// # Errors
    /// When the frame cannot be used or a parameter is out of range.
    pub fn segment(&mut self, frame: &Frame) -> anyhow::Result<Segmentation> {
        let segmentation = self.segmenter(frame)?.segment(&frame.images)?;
        if let Some(output) = self.output.get() {
            output.publish(frame, &segmentation);
        }
        let (level, message) = judge(&segmentation);
        self.health.report(level, message, figures(&segmentation));
        Ok(segmentation)
    }

    /// Forgets what it saw, as at the start.
    pub fn reset(&mut self) {
        if let Some((segmenter, _)) = &mut self.segmenter {
            segmenter.reset();
        }
    }

    /// The segmenter for this frame: a new one when camera or parameters changed, a fresh start when time was set back.
    fn segmenter(&mut self, frame: &Frame) -> anyhow::Result<&mut Segmenter> {
        let stamp = frame.images.stamp();
        if self.last_stamp.replace(stamp).is_some_and(|last| is_set_back(last, stamp)) {
            tracing::warn!("time was set back to {stamp}: segmentation starts afresh");
            self.reset();
        }
        let plan = Plan::new(frame.camera, self.settings.get().slam);
        let kept = self.segmenter.take().filter(|(_, made_for)| *made_for == plan);
        let segmenter = match kept {
            Some((segmenter, _)) => segmenter,
            None => Segmenter::new(plan.camera, plan.mode, &plan.config, plan.seed)?,
        };
        let (segmenter, _) = self.segmenter.insert((segmenter, plan));
        Ok(segmenter)
    }
}
