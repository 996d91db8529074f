//! Masks of `pfd-slam run` on real images: movers in two frames, without history, against outlines drawn by hand, and a scene in
//! which nothing moves.

// Tests fail by panicking, and so may their helpers.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::path::Path;
use std::process::Command;

use pfd_tests::{data, programs, repository};
use serde_json::Value;

/// Intersection over union from which movers count as found.
const FOUND: f64 = 0.6;

fn pfd_slam(arguments: &[&Path]) -> Vec<u8> {
    let output = programs::pfd_slam().unwrap().args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    output.stdout
}

/// Intersection over union of the mask of the second frame with the outlines.
fn iou(pairs: &Path, name: &str) -> f64 {
    let outlines = repository().join("tests/data/joint-vo-sf-outlines");
    let out = tempfile::tempdir().unwrap();
    let arguments = ["run".as_ref(), &*pairs.join(name), "--config".as_ref(), &*outlines.join("camera.yaml")];
    pfd_slam(&[&arguments[..], &["--save-masks".as_ref(), "--out".as_ref(), out.path()]].concat());
    let (masks, truth) = (out.path().join("masks"), outlines.join(name));
    let scores = pfd_slam(&["eval-masks".as_ref(), &*masks, &*truth, "--json".as_ref()]);
    let scores: Value = serde_json::from_slice(&scores).unwrap();
    assert_eq!(scores["frames"], 1, "the first frame has no outline");
    scores["iou"].as_f64().unwrap()
}

/// The door of the third pair is found in part only, so it is not here; crates/segmentation/README.md has its figure.
#[test]
fn people_are_found_in_two_frames() {
    let Some(pairs) = data("joint-vo-sf-pairs") else { return };
    for name in ["two-people-moving", "person-standing"] {
        let iou = iou(&pairs, name);
        assert!(iou >= FOUND, "{name}: {iou:.3}");
    }
}

/// The goals of static scenes: mean and largest share of a frame that is masked.
const STATIC: [f64; 2] = [0.005, 0.05];

/// Share of each frame of a static sequence that is masked.
fn masked(sequence: &Path) -> Vec<f64> {
    let out = tempfile::tempdir().unwrap();
    pfd_slam(&["run".as_ref(), sequence, "--out".as_ref(), out.path()]);
    let frames = std::fs::read_to_string(out.path().join("frames.csv")).unwrap();
    let column = frames.lines().next().unwrap().split(',').position(|name| name == "mask_fraction").unwrap();
    let share = |line: &str| line.split(',').nth(column).unwrap().parse::<f64>().unwrap();
    frames.lines().skip(1).map(share).collect()
}

fn assert_static(shares: &[f64]) {
    let mean = shares.iter().sum::<f64>() / shares.len() as f64;
    let worst = shares.iter().copied().fold(0.0, f64::max);
    assert!(mean <= STATIC[0] && worst <= STATIC[1], "mean {mean}, worst {worst}");
}

#[test]
fn next_to_nothing_is_masked_where_nothing_moves() {
    let Some(sequence) = data("tum-fr1-xyz-first180") else { return };
    let shares = masked(&sequence);
    assert_eq!(shares.len(), 180);
    assert_static(&shares);
}

/// Backwards the sequence starts before a dark screen, in which reflections move.
#[test]
fn reflections_are_no_objects() {
    let Some(sequence) = data("tum-fr1-xyz-first180") else { return };
    let Some(python) = programs::python_with("argparse") else { return };
    let takes = tempfile::tempdir().unwrap();
    let vary = Command::new(python)
        .arg(repository().join("tests/python/vary_sequence.py"))
        .args([&*sequence, "--only".as_ref(), "reversed".as_ref(), "--out".as_ref(), takes.path()])
        .output()
        .unwrap();
    assert!(vary.status.success(), "{}", String::from_utf8_lossy(&vary.stderr));
    let shares = masked(&takes.path().join("tum-fr1-xyz-first180+reversed"));
    assert!(shares.len() > 170, "{} frames", shares.len());
    assert_static(&shares);
}
