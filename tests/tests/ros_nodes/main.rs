//! The nodes as a user runs them: processes over DDS, on loopback, alone and beside real peers.

mod peers;
mod processes;
mod support;
