//! `pfd-slam config`.

use pfd_parameters::to_yaml_with_comments;

use crate::arguments::ConfigArguments;
use crate::{output, setup};

pub(crate) fn run(arguments: &ConfigArguments) -> anyhow::Result<()> {
    output::print(&to_yaml_with_comments(&setup::configuration(&arguments.config)?))
}
