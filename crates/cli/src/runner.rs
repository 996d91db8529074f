//! Runs the pipeline over a sequence.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::Context;
use pfd_dataset::{Association, DatasetError, Sequence, images};
use pfd_geometry::{Camera, Mask, RgbdFrame, StageTimes, StampedPose};
use pfd_pipeline::{Pipeline, PipelineOutput, SlamConfig};
use pfd_report::sample::{overlay, spread};
use pfd_report::{FrameRow, Sample, Video};

use crate::commands::eval_masks::{images_in, stem};
use crate::progress::Progress;
use crate::{interrupt, setup};

/// How many frames a report shows.
pub(crate) const SAMPLES: usize = 8;

/// What to run.
#[derive(Debug)]
pub(crate) struct Job<'a> {
    pub(crate) sequence: &'a Sequence,
    pub(crate) camera: Camera,
    pub(crate) config: &'a SlamConfig,
    pub(crate) max_frames: Option<usize>,
    /// Folder of masks that replace segmentation.
    pub(crate) given_masks: Option<&'a Path>,
    /// Folder that receives the masks.
    pub(crate) save_masks: Option<PathBuf>,
    /// File that receives a video of the frames with their masks.
    pub(crate) video: Option<&'a Path>,
}

impl Job<'_> {
    /// Number of frames that will be processed.
    pub(crate) fn frames(&self) -> usize {
        self.sequence.len().min(self.max_frames.unwrap_or(usize::MAX))
    }
}

/// What came out.
#[derive(Debug, Default)]
pub(crate) struct Outcome {
    /// Poses after the last correction of the map.
    pub(crate) trajectory: Vec<StampedPose>,
    /// Poses as they were when their frame was done.
    pub(crate) live: Vec<StampedPose>,
    pub(crate) keyframes: Vec<StampedPose>,
    pub(crate) map_points: usize,
    pub(crate) rows: Vec<FrameRow>,
    /// Milliseconds of each stage, in the order in which the stages first ran.
    pub(crate) stages: Vec<(String, Vec<f64>)>,
    pub(crate) samples: Vec<Sample>,
    /// Frames whose images could not be read, or were not of the camera's size.
    pub(crate) skipped: usize,
}

/// Processes every frame.
pub(crate) fn run(job: &Job<'_>, progress: &Progress) -> anyhow::Result<Outcome> {
    check_size(job)?;
    let mut pipeline = Pipeline::new(job.camera, job.config)?;
    let masks = Masks::open(job)?;
    let size = (job.camera.width as u32, job.camera.height as u32);
    let mut video = job.video.map(|path| Video::create(path, size, frames_per_second(job.sequence))).transpose()?;
    let sampled = spread(job.frames(), SAMPLES);
    let mut outcome = Outcome::default();
    for (i, frame) in job.sequence.frames().take(job.frames()).enumerate() {
        interrupt::check()?;
        progress.step();
        let pair = job.sequence.pair(i);
        let frame = match frame.and_then(|frame| fitting(job, pair, frame)) {
            Ok(frame) => frame,
            Err(error) if error.concerns_one_frame() => {
                outcome.skipped += 1;
                progress.note(&format!("skipped: {error}"));
                continue;
            }
            Err(error) => return Err(error.into()),
        };
        let output = masks.process(&mut pipeline, &frame, pair)?;
        masks.save(pair, &output.segmentation.mask)?;
        if sampled.contains(&i) {
            outcome.samples.push(sample(job, &frame, &output)?);
        }
        if let Some(video) = &mut video {
            video.add(&overlay(frame.rgb(), &output.segmentation.mask))?;
        }
        outcome.add(&output);
    }
    video.map(Video::finish).transpose()?;
    // Segmentation before tracking, each in its own order.
    outcome.stages.sort_by(|(a, _), (b, _)| part(a).cmp(part(b)));
    anyhow::ensure!(!outcome.rows.is_empty(), "{}: no frame could be read", job.sequence.folder().display());
    pipeline.finish();
    let tracker = pipeline.tracker();
    outcome.trajectory = tracker.trajectory();
    outcome.keyframes = tracker.keyframe_trajectory();
    outcome.map_points = tracker.map_points().len();
    Ok(outcome)
}

