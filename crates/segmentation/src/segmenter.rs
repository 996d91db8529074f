//! The entry point: one frame in, one mask out, by the configured mode.

use pfd_geometry::{Camera, Mask, RgbdFrame, StageTimes, Stamp};

use crate::config::{Mode, SegmentationConfig};
use crate::paper::PaperSegmenter;
use crate::result::{NewRegion, Segmentation, SegmentationError, Status};
use crate::rigid::{Outcome, RigidSegmenter};

/// Finds what moves, frame by frame.
#[derive(Debug)]
pub struct Segmenter {
    camera: Camera,
    mode: Mode,
    config: SegmentationConfig,
    seed: u64,
    engine: Engine,
    /// Stamp of the last frame.
    last: Option<Stamp>,
}

#[derive(Debug)]
enum Engine {
    Rigid(Box<RigidSegmenter>),
    Paper(Box<PaperSegmenter>),
    None,
}

impl Engine {
    fn new(camera: &Camera, mode: Mode, config: &SegmentationConfig, seed: u64) -> Self {
        match mode {
            Mode::Pfd => Self::Rigid(Box::new(RigidSegmenter::new(camera, config, seed))),
            Mode::Paper | Mode::Single | Mode::Flow => {
                Self::Paper(Box::new(PaperSegmenter::new((camera.width, camera.height), mode, config, seed)))
            }
            Mode::None => Self::None,
        }
    }
}

impl Segmenter {
    /// A segmenter for one camera. The same `seed` gives the same masks.
    ///
    /// # Errors
    /// [`SegmentationError::Parameter`] when a parameter is out of range.
    pub fn new(camera: Camera, mode: Mode, config: &SegmentationConfig, seed: u64) -> Result<Self, SegmentationError> {
        config.check()?;
        pfd_vision::use_single_thread()?;
        let engine = Engine::new(&camera, mode, config, seed);
        Ok(Self { camera, mode, config: config.clone(), seed, engine, last: None })
    }

    /// Segments one frame. One that is older than the last begins anew: a recording that repeats, or a clock that was set back.
    ///
    /// # Errors
    /// [`SegmentationError::Frame`] when the frame is not of the camera's size; [`SegmentationError::Vision`] when an image
    /// operation fails.
    pub fn segment(&mut self, frame: &RgbdFrame) -> Result<Segmentation, SegmentationError> {
        frame.check_camera(&self.camera)?;
        if self.last.replace(frame.stamp()).is_some_and(|last| frame.stamp() < last) {
            self.start_anew();
        }
        let time = frame.stamp().as_secs_f64();
        let mut result = Segmentation {
            stamp: frame.stamp(),
            mask: Mask::empty(self.camera.width, self.camera.height),
            regions: Vec::new(),
            particles: Vec::new(),
            status: Status::Segmented,
            timing: StageTimes::default(),
        };
        match &mut self.engine {
            Engine::Rigid(engine) => segment_rigid(engine, frame, time, &mut result)?,
            Engine::Paper(engine) => {
                let (status, found) = engine.step(frame, time, &mut result.mask, &mut result.timing)?;
                result.status = status;
                (result.regions, result.particles) = (found.regions, found.particles);
            }
            Engine::None => {}
        }
        Ok(result)
    }

    /// What the last frame showed that may be a mover and continued none, in mode `pfd`: believed or not. For calibration.
    pub fn new_regions(&self) -> &[NewRegion] {
        match &self.engine {
            Engine::Rigid(engine) => &engine.new_regions,
            Engine::Paper(_) | Engine::None => &[],
        }
    }

    /// Forgets everything, as if no frame had been seen.
    pub fn reset(&mut self) {
        self.last = None;
        self.start_anew();
    }

    fn start_anew(&mut self) {
        self.engine = Engine::new(&self.camera, self.mode, &self.config, self.seed);
    }
}

fn segment_rigid(
    engine: &mut RigidSegmenter,
    frame: &RgbdFrame,
    time: f64,
    result: &mut Segmentation,
) -> Result<(), SegmentationError> {
    result.status = match engine.step(frame, time, &mut result.timing)? {
        Outcome::First => Status::FirstFrame,
        Outcome::Failed(reason) => Status::FailedOpen(reason),
        Outcome::Done => Status::Segmented,
    };
    if result.status == Status::Segmented {
        let Segmentation { mask, timing, .. } = &mut *result;
        timing.measure("enlarge", || engine.view.enlarge(&engine.mask, mask));
        (result.regions, result.particles) = engine.report();
    }
    Ok(())
}
