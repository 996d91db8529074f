//! Tracks sequences and prints their absolute trajectory error.
//!
//! `cargo run --release -p pfd-tracking --example evaluate_poses -- [--masks] [--seed N] [--step N] [--config JSON] SEQUENCE...`
//! With `--masks` the ground-truth masks in `mask/` are used; without, none. `--step` leaves frames out: faster motion.

#![allow(clippy::print_stdout, clippy::unwrap_used)]

use std::path::{Path, PathBuf};

use pfd_dataset::Sequence;
use pfd_geometry::{Mask, StageTimes};
use pfd_tracking::{Tracker, TrackingConfig, TrackingState};

fn main() {
    let mut arguments = std::env::args().skip(1).peekable();
    let mut use_masks = false;
    let (mut seed, mut step) = (0, 1);
    let mut config = TrackingConfig::default();
    let mut sequences: Vec<PathBuf> = Vec::new();
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--masks" => use_masks = true,
            "--step" => step = arguments.next().unwrap().parse().unwrap(),
            "--seed" => seed = arguments.next().unwrap().parse().unwrap(),
            "--config" => config = serde_json::from_str(&arguments.next().unwrap()).unwrap(),
            path => sequences.push(path.into()),
        }
    }
    for path in sequences {
        evaluate(&path, use_masks, &config, seed, step);
    }
}

fn evaluate(path: &Path, use_masks: bool, config: &TrackingConfig, seed: u64, step: usize) {
    let sequence = Sequence::open(path).unwrap();
    let mut tracker = Tracker::new(sequence.camera().unwrap(), config, seed).unwrap();
    let (mut live, mut times, mut ok, mut inliers) = (Vec::new(), Vec::new(), 0, Vec::new());
    let mut stages: Vec<StageTimes> = Vec::new();
    let mut last = None;
    for i in (0..sequence.len()).step_by(step) {
        let frame = sequence.frame(i).unwrap();
        let mask = (use_masks && path.join("mask").is_dir()).then(|| read_mask(path, &sequence.pair(i).rgb_path));
        let start = std::time::Instant::now();
        let tracked = tracker.track(&frame, mask.as_ref()).unwrap();
        times.push(start.elapsed().as_secs_f64() * 1e3);
        stages.push(tracked.timing.clone());
        ok += usize::from(matches!(tracked.state, TrackingState::Ok | TrackingState::Relocalized));
        inliers.push(f64::from(tracked.inliers));
        if let Some(pose) = tracked.T_world_camera {
            live.push(pfd_geometry::StampedPose { stamp: tracked.stamp, pose });
        }
        last = Some(tracked);
    }
    tracker.finish();
    tracker.map().check().unwrap();
    let truth = sequence.ground_truth().unwrap();
    let error = |poses: &[_]| pfd_evaluation::ate(truth, poses).map_or(f64::NAN, |a| a.statistics.rmse);
    let quantile = |values: &[f64], q| pfd_evaluation::statistics::quantile(values, q).unwrap();
    let last = last.unwrap();
    println!(
        "{:28} masks {} tracked {}/{} ATE {:.4} live {:.4} inliers median {:.0} min {:.0} keyframes {} points {} readout {:.1} ms, ms a frame median {:.1} p99 {:.1}",
        sequence.name(),
        u8::from(use_masks),
        ok,
        sequence.len(),
        error(&tracker.trajectory()),
        error(&live),
        quantile(&inliers, 0.5),
        quantile(&inliers, 0.0),
        last.keyframes,
        last.map_points,
        tracker.readout() * 1e3,
        quantile(&times, 0.5),
        quantile(&times, 0.99),
    );
    for (k, (name, _)) in stages[0].0.iter().enumerate() {
        let of: Vec<f64> = stages.iter().map(|s| s.0[k].1).collect();
        print!("   {name} {:.1}/{:.1}", quantile(&of, 0.5), quantile(&of, 0.99));
    }
    println!();
}

fn read_mask(sequence: &Path, rgb: &Path) -> Mask {
    let name = rgb.with_extension("png");
    pfd_dataset::images::read_mask(&sequence.join("mask").join(name.file_name().unwrap())).unwrap()
}
