//! `pfd-slam config`.

use pfd_parameters::to_yaml_with_comments;

use crate::arguments::ConfigArguments;
use crate::{output, setup};

pub(crate) fn run(arguments: &ConfigArguments) -> anyhow::Result<()> {
    let mut text = to_yaml_with_comments(&setup::configuration(&arguments.config)?);
    if arguments.nodes {
        let (node, replay) = setup::node_configuration(&arguments.config)?;
        // The first lines say for which nodes: the same.
        text.extend(to_yaml_with_comments(&node).split_inclusive('\n').skip(SECTION_LINES));
        text += &to_yaml_with_comments(&replay).replacen("/**", "bag_replay_node", 1);
    }
    output::print(&text)
}

/// Lines that begin a section of a parameter file.
const SECTION_LINES: usize = 2;
