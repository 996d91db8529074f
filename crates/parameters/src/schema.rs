//! Reading JSON schemas: where a dotted name leads, and whether a value fits.

use schemars::{JsonSchema, generate::SchemaSettings};
use serde_json::{Map, Value};

use crate::ParameterKind;

/// The schema of `T` without references.
pub(crate) fn of<T: JsonSchema>() -> Value {
    let settings = SchemaSettings::draft2020_12().with(|s| s.inline_subschemas = true);
    settings.into_generator().into_root_schema_for::<T>().to_value()
}

/// What remains of a schema when "or null" is taken away.
pub(crate) fn without_null(schema: &Value) -> &Value {
    let alternatives = schema.get("anyOf").and_then(Value::as_array);
    let is_null = |s: &&Value| s.get("type").and_then(Value::as_str) != Some("null");
    alternatives.and_then(|a| a.iter().find(is_null)).unwrap_or(schema)
}

/// The fields of a schema, if it is that of a struct.
pub(crate) fn fields(schema: &Value) -> Option<&Map<String, Value>> {
    without_null(schema).get("properties").and_then(Value::as_object)
}

/// The schema that `parts` lead to.
pub(crate) fn find<'a>(schema: &'a Value, parts: &[&str]) -> Option<&'a Value> {
    parts.iter().try_fold(schema, |schema, part| fields(schema)?.get(*part))
}

/// First paragraph of the doc comment, of the field or else of its type.
pub(crate) fn description(schema: &Value) -> String {
    let text = [schema, without_null(schema)].into_iter().find_map(|s| s.get("description").and_then(Value::as_str));
    text.unwrap_or_default().split_whitespace().collect::<Vec<_>>().join(" ")
}

/// The allowed words of an enumeration.
pub(crate) fn choices(schema: &Value) -> Vec<String> {
    let schema = without_null(schema);
    let plain = schema.get("enum").and_then(Value::as_array).into_iter().flatten();
    let documented = schema.get("oneOf").and_then(Value::as_array).into_iter().flatten();
    let words = documented.flat_map(|s| {
        let single = s.get("const").into_iter();
        single.chain(s.get("enum").and_then(Value::as_array).into_iter().flatten())
    });
    plain.chain(words).filter_map(Value::as_str).map(str::to_owned).collect()
}

/// Smallest and largest allowed number.
pub(crate) fn range(schema: &Value) -> Option<(f64, f64)> {
    let schema = without_null(schema);
    let bound = |key: &str| schema.get(key).and_then(Value::as_f64);
    let (low, high) = (bound("minimum").or(bound("exclusiveMinimum")), bound("maximum").or(bound("exclusiveMaximum")));
    if low.is_none() && high.is_none() {
        return None;
    }
    Some((low.unwrap_or(f64::MIN), high.unwrap_or(f64::MAX)))
}

/// The ROS 2 parameter type of a leaf.
pub(crate) fn kind(schema: &Value) -> ParameterKind {
    let schema = without_null(schema);
    match type_name(schema) {
        Some("boolean") => ParameterKind::Boolean,
        Some("integer") => ParameterKind::Integer,
        Some("number") => ParameterKind::Double,
        Some("array") => match schema.get("items").and_then(type_name) {
            Some("boolean") => ParameterKind::BooleanArray,
            Some("integer") => ParameterKind::IntegerArray,
            Some("number") => ParameterKind::DoubleArray,
            _ => ParameterKind::StringArray,
        },
        _ => ParameterKind::String,
    }
}

fn type_name(schema: &Value) -> Option<&str> {
    match schema.get("type")? {
        Value::String(name) => Some(name),
        Value::Array(names) => names.iter().filter_map(Value::as_str).find(|&name| name != "null"),
        _ => None,
    }
}

fn allows_null(schema: &Value) -> bool {
    let in_type = schema.get("type").and_then(Value::as_array).is_some_and(|names| names.iter().any(|n| n == "null"));
    in_type || !std::ptr::eq(without_null(schema), schema)
}

/// Checks a leaf value.
///
/// # Errors
/// What is wrong and what would be right.
pub(crate) fn check(schema: &Value, value: &Value) -> Result<(), String> {
    if value.is_null() {
        return if allows_null(schema) { Ok(()) } else { Err("a value is needed".to_owned()) };
    }
    if fields(schema).is_some() {
        return Err(format!("is a group of parameters, not a value ({value})"));
    }
    check_scalar(schema, kind(schema), value)
}

fn check_scalar(schema: &Value, kind: ParameterKind, value: &Value) -> Result<(), String> {
    match kind {
        ParameterKind::Boolean if !value.is_boolean() => Err(format!("must be true or false, not {value}")),
        ParameterKind::Integer if !value.is_i64() && !value.is_u64() => {
            Err(format!("must be a whole number, not {value}"))
        }
        ParameterKind::Double if !value.is_number() => Err(format!("must be a number, not {value}")),
        ParameterKind::Boolean => Ok(()),
        ParameterKind::Integer | ParameterKind::Double => check_range(schema, value),
        ParameterKind::String => check_choice(schema, value),
        kind => check_elements(schema, kind, value),
    }
}

/// Smallest and largest number of an integer type that is narrower than those of a parameter.
fn limits_of_type(schema: &Value) -> Option<(f64, f64)> {
    match schema.get("format").and_then(Value::as_str)? {
        "int32" => Some((f64::from(i32::MIN), f64::from(i32::MAX))),
        "uint32" => Some((0.0, f64::from(u32::MAX))),
        _ => None,
    }
}

fn check_range(schema: &Value, value: &Value) -> Result<(), String> {
    let schema = without_null(schema);
    let number = value.as_f64().unwrap_or(f64::NAN);
    let bound = |key: &str| schema.get(key).and_then(Value::as_f64);
    let (least, most) = limits_of_type(schema).unzip();
    let (minimum, maximum) = (bound("minimum").or(least), bound("maximum").or(most));
    let (above, below) = (bound("exclusiveMinimum"), bound("exclusiveMaximum"));
    let inside = minimum.is_none_or(|low| number >= low)
        && maximum.is_none_or(|high| number <= high)
        && above.is_none_or(|low| number > low)
        && below.is_none_or(|high| number < high);
    if inside {
        return Ok(());
    }
    let text = |bound: Option<f64>| bound.map_or("any".to_owned(), |b| b.to_string());
    Err(format!("{value} is out of range [{}, {}]", text(minimum.or(above)), text(maximum.or(below))))
}

fn check_choice(schema: &Value, value: &Value) -> Result<(), String> {
    let Some(text) = value.as_str() else { return Err(format!("must be a string, not {value}")) };
    let choices = choices(schema);
    if choices.is_empty() || choices.iter().any(|c| c == text) {
        return Ok(());
    }
    Err(format!("`{text}` is none of: {}", choices.join(", ")))
}

fn check_elements(schema: &Value, kind: ParameterKind, value: &Value) -> Result<(), String> {
    let schema = without_null(schema);
    let Some(elements) = value.as_array() else { return Err(format!("must be a list, not {value}")) };
    let count = |key: &str| schema.get(key).and_then(Value::as_u64).map(|n| n as usize);
    let (low, high) = (count("minItems").unwrap_or(0), count("maxItems").unwrap_or(usize::MAX));
    if !(low..=high).contains(&elements.len()) {
        return Err(format!("must have {low} elements, not {}", elements.len()));
    }
    let item = schema.get("items").unwrap_or(&Value::Null);
    elements.iter().try_for_each(|element| check_scalar(item, kind.element(), element))
}