/// Refuses a camera that no image fits, before every frame would be skipped.
fn check_size(job: &Job<'_>) -> anyhow::Result<()> {
    let camera = (job.camera.width, job.camera.height);
    let mut other = None;
    for pair in &job.sequence.pairs()[..job.frames()] {
        match images::size(&pair.rgb_path) {
            Ok(size) if size == camera => return Ok(()),
            Ok(size) => other = other.or(Some((&pair.rgb_path, size))),
            // Told when its turn comes.
            Err(_) => {}
        }
    }
    let Some((path, (width, height))) = other else { return Ok(()) };
    anyhow::bail!(
        "{}: the image is {width}x{height}, and none is {}x{} as the camera ({})",
        path.display(),
        camera.0,
        camera.1,
        setup::camera_origin(job.config, job.sequence)
    )
}

/// The frame, if it has the size of the camera.
fn fitting(job: &Job<'_>, pair: &Association, frame: RgbdFrame) -> Result<RgbdFrame, DatasetError> {
    match frame.check_camera(&job.camera) {
        Ok(()) => Ok(frame),
        Err(error) => Err(DatasetError::Frame { path: pair.rgb_path.clone(), error }),
    }
}

impl Outcome {
    fn add(&mut self, output: &PipelineOutput) {
        self.rows.push(row(output));
        let tracked = &output.tracked;
        self.live.extend(tracked.T_world_camera.map(|pose| StampedPose { stamp: tracked.stamp, pose }));
        self.add_times("segmentation", &output.segmentation.timing);
        self.add_times("tracking", &tracked.timing);
    }

    fn add_times(&mut self, part: &str, times: &StageTimes) {
        for (stage, ms) in &times.0 {
            let name = format!("{part}: {stage}");
            match self.stages.iter_mut().find(|(known, _)| *known == name) {
                Some((_, all)) => all.push(*ms),
                None => self.stages.push((name, vec![*ms])),
            }
        }
    }
}

/// The part of the pipeline that a stage belongs to.
fn part(stage: &str) -> &str {
    stage.split(':').next().unwrap_or_default()
}

fn row(output: &PipelineOutput) -> FrameRow {
    let PipelineOutput { segmentation, tracked, segmentation_ms, tracking_ms } = output;
    // Thousandths of a millisecond and millionths of the image are finer than either is known.
    let rounded = |value: f64, unit: f64| (value * unit).round() / unit;
    FrameRow {
        stamp: tracked.stamp.to_string(),
        state: tracked.state.to_string(),
        segmentation_ms: rounded(*segmentation_ms, 1e3),
        tracking_ms: rounded(*tracking_ms, 1e3),
        total_ms: rounded(segmentation_ms + tracking_ms, 1e3),
        features: tracked.features,
        inliers: tracked.inliers,
        mask_fraction: rounded(segmentation.mask.fraction(), 1e6),
        objects: segmentation.regions.len(),
    }
}

fn sample(job: &Job<'_>, frame: &RgbdFrame, output: &PipelineOutput) -> anyhow::Result<Sample> {
    let segmentation = &output.segmentation;
    let time = frame.stamp().seconds_since(job.sequence.pair(0).rgb_stamp);
    let caption = caption(time, segmentation.mask.fraction(), segmentation.regions.len());
    Ok(Sample::new(frame.stamp(), caption, frame.rgb(), &segmentation.mask)?)
}

/// Rate of the recording.
fn frames_per_second(sequence: &Sequence) -> f64 {
    const USUAL: f64 = 30.0;
    let pairs = sequence.pairs();
    let seconds = match pairs {
        [first, .., last] => last.rgb_stamp.seconds_since(first.rgb_stamp),
        _ => 0.0,
    };
    if seconds > 0.0 { (pairs.len() - 1) as f64 / seconds } else { USUAL }
}

