//! `pfd-slam fetch`: sequences of the TUM RGB-D benchmark.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, ensure};
use pfd_dataset::{Sequence, archive};

use crate::arguments::FetchArguments;
use crate::output;

/// Where the benchmark's files are.
pub(crate) const BENCHMARK: &str = "https://cvg.cit.tum.de/rgbd/dataset";

/// What the names of the benchmark's files begin with.
const PREFIX: &str = "rgbd_dataset_";

pub(crate) fn run(arguments: &FetchArguments) -> anyhow::Result<()> {
    std::fs::create_dir_all(&arguments.out).with_context(|| arguments.out.display().to_string())?;
    for name in &arguments.names {
        let download = Download::new(name, arguments)?;
        if download.folder.exists() {
            output::note(&format!("{}: is already there", download.folder.display()));
        } else {
            download.fetch()?;
        }
        let sequence = Sequence::open(&download.folder)?;
        output::print(&format!("{}: {} frames\n", download.folder.display(), sequence.len()))?;
    }
    Ok(())
}

/// One sequence to be fetched.
struct Download {
    url: String,
    /// The part of the archive that has arrived; kept so that an interrupted download goes on.
    partial: PathBuf,
    /// The unpacked sequence.
    folder: PathBuf,
    out: PathBuf,
}

impl Download {
    fn new(name: &str, arguments: &FetchArguments) -> anyhow::Result<Self> {
        let name = full_name(name)?;
        let camera = name[PREFIX.len()..].split('_').next().unwrap_or_default().to_owned();
        Ok(Self {
            url: format!("{}/{camera}/{name}.tgz", arguments.base_url.trim_end_matches('/')),
            partial: arguments.out.join(format!("{name}.tgz.part")),
            folder: arguments.out.join(&name),
            out: arguments.out.clone(),
        })
    }

    fn fetch(&self) -> anyhow::Result<()> {
        let expected = self.size()?;
        let have = std::fs::metadata(&self.partial).map_or(0, |m| m.len());
        if have < expected {
            output::note(&format!("{}: {} MB", self.url, (expected - have) >> 20));
            curl(&["--continue-at", "-", "--output", &self.partial.to_string_lossy(), &self.url])?;
        }
        let have = std::fs::metadata(&self.partial).map_or(0, |m| m.len());
        ensure!(have == expected, "{}: {have} bytes arrived, {expected} expected", self.partial.display());
        self.unpack()
    }

    /// Size in bytes that the server states.
    fn size(&self) -> anyhow::Result<u64> {
        let header = curl(&["--head", &self.url])?;
        // After redirections the last answer counts.
        let length = header.lines().rev().find_map(|line| {
            let (name, value) = line.split_once(':')?;
            name.eq_ignore_ascii_case("content-length").then(|| value.trim().parse().ok())?
        });
        length.with_context(|| format!("{}: the server does not state the size", self.url))
    }

    /// Unpacks beside the target first, so that an interrupted unpacking leaves no half sequence.
    fn unpack(&self) -> anyhow::Result<()> {
        let staging = self.partial.with_extension("unpacking");
        let _ = std::fs::remove_dir_all(&staging);
        std::fs::create_dir_all(&staging).with_context(|| staging.display().to_string())?;
        archive::unpack(&self.partial, &staging, archive::Limits::default())?;
        let name = self.folder.file_name().unwrap_or_default();
        let inner = staging.join(name);
        let unpacked = if inner.is_dir() { inner } else { staging.clone() };
        std::fs::rename(&unpacked, &self.folder).with_context(|| self.folder.display().to_string())?;
        let _ = std::fs::remove_dir_all(&staging);
        std::fs::remove_file(&self.partial).with_context(|| self.out.display().to_string())
    }
}

/// `freiburg3_walking_xyz`, `fr3_walking_xyz`, `fr3/walking_xyz` and the full name are the same sequence.
fn full_name(name: &str) -> anyhow::Result<String> {
    let short = name.strip_prefix(PREFIX).unwrap_or(name).replace('/', "_");
    let short = short
        .strip_prefix("fr")
        .filter(|rest| rest.starts_with(|c: char| c.is_ascii_digit()))
        .map_or(short.clone(), |rest| format!("freiburg{rest}"));
    let is_plain = short.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    let known = ["freiburg1_", "freiburg2_", "freiburg3_"].iter().any(|camera| short.starts_with(camera));
    ensure!(is_plain && known, "`{name}` is not a sequence of the benchmark, such as freiburg3_walking_xyz");
    Ok(format!("{PREFIX}{short}"))
}

/// Runs curl, which brings TLS, proxies and resuming, and returns what it prints.
fn curl(arguments: &[&str]) -> anyhow::Result<String> {
    let url = Path::new(arguments.last().copied().unwrap_or_default()).display();
    let output = Command::new("curl")
        .args(["--fail", "--location", "--silent", "--show-error", "--retry", "3"])
        .args(arguments)
        .output()
        .context("curl cannot be started; install it (apt-get install curl)")?;
    ensure!(output.status.success(), "{url}: {}", String::from_utf8_lossy(&output.stderr).trim());
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_have_many_spellings() {
        for name in
            ["freiburg3_walking_xyz", "fr3_walking_xyz", "fr3/walking_xyz", "rgbd_dataset_freiburg3_walking_xyz"]
        {
            assert_eq!(full_name(name).unwrap(), "rgbd_dataset_freiburg3_walking_xyz");
        }
        for name in ["kitchen", "freiburg3_../x", "freiburg9_desk", "fr3_a;b"] {
            assert!(full_name(name).is_err(), "{name}");
        }
    }
}
