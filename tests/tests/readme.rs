//! The README against what makes its figures.

// Tests fail by panicking, and so may their helpers.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use pfd_report::bench::BenchRun;
use pfd_report::bench_summary::{DESCRIPTIONS, inserted, summary};
use pfd_tests::repository;
use serde_json::json;

/// A run whose figures are all there.
fn run(sequence: &str, variant: &str) -> BenchRun {
    let errors = json!({"rmse": 1.0, "mean": 1.0, "median": 1.0, "std": 1.0, "min": 1.0, "max": 1.0, "pairs": 1});
    let times = json!({"median": 1.0, "mean": 1.0, "p99": 1.0, "max": 1.0});
    let shares = json!({"precision": 1.0, "recall": 1.0, "iou": 1.0});
    let masks = json!({
        "frames": 1, "frames_with_movers": 1, "precision": 1.0, "recall": 1.0, "iou": 1.0, "pixels": shares,
        "static_masked": {"mean": 1.0, "max": 1.0},
    });
    let run = json!({
        "variant": variant,
        "summary": {
            "sequence": sequence, "frames": 1, "tracked": 1.0, "mode": variant, "seed": 0, "config": null,
            "ate": errors, "rpe_translation": errors, "rpe_rotation_deg": errors,
            "timing_ms": {"segmentation": times, "tracking": times, "total": times},
        },
        "masks": masks,
    });
    serde_json::from_value(run).unwrap()
}

/// The text with every figure, and every dash for a missing one, as `#`.
fn without_figures(text: &str) -> String {
    let is_figure = |c: char| c.is_ascii_digit() || c == '.' || c == '–';
    let mut masked = String::new();
    for c in text.chars() {
        match is_figure(c) {
            false => masked.push(c),
            true if !masked.ends_with('#') => masked.push('#'),
            true => {}
        }
    }
    masked
}

#[test]
fn the_table_has_the_form_that_bench_writes() {
    let variants = ["pfd", "none", "given"];
    let runs: Vec<BenchRun> =
        DESCRIPTIONS.iter().flat_map(|(sequence, _)| variants.iter().map(|v| run(sequence, v))).collect();
    let readme = std::fs::read_to_string(repository().join("README.md")).unwrap();
    let stands = without_figures(inserted(&readme).expect("README.md has no lines for the summary of the bench"));
    let written = without_figures(&summary(&runs, "commit 1"));
    // The order of the rows is that of the sequences on the command line.
    let table = |text: &str| {
        let mut lines: Vec<String> = text.lines().filter(|l| l.starts_with('|')).map(str::to_owned).collect();
        lines.sort();
        lines
    };
    assert_eq!(table(&stands), table(&written), "launch_scripts/results.sh brings README.md up to date");
    let facts = |text: &str| text.split_once("Mode `pfd`").map(|(_, facts)| facts.trim().to_owned());
    assert_eq!(facts(&stands), facts(&written), "launch_scripts/results.sh brings README.md up to date");
    assert!(stands.contains("By `pfd-slam bench` at commit "), "the figures name no commit");
}
