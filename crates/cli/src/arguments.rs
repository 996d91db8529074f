//! What can be said on the command line.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};
use pfd_pipeline::Mode;

/// RGB-D SLAM in rooms where things move.
#[derive(Debug, Parser)]
#[command(name = "pfd-slam", version, about)]
pub(crate) struct Arguments {
    /// What to do.
    #[command(subcommand)]
    pub(crate) command: Command,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Runs the whole pipeline on a sequence
    Run(RunArguments),
    /// Errors of a trajectory: ATE and RPE
    Eval(EvalArguments),
    /// Errors of motion masks: precision, recall, IoU
    EvalMasks(EvalMasksArguments),
    /// Tables over sequences, modes and seeds, beside published figures
    Bench(BenchArguments),
    /// Downloads sequences of the TUM RGB-D benchmark
    Fetch(FetchArguments),
    /// Prints the effective configuration with comments
    Config(ConfigArguments),
    /// Makes report.json and report.html from the files that the nodes wrote
    Report(ReportArguments),
}

/// How a sequence is read.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct SequenceArguments {
    /// Seconds added to the depth stamps before they are compared with the colour stamps
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true, value_name = "SECONDS", value_parser = seconds)]
    pub(crate) depth_offset: f64,
    /// Pair colour and depth as associate.py does: each image at most once, some colour images dropped
    #[arg(long)]
    pub(crate) one_to_one: bool,
}

/// Where the configuration comes from.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct ConfigSource {
    /// Parameter file, as the nodes read it; may be repeated, later ones win
    #[arg(long, value_name = "FILE")]
    pub(crate) config: Vec<PathBuf>,
    /// One parameter, such as `segmentation.particles.count=500`; may be repeated
    #[arg(long, value_name = "NAME=VALUE", value_parser = name_and_value)]
    pub(crate) set: Vec<(String, String)>,
}

/// Arguments of `run`.
#[derive(Debug, Args)]
pub(crate) struct RunArguments {
    /// Folder in TUM layout, or its .tgz
    pub(crate) sequence: PathBuf,
    /// Folder for the results; made where it does not exist
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    #[command(flatten)]
    pub(crate) config: ConfigSource,
    #[command(flatten)]
    pub(crate) reading: SequenceArguments,
    /// How moving things are found: pfd, paper, single, flow, none
    #[arg(long)]
    pub(crate) mode: Option<Mode>,
    /// Write the masks to DIR/masks
    #[arg(long)]
    pub(crate) save_masks: bool,
    /// Seed of all random choices
    #[arg(long)]
    pub(crate) seed: Option<u64>,
    /// Stop after this many frames
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    pub(crate) max_frames: Option<usize>,
    /// Use the masks of this folder instead of segmentation (files named like the colour images; not 0 = moving)
    #[arg(long, value_name = "DIR")]
    pub(crate) masks: Option<PathBuf>,
    /// Write a video of the frames with their masks (Motion JPEG in AVI)
    #[arg(long, value_name = "FILE.avi")]
    pub(crate) video: Option<PathBuf>,
}

/// Arguments of `bench`.
#[derive(Debug, Args)]
pub(crate) struct BenchArguments {
    /// Folders in TUM layout, or their .tgz
    #[arg(required = true)]
    pub(crate) sequences: Vec<PathBuf>,
    /// Folder for the results; a bench that was interrupted goes on where it stopped
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// What to compare: modes, and `given` for the true masks in the sequence's folder mask/
    #[arg(long, value_delimiter = ',', default_value = "pfd,none", value_name = "MODE,...")]
    pub(crate) modes: Vec<BenchMode>,
    /// Seeds per sequence and mode; tables state the median
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) runs: u64,
    /// Compare values of a parameter, such as `segmentation.particles.count=500,1000`; may be repeated
    #[arg(long, value_name = "NAME=VALUE,...", value_parser = name_and_value)]
    pub(crate) vary: Vec<(String, String)>,
    /// Runs at the same time; more than one disturbs the timings
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=64))]
    pub(crate) jobs: u64,
    /// Stop each run after this many frames
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    pub(crate) max_frames: Option<usize>,
    /// Put a summary into this file, between the lines `<!-- bench -->` and `<!-- /bench -->`
    #[arg(long, value_name = "FILE")]
    pub(crate) into: Option<PathBuf>,
    /// What the summary says about its origin, such as a commit
    #[arg(long, value_name = "TEXT", default_value = concat!("version ", env!("CARGO_PKG_VERSION")))]
    pub(crate) about: String,
    #[command(flatten)]
    pub(crate) config: ConfigSource,
    #[command(flatten)]
    pub(crate) reading: SequenceArguments,
}

