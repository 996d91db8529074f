//! Runs segmentation over sequences with exact masks and prints precision, recall, IoU, wrongly masked static pixels and time.
//!
//! `cargo run --release -p pfd-segmentation --example evaluate_masks -- --mode pfd --set pfd.static_model=false SEQUENCE...`
#![allow(clippy::print_stdout)]

mod common;

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result};
use clap::Parser;
use common::{guess_camera, truth_of};
use pfd_dataset::Sequence;
use pfd_geometry::{GrayImage, Image, RgbdFrame};
use pfd_segmentation::{Mode, Segmentation, SegmentationConfig, Segmenter, Status};

#[derive(Parser)]
struct Arguments {
    /// pfd, paper, single, flow or none.
    #[arg(long, default_value = "pfd")]
    mode: Mode,
    /// Parameters to change: `pfd.static_model=false`.
    #[arg(long)]
    set: Vec<String>,
    /// Folder for overlays (mask red, outline of the truth green).
    #[arg(long)]
    overlays: Option<PathBuf>,
    /// An overlay every this many frames.
    #[arg(long, default_value_t = 10)]
    every: usize,
    /// Frames per sequence.
    #[arg(long, default_value_t = usize::MAX)]
    frames: usize,
    /// Print every frame.
    #[arg(long)]
    verbose: bool,
    /// Print the mean time of each stage.
    #[arg(long)]
    stages: bool,
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Folders in TUM layout, with masks in `mask/`.
    sequences: Vec<PathBuf>,
}

/// Pixel counts of one frame: truth 255 = moving, 128 = ignored, 0 = static.
#[derive(Clone, Copy, Default)]
struct Counts {
    hit: usize,
    missed: usize,
    wrong: usize,
    still: usize,
}

impl Counts {
    fn of(mask: &GrayImage, truth: &GrayImage) -> Self {
        let mut counts = Self::default();
        for (&m, &t) in mask.pixels().iter().zip(truth.pixels()) {
            match (t, m != 0) {
                (255, true) => counts.hit += 1,
                (255, false) => counts.missed += 1,
                (0, true) => counts.wrong += 1,
                (0, false) => counts.still += 1,
                _ => {}
            }
        }
        counts
    }

    fn recall(&self) -> f64 {
        share(self.hit, self.hit + self.missed)
    }

    fn precision(&self) -> f64 {
        if self.hit + self.wrong == 0 { 0.0 } else { share(self.hit, self.hit + self.wrong) }
    }

    fn iou(&self) -> f64 {
        share(self.hit, self.hit + self.missed + self.wrong)
    }

    fn has_movers(&self) -> bool {
        share(self.hit + self.missed, self.hit + self.missed + self.wrong + self.still) > MIN_MOVING_SHARE
    }

    fn static_masked(&self) -> f64 {
        share(self.wrong, self.wrong + self.still)
    }
}

fn share(part: usize, whole: usize) -> f64 {
    part as f64 / whole.max(1) as f64
}

/// Frames whose truth shows fewer moving pixels than this share of the image do not enter the averages.
const MIN_MOVING_SHARE: f64 = 0.001;

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let config = configure(&arguments.set)?;
    println!(
        "{:<28} {:>6} {:>6} {:>6} {:>6}  {:>7} {:>7}  {:>5}  {:>6} {:>6}",
        "sequence", "frames", "P", "R", "IoU", "static%", "worst%", "delay", "ms", "p99"
    );
    for folder in &arguments.sequences {
        evaluate(folder, &arguments, &config).with_context(|| folder.display().to_string())?;
    }
    Ok(())
}

fn configure(changes: &[String]) -> Result<SegmentationConfig> {
    let mut tree = serde_json::to_value(SegmentationConfig::default())?;
    for change in changes {
        let (path, value) = change.split_once('=').context("--set wants name=value")?;
        let pointer = format!("/{}", path.replace('.', "/"));
        let leaf = tree.pointer_mut(&pointer).with_context(|| format!("no parameter {path}"))?;
        *leaf = serde_json::from_str(value).unwrap_or_else(|_| value.into());
    }
    Ok(serde_json::from_value(tree)?)
}

