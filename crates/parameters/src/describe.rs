//! What parameters there are: names, types, defaults, meaning, limits.

use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;

use crate::schema;

/// The types that ROS 2 parameters can have (`rcl_interfaces/ParameterType`, without byte arrays).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParameterKind {
    /// `bool`
    Boolean,
    /// `int64`
    Integer,
    /// `float64`
    Double,
    /// `string`
    String,
    /// `bool[]`
    BooleanArray,
    /// `int64[]`
    IntegerArray,
    /// `float64[]`
    DoubleArray,
    /// `string[]`
    StringArray,
}

impl ParameterKind {
    /// The kind of the elements of an array; a scalar's own kind.
    #[must_use]
    pub fn element(self) -> Self {
        match self {
            Self::BooleanArray => Self::Boolean,
            Self::IntegerArray => Self::Integer,
            Self::DoubleArray => Self::Double,
            Self::StringArray => Self::String,
            scalar => scalar,
        }
    }
}

/// One parameter.
#[derive(Clone, Debug, PartialEq)]
pub struct ParameterDescription {
    /// Dotted name, such as `tracking.features`.
    pub name: String,
    /// Its type.
    pub kind: ParameterKind,
    /// Its default; null when it is not set by default.
    pub default: Value,
    /// Its meaning and unit, from the doc comment.
    pub description: String,
    /// Smallest and largest allowed value of a number.
    pub range: Option<(f64, f64)>,
    /// Allowed words; empty when any text will do.
    pub choices: Vec<String>,
    schema: Value,
}

impl ParameterDescription {
    /// Checks a value for this parameter.
    ///
    /// # Errors
    /// What is wrong and what would be right.
    pub fn check(&self, value: &Value) -> Result<(), String> {
        schema::check(&self.schema, value)
    }
}

/// All parameters of `T`, in the order of its fields' names.
pub fn describe<T: JsonSchema + Serialize + Default>() -> Vec<ParameterDescription> {
    let defaults = serde_json::to_value(T::default()).unwrap_or(Value::Null);
    let mut out = Vec::new();
    collect(&schema::of::<T>(), &defaults, "", &mut out);
    out
}

/// Dotted names and values of a configuration.
pub fn values<T: Serialize>(config: &T) -> Vec<(String, Value)> {
    let mut out = Vec::new();
    flatten(&serde_json::to_value(config).unwrap_or(Value::Null), "", &mut out);
    out
}

fn collect(schema: &Value, default: &Value, prefix: &str, out: &mut Vec<ParameterDescription>) {
    let Some(fields) = schema::fields(schema) else { return };
    for (key, field) in fields {
        let name = join(prefix, key);
        let default = default.get(key).cloned().unwrap_or(Value::Null);
        if schema::fields(field).is_some() {
            collect(field, &default, &name, out);
        } else {
            out.push(ParameterDescription {
                name,
                kind: schema::kind(field),
                default,
                description: schema::description(field),
                range: schema::range(field),
                choices: schema::choices(field),
                schema: field.clone(),
            });
        }
    }
}

/// Leaves of a tree with their dotted names.
pub(crate) fn flatten(value: &Value, prefix: &str, out: &mut Vec<(String, Value)>) {
    match value {
        Value::Object(fields) => fields.iter().for_each(|(key, value)| flatten(value, &join(prefix, key), out)),
        leaf => out.push((prefix.to_owned(), leaf.clone())),
    }
}

pub(crate) fn join(prefix: &str, key: &str) -> String {
    if prefix.is_empty() { key.to_owned() } else { format!("{prefix}.{key}") }
}
