//! Time per frame of tracking on the bundled sequence, beside what ORB-SLAM3 needs for the same kind of frames.
//!
//! `cargo bench -p pfd-tracking`

#![allow(clippy::print_stdout, clippy::unwrap_used)]

use std::path::Path;
use std::time::Instant;

use pfd_dataset::Sequence;
use pfd_evaluation::statistics::quantile;
use pfd_geometry::StageTimes;
use pfd_tracking::{Tracker, TrackingConfig};

/// ORB-SLAM3 on 640×480 RGB-D frames of freiburg1_xyz on a machine with two cores, milliseconds: median and 99th percentile.
const ORB_SLAM3: [f64; 2] = [24.0, 60.0];

fn main() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/composite-demo");
    let sequence = Sequence::open(&path).unwrap();
    let frames: Vec<_> = sequence.frames().map(Result::unwrap).collect();
    let mut tracker = Tracker::new(sequence.camera().unwrap(), &TrackingConfig::default(), 0).unwrap();
    let (mut total, mut stages) = (Vec::new(), Vec::new());
    for frame in &frames {
        let start = Instant::now();
        let tracked = tracker.track(frame, None).unwrap();
        total.push(start.elapsed().as_secs_f64() * 1e3);
        stages.push(tracked.timing);
    }
    let at = |q| quantile(&total, q).unwrap();
    println!("tracking, {} frames: median {:.1} ms, p99 {:.1} ms", frames.len(), at(0.5), at(0.99));
    println!("ratio to ORB-SLAM3: median {:.2}, p99 {:.2}", at(0.5) / ORB_SLAM3[0], at(0.99) / ORB_SLAM3[1]);
    print_stages(&stages);
}

fn print_stages(stages: &[StageTimes]) {
    for (index, (name, _)) in stages[0].0.iter().enumerate() {
        let times: Vec<_> = stages.iter().map(|s| s.0[index].1).collect();
        println!(
            "  {name:16} median {:6.2}, p99 {:6.2}",
            quantile(&times, 0.5).unwrap(),
            quantile(&times, 0.99).unwrap()
        );
    }
}
