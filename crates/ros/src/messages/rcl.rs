//! `rcl_interfaces`: log messages, parameters and their services.

use bytes::Bytes;
use serde::{Deserialize, Serialize};

use super::{messages, service, standard::Time};

/// `rcl_interfaces/Log`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Log {
    /// When.
    pub stamp: Time,
    /// 10 debug, 20 info, 30 warning, 40 error, 50 fatal.
    pub level: u8,
    /// Logger.
    pub name: String,
    /// Text.
    pub msg: String,
    /// Source file.
    pub file: String,
    /// Function.
    pub function: String,
    /// Line.
    pub line: u32,
}

/// `rcl_interfaces/ParameterValue`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ParameterValue {
    /// Which of the fields counts.
    pub r#type: u8,
    /// Type 1.
    pub bool_value: bool,
    /// Type 2.
    pub integer_value: i64,
    /// Type 3.
    pub double_value: f64,
    /// Type 4.
    pub string_value: String,
    /// Type 5.
    pub byte_array_value: Bytes,
    /// Type 6.
    pub bool_array_value: Vec<bool>,
    /// Type 7.
    pub integer_array_value: Vec<i64>,
    /// Type 8.
    pub double_array_value: Vec<f64>,
    /// Type 9.
    pub string_array_value: Vec<String>,
}

/// `rcl_interfaces/Parameter`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// Dotted name.
    pub name: String,
    /// Value.
    pub value: ParameterValue,
}

/// `rcl_interfaces/ParameterEvent`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ParameterEvent {
    /// When.
    pub stamp: Time,
    /// Full name of the node.
    pub node: String,
    /// Declared.
    pub new_parameters: Vec<Parameter>,
    /// Changed.
    pub changed_parameters: Vec<Parameter>,
    /// Gone.
    pub deleted_parameters: Vec<Parameter>,
}

messages!("rcl_interfaces": Log, ParameterEvent);

/// `rcl_interfaces/FloatingPointRange`
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FloatingPointRange {
    /// Smallest value.
    pub from_value: f64,
    /// Largest value.
    pub to_value: f64,
    /// 0 for any.
    pub step: f64,
}

/// `rcl_interfaces/IntegerRange`
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct IntegerRange {
    /// Smallest value.
    pub from_value: i64,
    /// Largest value.
    pub to_value: i64,
    /// 0 for any.
    pub step: u64,
}

/// `rcl_interfaces/ParameterDescriptor`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ParameterDescriptor {
    /// Dotted name.
    pub name: String,
    /// Type as in [`ParameterValue`].
    pub r#type: u8,
    /// Meaning.
    pub description: String,
    /// Limits in words.
    pub additional_constraints: String,
    /// Whether it can only be set at start-up.
    pub read_only: bool,
    /// Whether its type may change.
    pub dynamic_typing: bool,
    /// At most one range.
    pub floating_point_range: Vec<FloatingPointRange>,
    /// At most one range.
    pub integer_range: Vec<IntegerRange>,
}

/// `rcl_interfaces/SetParametersResult`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SetParametersResult {
    /// Whether the value was taken.
    pub successful: bool,
    /// Why not.
    pub reason: String,
}

/// A request by names.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct NamesRequest {
    /// Dotted names.
    pub names: Vec<String>,
}

/// Response of `GetParameters`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct GetParametersResponse {
    /// One a name; type 0 where there is none.
    pub values: Vec<ParameterValue>,
}

/// Request of `GetParameterTypes`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct GetParameterTypesRequest {
    /// Dotted names.
    pub names: Vec<String>,
}

/// Response of `GetParameterTypes`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct GetParameterTypesResponse {
    /// One a name.
    pub types: Bytes,
}

/// Request of `DescribeParameters`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct DescribeParametersRequest {
    /// Dotted names.
    pub names: Vec<String>,
}

/// Response of `DescribeParameters`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct DescribeParametersResponse {
    /// One a name.
    pub descriptors: Vec<ParameterDescriptor>,
}

/// Request of `ListParameters`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct ListParametersRequest {
    /// Only these groups; empty for all.
    pub prefixes: Vec<String>,
    /// How deep; 0 for all.
    pub depth: u64,
}

/// Response of `ListParameters`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct ListParametersResponse {
    /// Dotted names.
    pub names: Vec<String>,
    /// Groups.
    pub prefixes: Vec<String>,
}

/// Request of `SetParameters`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct SetParametersRequest {
    /// What to set.
    pub parameters: Vec<Parameter>,
}

/// Response of `SetParameters`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct SetParametersResponse {
    /// One a parameter.
    pub results: Vec<SetParametersResult>,
}

/// Request of `SetParametersAtomically`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct SetParametersAtomicallyRequest {
    /// What to set.
    pub parameters: Vec<Parameter>,
}

/// Response of `SetParametersAtomically`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct SetParametersAtomicallyResponse {
    /// For all.
    pub result: SetParametersResult,
}

service!("rcl_interfaces", GetParameters: NamesRequest => GetParametersResponse);
service!("rcl_interfaces", GetParameterTypes: GetParameterTypesRequest => GetParameterTypesResponse);
service!("rcl_interfaces", DescribeParameters: DescribeParametersRequest => DescribeParametersResponse);
service!("rcl_interfaces", ListParameters: ListParametersRequest => ListParametersResponse);
service!("rcl_interfaces", SetParameters: SetParametersRequest => SetParametersResponse);
service!("rcl_interfaces", SetParametersAtomically: SetParametersAtomicallyRequest => SetParametersAtomicallyResponse);
