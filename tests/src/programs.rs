//! The programs of the workspace, as a user starts them.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;

use anyhow::{Context, ensure};

use crate::repository;

/// Path of the binary `name` of `package`, built by cargo first (a no-op when it is up to date), with the profile and in the
/// target folder of the running test.
///
/// # Errors
/// When cargo fails.
pub fn binary(package: &str, name: &str) -> anyhow::Result<PathBuf> {
    // Tests run in parallel; one cargo at a time keeps its messages readable.
    static CARGO: Mutex<()> = Mutex::new(());
    let _one_at_a_time = CARGO.lock().map_err(|_| anyhow::anyhow!("another test failed to build {name}"))?;
    let (target, profile) = target_and_profile()?;
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    command.current_dir(repository()).args(["build", "--quiet", "--locked", "--package", package, "--bin", name]);
    command.arg("--target-dir").arg(&target);
    if profile == "release" {
        command.arg("--release");
    }
    let status = command.status().context("cargo cannot be started")?;
    ensure!(status.success(), "cargo failed to build {name}");
    Ok(target.join(profile).join(name))
}

/// The command line tool.
///
/// # Errors
/// When cargo fails to build it.
pub fn pfd_slam() -> anyhow::Result<Command> {
    binary("pfd-slam", "pfd-slam").map(Command::new)
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
