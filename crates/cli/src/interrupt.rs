//! Ctrl-C and SIGTERM: work stops between two frames, so that what was unpacked for it is removed.

use std::sync::atomic::{AtomicU8, Ordering};

use anyhow::Context;
use tokio::signal::unix::{Signal, SignalKind, signal};

use crate::output;

/// Added to the number of a signal it makes the exit status, as in a shell.
const STATUS_OF_SIGNALS: u8 = 128;
/// What [`STATUS`] is while there was no signal.
const NONE: u8 = 0;

/// The exit status that the signal received asks for.
static STATUS: AtomicU8 = AtomicU8::new(NONE);

/// A signal asked the program to stop.
#[derive(Debug, thiserror::Error)]
#[error("interrupted")]
pub(crate) struct Interrupted {
    /// Exit status.
    pub(crate) status: u8,
}

/// From here on a signal makes [`check`] fail; a second one ends the program at once.
///
/// # Errors
/// When the system refuses.
pub(crate) fn watch() -> anyhow::Result<()> {
    let failed = "signals cannot be caught";
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().context(failed)?;
    let (interrupt, terminate) = {
        let _inside = runtime.enter();
        (signal(SignalKind::interrupt()).context(failed)?, signal(SignalKind::terminate()).context(failed)?)
    };
    let wait = move || runtime.block_on(note_signals(interrupt, terminate));
    std::thread::Builder::new().name("signals".to_owned()).spawn(wait).context(failed)?;
    Ok(())
}

async fn note_signals(mut interrupt: Signal, mut terminate: Signal) {
    loop {
        let kind = tokio::select! {
            _ = interrupt.recv() => SignalKind::interrupt(),
            _ = terminate.recv() => SignalKind::terminate(),
        };
        let status = STATUS_OF_SIGNALS.saturating_add(kind.as_raw_value() as u8);
        if STATUS.swap(status, Ordering::Relaxed) != NONE {
            std::process::exit(i32::from(status));
        }
        output::note("stopping after this frame; once more stops at once");
    }
}

/// Whether to go on.
///
/// # Errors
/// [`Interrupted`] after a signal.
pub(crate) fn check() -> Result<(), Interrupted> {
    match STATUS.load(Ordering::Relaxed) {
        NONE => Ok(()),
        status => Err(Interrupted { status }),
    }
}