/// The line under a sample frame.
pub(crate) fn caption(seconds: f64, masked: f64, objects: usize) -> String {
    let plural = if objects == 1 { "object" } else { "objects" };
    format!("{seconds:.2} s: {:.0} % masked, {objects} {plural}", 100.0 * masked)
}

/// Masks that come from files and go to files.
struct Masks {
    given: Option<(PathBuf, BTreeMap<String, PathBuf>)>,
    target: Option<PathBuf>,
    /// Names that more than one frame's colour image has; masks of these are named by stamp.
    repeated: BTreeSet<String>,
}

impl Masks {
    fn open(job: &Job<'_>) -> anyhow::Result<Self> {
        if let Some(folder) = &job.save_masks {
            prepare(folder, job.given_masks)?;
        }
        let given = job.given_masks.map(|folder| anyhow::Ok((folder.to_owned(), images_in(folder)?))).transpose()?;
        Ok(Self { given, target: job.save_masks.clone(), repeated: repeated_stems(job.sequence.pairs()) })
    }

    /// What the mask of a frame is called: like the colour image, else by the stamp, which no two frames share.
    fn name(&self, pair: &Association) -> String {
        let stem = file_stem(pair);
        if self.repeated.contains(&stem) { pair.rgb_stamp.to_string() } else { stem }
    }

    fn process(
        &self,
        pipeline: &mut Pipeline,
        frame: &RgbdFrame,
        pair: &Association,
    ) -> anyhow::Result<PipelineOutput> {
        let Some((folder, given)) = &self.given else { return Ok(pipeline.process(frame)?) };
        let name = self.name(pair);
        let path = given
            .get(&name)
            .with_context(|| format!("{}: no mask with this name", folder.join(name + ".png").display()))?;
        let mask = images::read_mask(path)?;
        let ((width, height), (columns, rows)) = (mask.image().size(), frame.rgb().size());
        anyhow::ensure!(
            (width, height) == (columns, rows),
            "{}: the mask is {width}x{height}, its image {columns}x{rows}",
            path.display()
        );
        Ok(pipeline.process_with_mask(frame, &mask)?)
    }

    fn save(&self, pair: &Association, mask: &Mask) -> anyhow::Result<()> {
        let Some(folder) = &self.target else { return Ok(()) };
        let path = folder.join(format!("{}.png", self.name(pair)));
        let (width, height) = mask.image().size();
        let (width, height) = (width as u32, height as u32);
        image::save_buffer(&path, mask.image().pixels(), width, height, image::ExtendedColorType::L8)
            .with_context(|| path.display().to_string())
    }
}

/// Makes the folder for masks, without masks of an earlier run: every mask in it is judged and shown as one of this run.
fn prepare(folder: &Path, given: Option<&Path>) -> anyhow::Result<()> {
    let named = || folder.display().to_string();
    std::fs::create_dir_all(folder).with_context(named)?;
    let is_given = given.is_some_and(|given| given.canonicalize().ok() == folder.canonicalize().ok());
    anyhow::ensure!(
        !is_given,
        "{}: the masks that --masks reads would be replaced by --save-masks: name another --out",
        folder.display()
    );
    for entry in std::fs::read_dir(folder).with_context(named)? {
        let path = entry.with_context(named)?.path();
        if path.extension().is_some_and(|extension| extension == "png") {
            std::fs::remove_file(&path).with_context(|| path.display().to_string())?;
        }
    }
    Ok(())
}

fn repeated_stems(pairs: &[Association]) -> BTreeSet<String> {
    let mut seen = BTreeSet::new();
    pairs.iter().map(file_stem).filter(|stem| !seen.insert(stem.clone())).collect()
}

/// Name of the colour image without its extension.
fn file_stem(pair: &Association) -> String {
    stem(&pair.rgb_path.file_name().unwrap_or_default().to_string_lossy()).to_owned()
}