/// A column of the bench.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BenchMode {
    /// Masks by segmentation.
    Mode(Mode),
    /// The true masks.
    Given,
}

impl std::str::FromStr for BenchMode {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "given" {
            return Ok(Self::Given);
        }
        text.parse().map(Self::Mode).map_err(|e| format!("{e}, or given"))
    }
}

impl std::fmt::Display for BenchMode {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Mode(mode) => mode.fmt(f),
            Self::Given => f.write_str("given"),
        }
    }
}

/// Arguments of `fetch`.
#[derive(Debug, Args)]
pub(crate) struct FetchArguments {
    /// Sequences, such as freiburg3_walking_xyz
    #[arg(required = true)]
    pub(crate) names: Vec<String>,
    /// Folder for the sequences
    #[arg(long, default_value = ".", value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// Where the benchmark's files are
    #[arg(long, default_value = crate::commands::fetch::BENCHMARK, value_name = "URL")]
    pub(crate) base_url: String,
}

/// Arguments of `eval`.
#[derive(Debug, Args)]
pub(crate) struct EvalArguments {
    /// Ground truth: lines `stamp tx ty tz qx qy qz qw`
    pub(crate) ground_truth: PathBuf,
    /// Estimate, in the same form
    pub(crate) estimate: PathBuf,
    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// Arguments of `eval-masks`.
#[derive(Debug, Args)]
pub(crate) struct EvalMasksArguments {
    /// Masks to judge: PNG, not 0 = moving
    pub(crate) masks: PathBuf,
    /// Masks of the same names: 255 = moving, 128 = ignored, 0 = static
    pub(crate) ground_truth: PathBuf,
    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// Arguments of `config`.
#[derive(Debug, Args)]
pub(crate) struct ConfigArguments {
    #[command(flatten)]
    pub(crate) config: ConfigSource,
    /// Print the parameters of the nodes as well (topics, frames, files, replay)
    #[arg(long)]
    pub(crate) nodes: bool,
}

/// Arguments of `report`.
#[derive(Debug, Args)]
pub(crate) struct ReportArguments {
    /// The sequence that was replayed
    pub(crate) sequence: PathBuf,
    /// Folder with trajectory.txt and frames.csv of tracking_node or slam_node and, where written, segmentation.csv and masks/
    /// of segmentation_node; receives the report
    pub(crate) directory: PathBuf,
    #[command(flatten)]
    pub(crate) config: ConfigSource,
    #[command(flatten)]
    pub(crate) reading: SequenceArguments,
}

fn seconds(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|s: &f64| s.is_finite()).ok_or_else(|| "seconds are needed, such as -0.02".to_owned())
}

fn at_least_one(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|n| *n > 0).ok_or_else(|| "a whole number from 1 on is needed".to_owned())
}

fn name_and_value(text: &str) -> Result<(String, String), String> {
    let (name, value) = text.split_once('=').ok_or("NAME=VALUE is expected")?;
    Ok((name.trim_end_matches(':').to_owned(), value.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_definition_is_consistent() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn assignments_are_split() {
        assert_eq!(name_and_value("a.b=1"), Ok(("a.b".into(), "1".into())));
        assert_eq!(name_and_value("a:=x=y"), Ok(("a".into(), "x=y".into())));
        assert!(name_and_value("a").is_err());
    }
}
