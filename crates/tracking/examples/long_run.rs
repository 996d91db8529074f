//! Plays a sequence forward and backward again and again as one long recording, and prints what grows.
//!
//! `cargo run --release -p pfd-tracking --example long_run -- SEQUENCE PASSES`
//! A hundred passes of 180 frames are ten minutes at 30 Hz. Drift is the distance between the poses of one frame in the first and in
//! this pass, as a share of the path between them.

#![allow(clippy::print_stdout, clippy::unwrap_used)]

use std::path::PathBuf;
use std::time::Instant;

use pfd_dataset::Sequence;
use pfd_geometry::{Pose, RgbdFrame};
use pfd_tracking::{Tracker, TrackingConfig};

/// Time between two frames, seconds.
const PERIOD: f64 = 1.0 / 30.0;

fn main() {
    let mut arguments = std::env::args().skip(1);
    let path: PathBuf = arguments.next().unwrap().into();
    let passes: usize = arguments.next().unwrap().parse().unwrap();
    let sequence = Sequence::open(&path).unwrap();
    let frames: Vec<RgbdFrame> = sequence.frames().map(Result::unwrap).collect();
    let mut tracker = Tracker::new(sequence.camera().unwrap(), &TrackingConfig::default(), 0).unwrap();
    let (mut first_pass, mut path_length, mut last): (Vec<Pose>, f64, Option<Pose>) = (Vec::new(), 0.0, None);
    println!("pass  tracked  median ms  p99 ms  keyframes  points  loops  MB  drift %");
    for pass in 0..passes {
        let (mut times, mut tracked_frames, mut drift) = (Vec::new(), 0, 0.0_f64);
        for k in 0..frames.len() {
            let i = if pass % 2 == 0 { k } else { frames.len() - 1 - k };
            let stamp = frames[0].stamp().offset_by((pass * frames.len() + k) as f64 * PERIOD);
            let frame = RgbdFrame::new(stamp, frames[i].rgb().clone(), frames[i].depth().clone()).unwrap();
            let start = Instant::now();
            let tracked = tracker.track(&frame, None).unwrap();
            times.push(start.elapsed().as_secs_f64() * 1e3);
            let Some(pose) = tracked.T_world_camera else { continue };
            tracked_frames += 1;
            if let Some(last) = last.replace(pose) {
                path_length += (pose.translation.vector - last.translation.vector).norm();
            }
            match first_pass.get(i) {
                Some(before) => drift = (pose.translation.vector - before.translation.vector).norm() / path_length,
                None => first_pass.push(pose),
            }
        }
        let quantile = |q| pfd_evaluation::statistics::quantile(&times, q).unwrap();
        println!(
            "{pass:4}  {tracked_frames:3}/{}  {:9.1}  {:6.1}  {:9}  {:6}  {:5}  {:4}  {:.3}",
            frames.len(),
            quantile(0.5),
            quantile(0.99),
            tracker.map().keyframe_count(),
            tracker.map().point_count(),
            tracker.loops(),
            resident_megabytes(),
            drift * 100.0,
        );
    }
}

/// Memory of this process, the frames included.
fn resident_megabytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:")).unwrap_or_default();
    line.split_whitespace().next().and_then(|kb| kb.parse::<u64>().ok()).unwrap_or_default() / 1024
}
