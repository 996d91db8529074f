//! Whether single frames are found in a map: those of the same place, and none of another.
//!
//! `cargo run --release -p pfd-tracking --example relocalize -- [--masks] MAP_SEQUENCE [OTHER_SEQUENCE...]`
//!
//! The first half of the first sequence makes the map. Every frame of its second half, and of the other sequences, is sought in it as if the
//! camera had just been switched on. Prints how many were found, and for those of the first sequence how far they are from ground truth.
//! With `--masks` the true masks in `mask/` are used.

#![allow(clippy::print_stdout)]

use std::path::{Path, PathBuf};

use anyhow::Context;
use nalgebra::Point3;
use pfd_dataset::{Sequence, images};
use pfd_geometry::{Camera, Mask, Stamp, StampedPose, alignment};
use pfd_tracking::{Tracker, TrackingConfig, TrackingState};

/// Ground truth counts for a frame from which it is no farther in time, seconds.
const SAME_TIME: f64 = 0.02;

fn main() -> anyhow::Result<()> {
    let mut paths: Vec<PathBuf> = std::env::args().skip(1).map(PathBuf::from).collect();
    let use_masks = paths.iter().any(|p| p.as_os_str() == "--masks");
    paths.retain(|p| p.as_os_str() != "--masks");
    let home = paths.first().context("name a sequence for the map")?;
    let sequence = Sequence::open(home)?;
    let half = sequence.len() / 2;
    let folder = tempfile::tempdir()?;
    let map = folder.path().join("half.map");
    let trajectory = make_map(&sequence, half, use_masks, &map)?;
    for path in &paths {
        let is_home = path == home;
        let frames = Sequence::open(path)?;
        let first = if is_home { half } else { 0 };
        let found = seek(&frames, first, use_masks, (&map, &sequence))?;
        let errors = if is_home { errors(&sequence, &trajectory, &found) } else { Vec::new() };
        let worst = errors.iter().copied().reduce(f64::max).map_or("–".into(), |worst| format!("{worst:.3} m"));
        println!("{:28} found {} of {}, worst {worst}", frames.name(), found.len(), frames.len() - first);
    }
    Ok(())
}

/// Tracks the first `count` frames and saves their map. Returns the trajectory.
fn make_map(sequence: &Sequence, count: usize, use_masks: bool, file: &Path) -> anyhow::Result<Vec<StampedPose>> {
    let mut tracker = Tracker::new(camera(sequence)?, &TrackingConfig::default(), 0)?;
    for i in 0..count {
        tracker.track(&sequence.frame(i)?, mask(sequence, i, use_masks)?.as_ref())?;
    }
    tracker.finish();
    tracker.snapshot().save(file)?;
    Ok(tracker.trajectory())
}

fn camera(sequence: &Sequence) -> anyhow::Result<Camera> {
    sequence.camera().with_context(|| format!("{}: the camera is not known", sequence.name()))
}

/// Poses of the frames from `first` on that were found in the map of a sequence, each sought on its own. All count as frames of the camera
/// that made the map: what is asked is whether places are confused.
fn seek(
    sequence: &Sequence,
    first: usize,
    use_masks: bool,
    (file, made_by): (&Path, &Sequence),
) -> anyhow::Result<Vec<StampedPose>> {
    let mut config = TrackingConfig::default();
    config.mapping.enabled = false;
    let mut tracker = Tracker::new(camera(made_by)?, &config, 0)?;
    tracker.load_map(file)?;
    let mut found = Vec::new();
    for i in first..sequence.len() {
        tracker.reset();
        let tracked = tracker.track(&sequence.frame(i)?, mask(sequence, i, use_masks)?.as_ref())?;
        if let (TrackingState::Relocalized, Some(pose)) = (tracked.state, tracked.T_world_camera) {
            found.push(StampedPose { stamp: tracked.stamp, pose });
        }
    }
    Ok(found)
}

fn mask(sequence: &Sequence, i: usize, wanted: bool) -> anyhow::Result<Option<Mask>> {
    let folder = sequence.folder().join("mask");
    if !wanted || !folder.is_dir() {
        return Ok(None);
    }
    let name = sequence.pair(i).rgb_path.with_extension("png");
    Ok(Some(images::read_mask(&folder.join(name.file_name().context("a frame without a name")?))?))
}

/// Distances of the poses found from ground truth, metres, when the trajectory of the map is laid on it.
fn errors(sequence: &Sequence, trajectory: &[StampedPose], found: &[StampedPose]) -> Vec<f64> {
    let truth = sequence.ground_truth().unwrap_or_default();
    let place = |stamp: Stamp| {
        let distance = |pose: &StampedPose| pose.stamp.seconds_since(stamp).abs();
        let nearest = truth.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
        (distance(nearest) < SAME_TIME).then(|| Point3::from(nearest.pose.translation.vector))
    };
    let pairs = |poses: &[StampedPose]| -> Vec<_> {
        poses.iter().filter_map(|p| Some((place(p.stamp)?, Point3::from(p.pose.translation.vector)))).collect()
    };
    let Some(motion) = alignment::align(&pairs(trajectory)) else { return Vec::new() };
    pairs(found).into_iter().map(|(truth, estimate)| (motion * estimate - truth).norm()).collect()
}
