//! Time per frame of the modes `pfd` and `paper`, and the ratio to the published 82.2 ms (PFD-SLAM, table 8).
//!
//! `PFD_SEQUENCE=/path/to/sequence cargo bench -p pfd-segmentation`
#![allow(clippy::print_stdout)]

use std::path::Path;
use std::time::Instant;

use criterion::{Criterion, criterion_group, criterion_main};
use pfd_dataset::Sequence;
use pfd_geometry::{Camera, RgbdFrame};
use pfd_segmentation::{Mode, SegmentationConfig, Segmenter};

/// Mean time of "tracking and segmentation of motion objects" per frame, milliseconds.
const PUBLISHED_MS: f64 = 82.2;
/// Frames measured.
const FRAMES: usize = 60;

fn frames(path: &Path) -> Option<(Camera, Vec<RgbdFrame>)> {
    let sequence = Sequence::open(path).ok()?;
    let camera = sequence.camera()?;
    let frames = (0..sequence.len().min(FRAMES)).filter_map(|i| sequence.frame(i).ok()).collect();
    Some((camera, frames))
}

/// Median time per frame, milliseconds.
fn median_ms(segmenter: &mut Segmenter, frames: &[RgbdFrame]) -> f64 {
    let mut times: Vec<f64> = frames
        .iter()
        .map(|frame| {
            let start = Instant::now();
            let _ = segmenter.segment(frame);
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times.get(times.len() / 2).copied().unwrap_or(0.0)
}

fn segmentation(criterion: &mut Criterion) {
    let Some((camera, frames)) = std::env::var_os("PFD_SEQUENCE").and_then(|path| frames(Path::new(&path))) else {
        println!("set PFD_SEQUENCE to a sequence in TUM layout with known intrinsics");
        return;
    };
    for mode in [Mode::Pfd, Mode::Paper] {
        let Ok(mut segmenter) = Segmenter::new(camera, mode, &SegmentationConfig::default(), 0) else { return };
        let ms = median_ms(&mut segmenter, &frames);
        println!("{mode}: median {ms:.1} ms per frame, {:.2} of the published {PUBLISHED_MS} ms", ms / PUBLISHED_MS);
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
