//! Fits the weights by which new regions are judged (`src/rigid/credibility.rs`) to sequences with exact masks: a logistic regression
//! in which movers and the rest count alike.
//!
//! `cargo run --release -p pfd-segmentation --example fit_credibility -- SEQUENCE...`
//!
//! Prints how many regions the present rule believes, the weights of all sequences together, and how well weights that were fitted
//! to the other sequences tell the regions of each apart. Without masks a sequence counts as static.
#![allow(clippy::print_stdout)]

mod common;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Parser;
use common::{guess_camera, truth_of};
use nalgebra::{SMatrix, SVector};
use pfd_dataset::Sequence;
use pfd_geometry::{GrayImage, Image};
use pfd_segmentation::{Mode, NewRegion, SegmentationConfig, Segmenter};

#[derive(Parser)]
struct Arguments {
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Folders in TUM layout, with masks in `mask/`.
    #[arg(required = true)]
    sequences: Vec<PathBuf>,
}

/// The bias, the cues, and whether the region reaches the border of the image.
const PARAMETERS: usize = 2 + NewRegion::CUES;
/// Newton steps: the likelihood is concave, and a few more than it takes do no harm.
const STEPS: usize = 20;
/// Prior precision of each weight: about one region's worth, so that cues which never occur get no weight.
const RIDGE: f64 = 1.0;

type Weights = SVector<f64, PARAMETERS>;

/// A region of which the truth is known.
struct Sample {
    sequence: usize,
    features: Weights,
    moves: bool,
    believed: bool,
}

impl Sample {
    /// `None` where all of the region is to be ignored.
    fn new(sequence: usize, region: &NewRegion, truth: &GrayImage) -> Option<Self> {
        let values = region.pixels.iter().filter_map(|[x, y]| truth.get(x.round() as usize, y.round() as usize));
        let (moving, still) = values.fold((0, 0), |(m, s), v| (m + u32::from(*v == 255), s + u32::from(*v == 0)));
        let cues = region.cues.iter().map(|c| f64::from(*c));
        let at_border = f64::from(u8::from(region.at_border));
        let features = Weights::from_iterator(std::iter::once(1.0).chain(cues).chain([at_border]));
        (moving + still > 0).then_some(Self { sequence, features, moves: moving > still, believed: region.believed })
    }
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let mut samples = Vec::new();
    for (index, folder) in arguments.sequences.iter().enumerate() {
        collect(index, folder, arguments.seed, &mut samples).with_context(|| folder.display().to_string())?;
    }
    let everything: Vec<&Sample> = samples.iter().collect();
    let believed = |moves: bool| everything.iter().filter(|s| s.moves == moves && s.believed).count();
    let moving = everything.iter().filter(|s| s.moves).count();
    let still = everything.len() - moving;
    println!("believed: {} of {moving} movers, {} of {still} others", believed(true), believed(false));
    println!("weights: {:.2}", fit(&everything).transpose());
    let mut scores = Vec::new();
    for (index, folder) in arguments.sequences.iter().enumerate() {
        let (own, others): (Vec<&Sample>, Vec<&Sample>) = everything.iter().partition(|s| s.sequence == index);
        let weights = fit(&others);
        let start = scores.len();
        scores.extend(own.iter().map(|s| (weights.dot(&s.features), s.moves)));
        println!("{:<28} {} regions, {}", sequence_name(folder), own.len(), describe(&scores[start..]));
    }
    println!("all, each by the weights of the others: {}", describe(&scores));
    Ok(())
}

fn sequence_name(folder: &Path) -> String {
    folder.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}

fn collect(index: usize, folder: &Path, seed: u64, samples: &mut Vec<Sample>) -> Result<()> {
    let sequence = Sequence::open(folder)?;
    let camera = sequence.camera().map_or_else(|| guess_camera(&sequence.frame(0)?), Ok)?;
    let size = (camera.width, camera.height);
    let mut segmenter = Segmenter::new(camera, Mode::Pfd, &SegmentationConfig::default(), seed)?;
    for i in 0..sequence.len() {
        segmenter.segment(&sequence.frame(i)?)?;
        let truth = truth_of(folder, &sequence.pair(i).rgb_path, size)?;
        let truth = truth.unwrap_or_else(|| Image::filled(size.0, size.1, 0));
        samples.extend(segmenter.new_regions().iter().filter_map(|r| Sample::new(index, r, &truth)));
    }
    Ok(())
}

/// Maximum likelihood by Newton's method, movers and others weighted to the same total.
fn fit(samples: &[&Sample]) -> Weights {
    let moving = samples.iter().filter(|s| s.moves).count().max(1) as f64;
    let still = samples.iter().filter(|s| !s.moves).count().max(1) as f64;
    let half = samples.len() as f64 / 2.0;
    let mut weights = Weights::zeros();
    for _ in 0..STEPS {
        let mut gradient = -weights * RIDGE;
        let mut hessian = SMatrix::<f64, PARAMETERS, PARAMETERS>::identity() * RIDGE;
        for sample in samples {
            let p = 1.0 / (1.0 + (-weights.dot(&sample.features)).exp());
            let importance = half / if sample.moves { moving } else { still };
            gradient += sample.features * (importance * (f64::from(u8::from(sample.moves)) - p));
            hessian += sample.features * sample.features.transpose() * (importance * p * (1.0 - p));
        }
        let Some(cholesky) = hessian.cholesky() else { break };
        weights += cholesky.solve(&gradient);
    }
    weights
}

/// The area under the receiver operating characteristic: how often a mover scores above another region.
fn describe(scores: &[(f64, bool)]) -> String {
    let of = |moving: bool| scores.iter().filter(|s| s.1 == moving).map(|s| s.0).collect::<Vec<f64>>();
    let (movers, others) = (of(true), of(false));
    if movers.is_empty() || others.is_empty() {
        return format!("{} movers", movers.len());
    }
    let above = movers.iter().map(|m| others.iter().filter(|o| m > o).count()).sum::<usize>();
    format!("{} movers, area under the curve {:.3}", movers.len(), above as f64 / (movers.len() * others.len()) as f64)
}
