//! The demo as a user runs it, while a listener counts what every topic carries.

// Tests fail by panicking, and so may their helpers.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::BTreeMap;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use pfd_ros::messages::diagnostic::DiagnosticArray;
use pfd_ros::messages::geometry::{PoseStamped, TfMessage};
use pfd_ros::messages::nav;
use pfd_ros::messages::pfd::{DynamicRegions, TrackingState};
use pfd_ros::messages::sensor::{CameraInfo, Image, PointCloud2};
use pfd_ros::messages::standard::Clock;
use pfd_ros::messages::visualization::MarkerArray;
use pfd_ros::{Arguments, Names, Node, Qos, RosError, Setup};
use pfd_tests::domain::Domain;
use pfd_tests::repository;
use tokio::sync::Notify;

/// Share of the frames that must have a pose. The replay waits for the nodes, so that what else runs on the machine does not
/// decide.
const MIN_TRACKED: f64 = 0.99;
/// Largest absolute error (RMSE), metres.
const MAX_ATE: f64 = 0.03;

type Counts = Arc<Mutex<BTreeMap<&'static str, u64>>>;

macro_rules! count_topics {
    ($node:expr, $counts:expr, $($name:literal: $message:ty, $qos:expr;)*) => {
        $({
            let counts = $counts.clone();
            counts.lock().unwrap().insert($name, 0);
            $node.subscribe::<$message>($name, $qos, move |_| *counts.lock().unwrap().entry($name).or_default() += 1)?;
        })*
    };
}

fn listen(node: &mut Node, counts: &Counts) -> Result<(), RosError> {
    let some = Qos::best_effort(10);
    count_topics!(node, counts,
        "/camera/rgb/image_raw": Image, some;
        "/camera/depth_registered/image_raw": Image, some;
        "/camera/rgb/camera_info": CameraInfo, some;
        "/clock": Clock, some;
        "/tf_static": TfMessage, Qos::latched();
        "ground_truth/pose": PoseStamped, some;
        "ground_truth/path": nav::Path, Qos::latched();
        "dynamic_mask": Image, Qos::masks();
        "dynamic_regions": DynamicRegions, some;
        "overlay": Image, some;
        "pose": PoseStamped, some;
        "odometry": nav::Odometry, some;
        "path": nav::Path, Qos::latched();
        "map_points": PointCloud2, Qos::latched();
        "keyframes": MarkerArray, Qos::latched();
        "tracking_state": TrackingState, some;
        "/tf": TfMessage, some;
        "/diagnostics": DiagnosticArray, some;
    );
    Ok(())
}

