//! `pfd-slam eval-masks`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::Context;
use pfd_dataset::images;
use pfd_evaluation::{MaskScore, MaskSummary};
use serde::Serialize;

use crate::arguments::EvalMasksArguments;
use crate::output;

/// What `--json` prints.
#[derive(Serialize)]
pub(crate) struct MaskErrors {
    #[serde(flatten)]
    pub(crate) summary: MaskSummary,
    /// Ground-truth masks without a mask to judge.
    pub(crate) missing: usize,
}

pub(crate) fn run(arguments: &EvalMasksArguments) -> anyhow::Result<()> {
    let errors = compare(&arguments.masks, &arguments.ground_truth)?;
    if arguments.json { output::print_json(&errors) } else { output::print(&text(&errors)) }
}

/// Compares the masks of two folders by name.
pub(crate) fn compare(masks: &Path, ground_truth: &Path) -> anyhow::Result<MaskErrors> {
    let (masks_by_name, truths) = (images_in(masks)?, images_in(ground_truth)?);
    let mut scores = Vec::new();
    for (name, truth) in &truths {
        if let Some(mask) = masks_by_name.get(name) {
            scores.push(score(mask, truth)?);
        }
    }
    anyhow::ensure!(
        !scores.is_empty(),
        "{}: no mask has the name of one in {}",
        masks.display(),
        ground_truth.display()
    );
    Ok(MaskErrors { summary: MaskSummary::of(&scores), missing: truths.len() - scores.len() })
}

fn score(mask: &Path, truth: &Path) -> anyhow::Result<MaskScore> {
    let judged = images::read_mask(mask)?;
    MaskScore::of(&judged, &images::read_gray(truth)?)
        .with_context(|| format!("{} against {}", mask.display(), truth.display()))
}

/// The images of a folder by the name of the colour image they belong to, without extensions: `1.5.png` and `1.5.jpg.png` are
/// both masks of `1.5.jpg`.
pub(crate) fn images_in(folder: &Path) -> anyhow::Result<BTreeMap<String, PathBuf>> {
    let entries = std::fs::read_dir(folder).with_context(|| folder.display().to_string())?;
    let mut images = BTreeMap::new();
    for entry in entries {
        let path = entry.with_context(|| folder.display().to_string())?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if let Some(name) = name.strip_suffix(".png") {
            images.insert(stem(name).to_owned(), path.clone());
        }
    }
    anyhow::ensure!(!images.is_empty(), "{}: no PNG images in this folder", folder.display());
    Ok(images)
}

/// The name without the extension of a colour image.
pub(crate) fn stem(name: &str) -> &str {
    [".png", ".jpg", ".jpeg"].iter().find_map(|extension| name.strip_suffix(extension)).unwrap_or(name)
}

fn text(errors: &MaskErrors) -> String {
    let MaskErrors { summary: s, missing } = errors;
    let percent = |share: Option<f64>| share.map_or("   –  ".to_owned(), |x| format!("{:5.1} %", 100.0 * x));
    format!(
        "frames {} ({} with movers, {missing} of the ground truth without a mask)\n\
         mean of frames   precision {}  recall {}  IoU {}\n\
         all pixels       precision {}  recall {}  IoU {}\n\
         static pixels masked   mean {}  worst frame {}\n",
        s.frames,
        s.frames_with_movers,
        percent(s.precision),
        percent(s.recall),
        percent(s.iou),
        percent(s.pixels.precision),
        percent(s.pixels.recall),
        percent(s.pixels.iou),
        percent(s.static_masked.mean),
        percent(s.static_masked.max),
    )
}
