//! What the four programs have in common: command line, logging, exit status.

use std::io::Write as _;
use std::process::ExitCode;

use pfd_ros::{Arguments, Names, rosout};

/// Reads the command line, starts logging and runs a node: 0 when it ends as it should, 2 for wrong usage, 1 for anything else,
/// with one line on stderr.
pub fn main(name: &str, about: &str, run: impl FnOnce(&Arguments, Names) -> anyhow::Result<()>) -> ExitCode {
    let args: Vec<String> = std::env::args().skip(1).collect();
    if args.iter().any(|arg| arg == "--help" || arg == "-h") {
        return print(&help(name, about));
    }
    if args.iter().any(|arg| arg == "--version") {
        return print(&format!("{name} {}\n", env!("CARGO_PKG_VERSION")));
    }
    let (args, names) = match prepare(args, name) {
        Ok(prepared) => prepared,
        Err(error) => return fail(name, &error, 2),
    };
    match run(&args, names) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => fail(name, &error, 1),
    }
}

fn prepare(args: Vec<String>, name: &str) -> anyhow::Result<(Arguments, Names)> {
    let args = Arguments::parse(args)?;
    if let Some(unknown) = args.rest.first() {
        anyhow::bail!("unknown argument {unknown}; ROS arguments come after --ros-args (see --help)");
    }
    let names = Names::new(&args, name)?;
    rosout::start(&args, names.node().base())?;
    Ok((args, names))
}

fn help(name: &str, about: &str) -> String {
    format!(
        "{about}\n\nUsage: {name} [--ros-args OPTION...]\n\n\
         \x20 -r FROM:=TO             rename a topic or service; __ns and __node rename the node\n\
         \x20 -p NAME:=VALUE          set a parameter\n\
         \x20 --params-file FILE      set parameters from a file\n\
         \x20 --log-level LEVEL       debug, info, warn, error\n\n\
         Topics and parameters are documented in the README; `ros2 param describe /{name} NAME` explains a parameter.\n"
    )
}

fn print(text: &str) -> ExitCode {
    // Nobody reads it when stdout is closed.
    let _ = std::io::stdout().write_all(text.as_bytes());
    ExitCode::SUCCESS
}

fn fail(name: &str, error: &anyhow::Error, status: u8) -> ExitCode {
    let _ = writeln!(std::io::stderr(), "{name}: {error:#}");
    ExitCode::from(status)
}
