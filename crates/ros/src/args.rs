//! The command line of a ROS 2 node (<https://design.ros2.org/articles/ros_command_line_arguments.html>).

use std::path::PathBuf;

use pfd_parameters::{Value, parse_value};

use crate::RosError;

/// `from:=to`, perhaps only for one node (`node:from:=to`).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Remap {
    /// The node that it is for; `None` for all.
    pub node: Option<String>,
    /// Name to replace, `__node` or `__ns`.
    pub from: String,
    /// Its replacement.
    pub to: String,
}

/// `name:=value`, perhaps only for one node (`node:name:=value`).
#[derive(Clone, Debug, PartialEq)]
pub struct Override {
    /// The node that it is for; `None` for all.
    pub node: Option<String>,
    /// Dotted name.
    pub name: String,
    /// Value.
    pub value: Value,
}

/// What stands between `--ros-args` and its end, and the rest.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Arguments {
    /// `-r`, `--remap`, in order; the first that fits counts.
    pub remaps: Vec<Remap>,
    /// `-p`, `--param`, in order; the last counts.
    pub parameters: Vec<Override>,
    /// `--params-file`, in order; the last counts.
    pub parameter_files: Vec<PathBuf>,
    /// `--log-level LEVEL`.
    pub log_level: Option<LogLevel>,
    /// `--log-level LOGGER:=LEVEL`.
    pub logger_levels: Vec<(String, LogLevel)>,
    /// `--disable-rosout-logs` is not given.
    pub rosout: bool,
    /// `--disable-stdout-logs` is not given.
    pub stdout: bool,
    /// Arguments that are not for ROS.
    pub rest: Vec<String>,
}

/// Severity of log messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum LogLevel {
    /// Everything.
    Debug,
    /// What happens.
    Info,
    /// What may be wrong.
    Warn,
    /// What is wrong.
    Error,
    /// What ends the node.
    Fatal,
}

impl LogLevel {
    /// The word that log filters use.
    pub fn filter(self) -> &'static str {
        match self {
            Self::Debug => "debug",
            Self::Info => "info",
            Self::Warn => "warn",
            Self::Error | Self::Fatal => "error",
        }
    }
}

impl std::str::FromStr for LogLevel {
    type Err = RosError;

    fn from_str(text: &str) -> Result<Self, RosError> {
        match text.to_ascii_lowercase().as_str() {
            "debug" => Ok(Self::Debug),
            "info" => Ok(Self::Info),
            "warn" | "warning" => Ok(Self::Warn),
            "error" => Ok(Self::Error),
            "fatal" => Ok(Self::Fatal),
            _ => Err(RosError::Arguments(format!("--log-level {text}: expected debug, info, warn, error or fatal"))),
        }
    }
}

impl Arguments {
    /// Reads the arguments after the program's name.
    ///
    /// # Errors
    /// [`RosError::Arguments`] for unknown options and malformed rules.
    pub fn parse(args: impl IntoIterator<Item = String>) -> Result<Self, RosError> {
        let mut out = Self { rosout: true, stdout: true, ..Self::default() };
        let mut args = args.into_iter();
        let mut in_ros = false;
        while let Some(arg) = args.next() {
            match arg.as_str() {
                "--ros-args" => in_ros = true,
                "--" if in_ros => in_ros = false,
                _ if in_ros => out.ros_option(&arg, &mut args)?,
                _ => out.rest.push(arg),
            }
        }
        Ok(out)
    }

    fn ros_option(&mut self, option: &str, args: &mut impl Iterator<Item = String>) -> Result<(), RosError> {
        let mut value = || args.next().ok_or_else(|| RosError::Arguments(format!("{option} needs a value")));
        match option {
            "-r" | "--remap" => self.remaps.push(parse_remap(&value()?)?),
            "-p" | "--param" => self.parameters.push(parse_override(&value()?)?),
            "--params-file" => self.parameter_files.push(value()?.into()),
            "--log-level" => self.set_log_level(&value()?)?,
            "--log-config-file" | "--log-file-name" | "-e" | "--enclave" => drop(value()?),
            "--enable-rosout-logs" => self.rosout = true,
            "--disable-rosout-logs" => self.rosout = false,
            "--enable-stdout-logs" => self.stdout = true,
            "--disable-stdout-logs" => self.stdout = false,
            "--enable-external-lib-logs" | "--disable-external-lib-logs" => {}
            _ => return Err(RosError::Arguments(format!("unknown option {option} after --ros-args"))),
        }
        Ok(())
    }

