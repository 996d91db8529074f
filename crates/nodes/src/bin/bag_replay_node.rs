//! Replays a sequence in TUM layout as if it were a camera.

use std::process::ExitCode;

fn main() -> ExitCode {
    pfd_slam_nodes::app::main(
        "bag_replay_node",
        "Replays a sequence in TUM layout as if it were a camera.",
        pfd_slam_nodes::replay::run,
    )
}
