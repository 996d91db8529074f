//! `diagnostic_msgs`.

use serde::{Deserialize, Serialize};

use super::{messages, standard::Header};

/// `diagnostic_msgs/KeyValue`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyValue {
    /// What.
    pub key: String,
    /// How much.
    pub value: String,
}

/// `diagnostic_msgs/DiagnosticStatus`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosticStatus {
    /// 0 ok, 1 warning, 2 error, 3 stale.
    pub level: u8,
    /// Which part.
    pub name: String,
    /// Its state in words.
    pub message: String,
    /// Device.
    pub hardware_id: String,
    /// Figures.
    pub values: Vec<KeyValue>,
}

/// `diagnostic_msgs/DiagnosticArray`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosticArray {
    /// Stamp.
    pub header: Header,
    /// The parts.
    pub status: Vec<DiagnosticStatus>,
}

messages!("diagnostic_msgs": DiagnosticArray);
