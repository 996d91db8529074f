//! Tracks an RGB-D camera and builds a map.

use std::process::ExitCode;

use pfd_slam_nodes::slam::Kind;

fn main() -> ExitCode {
    pfd_slam_nodes::app::main("tracking_node", "Tracks an RGB-D camera and builds a map.", |args, names| {
        pfd_slam_nodes::slam::run(Kind::Tracking, args, names)
    })
}
