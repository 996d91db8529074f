//! The nodes as processes over DDS.

use std::path::Path;
use std::process::Command;

use crate::support::{Node, PATIENCE, replay, slam_in_mode};
use pfd_tests::domain::Domain;
use pfd_tests::{bundled_sequence, programs, repository};

fn lines(path: &Path) -> usize {
    std::fs::read_to_string(path).unwrap().lines().count()
}

/// The trajectory by these nodes in a mode, and how many frames the last of them had.
fn by_nodes(mode: &str, nodes: &[&str], out: &Path) -> (String, usize) {
    std::fs::create_dir_all(out).unwrap();
    let domain = Domain::reserve().unwrap();
    let mut running: Vec<Node> = nodes.iter().map(|name| slam_in_mode(mode, name, &domain, out)).collect();
    let mut replay = replay(&domain, out, nodes.len() as u32, &["-p", "duration:=1.5"]);
    assert!(replay.wait(PATIENCE).unwrap().success(), "{}", replay.log());
    for node in &mut running {
        node.stop("INT").unwrap();
    }
    // Without the header.
    let frames = lines(&out.join(format!("{}.csv", nodes[nodes.len() - 1]))) - 1;
    (std::fs::read_to_string(out.join("trajectory.txt")).unwrap(), frames)
}

/// The nodes, composed and as `separate` processes, give the same trajectory as the command line.
fn check_trajectories(mode: &str, separate: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    let (composed, frames) = by_nodes(mode, &["slam_node"], &folder.path().join("composed"));
    assert!(frames >= 40, "1.5 s at 30 Hz, not {frames} frames");
    let out = folder.path().join("offline");
    let status = programs::pfd_slam()
        .unwrap()
        .args(["run", bundled_sequence().to_str().unwrap(), "--out", out.to_str().unwrap(), "--mode", mode])
        .args(["--max-frames", &frames.to_string()])
        .status()
        .unwrap();
    assert!(status.success());
    let offline = std::fs::read_to_string(out.join("trajectory.txt")).unwrap();
    assert!(offline.lines().count() > frames / 2, "most frames are tracked");
    assert_eq!(composed, offline, "composed against offline");
    assert_eq!(by_nodes(mode, separate, &folder.path().join("separate")).0, offline, "separate against offline");
}

#[test]
fn separate_nodes_composed_node_and_offline_give_the_same_trajectory() {
    check_trajectories("pfd", &["segmentation_node", "tracking_node"]);
}

#[test]
fn so_they_do_where_nothing_is_looked_for() {
    check_trajectories("none", &["tracking_node"]);
}

#[test]
fn mistakes_end_a_node_with_one_line_that_names_them() {
    let domain = Domain::reserve().unwrap();
    let run = |name: &str, args: &[&str]| {
        let program = programs::binary(name).unwrap();
        let output = Command::new(program).args(args).env("ROS_DOMAIN_ID", domain.to_string()).output().unwrap();
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    let readme = repository().join("README.md");
    let readme = readme.to_str().unwrap();
    let bundled = format!("sequence:={}", bundled_sequence().display());
    let bundled = bundled.as_str();
    for (name, args, code, expected) in [
        ("slam_node", &["--frobnicate"][..], 2, "--frobnicate"),
        ("slam_node", &["--ros-args", "-r", "nonsense"], 2, "expected `name:=value`"),
        ("slam_node", &["--ros-args", "-p", "mask_timeout:=-1"], 1, "mask_timeout"),
        ("tracking_node", &["--ros-args", "-p", "trakcing.x:=1"], 1, "trakcing"),
        ("segmentation_node", &["--ros-args", "--params-file", "/none.yaml"], 1, "/none.yaml"),
        ("segmentation_node", &["--ros-args", "-p", "network:=moon"], 1, "moon"),
        ("segmentation_node", &["--ros-args", "--params-file", readme], 1, "README.md is not valid YAML"),
        ("slam_node", &["--ros-args", "-p", "trajectory_file:=/proc/none/t.txt"], 1, "trajectory_file"),
        ("bag_replay_node", &[], 1, "parameter `sequence` is needed"),
        ("bag_replay_node", &["--ros-args", "-p", bundled, "-p", "start:=1000.0", "-p", "loop:=true"], 1, "`start`"),
        ("bag_replay_node", &["--ros-args", "-p", bundled, "-p", "acknowledge_topic:=x"], 1, "acknowledge_topic"),
        ("bag_replay_node", &["--ros-args", "-p", "sequence:=/none"], 1, "/none"),
    ] {
        let (status, stderr) = run(name, args);
        assert_eq!(status, Some(code), "{name} {args:?}: {stderr}");
        assert!(stderr.contains(expected) && stderr.trim_end().lines().count() == 1, "{name} {args:?}: {stderr}");
    }
}

#[test]
fn a_replay_that_nobody_hears_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let mut replay = replay(&Domain::reserve().unwrap(), folder.path(), 1, &["-p", "wait_timeout:=1.0"]);
    assert_eq!(replay.wait(PATIENCE).unwrap().code(), Some(1));
    assert!(replay.log().contains("wait_for_subscribers"), "{}", replay.log());
}
