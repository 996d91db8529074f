//! The nodes as a user runs them: processes over DDS, on loopback, alone and beside real peers.
#![allow(clippy::unwrap_used)] // Helpers of tests fail as tests do.

mod peers;
mod processes;
mod recovery;
mod support;
