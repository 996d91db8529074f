//! Finds what moves in the images of an RGB-D camera.

use std::process::ExitCode;

fn main() -> ExitCode {
    pfd_slam_nodes::app::main(
        "segmentation_node",
        "Finds what moves in the images of an RGB-D camera.",
        pfd_slam_nodes::segmentation::run,
    )
}