    fn set_log_level(&mut self, text: &str) -> Result<(), RosError> {
        match text.split_once(":=") {
            Some((logger, level)) => self.logger_levels.push((logger.to_owned(), level.parse()?)),
            None => self.log_level = Some(text.parse()?),
        }
        Ok(())
    }
}

fn split_rule<'a>(option: &str, text: &'a str) -> Result<(&'a str, &'a str), RosError> {
    let malformed = || RosError::Arguments(format!("{option} {text}: expected `name:=value`"));
    text.split_once(":=").filter(|(left, _)| !left.is_empty()).ok_or_else(malformed)
}

/// `node:name` → (node, name); a scheme such as `rostopic://` is no node.
fn split_node(text: &str) -> (Option<String>, &str) {
    match text.split_once(':') {
        Some((node, name)) if !name.starts_with("//") => (Some(node.to_owned()), name),
        _ => (None, text),
    }
}

fn parse_remap(text: &str) -> Result<Remap, RosError> {
    let (left, to) = split_rule("--remap", text)?;
    if to.is_empty() {
        return Err(RosError::Arguments(format!("--remap {text}: nothing after `:=`")));
    }
    let (node, from) = split_node(left);
    let from = ["rostopic://", "rosservice://"].iter().find_map(|scheme| from.strip_prefix(scheme)).unwrap_or(from);
    Ok(Remap { node, from: from.to_owned(), to: to.to_owned() })
}

fn parse_override(text: &str) -> Result<Override, RosError> {
    let (left, value) = split_rule("--param", text)?;
    let (node, name) = split_node(left);
    Ok(Override { node, name: name.to_owned(), value: parse_value(value) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn parse(line: &str) -> Result<Arguments, RosError> {
        Arguments::parse(line.split_whitespace().map(str::to_owned))
    }

    #[test]
    fn understands_everything_that_rcl_does() {
        let args = parse(
            "first --ros-args -r rgb/image:=/camera/rgb -r __ns:=/robot --remap other:__node:=x -p a.b:=3 \
             -p node:c:=text --params-file f.yaml --log-level debug --log-level rustdds:=error -e /enclave \
             --disable-rosout-logs -- last --ros-args -p d:=[1,2]",
        )
        .unwrap();
        let remap = |node: Option<&str>, from: &str, to: &str| Remap {
            node: node.map(str::to_owned),
            from: from.into(),
            to: to.into(),
        };
        assert_eq!(
            args.remaps,
            [
                remap(None, "rgb/image", "/camera/rgb"),
                remap(None, "__ns", "/robot"),
                remap(Some("other"), "__node", "x")
            ]
        );
        assert_eq!(args.parameters[0].value, Value::from(3));
        assert_eq!(args.parameters[1].node.as_deref(), Some("node"));
        assert_eq!(args.parameters[2].value, parse_value("[1,2]"));
        assert_eq!(args.parameter_files, [PathBuf::from("f.yaml")]);
        assert_eq!(args.log_level, Some(LogLevel::Debug));
        assert_eq!(args.logger_levels, [("rustdds".to_owned(), LogLevel::Error)]);
        assert_eq!((args.rosout, args.rest), (false, vec!["first".to_owned(), "last".to_owned()]));
    }

    #[test]
    fn mistakes_are_named() {
        for (line, expected) in [
            ("--ros-args -r a", "expected `name:=value`"),
            ("--ros-args -r", "-r needs a value"),
            ("--ros-args -r a:=", "nothing after"),
            ("--ros-args --frobnicate", "unknown option --frobnicate"),
            ("--ros-args --log-level loud", "expected debug"),
        ] {
            let message = parse(line).unwrap_err().to_string();
            assert!(message.contains(expected), "{line}: {message}");
        }
    }

    proptest! {
        #[test]
        fn any_words_parse_or_are_refused(words in prop::collection::vec("(-r|-p|--ros-args|--|[a-z:=/_.]{0,12})", 0..12)) {
            let _ = Arguments::parse(words);
        }
    }
}
