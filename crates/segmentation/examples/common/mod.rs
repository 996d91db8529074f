//! What the examples share: ground truth beside a sequence.

use std::path::Path;

use anyhow::Result;
use pfd_dataset::images;
use pfd_geometry::{Camera, Distortion, GrayImage, RgbdFrame};

/// A camera for sequences without calibration.
pub(crate) fn guess_camera(frame: &RgbdFrame) -> Result<Camera> {
    let (width, height) = frame.rgb().size();
    let intrinsics = [525.0, 525.0, (width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0];
    Ok(Camera::new((width, height), intrinsics, Distortion::default())?)
}

/// The exact mask of a frame: 255 = moving, 128 = ignored, 0 = static; `None` where there is none.
pub(crate) fn truth_of(folder: &Path, rgb: &Path, size: (usize, usize)) -> Result<Option<GrayImage>> {
    let Some(stem) = rgb.file_stem() else { return Ok(None) };
    let path = folder.join("mask").join(format!("{}.png", stem.to_string_lossy()));
    if !path.exists() {
        return Ok(None);
    }
    let truth = images::read_gray(&path)?;
    anyhow::ensure!(truth.size() == size, "{}: wrong size", path.display());
    Ok(Some(truth))
}
