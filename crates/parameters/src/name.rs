//! Node names and the patterns that parameter files use for them.

use std::fmt;

use crate::ParameterError;

/// The full name of a node, such as `/robot/tracking_node`.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct NodeName {
    namespace: String,
    base: String,
}

impl NodeName {
    /// A name from namespace (`/`, `/robot`) and base name.
    ///
    /// # Errors
    /// [`ParameterError::NodeName`] when either has characters that ROS 2 does not allow.
    pub fn new(namespace: &str, base: &str) -> Result<Self, ParameterError> {
        let namespace = namespace.trim_matches('/');
        let tokens_are_valid = namespace.is_empty() || namespace.split('/').all(is_token);
        if !tokens_are_valid || !is_token(base) {
            return Err(ParameterError::NodeName(format!("{namespace}/{base}")));
        }
        Ok(Self { namespace: format!("/{namespace}"), base: base.to_owned() })
    }

    /// The namespace, beginning with `/`.
    pub fn namespace(&self) -> &str {
        &self.namespace
    }

    /// The last part.
    pub fn base(&self) -> &str {
        &self.base
    }

    /// Whether a section name of a parameter file means this node: `*` stands for one part, `**` for any number of parts, and a
    /// name without a leading `/` is taken as one in the root namespace, as in rcl.
    pub fn matches(&self, pattern: &str) -> bool {
        let full = self.to_string();
        let name: Vec<&str> = full.split('/').filter(|t| !t.is_empty()).collect();
        let pattern: Vec<&str> = pattern.split('/').filter(|t| !t.is_empty()).collect();
        matches_tokens(&pattern, &name)
    }
}

impl fmt::Display for NodeName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let separator = if self.namespace == "/" { "" } else { "/" };
        write!(f, "{}{separator}{}", self.namespace, self.base)
    }
}

fn is_token(token: &str) -> bool {
    let mut bytes = token.bytes();
    let first = bytes.next().is_some_and(|b| b.is_ascii_alphabetic() || b == b'_');
    first && bytes.all(|b| b.is_ascii_alphanumeric() || b == b'_')
}

fn matches_tokens(pattern: &[&str], name: &[&str]) -> bool {
    match (pattern.split_first(), name.split_first()) {
        (None, None) => true,
        (Some((&"**", rest)), _) => (0..=name.len()).any(|skipped| matches_tokens(rest, &name[skipped..])),
        (Some((&token, pattern)), Some((&part, name))) => {
            (token == "*" || token == part) && matches_tokens(pattern, name)
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_checked() {
        assert_eq!(NodeName::new("/", "a").unwrap().to_string(), "/a");
        assert_eq!(NodeName::new("robot", "a").unwrap().to_string(), "/robot/a");
        for (namespace, base) in [("/", ""), ("/", "1a"), ("/", "a/b"), ("/a//b", "c"), ("/a b", "c")] {
            assert!(NodeName::new(namespace, base).is_err(), "{namespace} {base}");
        }
    }

    #[test]
    fn wildcards_match_as_in_rcl() {
        let name = NodeName::new("/robot/left", "tracking_node").unwrap();
        for pattern in ["/**", "/**/tracking_node", "/robot/*/tracking_node", "/robot/left/tracking_node", "/*/*/*"] {
            assert!(name.matches(pattern), "{pattern}");
        }
        for pattern in ["/*", "tracking_node", "/robot/*", "/robot/left/tracking", "/**/left"] {
            assert!(!name.matches(pattern), "{pattern}");
        }
        assert!(NodeName::new("/", "tracking_node").unwrap().matches("tracking_node"));
    }
}