fn evaluate(folder: &Path, arguments: &Arguments, config: &SegmentationConfig) -> Result<()> {
    let sequence = Sequence::open(folder)?;
    let first = sequence.frame(0)?;
    let camera = sequence.camera().map_or_else(|| guess_camera(&first), Ok)?;
    let mut segmenter = Segmenter::new(camera, arguments.mode, config, arguments.seed)?;
    let mut all = Vec::new();
    let mut times = Vec::new();
    let mut stages: Vec<(&'static str, f64)> = Vec::new();
    for i in 0..sequence.len().min(arguments.frames) {
        let frame = sequence.frame(i)?;
        let start = Instant::now();
        let result = segmenter.segment(&frame)?;
        times.push(start.elapsed().as_secs_f64() * 1e3);
        add_stages(&mut stages, &result);
        let truth = truth_of(folder, &sequence.pair(i).rgb_path, result.mask.image().size())?;
        let counts =
            Counts::of(result.mask.image(), truth.as_ref().unwrap_or(&Image::filled(camera.width, camera.height, 0)));
        report_frame(arguments, i, &counts, &result);
        if result.status != Status::FirstFrame {
            all.push(counts);
        }
        if let Some(out) = arguments.overlays.as_ref().filter(|_| i % arguments.every == 0) {
            save_overlay(out, &format!("{}-{i:04}", sequence.name()), &frame, &result, truth.as_ref())?;
        }
    }
    summarise(sequence.name(), &all, &mut times);
    if arguments.stages {
        let frames = times.len() as f64;
        println!(
            "    {}",
            stages.iter().map(|(n, ms)| format!("{n} {:.2}", ms / frames)).collect::<Vec<_>>().join("  ")
        );
    }
    Ok(())
}

fn add_stages(stages: &mut Vec<(&'static str, f64)>, result: &Segmentation) {
    for &(name, ms) in &result.timing.0 {
        match stages.iter_mut().find(|(n, _)| *n == name) {
            Some(stage) => stage.1 += ms,
            None => stages.push((name, ms)),
        }
    }
}

fn report_frame(arguments: &Arguments, i: usize, counts: &Counts, result: &Segmentation) {
    if !arguments.verbose {
        return;
    }
    println!(
        "  {i:4} P {:.3} R {:.3} IoU {:.3} static {:.2}% objects {} {:?}",
        counts.precision(),
        counts.recall(),
        counts.iou(),
        counts.static_masked() * 100.0,
        result.regions.len(),
        result.status
    );
}

/// Frames from the first that shows something moving, after one that shows nothing, to the first in which half of it is masked.
fn delay(all: &[Counts]) -> Option<usize> {
    let onset = all.windows(2).position(|pair| !pair[0].has_movers() && pair[1].has_movers())? + 1;
    all[onset..].iter().position(|c| c.has_movers() && c.recall() >= 0.5)
}

fn summarise(name: &str, all: &[Counts], times: &mut [f64]) {
    let dynamic: Vec<&Counts> = all.iter().filter(|c| c.has_movers()).collect();
    let mean = |f: &dyn Fn(&Counts) -> f64| match dynamic.len() {
        0 => "–".to_owned(),
        count => format!("{:.3}", dynamic.iter().map(|c| f(c)).sum::<f64>() / count as f64),
    };
    let masked = all.iter().map(|c| c.static_masked() * 100.0);
    let worst = masked.clone().fold(0.0, f64::max);
    times.sort_by(f64::total_cmp);
    let at = |q: f64| times[((times.len() - 1) as f64 * q) as usize];
    println!(
        "{name:<28} {:>6} {:>6} {:>6} {:>6}  {:>7.2} {:>7.2}  {:>5}  {:>6.1} {:>6.1}",
        dynamic.len(),
        mean(&Counts::precision),
        mean(&Counts::recall),
        mean(&Counts::iou),
        masked.sum::<f64>() / all.len().max(1) as f64,
        worst,
        delay(all).map_or("–".to_owned(), |frames| frames.to_string()),
        at(0.5),
        at(0.99)
    );
}

fn save_overlay(
    out: &Path,
    name: &str,
    frame: &RgbdFrame,
    result: &Segmentation,
    truth: Option<&GrayImage>,
) -> Result<()> {
    std::fs::create_dir_all(out)?;
    let (width, height) = frame.rgb().size();
    let mut picture = image::RgbImage::new(width as u32, height as u32);
    for v in 0..height {
        for u in 0..width {
            let mut colour = frame.rgb()[(u, v)];
            if result.mask.is_dynamic(u, v) {
                colour = [colour[0] / 2 + 127, colour[1] / 2, colour[2] / 2];
            }
            if truth.is_some_and(|t| is_outline(t, u, v)) {
                colour = [0, 255, 0];
            }
            picture.put_pixel(u as u32, v as u32, image::Rgb(colour));
        }
    }
    for particle in result.particles.iter().flatten() {
        let (u, v) = (particle[0] as u32, particle[1] as u32);
        if u < width as u32 && v < height as u32 {
            picture.put_pixel(u, v, image::Rgb([255, 255, 0]));
        }
    }
    picture.save(out.join(format!("{name}.png")))?;
    Ok(())
}

fn is_outline(truth: &GrayImage, u: usize, v: usize) -> bool {
    let own = truth[(u, v)];
    let differs = |x: usize, y: usize| truth.get(x, y).is_some_and(|&t| t != own);
    own != 0
        && (differs(u + 1, v) || differs(u, v + 1) || differs(u.wrapping_sub(1), v) || differs(u, v.wrapping_sub(1)))
}
