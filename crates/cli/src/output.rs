//! Text for the user.

use std::io::Write;

use pfd_evaluation::Statistics;
use serde::Serialize;

/// Prints a result. A reader that went away (`| head`) is no error.
pub(crate) fn print(text: &str) -> anyhow::Result<()> {
    let mut stdout = std::io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        other => Ok(other?),
    }
}

/// Prints a value as JSON.
pub(crate) fn print_json(value: &impl Serialize) -> anyhow::Result<()> {
    print(&format!("{}\n", serde_json::to_string_pretty(value)?))
}

/// Prints an error with its causes on one line of stderr.
pub(crate) fn error(error: &anyhow::Error) {
    note(&format!("pfd-slam: {error:#}"));
}

/// Prints one line on stderr.
pub(crate) fn note(text: &str) {
    let line = text.split_whitespace().collect::<Vec<_>>().join(" ");
    // There is nowhere left to report a closed stderr.
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}

/// One row of figures.
pub(crate) fn statistics_row(name: &str, s: &Statistics) -> String {
    format!(
        "{name:<24} rmse {:.6}  mean {:.6}  median {:.6}  std {:.6}  min {:.6}  max {:.6}  pairs {}\n",
        s.rmse, s.mean, s.median, s.std, s.min, s.max, s.pairs
    )
}
