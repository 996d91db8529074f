//! Parameters of the nodes and of the command line tool.
//!
//! One format everywhere: ROS 2 parameter files (`/**:` or a node's name → `ros__parameters:` → tree). The tree is typed: each
//! stage owns its struct, defaults live in its `Default`, meaning and limits in its doc comments and `schemars` attributes.
//! Unknown keys, wrong types and values out of range are errors that name the file and the key.

pub mod describe;
pub mod error;
pub mod name;
pub mod node_config;
mod schema;
pub mod spelling;
pub mod tree;
pub mod yaml;

use std::path::Path;

use schemars::JsonSchema;
use serde::{Serialize, de::DeserializeOwned};
pub use serde_json::Value;

pub use describe::{ParameterDescription, ParameterKind, describe, values};
pub use error::ParameterError;
pub use name::NodeName;
pub use node_config::{Acknowledgement, DepthEncoding, NodeConfig, Queue, Reliability, ReplayConfig};
pub use tree::ParameterTree;
pub use yaml::{parse_value, to_yaml_with_comments};

/// Reads `T` for `node` from parameter files, later ones over earlier ones, and from `overrides` (dotted name, value) over all.
///
/// Keys of [`NodeConfig`] and [`ReplayConfig`] may stand in the same files: they are checked and left alone.
///
/// # Errors
/// [`ParameterError`] for files that cannot be read, unknown keys, wrong types and values out of range.
pub fn load<T>(files: &[&Path], node: &NodeName, overrides: &[(String, Value)]) -> Result<T, ParameterError>
where
    T: DeserializeOwned + Serialize + JsonSchema + Default,
{
    let mut tree = ParameterTree::read(files, node, overrides)?;
    let config = tree.take::<T>()?;
    tree.check::<NodeConfig>()?;
    tree.check::<ReplayConfig>()?;
    tree.finish()?;
    Ok(config)
}
