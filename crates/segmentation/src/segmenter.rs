//! The entry point: one frame in, one mask out, by the configured mode.

use pfd_geometry::{Camera, Mask, RgbdFrame, StageTimes, Stamp};

use crate::config::{Mode, SegmentationConfig};
use crate::result::{Segmentation, SegmentationError, Status};
use crate::rigid::{Outcome, RigidSegmenter};

/// Finds what moves, frame by frame.
#[derive(Debug)]
pub struct Segmenter {
    camera: Camera,
    engine: Engine,
}

#[derive(Debug)]
enum Engine {
    Rigid(Box<RigidSegmenter>),
    None,
}

impl Segmenter {
    /// A segmenter for one camera. The same `seed` gives the same masks.
    ///
    /// # Errors
    /// [`SegmentationError::Parameter`] when a parameter is out of range.
    pub fn new(camera: Camera, mode: Mode, config: &SegmentationConfig, seed: u64) -> Result<Self, SegmentationError> {
        pfd_vision::use_single_thread()?;
        let engine = match mode {
            Mode::Pfd => Engine::Rigid(Box::new(RigidSegmenter::new(&camera, config, seed))),
            Mode::Paper | Mode::Single | Mode::Flow | Mode::None => Engine::None,
        };
        Ok(Self { camera, engine })
    }

    /// Segments one frame.
    ///
    /// # Errors
    /// [`SegmentationError::Frame`] when the frame is not of the camera's size; [`SegmentationError::Vision`] when an image
    /// operation fails.
    pub fn segment(&mut self, frame: &RgbdFrame) -> Result<Segmentation, SegmentationError> {
        frame.check_camera(&self.camera)?;
        let mut timing = StageTimes::default();
        let mut mask = Mask::empty(self.camera.width, self.camera.height);
        let mut status = Status::Segmented;
        if let Engine::Rigid(engine) = &mut self.engine {
            let time = seconds(frame.stamp());
            status = match engine.step(frame, time, &mut timing)? {
                Outcome::First => Status::FirstFrame,
                Outcome::Failed(reason) => Status::FailedOpen(reason),
                Outcome::Done => Status::Segmented,
            };
            if status == Status::Segmented {
                timing.measure("enlarge", || engine.view.enlarge(&engine.mask, &mut mask));
            }
        }
        Ok(Segmentation { stamp: frame.stamp(), mask, regions: vec![], particles: vec![], status, timing })
    }

    /// Forgets everything, as if no frame had been seen.
    pub fn reset(&mut self) {
        match &mut self.engine {
            Engine::Rigid(engine) => engine.reset(),
            Engine::None => {}
        }
    }
}

fn seconds(stamp: Stamp) -> f64 {
    stamp.as_secs_f64()
}
