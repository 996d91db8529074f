//! The offline command line of PFD-SLAM.

mod arguments;
mod commands;
mod output;

use std::process::ExitCode;

use clap::Parser;

use crate::arguments::{Arguments, Command};

fn main() -> ExitCode {
    // Wrong usage ends here with status 2.
    let arguments = Arguments::parse();
    match run(&arguments.command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            output::error(&error);
            ExitCode::FAILURE
        }
    }
}

fn run(command: &Command) -> anyhow::Result<()> {
    match command {
        Command::Eval(arguments) => commands::eval::run(arguments),
        Command::EvalMasks(arguments) => commands::eval_masks::run(arguments),
    }
}
