//! Shared helpers of the cross-crate tests.

pub mod domain;
pub mod programs;

use std::io::Write;
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

/// Says which test is skipped and why, past the test harness, which keeps to itself what tests that pass print by macros.
pub fn skip(reason: &str) {
    let thread = std::thread::current();
    let test = thread.name().unwrap_or("a test");
    // Nobody to tell.
    let _ = writeln!(std::io::stderr().lock(), "skipped: {test}: {reason}");
}
