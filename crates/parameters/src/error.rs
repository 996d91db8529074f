//! What can be wrong with parameters.

use std::path::PathBuf;

/// A parameter file or value that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ParameterError {
    /// The file is missing or unreadable.
    #[error("cannot read parameter file {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file is not YAML.
    #[error("parameter file {} is not valid YAML: {reason}", path.display())]
    Syntax {
        /// The file.
        path: PathBuf,
        /// What the parser says, with line and column.
        reason: String,
    },
    /// The file is YAML but not a ROS 2 parameter file.
    #[error(
        "{origin}: `{key}` is not a section of a ROS 2 parameter file: expected a node name or `/**`, then `ros__parameters`"
    )]
    Layout {
        /// The file.
        origin: String,
        /// Where in it.
        key: String,
    },
    /// Nobody knows this parameter.
    #[error("{origin}: unknown parameter `{key}`{}", hint.as_ref().map_or(String::new(), |h| format!("; did you mean `{h}`?")))]
    Unknown {
        /// File or command line.
        origin: String,
        /// Dotted name.
        key: String,
        /// A known name that looks like it.
        hint: Option<String>,
    },
    /// The value does not fit the parameter.
    #[error("{origin}: parameter `{key}`: {reason}")]
    Invalid {
        /// File or command line.
        origin: String,
        /// Dotted name.
        key: String,
        /// What is wrong and what would be right.
        reason: String,
    },
    /// The values fit one by one but not together.
    #[error("the parameters do not fit together: {0}")]
    Inconsistent(String),
    /// Not a node name.
    #[error("`{0}` is not a node name: letters, digits and `_`, separated by `/`, no part beginning with a digit")]
    NodeName(String),
}
