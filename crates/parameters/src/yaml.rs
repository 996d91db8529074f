//! Reading YAML, and writing a configuration with its documentation.

use std::fmt::Write as _;
use std::path::Path;

use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;

use crate::{ParameterError, schema};

/// Longest line of a comment, characters.
const COMMENT_WIDTH: usize = 110;

pub(crate) fn read(path: &Path) -> Result<Value, ParameterError> {
    let text =
        std::fs::read_to_string(path).map_err(|source| ParameterError::Read { path: path.to_owned(), source })?;
    let syntax = |reason: String| ParameterError::Syntax { path: path.to_owned(), reason };
    // Without the excerpt of the file: error messages are one line.
    serde_saphyr::from_str(&text).map_err(|e| syntax(e.without_snippet().to_string()))
}

/// The value of `name:=value` on a command line: YAML, and plain text where it is none.
pub fn parse_value(text: &str) -> Value {
    serde_saphyr::from_str(text).unwrap_or_else(|_| Value::String(text.to_owned()))
}

/// A ROS 2 parameter file with every parameter of `config`, each preceded by its meaning and limits.
pub fn to_yaml_with_comments<T: Serialize + JsonSchema>(config: &T) -> String {
    let mut out = String::from("/**:\n  ros__parameters:\n");
    let value = serde_json::to_value(config).unwrap_or(Value::Null);
    write_group(&mut out, &schema::of::<T>(), &value, 2);
    out
}

fn write_group(out: &mut String, schema: &Value, value: &Value, depth: usize) {
    let Some(fields) = schema::fields(schema) else { return };
    let indent = "  ".repeat(depth);
    for (key, field) in fields {
        write_comment(out, field, &indent);
        match value.get(key) {
            Some(group @ Value::Object(_)) => {
                let _ = writeln!(out, "{indent}{key}:");
                write_group(out, field, group, depth + 1);
            }
            None | Some(Value::Null) => {
                let _ = writeln!(out, "{indent}# {key}: (not set)");
            }
            Some(leaf) => {
                let _ = writeln!(out, "{indent}{key}: {leaf}");
            }
        }
    }
}

fn write_comment(out: &mut String, field: &Value, indent: &str) {
    let mut text = schema::description(field);
    if let Some((low, high)) = schema::range(field) {
        let _ = match (low > f64::MIN, high < f64::MAX) {
            (true, true) => write!(text, " [{low}, {high}]"),
            (true, false) => write!(text, " (at least {low})"),
            _ => write!(text, " (at most {high})"),
        };
    }
    let choices = schema::choices(field);
    if !choices.is_empty() {
        let _ = write!(text, " (one of: {})", choices.join(", "));
    }
    let mut line = String::new();
    for word in text.split_whitespace() {
        if line.len() + word.len() > COMMENT_WIDTH {
            let _ = writeln!(out, "{indent}#{line}");
            line.clear();
        }
        line.push(' ');
        line.push_str(word);
    }
    if !line.is_empty() {
        let _ = writeln!(out, "{indent}#{line}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn limits_are_stated_where_there_are_some() {
        #[derive(Default, Serialize, JsonSchema)]
        struct Config {
            #[schemars(range(min = 0))]
            open: u64,
            #[schemars(range(min = 1, max = 5))]
            closed: i32,
        }
        let text = to_yaml_with_comments(&Config::default());
        assert!(text.contains("# (at least 0)\n    open: 0") && text.contains("# [1, 5]\n    closed: 0"), "{text}");
    }

    #[test]
    fn command_line_values_are_yaml() {
        assert_eq!(parse_value("true"), Value::Bool(true));
        assert_eq!(parse_value("3"), serde_json::json!(3));
        assert_eq!(parse_value("1e-3"), serde_json::json!(1e-3));
        assert_eq!(parse_value("[1, 2]"), serde_json::json!([1, 2]));
        assert_eq!(parse_value("/a/b c"), Value::String("/a/b c".into()));
        assert_eq!(parse_value("\"3\""), Value::String("3".into()));
    }

    proptest! {
        #[test]
        fn any_text_is_a_value(text in ".{0,60}") {
            let _ = parse_value(&text);
        }
    }
}
