//! What can be said on the command line.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};

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
    /// Errors of a trajectory: ATE and RPE
    Eval(EvalArguments),
    /// Errors of motion masks: precision, recall, IoU
    EvalMasks(EvalMasksArguments),
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
