//! One module a command.

pub(crate) mod bench;
pub(crate) mod config;
pub(crate) mod eval;
pub(crate) mod eval_masks;
pub(crate) mod fetch;
pub(crate) mod report;
pub(crate) mod run;
