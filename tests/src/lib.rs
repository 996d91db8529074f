//! Shared helpers of the cross-crate tests.

pub mod domain;
pub mod programs;

use std::path::{Path, PathBuf};

/// Root of the repository.
pub fn repository() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap_or(Path::new("."))
}

/// The bundled sequence.
pub fn bundled_sequence() -> PathBuf {
    repository().join("tests/data/composite-demo")
}

/// A folder of the data that is not part of the repository: below `$PFD_DATA`, else below `../shared/data` beside the
/// repository. Prints why the calling test is skipped where it is absent.
pub fn data(name: &str) -> Option<PathBuf> {
    let root = std::env::var_os("PFD_DATA").map_or_else(|| repository().join("../shared/data"), PathBuf::from);
    let folder = root.join(name);
    if !folder.exists() {
        skip(&format!("{name} is not at hand; set PFD_DATA to the folder that has it"));
        return None;
    }
    Some(folder)
}

/// Says why a test is skipped.
#[allow(clippy::print_stderr)]
pub fn skip(reason: &str) {
    eprintln!("skipped: {reason}");
}
