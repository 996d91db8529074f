//! The evaluator against known answers of other tools: the benchmark's scripts and evo.

// Tests fail by panicking, and so may their helpers.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use nalgebra::Vector3;
use pfd_evaluation::{Statistics, ate, read_trajectory, rpe, write_trajectory};
use pfd_geometry::{Pose, Stamp, StampedPose};
use pfd_tests::{data, programs};

/// Agreement asked for: the known answers are printed with six decimals.
const TOLERANCE: f64 = 1e-6;

/// `name value unit` lines of the benchmark's scripts.
fn recorded(path: &Path) -> BTreeMap<String, f64> {
    let text = std::fs::read_to_string(path).unwrap();
    let line = |l: &str| {
        let mut fields = l.split_whitespace();
        Some((fields.next()?.to_owned(), fields.next()?.parse().ok()?))
    };
    text.lines().filter_map(line).collect()
}

fn file_with(folder: &Path, part: &str) -> PathBuf {
    let mut files = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
    files.find(|f| f.file_name().unwrap().to_string_lossy().contains(part)).unwrap()
}

fn assert_recorded(record: &BTreeMap<String, f64>, prefix: &str, s: &Statistics, fields: &[&str]) {
    assert_eq!(record["compared_pose_pairs"] as usize, s.pairs);
    for (name, value) in named(s).into_iter().filter(|(name, _)| fields.contains(name)) {
        let known = record[&format!("{prefix}.{name}")];
        assert!((known - value).abs() <= TOLERANCE, "{prefix}.{name}: {value}, known answer {known}");
    }
}

