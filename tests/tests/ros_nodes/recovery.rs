//! What happens to the others when a process is suspended, killed, or hangs.

use std::path::Path;

use crate::support::{Node, PATIENCE, peer_python, replay, slam};
use pfd_tests::domain::Domain;

/// A lossless replay that soon sends a frame again when nobody says to have worked on it.
fn impatient_replay(domain: &Domain, folder: &Path, nodes: usize) -> Node {
    replay(domain, folder, nodes as u32, &["-p", "duration:=2.0", "-p", "acknowledge_timeout:=8.0"])
}

/// What the replay says when a node does not answer.
const SENT_AGAIN: &str = "sending it again";

fn start(names: &[&str], domain: &Domain, folder: &Path) -> Vec<Node> {
    names.iter().map(|name| slam(name, domain, folder)).collect()
}

fn logs(nodes: &[Node]) -> String {
    nodes.iter().map(Node::log).collect()
}

/// Suspends one of the nodes until the replay misses it, and lets it go on.
fn check_suspension(names: &[&str], suspended: usize) {
    let (folder, domain) = (tempfile::tempdir().unwrap(), Domain::reserve().unwrap());
    let mut nodes = start(names, &domain, folder.path());
    let mut replay = impatient_replay(&domain, folder.path(), names.len());
    replay.wait_for("frames", PATIENCE).unwrap();
    nodes[suspended].signal("STOP").unwrap();
    replay.wait_for(SENT_AGAIN, PATIENCE).unwrap();
    nodes[suspended].signal("CONT").unwrap();
    assert!(replay.wait(PATIENCE).unwrap().success(), "{}\n{}", replay.log(), logs(&nodes));
    // It was suspended for the replay's acknowledge_timeout, for which others may have given it up.
    assert!(nodes[suspended].count("joining anew") > 0, "{}", nodes[suspended].log());
    for node in &mut nodes {
        node.stop("TERM").unwrap();
    }
}

/// Kills one of the nodes and starts it anew.
fn check_replacement(names: &[&str], killed: usize) {
    let (folder, domain) = (tempfile::tempdir().unwrap(), Domain::reserve().unwrap());
    let mut nodes = start(names, &domain, folder.path());
    let mut replay = impatient_replay(&domain, folder.path(), names.len());
    replay.wait_for("frames", PATIENCE).unwrap();
    nodes[killed].signal("KILL").unwrap();
    nodes[killed].wait(PATIENCE).unwrap();
    nodes[killed] = slam(names[killed], &domain, folder.path());
    assert!(replay.wait(PATIENCE).unwrap().success(), "{}\n{}", replay.log(), logs(&nodes));
    for node in &mut nodes {
        node.stop("INT").unwrap();
    }
}

#[test]
fn a_suspended_slam_node_goes_on() {
    check_suspension(&["slam_node"], 0);
}

#[test]
fn a_suspended_tracking_node_goes_on() {
    check_suspension(&["segmentation_node", "tracking_node"], 1);
}

#[test]
fn a_killed_slam_node_is_replaced() {
    check_replacement(&["slam_node"], 0);
}

#[test]
fn a_killed_segmentation_node_is_replaced() {
    check_replacement(&["segmentation_node", "tracking_node"], 0);
}

#[test]
fn a_killed_tracking_node_is_replaced() {
    check_replacement(&["segmentation_node", "tracking_node"], 1);
}

#[test]
fn a_suspended_segmentation_node_goes_on_and_tracking_does_not_wait_for_it() {
    let (folder, domain) = (tempfile::tempdir().unwrap(), Domain::reserve().unwrap());
    // Without `queue: all` tracking gives up on a mask after `mask_timeout`.
    let mut segmentation = slam("segmentation_node", &domain, folder.path());
    let frames_file = format!("frames_file:={}", folder.path().join("tracking_node.csv").display());
    let live = ["--params-file", &crate::support::parameters(), "-p", "queue:=newest", "-p", &frames_file];
    let mut tracking = Node::start("tracking_node", &domain, folder.path(), &live).unwrap();
    let mut replay = impatient_replay(&domain, folder.path(), 2);
    replay.wait_for("frames", PATIENCE).unwrap();
    segmentation.signal("STOP").unwrap();
    tracking.wait_for("tracked without a mask", PATIENCE).unwrap();
    segmentation.signal("CONT").unwrap();
    assert!(replay.wait(PATIENCE).unwrap().success(), "{}\n{}", replay.log(), tracking.log());
    segmentation.stop("TERM").unwrap();
    tracking.stop("TERM").unwrap();
    let last_stamp = |file: &str| {
        let text = std::fs::read_to_string(folder.path().join(file)).unwrap();
        text.lines().last().unwrap().split(',').next().unwrap().to_owned()
    };
    assert_eq!(last_stamp("segmentation_node.csv"), last_stamp("tracking_node.csv"), "segmentation works again");
}

#[test]
fn a_killed_camera_is_picked_up_again() {
    let (folder, domain) = (tempfile::tempdir().unwrap(), Domain::reserve().unwrap());
    let mut node = slam("slam_node", &domain, folder.path());
    let mut first = impatient_replay(&domain, folder.path(), 1);
    first.wait_for("frames", PATIENCE).unwrap();
    first.signal("KILL").unwrap();
    first.wait(PATIENCE).unwrap();
    let mut second = impatient_replay(&domain, folder.path(), 1);
    assert!(second.wait(PATIENCE).unwrap().success(), "{}\n{}", second.log(), node.log());
    node.stop("INT").unwrap();
}

/// Twice what the node may keep for a subscriber that hangs (60 masks and overlays, 75 MB); what it publishes in three rounds is
/// 500 MB.
const MAX_GROWTH: u64 = 150 << 20;

/// Rounds after which queues and the middleware's caches are as large as they get.
const WARM: usize = 4;

#[test]
fn a_subscriber_that_hangs_harms_nobody() {
    let Some(python) = peer_python("cyclone") else { return };
    let (folder, domain) = (tempfile::tempdir().unwrap(), Domain::reserve().unwrap());
    let fast = ["--params-file", &crate::support::parameters(), "-p", "mode:=none", "-p", "overlay_qos:=reliable"];
    let mut node = Node::start("slam_node", &domain, folder.path(), &fast).unwrap();
    let subscriber = Node::script(&python, "ros_hanging_subscriber.py", &domain, folder.path()).unwrap();
    let mut replay = replay(&domain, folder.path(), 1, &["-p", "loop:=true"]);
    subscriber.wait_for("mask", PATIENCE).unwrap();
    replay.wait_for_times("again from the start", WARM, PATIENCE).unwrap();
    let before = node.peak_memory().unwrap();
    subscriber.signal("STOP").unwrap();
    replay.wait_for_times("again from the start", WARM + 3, PATIENCE).unwrap();
    let after = node.peak_memory().unwrap();
    assert!(after < before + MAX_GROWTH, "{before} bytes grew to {after}: {}", node.log());
    replay.stop("INT").unwrap();
    node.stop("INT").unwrap();
}
