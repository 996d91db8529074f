//! The nodes beside real peers: rclpy on Fast DDS, and Cyclone DDS. Skipped where the peers are not installed.

use crate::support::{Node, own_messages, peer_python, replay, run_peer, slam};
use pfd_tests::domain::Domain;
use pfd_tests::{bundled_sequence, programs};
use serde_json::Value;

/// How long the peers' cameras run, seconds.
const SECONDS: &str = "10";

fn check_rclpy(reliability: &str) {
    let Some(python) = peer_python("jazzy") else { return };
    let (folder, domain) = (tempfile::tempdir().unwrap(), Domain::reserve().unwrap());
    // A machine that builds and tests at the same time is slower than the camera: the newest image counts.
    let mut node = Node::start("slam_node", &domain, folder.path(), &[]).unwrap();
    let report = run_peer(&python, "ros_rclpy_peer.py", &domain, &["slam_node", reliability, SECONDS], &[]).unwrap();
    node.stop("INT").unwrap();
    for topic in
        ["pose", "odometry", "path", "map_points", "keyframes", "dynamic_mask", "overlay", "/diagnostics", "/rosout"]
    {
        assert!(report["received"][topic].as_u64().unwrap_or(0) > 0, "nothing on {topic}: {report}\n{}", node.log());
    }
    check_graph(&report);
    check_parameters(&report);
    check_motion(&report);
    assert_eq!(report["sim_stamp"], 1234, "simulated time: {report}");
    assert!(report["pause"] == true && report["resume"] == true, "{report}");
}

fn check_graph(report: &Value) {
    assert!(report["nodes"].as_array().unwrap().iter().any(|n| n == "slam_node"), "{report}");
    for (topic, kind) in [
        ("/dynamic_mask", "sensor_msgs/msg/Image"),
        ("/dynamic_regions", "pfd_slam_msgs/msg/DynamicRegions"),
        ("/tracking_state", "pfd_slam_msgs/msg/TrackingState"),
        ("/odometry", "nav_msgs/msg/Odometry"),
        ("/tf", "tf2_msgs/msg/TFMessage"),
    ] {
        assert_eq!(report["topics"][topic], kind, "{report}");
    }
}

fn check_parameters(report: &Value) {
    let listed = report["listed"].as_array().unwrap().len();
    assert!(
        listed > 50 && report["listed"].as_array().unwrap().iter().any(|n| n == "segmentation.particles.count"),
        "{report}"
    );
    assert_eq!(report["all_values"].as_array().map(Vec::len), Some(listed), "{report}");
    let texts = report["all_texts"].as_array().unwrap();
    assert!(texts.len() == listed && texts.iter().all(|length| length.as_u64() > Some(0)), "{report}");
    assert_eq!(report["got"], serde_json::json!([0.2, "best_effort", 1000]), "{report}");
    assert!(report["described"][0][0].as_str().unwrap().contains("seconds"), "{report}");
    assert_eq!(
        (&report["described"][0][1], &report["described"][1][1]),
        (&false.into(), &true.into()),
        "read-only: {report}"
    );
    assert!(report["set_good"][0] == true && report["set_running"][0] == true, "{report}");
    assert_eq!(report["set_bad"][0], false, "{report}");
    assert!(report["set_bad"][1].as_str().unwrap().contains("out of range"), "{report}");
}

/// The camera moves sideways past a wall: in the odometry frame that is to the right, which is -y.
fn check_motion(report: &Value) {
    let position: Vec<f64> = report["position"].as_array().unwrap().iter().filter_map(Value::as_f64).collect();
    let expected = report["expected_x"].as_f64().unwrap();
    assert!(position[1] < -0.3 * expected, "{report}");
    assert!(position[0].abs() < 0.1 && position[2].abs() < 0.1, "{report}");
}

#[test]
fn rclpy_best_effort() {
    check_rclpy("BEST_EFFORT");
}

#[test]
fn rclpy_reliable() {
    check_rclpy("RELIABLE");
}

