//! Files and text that a run leaves.

use std::fmt::Write as _;
use std::path::Path;

use pfd_evaluation::{Statistics, write_trajectory};
use pfd_report::summary::{Errors, NO_ERRORS, StageTiming, Timing};
use pfd_report::{Percentiles, RunPage, Summary, frames};

use crate::output;
use crate::runner::{Job, Outcome};

/// The figures of a run.
pub(crate) fn summarise(job: &Job<'_>, outcome: &Outcome) -> anyhow::Result<(Summary, Errors)> {
    let ground_truth = job.sequence.ground_truth();
    let errors = Errors::of(ground_truth, &outcome.trajectory);
    let live = Errors::of(ground_truth, &outcome.live);
    let stage =
        |(stage, times): &(String, Vec<f64>)| StageTiming { stage: stage.clone(), percentiles: Percentiles::of(times) };
    let summary = Summary {
        sequence: job.sequence.name().to_owned(),
        frames: outcome.rows.len(),
        tracked: outcome.trajectory.len() as f64 / outcome.rows.len() as f64,
        skipped: outcome.skipped,
        unpaired: job.sequence.unpaired(),
        ate: errors.ate.as_ref().map(|a| a.statistics),
        ate_live: live.ate.map(|a| a.statistics),
        rpe_translation: errors.rpe.as_ref().map(|r| r.translation),
        rpe_rotation_deg: errors.rpe.as_ref().map(|r| r.rotation_deg),
        timing_ms: Timing::of(&outcome.rows),
        stages_ms: outcome.stages.iter().map(stage).collect(),
        keyframes: Some(outcome.keyframes.len()),
        map_points: Some(outcome.map_points),
        mode: if job.given_masks.is_some() { "given masks".to_owned() } else { job.config.mode.to_string() },
        seed: job.config.seed,
        config: serde_json::to_value(job.config)?,
    };
    Ok((summary, errors))
}

/// Writes all files of a run but the masks.
pub(crate) fn write(out: &Path, summary: &Summary, errors: &Errors, outcome: &Outcome) -> anyhow::Result<()> {
    write_trajectory(&out.join("trajectory.txt"), &outcome.trajectory)?;
    write_trajectory(&out.join("trajectory_live.txt"), &outcome.live)?;
    write_trajectory(&out.join("keyframe_trajectory.txt"), &outcome.keyframes)?;
    frames::write(&out.join("frames.csv"), &outcome.rows)?;
    summary.write(&out.join("report.json"))?;
    let page =
        RunPage { summary, errors, trajectory: &outcome.trajectory, frames: &outcome.rows, samples: &outcome.samples };
    page.write(&out.join("report.html"))?;
    Ok(page.write_picture(&out.join("picture.svg"))?)
}

/// Prints the key figures.
pub(crate) fn print(summary: &Summary, out: &Path) -> anyhow::Result<()> {
    let mut printed = text(summary);
    for (name, file) in [("report", "report.html"), ("picture", "picture.svg")] {
        let path = out.join(file);
        // A report without masks has no picture.
        if path.exists() {
            let _ = writeln!(printed, "{name}: {}", path.display());
        }
    }
    output::print(&printed)
}

fn text(s: &Summary) -> String {
    let mut text = format!(
        "{}: {} frames, {:.1} % tracked, mode {}, seed {}{}\n",
        s.sequence,
        s.frames,
        100.0 * s.tracked,
        s.mode,
        s.seed,
        s.settings_note()
    );
    if s.skipped > 0 {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{} frames skipped because an image could not be used or did not arrive", s.skipped);
    }
    let rows: [(&str, &Option<Statistics>); 4] = [
        ("ATE (m)", &s.ate),
        ("ATE as published (m)", &s.ate_live),
        ("RPE translation (m/s)", &s.rpe_translation),
        ("RPE rotation (deg/s)", &s.rpe_rotation_deg),
    ];
    for (name, statistics) in rows {
        text += &statistics.map(|s| output::statistics_row(name, &s)).unwrap_or_default();
    }
    if s.ate.is_none() {
        let _ = writeln!(text, "{NO_ERRORS}");
    }
    for (name, p) in
        [("segmentation", s.timing_ms.segmentation), ("tracking", s.timing_ms.tracking), ("total", s.timing_ms.total)]
    {
        let _ = writeln!(text, "{name:<24} median {:.1} ms  p99 {:.1} ms", p.median, p.p99);
    }
    text
}
