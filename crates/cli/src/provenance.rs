//! What the result of a run depends on beside its configuration, as text that can be compared.

use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use anyhow::Context;
use pfd_dataset::Sequence;

use crate::arguments::SequenceArguments;

/// Files of a sequence that say what its frames are, beside the images.
const FILES: [&str; 4] = ["rgb.txt", "depth.txt", "groundtruth.txt", "calib.yaml"];

/// The sequence, how it is read, the masks that are given, and the program.
///
/// # Errors
/// When the folder of masks cannot be read.
pub(crate) fn of(
    sequence: &Sequence,
    reading: &SequenceArguments,
    given_masks: Option<&Path>,
) -> anyhow::Result<String> {
    let path = sequence.path();
    let SequenceArguments { depth_offset, one_to_one } = reading;
    let mut lines = vec![
        // Not the folder: an archive is unpacked into another one each time.
        path.canonicalize().unwrap_or_else(|_| path.to_owned()).display().to_string(),
        format!("depth offset {depth_offset} s, one to one: {one_to_one}"),
        format!("camera {:?}, depth factor {}", sequence.camera(), sequence.depth_factor()),
    ];
    if path.is_dir() {
        lines.extend(FILES.iter().map(|name| file_state(name, &sequence.folder().join(name))));
        lines.extend(given_masks.map(folder_state).transpose()?);
    } else {
        // The files in it got their times when they were unpacked.
        lines.push(file_state("archive", path));
    }
    lines.push(program());
    Ok(lines.join("\n") + "\n")
}

/// Size and time of a file, or that there is none.
fn file_state(name: &str, path: &Path) -> String {
    match path.metadata() {
        Ok(data) => format!("{name}: {} bytes of {:?}", data.len(), since_epoch(data.modified().ok())),
        Err(_) => format!("{name}: none"),
    }
}

/// How many files a folder has, and when the newest was written.
fn folder_state(folder: &Path) -> anyhow::Result<String> {
    let (mut count, mut newest) = (0_usize, Duration::ZERO);
    for entry in std::fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let data = entry.and_then(|entry| entry.metadata()).with_context(|| folder.display().to_string())?;
        count += 1;
        newest = newest.max(since_epoch(data.modified().ok()));
    }
    Ok(format!("masks: {count} files, the newest of {newest:?}"))
}

fn program() -> String {
    let built = std::env::current_exe().and_then(|exe| exe.metadata()).and_then(|data| data.modified()).ok();
    format!("{} of {} s", env!("CARGO_PKG_VERSION"), since_epoch(built).as_secs())
}

fn since_epoch(time: Option<SystemTime>) -> Duration {
    time.and_then(|time| time.duration_since(UNIX_EPOCH).ok()).unwrap_or_default()
}
