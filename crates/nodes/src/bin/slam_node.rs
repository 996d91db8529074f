//! Finds what moves, tracks the camera and builds a map, in one process.

use std::process::ExitCode;

use pfd_slam_nodes::slam::Kind;

fn main() -> ExitCode {
    pfd_slam_nodes::app::main(
        "slam_node",
        "Finds what moves, tracks the camera and builds a map, in one process.",
        |args, names| pfd_slam_nodes::slam::run(Kind::Composed, args, names),
    )
}
