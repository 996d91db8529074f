//! The programs of the workspace, as a user starts them.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use anyhow::{Context, ensure};

use crate::repository;

/// Path of the program `name`, built by cargo first (once for each process of tests; a no-op when it is up to date), with the
/// profile and in the target folder of the running test.
///
/// # Errors
/// When cargo fails.
pub fn binary(name: &str) -> anyhow::Result<PathBuf> {
    static BUILT: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    let folder = BUILT.get_or_init(|| build().map_err(|e| format!("{e:#}")));
    Ok(folder.as_ref().map_err(|e| anyhow::anyhow!("{e}"))?.join(name))
}

/// Builds all programs, as `.ci/run` and the demo do: a choice of packages would build common dependencies anew, with other
/// features. Returns the folder that has them.
fn build() -> anyhow::Result<PathBuf> {
    let (target, profile) = target_and_profile()?;
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    command.current_dir(repository()).args(["build", "--quiet", "--locked", "--workspace", "--bins"]);
    command.arg("--target-dir").arg(&target);
    if profile == "release" {
        command.arg("--release");
    }
    let status = command.status().context("cargo cannot be started")?;
    ensure!(status.success(), "cargo failed to build the programs");
    Ok(target.join(profile))
}

/// The command line tool.
///
/// # Errors
/// When cargo fails to build it.
pub fn pfd_slam() -> anyhow::Result<Command> {
    binary("pfd-slam").map(Command::new)
}

/// A Python that can import `module`, if there is one.
pub fn python_with(module: &str) -> Option<PathBuf> {
    let candidates = std::env::var_os("PFD_PYTHON").map(PathBuf::from).into_iter().chain([PathBuf::from("python3")]);
    let imports = |python: &Path| {
        let output = Command::new(python).args(["-c", &format!("import {module}")]).output();
        output.is_ok_and(|o| o.status.success())
    };
    let found = candidates.into_iter().find(|python| imports(python));
    if found.is_none() {
        crate::skip(&format!("no python3 with {module} (pip install {module}; PFD_PYTHON names another Python)"));
    }
    found
}

/// Tests run as `<target>/<profile>/deps/<test>-<hash>`.
fn target_and_profile() -> anyhow::Result<(PathBuf, String)> {
    let test = std::env::current_exe()?;
    let profile = test.ancestors().nth(2).context("a test runs in target/<profile>/deps")?;
    let target = profile.parent().context("a profile folder lies in the target folder")?;
    let name = profile.file_name().unwrap_or_default().to_string_lossy().into_owned();
    Ok((target.to_owned(), name))
}
