//! The nodes as processes over DDS.

use std::path::Path;
use std::process::Command;
use std::time::Duration;

use crate::support::{Node, domain};
use pfd_tests::{bundled_sequence, programs, repository};

const PATIENCE: Duration = Duration::from_secs(180);

fn parameters() -> String {
    repository().join("config/replay.yaml").display().to_string()
}

/// Replays the first seconds of the bundled sequence, lossless.
fn replay(domain: &str, folder: &Path, subscribers: u32, more: &[&str]) -> Node {
    let sequence = format!("sequence:={}", bundled_sequence().display());
    let wait = format!("wait_for_subscribers:={subscribers}");
    let file = parameters();
    let mut args = vec!["--params-file", &file, "-p", &sequence, "-p", "rate:=0.0", "-p", &wait];
    args.extend(more);
    Node::start("bag_replay_node", domain, folder, &args).unwrap()
}

fn slam(name: &str, domain: &str, folder: &Path) -> Node {
    let trajectory = format!("trajectory_file:={}", folder.join("trajectory.txt").display());
    let frames = format!("frames_file:={}", folder.join(format!("{name}.csv")).display());
    Node::start(name, domain, folder, &["--params-file", &parameters(), "-p", &trajectory, "-p", &frames]).unwrap()
}

fn lines(path: &Path) -> usize {
    std::fs::read_to_string(path).unwrap().lines().count()
}

#[test]
fn separate_nodes_composed_node_and_offline_give_the_same_trajectory() {
    let folder = tempfile::tempdir().unwrap();
    let part = ["-p", "duration:=1.5"];
    let mut trajectories = Vec::new();
    let mut frames = 0;
    for (i, nodes) in [&["slam_node"][..], &["segmentation_node", "tracking_node"]].into_iter().enumerate() {
        let (domain, out) = (domain(i as u32), folder.path().join(i.to_string()));
        std::fs::create_dir_all(&out).unwrap();
        let mut running: Vec<Node> = nodes.iter().map(|name| slam(name, &domain, &out)).collect();
        let mut replay = replay(&domain, &out, nodes.len() as u32, &part);
        assert!(replay.wait(PATIENCE).unwrap().success(), "{}", replay.log());
        for node in &mut running {
            node.stop("INT").unwrap();
        }
        // Without the header.
        frames = lines(&out.join(format!("{}.csv", nodes[nodes.len() - 1]))) - 1;
        trajectories.push(std::fs::read_to_string(out.join("trajectory.txt")).unwrap());
    }
    assert!(frames >= 40, "1.5 s at 30 Hz, not {frames} frames");
    let out = folder.path().join("offline");
    let status = programs::pfd_slam()
        .unwrap()
        .args(["run", bundled_sequence().to_str().unwrap(), "--out", out.to_str().unwrap()])
        .args(["--max-frames", &frames.to_string()])
        .status()
        .unwrap();
    assert!(status.success());
    let offline = std::fs::read_to_string(out.join("trajectory.txt")).unwrap();
    assert!(offline.lines().count() > frames / 2, "most frames are tracked");
    assert_eq!(trajectories[0], offline, "composed against offline");
    assert_eq!(trajectories[1], offline, "separate against offline");
}

#[test]
fn a_suspended_node_joins_anew_and_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let domain = domain(2);
    let mut node = slam("slam_node", &domain, folder.path());
    let mut replay = replay(&domain, folder.path(), 1, &["-p", "duration:=3.0", "-p", "acknowledge_timeout:=5.0"]);
    replay.wait_for("frames", PATIENCE).unwrap();
    node.suspend_until("joining anew", Duration::from_secs(60)).unwrap();
    assert!(replay.wait(PATIENCE).unwrap().success(), "{}\n{}", replay.log(), node.log());
    node.stop("TERM").unwrap();
}

#[test]
fn a_killed_node_is_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let domain = domain(3);
    let mut node = slam("slam_node", &domain, folder.path());
    let mut replay = replay(&domain, folder.path(), 1, &["-p", "duration:=2.0", "-p", "acknowledge_timeout:=5.0"]);
    replay.wait_for("frames", PATIENCE).unwrap();
    node.signal("KILL").unwrap();
    node.wait(PATIENCE).unwrap();
    let mut second = slam("slam_node", &domain, folder.path());
    assert!(replay.wait(PATIENCE).unwrap().success(), "{}\n{}", replay.log(), second.log());
    second.stop("INT").unwrap();
}

#[test]
fn mistakes_end_a_node_with_one_line_that_names_them() {
    let run = |name: &str, args: &[&str]| {
        let program = programs::binary(name).unwrap();
        let output = Command::new(program).args(args).env("ROS_DOMAIN_ID", domain(4)).output().unwrap();
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    for (name, args, code, expected) in [
        ("slam_node", &["--frobnicate"][..], 2, "--frobnicate"),
        ("slam_node", &["--ros-args", "-r", "nonsense"], 2, "expected `name:=value`"),
        ("slam_node", &["--ros-args", "-p", "mask_timeout:=-1"], 1, "mask_timeout"),
        ("tracking_node", &["--ros-args", "-p", "trakcing.x:=1"], 1, "trakcing"),
        ("segmentation_node", &["--ros-args", "--params-file", "/none.yaml"], 1, "/none.yaml"),
        ("segmentation_node", &["--ros-args", "-p", "network:=moon"], 1, "moon"),
        ("bag_replay_node", &[], 1, "parameter `sequence` is needed"),
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
    let mut replay = replay(&domain(5), folder.path(), 1, &["-p", "wait_timeout:=1.0"]);
    assert_eq!(replay.wait(PATIENCE).unwrap().code(), Some(1));
    assert!(replay.log().contains("wait_for_subscribers"), "{}", replay.log());
}
