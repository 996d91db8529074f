//! The offline command line of PFD-SLAM.

mod arguments;
mod commands;
mod interrupt;
mod output;
mod progress;
mod provenance;
mod results;
mod runner;
mod setup;

use std::process::ExitCode;

use clap::Parser;

use crate::arguments::{Arguments, Command};
use crate::interrupt::Interrupted;

fn main() -> ExitCode {
    // Wrong usage ends here with status 2.
    let arguments = Arguments::parse();
    match run(&arguments.command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            output::error(&error);
            error.downcast_ref::<Interrupted>().map_or(ExitCode::FAILURE, |interrupted| interrupted.status.into())
        }
    }
}

fn run(command: &Command) -> anyhow::Result<()> {
    match command {
        Command::Run(arguments) => commands::run::run(arguments),
        Command::Eval(arguments) => commands::eval::run(arguments),
        Command::EvalMasks(arguments) => commands::eval_masks::run(arguments),
        Command::Bench(arguments) => commands::bench::run(arguments),
        Command::Fetch(arguments) => commands::fetch::run(arguments),
        Command::Config(arguments) => commands::config::run(arguments),
        Command::Report(arguments) => commands::report::run(arguments),
    }
}