fn named(s: &Statistics) -> [(&'static str, f64); 6] {
    [("rmse", s.rmse), ("mean", s.mean), ("median", s.median), ("std", s.std), ("min", s.min), ("max", s.max)]
}

/// Output of the benchmark's `evaluate_ate.py` and `evaluate_rpe.py --fixed_delta` that another project recorded.
#[test]
fn agrees_with_recorded_output_of_the_benchmarks_scripts() {
    let Some(data) = data("tum-fr3-dynamic-text") else { return };
    const ALL: [&str; 6] = ["rmse", "mean", "median", "std", "min", "max"];
    for sequence in ["sitting_static", "walking_static", "walking_xyz", "walking_rpy", "walking_halfsphere"] {
        let folder = data.join(format!("estimates/dynaslam-yubaoliu/fr3_{sequence}"));
        let truth = read_trajectory(&data.join(format!("groundtruth/fr3_{sequence}.txt"))).unwrap();
        let estimate = read_trajectory(&folder.join("CameraTrajectory_0.txt")).unwrap();
        let record = recorded(&file_with(&folder, "_ate_"));
        assert_recorded(&record, "absolute_translational_error", &ate(&truth, &estimate).unwrap().statistics, &ALL);
        let (record, relative) = (recorded(&file_with(&folder, "_rpe_")), rpe(&truth, &estimate, 1.0).unwrap());
        assert_recorded(&record, "translational_error", &relative.translation, &ALL);
        // That script prints the median of the rotation in radians and calls it degrees.
        let others = ["rmse", "mean", "std", "min", "max"];
        assert_recorded(&record, "rotational_error", &relative.rotation_deg, &others);
    }
}

/// Figures listed in the data's README, four decimals.
#[test]
fn agrees_with_the_listed_figures() {
    let Some(data) = data("tum-fr3-dynamic-text") else { return };
    for (estimate, sequence, pairs, rmse) in [
        ("dynamic_orb_slam2-horacehxw/fr3_walking_static_ORB.txt", "walking_static", 714, 0.3789),
        ("dynamic_orb_slam2-horacehxw/fr3_walking_xyz_Dyna0.txt", "walking_xyz", 826, 0.0154),
        ("dynamic_orb_slam2-horacehxw/fr3_walking_rpy_Dyna0.txt", "walking_rpy", 864, 0.1066),
        ("lc-crf-slam/fr3_walking_xyz.txt", "walking_xyz", 826, 0.0221),
        ("yolo-dynaslam-jimgreen/fr3_walking_xyz.txt", "walking_xyz", 536, 0.0721),
        ("cds-slam/fr3_walking_rpy.txt", "walking_rpy", 864, 0.0538),
    ] {
        let truth = read_trajectory(&data.join(format!("groundtruth/fr3_{sequence}.txt"))).unwrap();
        let estimate = read_trajectory(&data.join("estimates").join(estimate)).unwrap();
        let result = ate(&truth, &estimate).unwrap().statistics;
        assert_eq!(result.pairs, pairs, "{sequence}");
        assert!((result.rmse - rmse).abs() < 0.5e-4 + TOLERANCE, "{sequence}: {}", result.rmse);
    }
}

/// Errors by evo; `None` where evo is not installed.
fn evo(ground_truth: &Path, estimate: &Path, frames: Option<usize>) -> Option<serde_json::Value> {
    let python = programs::python_with("evo")?;
    let mut command = Command::new(python);
    command.arg(pfd_tests::repository().join("tests/python/evo_reference.py")).arg(ground_truth).arg(estimate);
    let output = command.args(frames.map(|f| f.to_string())).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(serde_json::from_slice(&output.stdout).unwrap())
}

fn assert_equals_evo(evo: &serde_json::Value, s: &Statistics) {
    assert_eq!(evo["pairs"], s.pairs);
    for (name, value) in named(s) {
        let reference = evo[name].as_f64().unwrap();
        assert!((reference - value).abs() <= TOLERANCE, "{name}: {value}, evo {reference}");
    }
}

#[test]
fn agrees_with_evo_on_published_estimates() {
    let Some(data) = data("tum-estimates-evo") else { return };
    for (truth, estimate) in [
        ("fr2_desk_groundtruth.txt", "fr2_desk_ORB.txt"),
        ("freiburg1_xyz-groundtruth.txt", "freiburg1_xyz-rgbdslam.txt"),
    ] {
        let (truth, estimate) = (data.join(truth), data.join(estimate));
        let Some(reference) = evo(&truth, &estimate, None) else { return };
        let result = ate(&read_trajectory(&truth).unwrap(), &read_trajectory(&estimate).unwrap()).unwrap();
        assert_equals_evo(&reference["ate"], &result.statistics);
    }
}

/// A curved trajectory at 20 Hz, with a wobble that stands for the error of an estimate.
fn curve(wobble: f64, poses: i64) -> Vec<StampedPose> {
    let pose = |i: i64| {
        let t = i as f64 * 0.05;
        let noise = wobble * (i as f64 * 2.39).sin();
        let position = Vector3::new(t.cos() + noise, (1.3 * t).sin(), 0.2 * t - noise);
        let rotation = Vector3::new(0.3 * t.sin(), 0.2 * t + noise, 0.1);
        StampedPose {
            stamp: Stamp::from_nanos(1_000_000_000_000 + i * 50_000_000),
            pose: Pose::new(position, rotation),
        }
    };
    (0..poses).map(pose).collect()
}

/// evo pairs frames, not times: at an even rate that is the same, except for the last pose, which the benchmark's rule leaves
/// out; here it has no ground truth.
#[test]
fn agrees_with_evo_on_relative_errors_of_a_written_trajectory() {
    let folder = tempfile::tempdir().unwrap();
    let (truth, estimate) = (folder.path().join("truth.txt"), folder.path().join("estimate.txt"));
    write_trajectory(&truth, &curve(0.0, 100)).unwrap();
    write_trajectory(&estimate, &curve(0.01, 101)).unwrap();
    let Some(reference) = evo(&truth, &estimate, Some(20)) else { return };
    let (truth, estimate) = (read_trajectory(&truth).unwrap(), read_trajectory(&estimate).unwrap());
    assert_equals_evo(&reference["ate"], &ate(&truth, &estimate).unwrap().statistics);
    let relative = rpe(&truth, &estimate, 1.0).unwrap();
    assert_equals_evo(&reference["rpe_translation"], &relative.translation_evo);
    assert_equals_evo(&reference["rpe_rotation_deg"], &relative.rotation_deg);
}
