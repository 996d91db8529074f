//! The merged parameter tree of a node, and taking typed parts out of it.

use std::collections::BTreeMap;
use std::path::Path;

use schemars::JsonSchema;
use serde::{Serialize, de::DeserializeOwned};
use serde_json::{Map, Value};

use crate::{NodeName, ParameterError, describe, schema, spelling, yaml};

/// How often names may be nested; deeper files are refused.
const MAX_DEPTH: usize = 16;

/// A value and the file or command line it comes from.
#[derive(Clone, Debug)]
struct Leaf {
    value: Value,
    origin: String,
}

/// Parameters from files and command line, not yet typed. Keys are dotted names.
#[derive(Clone, Debug, Default)]
pub struct ParameterTree {
    leaves: BTreeMap<String, Leaf>,
    known: Vec<String>,
}

impl ParameterTree {
    /// Merges the sections for `node` of all files, later files over earlier ones, named sections over wildcards, `overrides`
    /// over all.
    ///
    /// # Errors
    /// [`ParameterError`] for unreadable files, YAML errors, and files that are no ROS 2 parameter files.
    pub fn read(files: &[&Path], node: &NodeName, overrides: &[(String, Value)]) -> Result<Self, ParameterError> {
        let mut tree = Self::default();
        for file in files {
            let root = yaml::read(file)?;
            tree.merge_sections(&root, "", node, &file.display().to_string(), 0)?;
        }
        for (name, value) in overrides {
            tree.merge(name, value, "command line");
        }
        Ok(tree)
    }

    /// Walks down to `ros__parameters`; the keys on the way, joined, are the pattern of the node's name.
    fn merge_sections(
        &mut self,
        section: &Value,
        pattern: &str,
        node: &NodeName,
        origin: &str,
        depth: usize,
    ) -> Result<(), ParameterError> {
        let layout = |key: &str| ParameterError::Layout { origin: origin.to_owned(), key: key.to_owned() };
        let fields = section.as_object().filter(|_| depth < MAX_DEPTH).ok_or_else(|| layout(pattern))?;
        for (key, value) in fields {
            if key != "ros__parameters" {
                let pattern = format!("{}/{}", pattern.trim_end_matches('/'), key.trim_start_matches('/'));
                self.merge_sections(value, &pattern, node, origin, depth + 1)?;
            } else if !value.is_null() && node.matches(pattern) {
                let fields = value.as_object().ok_or_else(|| layout(key))?;
                fields.iter().for_each(|(name, value)| self.merge(name, value, origin));
            }
        }
        Ok(())
    }

    fn merge(&mut self, name: &str, value: &Value, origin: &str) {
        let mut leaves = Vec::new();
        describe::flatten(value, name, &mut leaves);
        for (name, value) in leaves {
            self.leaves.insert(name, Leaf { value, origin: origin.to_owned() });
        }
    }

    /// Takes the parameters of `T` out of the tree; what is not set keeps its default.
    ///
    /// # Errors
    /// [`ParameterError`] for unknown keys below a group of `T`, wrong types and values out of range.
    pub fn take<T>(&mut self) -> Result<T, ParameterError>
    where
        T: DeserializeOwned + Serialize + JsonSchema + Default,
    {
        let mut root = serde_json::to_value(T::default()).map_err(|e| ParameterError::Inconsistent(e.to_string()))?;
        for (name, leaf) in self.take_leaves::<T>()? {
            insert(&mut root, &name.split('.').collect::<Vec<_>>(), leaf.value);
        }
        serde_json::from_value(root).map_err(|e| ParameterError::Inconsistent(e.to_string()))
    }

    /// Takes the parameters of `T` out of the tree, checks them and forgets them: they are another node's.
    ///
    /// # Errors
    /// As [`Self::take`].
    pub fn check<T: JsonSchema>(&mut self) -> Result<(), ParameterError> {
        self.take_leaves::<T>().map(|_| ())
    }

    /// # Errors
    /// [`ParameterError::Unknown`] when a parameter is left that nobody took.
    pub fn finish(self) -> Result<(), ParameterError> {
        match self.leaves.iter().next() {
            None => Ok(()),
            Some((key, leaf)) => Err(unknown(key, leaf, &self.known)),
        }
    }

    fn take_leaves<T: JsonSchema>(&mut self) -> Result<BTreeMap<String, Leaf>, ParameterError> {
        let schema = schema::of::<T>();
        let Some(fields) = schema::fields(&schema) else { return Ok(BTreeMap::new()) };
        self.known.extend(fields.keys().cloned());
        let belongs = |name: &str| name.split('.').next().is_some_and(|head| fields.contains_key(head));
        let (mine, rest) = std::mem::take(&mut self.leaves).into_iter().partition(|(name, _)| belongs(name));
        self.leaves = rest;
        let mine: BTreeMap<String, Leaf> = mine;
        mine.iter().try_for_each(|(name, leaf)| check_leaf(&schema, name, leaf))?;
        Ok(mine)
    }
}

fn check_leaf(schema: &Value, name: &str, leaf: &Leaf) -> Result<(), ParameterError> {
    let parts: Vec<&str> = name.split('.').collect();
    let Some(found) = schema::find(schema, &parts) else {
        let parent = schema::find(schema, &parts[..parts.len() - 1]).and_then(schema::fields);
        let siblings: Vec<String> = parent.into_iter().flat_map(Map::keys).cloned().collect();
        let prefix = &parts[..parts.len() - 1].join(".");
        let names: Vec<String> = siblings.iter().map(|s| describe::join(prefix, s)).collect();
        return Err(unknown(name, leaf, &names));
    };
    let invalid = |reason| ParameterError::Invalid { origin: leaf.origin.clone(), key: name.to_owned(), reason };
    schema::check(found, &leaf.value).map_err(invalid)
}

