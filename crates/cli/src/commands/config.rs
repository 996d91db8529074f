//! `pfd-slam config`.

use pfd_parameters::{NodeConfig, ReplayConfig, to_yaml_with_comments};

use crate::arguments::ConfigArguments;
use crate::{output, setup};

pub(crate) fn run(arguments: &ConfigArguments) -> anyhow::Result<()> {
    let mut text = to_yaml_with_comments(&setup::configuration(&arguments.config)?);
    if arguments.nodes {
        // The first lines say for which nodes: the same.
        text.extend(to_yaml_with_comments(&NodeConfig::default()).split_inclusive('\n').skip(SECTION_LINES));
        text += &to_yaml_with_comments(&ReplayConfig::default()).replacen("/**", "bag_replay_node", 1);
    }
    output::print(&text)
}

/// Lines that begin a section of a parameter file.
const SECTION_LINES: usize = 2;
