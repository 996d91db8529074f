//! Time per frame of the modes `pfd` and `paper`, and the ratio to the published 82.2 ms (PFD-SLAM, table 8).
//!
//! `cargo bench -p pfd-segmentation`, on the bundled sequence or the one that `PFD_SEQUENCE` names (an absolute path).
#![allow(clippy::print_stdout)]

use std::path::{Path, PathBuf};
use std::time::Instant;

use criterion::{Criterion, criterion_group, criterion_main};
use pfd_dataset::Sequence;
use pfd_geometry::{Camera, RgbdFrame};
use pfd_segmentation::{Mode, SegmentationConfig, Segmenter};

/// Mean time of "tracking and segmentation of motion objects" per frame, milliseconds.
const PUBLISHED_MS: f64 = 82.2;
/// Frames measured.
const FRAMES: usize = 60;

fn sequence() -> PathBuf {
    let bundled = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/composite-demo");
    std::env::var_os("PFD_SEQUENCE").map_or_else(bundled, PathBuf::from)
}

fn frames(path: &Path) -> Option<(Camera, Vec<RgbdFrame>)> {
    let sequence = Sequence::open(path).ok()?;
    let camera = sequence.camera()?;
    let frames = (0..sequence.len().min(FRAMES)).filter_map(|i| sequence.frame(i).ok()).collect();
    Some((camera, frames))
}

/// Median and 99th percentile of the time per frame, milliseconds.
fn quantiles_ms(segmenter: &mut Segmenter, frames: &[RgbdFrame]) -> [f64; 2] {
    let mut times: Vec<f64> = frames
        .iter()
        .map(|frame| {
            let start = Instant::now();
            let _ = segmenter.segment(frame);
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    [0.5, 0.99].map(|q| times[((times.len() - 1) as f64 * q) as usize])
}

fn segmentation(criterion: &mut Criterion) {
    let path = sequence();
    let Some((camera, frames)) = frames(&path).filter(|(_, frames)| !frames.is_empty()) else {
        println!("{} is no sequence in TUM layout with known intrinsics", path.display());
        return;
    };
    for mode in [Mode::Pfd, Mode::Paper] {
        let Ok(mut segmenter) = Segmenter::new(camera, mode, &SegmentationConfig::default(), 0) else { return };
        let [median, p99] = quantiles_ms(&mut segmenter, &frames);
        let ratio = median / PUBLISHED_MS;
        println!(
            "{mode}: median {median:.1} ms, p99 {p99:.1} ms per frame, {ratio:.2} of the published {PUBLISHED_MS} ms"
        );
        let mut next = 0;
        criterion.bench_function(mode.name(), |bencher| {
            bencher.iter(|| {
                next = (next + 1) % frames.len();
                segmenter.segment(&frames[next]).map(|result| result.mask.fraction())
            });
        });
    }
}

criterion_group! { name = benches; config = Criterion::default().sample_size(20); targets = segmentation }
criterion_main!(benches);
