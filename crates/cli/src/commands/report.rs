//! `pfd-slam report`: from the files of the nodes to the same report that `run` writes.

use std::path::{Path, PathBuf};

use pfd_dataset::{Association, Sequence, images};
use pfd_evaluation::read_trajectory;
use pfd_report::sample::spread;
use pfd_report::summary::{Errors, Timing};
use pfd_report::{FrameRow, RunPage, Sample, Summary, frames};

use crate::arguments::ReportArguments;
use crate::runner::{SAMPLES, caption};
use crate::{interrupt, results, setup};

pub(crate) fn run(arguments: &ReportArguments) -> anyhow::Result<()> {
    interrupt::watch()?;
    let sequence = setup::sequence(&arguments.sequence, &arguments.reading)?;
    let config = setup::configuration(&arguments.config)?;
    let directory = &arguments.directory;
    let trajectory = read_trajectory(&directory.join("trajectory.txt"))?;
    let rows = rows(directory)?;
    let errors = Errors::of(sequence.ground_truth(), &trajectory);
    let summary = Summary {
        sequence: sequence.name().to_owned(),
        frames: sequence.len(),
        // A replay that begins again shows the same frames more than once.
        tracked: (trajectory.len() as f64 / sequence.len() as f64).min(1.0),
        skipped: sequence.len().saturating_sub(rows.len()),
        unpaired: sequence.unpaired(),
        ate: errors.ate.as_ref().map(|a| a.statistics),
        ate_live: None,
        rpe_translation: errors.rpe.as_ref().map(|r| r.translation),
        rpe_rotation_deg: errors.rpe.as_ref().map(|r| r.rotation_deg),
        timing_ms: Timing::of(&rows),
        stages_ms: Vec::new(),
        keyframes: None,
        map_points: None,
        mode: config.mode.to_string(),
        seed: config.seed,
        config: serde_json::to_value(&config)?,
    };
    let samples = samples(&sequence, &rows, &directory.join("masks"))?;
    summary.write(&directory.join("report.json"))?;
    let page =
        RunPage { summary: &summary, errors: &errors, trajectory: &trajectory, frames: &rows, samples: &samples };
    page.write(&directory.join("report.html"))?;
    page.write_picture(&directory.join("picture.svg"))?;
    results::print(&summary, directory)
}

/// The table of tracking, with the columns of segmentation where another node wrote them.
fn rows(directory: &Path) -> anyhow::Result<Vec<FrameRow>> {
    let mut rows: Vec<FrameRow> = frames::read(&directory.join("frames.csv"))?;
    let segmentation = directory.join("segmentation.csv");
    if segmentation.exists() {
        frames::merge(&mut rows, &frames::read(&segmentation)?);
    }
    Ok(rows)
}

/// Frames for which there is a mask, spread over the sequence.
pub(crate) fn samples(sequence: &Sequence, rows: &[FrameRow], masks: &Path) -> anyhow::Result<Vec<Sample>> {
    // `run` names masks like the colour images, the nodes by their stamps.
    let mask_of = |pair: &Association| -> Option<PathBuf> {
        let names = [pair.rgb_path.file_stem()?.to_string_lossy().into_owned(), pair.rgb_stamp.to_string()];
        names.into_iter().map(|name| masks.join(name + ".png")).find(|path| path.exists())
    };
    let with_mask: Vec<_> = sequence.pairs().iter().filter_map(|pair| Some((pair, mask_of(pair)?))).collect();
    let mut samples = Vec::new();
    for (pair, mask) in spread(with_mask.len(), SAMPLES).into_iter().map(|i| &with_mask[i]) {
        let stamp = pair.rgb_stamp;
        let (rgb, mask) = (images::read_color(&pair.rgb_path)?, images::read_mask(mask)?);
        let objects = rows.iter().find(|r| r.stamp == stamp.to_string()).map_or(0, |r| r.objects);
        let time = stamp.seconds_since(sequence.pair(0).rgb_stamp);
        samples.push(Sample::new(stamp, caption(time, mask.fraction(), objects), &rgb, &mask)?);
    }
    Ok(samples)
}
