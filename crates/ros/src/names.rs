//! Names of the node, its topics and services: namespaces, `~`, remapping.

use pfd_parameters::NodeName;

use crate::{Arguments, RosError, args::Remap};

/// Who the node is and how it calls its topics.
#[derive(Clone, Debug)]
pub struct Names {
    node: NodeName,
    /// `from` (full name) → `to` (full name).
    rules: Vec<(String, String)>,
}

impl Names {
    /// Applies `__ns`, `__node` and the remapping rules for the node called `default_name`.
    ///
    /// # Errors
    /// [`RosError`] when a name is malformed.
    pub fn new(args: &Arguments, default_name: &str) -> Result<Self, RosError> {
        let mine: Vec<&Remap> =
            args.remaps.iter().filter(|r| r.node.as_deref().is_none_or(|n| n == default_name)).collect();
        let special = |keys: &[&str]| mine.iter().find(|r| keys.contains(&r.from.as_str())).map(|r| r.to.as_str());
        let name = special(&["__node", "__name"]).unwrap_or(default_name);
        let node = NodeName::new(special(&["__ns"]).unwrap_or("/"), name)?;
        let ordinary = mine.iter().filter(|r| !r.from.starts_with("__"));
        let rules = ordinary.map(|r| Ok((expand(&r.from, &node)?, expand(&r.to, &node)?)));
        Ok(Self { rules: rules.collect::<Result<_, RosError>>()?, node })
    }

    /// The full name of the node.
    pub fn node(&self) -> &NodeName {
        &self.node
    }

    /// Full name of a topic or service after expansion and remapping.
    ///
    /// # Errors
    /// [`RosError::Name`] when the name is malformed.
    pub fn resolve(&self, name: &str) -> Result<String, RosError> {
        let full = expand(name, &self.node)?;
        Ok(self.rules.iter().find(|(from, _)| *from == full).map_or(full, |(_, to)| to.clone()))
    }
}

/// `/a` stays, `~/a` goes below the node, `a` below the namespace; `{node}` and `{ns}` are replaced.
fn expand(name: &str, node: &NodeName) -> Result<String, RosError> {
    let namespace = node.namespace().trim_end_matches('/');
    let substituted = name.replace("{node}", node.base()).replace("{ns}", namespace).replace("{namespace}", namespace);
    let full = if substituted == "~" {
        node.to_string()
    } else if let Some(private) = substituted.strip_prefix("~/") {
        format!("{node}/{private}")
    } else if substituted.starts_with('/') {
        substituted
    } else {
        format!("{namespace}/{substituted}")
    };
    if is_valid(&full) { Ok(full) } else { Err(RosError::Name(name.to_owned())) }
}

fn is_valid(full: &str) -> bool {
    let Some(path) = full.strip_prefix('/') else { return false };
    path.split('/').all(|token| {
        let first = token.bytes().next().is_some_and(|b| b.is_ascii_alphabetic() || b == b'_');
        first && !token.contains("__") && token.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_')
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn names(line: &str) -> Result<Names, RosError> {
        let args = Arguments::parse(line.split_whitespace().map(str::to_owned)).unwrap();
        Names::new(&args, "tracking_node")
    }

    #[test]
    fn names_expand_by_the_rules() {
        let n =
            names("--ros-args -r __ns:=/robot -r __node:=t -r depth:=/d -r ~/reset:=clear -r other:pose:=x").unwrap();
        assert_eq!(n.node().to_string(), "/robot/t");
        for (name, full) in [
            ("pose", "/robot/pose"),
            ("/tf", "/tf"),
            ("~/pause", "/robot/t/pause"),
            ("depth", "/d"),
            ("/robot/depth", "/d"),
            ("~/reset", "/robot/clear"),
            ("{node}/x", "/robot/t/x"),
        ] {
            assert_eq!(n.resolve(name).unwrap(), full, "{name}");
        }
    }

    #[test]
    fn malformed_names_are_refused() {
        let n = names("").unwrap();
        for name in ["", "/", "a//b", "a/", "1a", "a b", "a__b", "~a"] {
            assert!(n.resolve(name).is_err(), "{name}");
        }
        assert!(names("--ros-args -r __node:=1").is_err());
        assert!(names("--ros-args -r a:=b//c").is_err());
    }

    proptest! {
        #[test]
        fn resolved_names_are_valid(name in "[a-z0-9_~/{}]{0,16}") {
            if let Ok(full) = names("").unwrap().resolve(&name) {
                prop_assert!(is_valid(&full));
            }
        }
    }
}