#[test]
#[allow(clippy::print_stdout)] // What the demo says belongs into the log of the checks.
#[ignore = "builds and replays; .ci/run calls it"]
fn the_demo_tracks_and_every_topic_carries_data() {
    let out = tempfile::tempdir().unwrap();
    let arguments = Arguments::parse(["--ros-args".to_owned()]).unwrap();
    let names = Names::new(&arguments, "demo_listener").unwrap();
    let mut setup = Setup::new(&arguments, names, "loopback", false).unwrap();
    let reserved = Domain::reserve().unwrap();
    setup.domain = reserved.id();
    let (counts, done) = (Counts::default(), Arc::new(Notify::new()));
    let domain = reserved.to_string();
    let demo = || {
        let mut command = Command::new(repository().join("launch_scripts/demo.sh"));
        command.args(["--rate", "0", "--out"]).arg(out.path()).env("ROS_DOMAIN_ID", &domain);
        let output = command.output().unwrap();
        done.notify_one();
        output
    };
    let output = std::thread::scope(|scope| {
        let demo = scope.spawn(demo);
        pfd_ros::run(&setup, &done, |node: &mut Node| listen(node, &counts)).unwrap();
        demo.join().unwrap()
    });
    let text = String::from_utf8_lossy(&output.stdout);
    println!("{text}");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let counts = counts.lock().unwrap();
    println!("messages: {counts:?}");
    assert!(counts.values().all(|&n| n > 0), "a topic carried nothing: {counts:?}");
    let report = std::fs::read_to_string(out.path().join("report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    assert!(report["tracked"].as_f64().unwrap() >= MIN_TRACKED, "{text}");
    assert!(report["ate"]["rmse"].as_f64().unwrap() <= MAX_ATE, "{text}");
    for file in ["report.html", "picture.svg", "trajectory.txt"] {
        assert!(out.path().join(file).exists(), "{file}");
    }
}

/// Moments at which the demo is interrupted.
#[derive(Clone, Copy, Debug)]
enum Moment {
    /// While cargo looks whether something is to be built.
    Building,
    /// Once the nodes are started.
    Started,
    /// Once the first mask is written.
    Replaying,
}

impl Moment {
    fn has_come(self, said: &str, out: &Path) -> bool {
        match self {
            Self::Building => said.contains("Building"),
            Self::Started => said.contains("Replaying"),
            Self::Replaying => std::fs::read_dir(out.join("masks")).is_ok_and(|mut masks| masks.next().is_some()),
        }
    }
}

/// Waits until `condition` holds; fails with what the demo said when that takes unreasonably long.
fn wait_until(log: &Path, what: &str, mut condition: impl FnMut(&str) -> bool) {
    /// Far more than a loaded machine needs.
    const PATIENCE: Duration = Duration::from_secs(300);
    let deadline = Instant::now() + PATIENCE;
    let said = || std::fs::read_to_string(log).unwrap_or_default();
    while !condition(&said()) {
        assert!(Instant::now() < deadline, "{what} has not come: {}", said());
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Command lines of the processes of a group, zombies left out.
fn processes_of_group(group: u32) -> Vec<String> {
    let of_process = |folder: PathBuf| {
        let stat = std::fs::read_to_string(folder.join("stat")).ok()?;
        // Behind the name, which may hold anything: state, parent, group.
        let fields: Vec<&str> = stat[stat.rfind(')')? + 1..].split_whitespace().collect();
        let command = std::fs::read_to_string(folder.join("cmdline")).unwrap_or_default().replace('\0', " ");
        (fields[0] != "Z" && fields[2] == group.to_string()).then_some(command)
    };
    std::fs::read_dir("/proc").unwrap().filter_map(|entry| of_process(entry.unwrap().path())).collect()
}

/// Starts the demo in a process group of its own and sends the group SIGINT, as Ctrl-C in a terminal does.
fn interrupt_demo_at(moment: Moment) {
    let folder = tempfile::tempdir().unwrap();
    let (log, out) = (folder.path().join("log"), folder.path().join("out"));
    let file = std::fs::File::create(&log).unwrap();
    // A shell that was started with SIGINT ignored, as in the background of another, cannot trap it.
    let mut command = Command::new("env");
    command.arg("--default-signal=INT").arg(repository().join("launch_scripts/demo.sh"));
    command.arg("--out").arg(&out).stdin(Stdio::null()).stdout(file.try_clone().unwrap()).stderr(file);
    let mut demo = command.process_group(0).spawn().unwrap();
    wait_until(&log, &format!("{moment:?}"), |said| moment.has_come(said, &out));
    let status = Command::new("kill").args(["-INT", "--", &format!("-{}", demo.id())]).status().unwrap();
    assert!(status.success(), "the demo has ended before");
    let mut ended = None;
    wait_until(&log, "the end", |_| {
        ended = demo.try_wait().unwrap();
        ended.is_some()
    });
    let said = std::fs::read_to_string(&log).unwrap();
    assert_eq!(ended.and_then(|status| status.code()), Some(130), "{moment:?}: {said}");
    assert!(said.contains("nothing it started is left running"), "{moment:?}: {said}");
    assert_eq!(processes_of_group(demo.id()), Vec::<String>::new(), "{moment:?}: {said}");
}

#[test]
#[ignore = "builds and replays; .ci/run calls it"]
fn ctrl_c_ends_everything_the_demo_started() {
    for moment in [Moment::Building, Moment::Started, Moment::Replaying] {
        interrupt_demo_at(moment);
    }
}