#[test]
fn cyclone_camera_and_transforms() {
    let Some(python) = peer_python("cyclone") else { return };
    let (folder, domain) = (tempfile::tempdir().unwrap(), Domain::reserve().unwrap());
    let mut node = Node::start("slam_node", &domain, folder.path(), &[]).unwrap();
    let report = run_peer(&python, "ros_cyclone_peer.py", &domain, &[SECONDS], &[]).unwrap();
    node.stop("INT").unwrap();
    assert!(report["poses"].as_u64().unwrap() > 10, "{report}\n{}", node.log());
    let frames = &report["transforms"];
    assert!(frames["map->odom"].as_u64().unwrap_or(0) > 10, "{report}");
    assert!(frames["odom->camera_link"].as_u64().unwrap_or(0) > 10, "the base comes from /tf_static: {report}");
    let below_odom = frames.as_object().unwrap().keys().filter(|name| name.starts_with("odom->")).count();
    assert_eq!(below_odom, 1, "nothing stood in for the base: {report}");
    let mask = report["mask"].as_array().unwrap();
    assert_eq!((&mask[0], &mask[1], &mask[2]), (&640.into(), &480.into(), &"mono8".into()), "{report}");
}

#[test]
fn a_node_that_is_stopped_says_goodbye() {
    let Some(python) = peer_python("jazzy") else { return };
    let domain = Domain::reserve().unwrap();
    let node = programs::binary("slam_node").unwrap();
    let report = run_peer(&python, "ros_goodbye.py", &domain, &[node.to_str().unwrap()], &[]).unwrap();
    assert_eq!(report, serde_json::json!({"seen": true, "gone": true, "exit": 0}));
}

#[test]
fn a_camera_with_two_clocks_is_named_and_one_that_changes_leaves_the_odometry_where_it_is() {
    let Some(python) = peer_python("jazzy") else { return };
    let (folder, domain) = (tempfile::tempdir().unwrap(), Domain::reserve().unwrap());
    let mut node = Node::start("slam_node", &domain, folder.path(), &[]).unwrap();
    let sequence = bundled_sequence();
    let report = run_peer(&python, "ros_odd_camera.py", &domain, &[sequence.to_str().unwrap()], &[]).unwrap();
    node.stop("INT").unwrap();
    assert!(report["skewed"].as_str().is_some_and(|said| said.contains("differ by -5.0")), "{report}");
    assert_eq!(report["poses_while_skewed"], 0, "{report}");
    let position = |when: &str| {
        let coordinates = report[when].as_array().unwrap().iter().filter_map(Value::as_f64);
        nalgebra::Vector3::from_iterator(coordinates)
    };
    let (before, after) = (position("before"), position("after"));
    // A second and a half lie between the two, in which no image was taken but the first of the new size.
    assert!(before.norm() > 0.1 && (after - before).norm() < 0.5 * before.norm(), "{report}\n{}", node.log());
    assert!(report["poses_after"].as_u64().unwrap() > 10, "{report}\n{}", node.log());
}

#[test]
fn rclpy_reads_our_own_messages() {
    let (Some(python), Some(environment)) = (peer_python("jazzy"), own_messages()) else { return };
    let (folder, domain) = (tempfile::tempdir().unwrap(), Domain::reserve().unwrap());
    let mut node = slam("slam_node", &domain, folder.path());
    let mut replay = replay(&domain, folder.path(), 1, &["-p", "loop:=true"]);
    let saved = folder.path().join("saved.txt");
    let args = ["slam_node", saved.to_str().unwrap()];
    let report = run_peer(&python, "ros_own_messages.py", &domain, &args, &environment).unwrap();
    replay.stop("INT").unwrap();
    node.stop("INT").unwrap();
    assert!(report["states"].as_u64().unwrap() >= 20 && report["regions"].as_u64().unwrap() >= 20, "{report}");
    assert_eq!(report["state"], report["ok"], "{report}");
    assert!(report["features"].as_u64().unwrap() > 0 && report["stages"].as_array().unwrap().len() > 1, "{report}");
    assert!(report["mask_used"] == true && report["boxes_fit"] == true, "{report}");
    assert!(report["objects"].as_u64().unwrap() > 0, "boxes of what: {report}");
    assert_eq!(report["saved"][0], true, "{report}");
    assert!(std::fs::read_to_string(saved).unwrap().lines().count() > 1, "{report}");
}