fn unknown(key: &str, leaf: &Leaf, known: &[String]) -> ParameterError {
    let hint = spelling::similar(key, known.iter().map(String::as_str)).map(str::to_owned);
    ParameterError::Unknown { origin: leaf.origin.clone(), key: key.to_owned(), hint }
}

/// Sets the value at `parts`, making the groups on the way.
fn insert(root: &mut Value, parts: &[&str], value: Value) {
    let Some((first, rest)) = parts.split_first() else {
        *root = value;
        return;
    };
    if !root.is_object() {
        *root = Value::Object(Map::new());
    }
    if let Value::Object(fields) = root {
        insert(fields.entry((*first).to_owned()).or_insert(Value::Null), rest, value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
    #[serde(default, deny_unknown_fields)]
    struct Stage {
        /// How many, pixels.
        #[schemars(range(min = 1, max = 100))]
        count: u32,
        levels: u32,
        scale: f64,
        on: bool,
        size: Option<[f64; 2]>,
    }

    impl Default for Stage {
        fn default() -> Self {
            Self { count: 7, levels: 1, scale: 1.5, on: false, size: None }
        }
    }

    #[derive(Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
    #[serde(rename_all = "lowercase")]
    enum Mode {
        /// One.
        #[default]
        One,
        /// Two.
        Two,
    }

    #[derive(Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
    #[serde(default, deny_unknown_fields)]
    struct Config {
        mode: Mode,
        stage: Stage,
        optional: Option<Stage>,
    }

    fn load(text: &str, overrides: &[(&str, Value)]) -> Result<Config, ParameterError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        let node = NodeName::new("/robot", "node").unwrap();
        let overrides: Vec<_> = overrides.iter().map(|(k, v)| ((*k).to_owned(), v.clone())).collect();
        crate::load(&[file.path()], &node, &overrides)
    }

    #[test]
    fn sections_merge_and_named_ones_win() {
        let text = "
/robot/node: {ros__parameters: {stage: {count: 9}}}
/**:
  ros__parameters:
    mode: two
    stage.scale: 2
    stage: {count: 8, on: true}
    mask_timeout: 0.5
robot:
  other: {ros__parameters: {nonsense: 1}}
";
        let config = load(text, &[("stage.size", serde_json::json!([1, 2.5]))]).unwrap();
        let stage = Stage { count: 9, scale: 2.0, on: true, size: Some([1.0, 2.5]), ..Stage::default() };
        assert_eq!(config, Config { mode: Mode::Two, stage, optional: None });
    }

    #[test]
    fn groups_may_be_optional() {
        let config = load("/**: {ros__parameters: {optional: {count: 3}}}", &[]).unwrap();
        assert_eq!(config.optional, Some(Stage { count: 3, ..Stage::default() }));
        assert_eq!(load("/**: {ros__parameters: {optional: null}}", &[]).unwrap(), Config::default());
    }

    #[test]
    fn mistakes_are_named() {
        let message = |text: &str| load(text, &[]).unwrap_err().to_string();
        for (yaml, expected) in [
            ("stage: {cuont: 1}", "unknown parameter `stage.cuont`; did you mean `stage.count`?"),
            ("stge: 1", "unknown parameter `stge`; did you mean `stage`?"),
            ("stage: {count: 0}", "`stage.count`: 0 is out of range [1, 100]"),
            ("stage: {levels: 5000000000}", "`stage.levels`: 5000000000 is out of range [0, 4294967295]"),
            ("stage: {count: 1.5}", "must be a whole number"),
            ("stage: {scale: big}", "must be a number"),
            ("stage: {on: 1}", "must be true or false"),
            ("stage: 3", "group of parameters"),
            ("stage: {size: [1]}", "must have 2 elements"),
            ("mode: three", "`three` is none of: one, two"),
            ("mask_timeout: true", "`mask_timeout`: must be a number"),
        ] {
            let message = message(&format!("/**: {{ros__parameters: {{{yaml}}}}}"));
            assert!(message.contains(expected), "{yaml}: {message}");
        }
        assert!(message("/**: 3").contains("not a section"));
        assert!(message("a: [").contains("not valid YAML"));
    }

    #[test]
    fn descriptions_follow_the_types() {
        let all = crate::describe::<Config>();
        let count = all.iter().find(|d| d.name == "stage.count").unwrap();
        assert_eq!(count.description, "How many, pixels.");
        assert_eq!((count.range, count.default.clone()), (Some((1.0, 100.0)), 7.into()));
        let mode = all.iter().find(|d| d.name == "mode").unwrap();
        assert_eq!(mode.choices, ["one", "two"]);
        assert!(all.iter().any(|d| d.name == "optional.count" && d.default.is_null()));
    }

    #[test]
    fn printed_configuration_reads_back() {
        let config = Config { mode: Mode::Two, stage: Stage { count: 5, ..Stage::default() }, optional: None };
        let text = crate::to_yaml_with_comments(&config);
        assert!(text.contains("# How many, pixels."), "{text}");
        assert_eq!(load(&text, &[]).unwrap(), config);
    }
}
