//! What every command that runs the pipeline needs: sequence, configuration, camera.

use std::path::Path;

use anyhow::Context;
use pfd_dataset::{Options, Pairing, Sequence};
use pfd_geometry::Camera;
use pfd_parameters::{NodeConfig, NodeName, ParameterTree, ReplayConfig, Value, load, parse_value};
use pfd_pipeline::SlamConfig;

use crate::arguments::{ConfigSource, SequenceArguments};
use crate::interrupt;

/// The node whose sections of a parameter file are read; it does in one process what the command line does.
const NODE: &str = "slam_node";
/// The node whose sections say how a sequence is replayed.
const REPLAY: &str = "bag_replay_node";

pub(crate) fn sequence(path: &Path, arguments: &SequenceArguments) -> anyhow::Result<Sequence> {
    let pairing = if arguments.one_to_one { Pairing::OneToOne } else { Pairing::Nearest };
    let options = Options { depth_offset: arguments.depth_offset, pairing, ..Options::default() };
    let sequence = Sequence::open_with(path, &options)?;
    // Unpacking an archive takes long enough for somebody to lose patience.
    interrupt::check()?;
    Ok(sequence)
}

pub(crate) fn configuration(source: &ConfigSource) -> anyhow::Result<SlamConfig> {
    let (files, overrides) = said(source);
    Ok(load(&files, &NodeName::new("/", NODE)?, &overrides)?)
}

/// The parameters of the nodes beside those of the pipeline: of the ones that work on frames, and of the replay.
pub(crate) fn node_configuration(source: &ConfigSource) -> anyhow::Result<(NodeConfig, ReplayConfig)> {
    let (files, overrides) = said(source);
    let tree = |node| anyhow::Ok(ParameterTree::read(&files, &NodeName::new("/", node)?, &overrides)?);
    Ok((tree(NODE)?.take()?, tree(REPLAY)?.take()?))
}

/// Files and single parameters.
fn said(source: &ConfigSource) -> (Vec<&Path>, Vec<(String, Value)>) {
    let files = source.config.iter().map(AsRef::as_ref).collect();
    (files, source.set.iter().map(|(name, value)| (name.clone(), parse_value(value))).collect())
}

/// The camera of the configuration, else that of the sequence.
pub(crate) fn camera(config: &SlamConfig, sequence: &Sequence) -> anyhow::Result<Camera> {
    let Some(c) = &config.camera else {
        return sequence.camera().with_context(|| {
            format!(
                "{}: the camera is not known: put calib.yaml (width, height, fx, fy, cx, cy, distortion) into the \
                 sequence, or pass --config with `camera:`",
                sequence.folder().display()
            )
        });
    };
    c.to_camera().context("parameter `camera`")
}

/// Where the numbers of [`camera`] come from.
pub(crate) fn camera_origin(config: &SlamConfig, sequence: &Sequence) -> String {
    let file = sequence.folder().join("calib.yaml");
    if config.camera.is_some() {
        "parameter `camera`".to_owned()
    } else if file.exists() {
        file.display().to_string()
    } else {
        format!("by the name {}", sequence.name())
    }
}
