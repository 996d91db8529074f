//! Running nodes, each test in a DDS domain of its own, on loopback.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, ensure};

use pfd_tests::domain::Domain;
use pfd_tests::{bundled_sequence, programs, repository, skip};

/// How long anything may take on a machine that is busy with other things.
pub(crate) const PATIENCE: Duration = Duration::from_secs(180);

/// A node that is stopped when it is dropped.
pub(crate) struct Node {
    child: Child,
    log: PathBuf,
}

impl Node {
    /// Starts a node with arguments after `--ros-args`; its log goes to `<folder>/<name>.log`.
    ///
    /// # Errors
    /// When it cannot be built or started.
    pub(crate) fn start(name: &str, domain: &Domain, folder: &Path, args: &[&str]) -> anyhow::Result<Self> {
        let mut command = Command::new(programs::binary(name)?);
        command.arg("--ros-args").args(args);
        Self::spawn(command, domain, &folder.join(format!("{name}.log")))
    }

    /// Starts a script of `tests/python` with a peer's Python; what it prints goes to `<folder>/<script>.log`.
    ///
    /// # Errors
    /// When it cannot be started.
    pub(crate) fn script(python: &Path, script: &str, domain: &Domain, folder: &Path) -> anyhow::Result<Self> {
        let mut command = Command::new(python);
        command.arg(repository().join("tests/python").join(script));
        Self::spawn(command, domain, &folder.join(format!("{script}.log")))
    }

    fn spawn(mut command: Command, domain: &Domain, log: &Path) -> anyhow::Result<Self> {
        let output = std::fs::File::create(log)?;
        let child = command
            .env("ROS_DOMAIN_ID", domain.to_string())
            .env_remove("ROS_AUTOMATIC_DISCOVERY_RANGE")
            .env_remove("ROS_LOCALHOST_ONLY")
            .stdin(Stdio::null())
            .stdout(output.try_clone()?)
            .stderr(output)
            .spawn()?;
        Ok(Self { child, log: log.to_owned() })
    }

    /// The most memory that it had in use, bytes.
    ///
    /// # Errors
    /// When the process is gone.
    pub(crate) fn peak_memory(&self) -> anyhow::Result<u64> {
        let path = format!("/proc/{}/status", self.child.id());
        let status = std::fs::read_to_string(&path).with_context(|| path.clone())?;
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).context("no VmHWM")?;
        let kilobytes: u64 = line.trim().trim_end_matches(" kB").parse().with_context(|| line.to_owned())?;
        Ok(kilobytes * 1024)
    }

    /// Sends a signal, such as `INT`.
    ///
    /// # Errors
    /// When the process is gone.
    pub(crate) fn signal(&self, signal: &str) -> anyhow::Result<()> {
        let status = Command::new("kill").args([&format!("-{signal}"), &self.child.id().to_string()]).status()?;
        ensure!(status.success(), "kill -{signal} failed: {}", self.log());
        Ok(())
    }

    /// Waits for the end of the process.
    ///
    /// # Errors
    /// When it does not end in time.
    pub(crate) fn wait(&mut self, timeout: Duration) -> anyhow::Result<ExitStatus> {
        let deadline = Instant::now() + timeout;
        loop {
            if let Some(status) = self.child.try_wait()? {
                return Ok(status);
            }
            ensure!(Instant::now() < deadline, "still running after {timeout:?}: {}", self.log());
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Stops it with a signal and checks that it ends with status 0.
    ///
    /// # Errors
    /// When it does not.
    pub(crate) fn stop(&mut self, signal: &str) -> anyhow::Result<()> {
        /// What waits in queues is worked off first.
        const PATIENCE: Duration = Duration::from_secs(60);
        self.signal(signal)?;
        let status = self.wait(PATIENCE)?;
        ensure!(status.success(), "{status} on SIG{signal}: {}", self.log());
        Ok(())
    }

    /// What it said so far.
    pub(crate) fn log(&self) -> String {
        std::fs::read_to_string(&self.log).unwrap_or_default()
    }

    /// Waits until the log has a text.
    ///
    /// # Errors
    /// When it has not in time.
    pub(crate) fn wait_for(&self, text: &str, timeout: Duration) -> anyhow::Result<()> {
        self.wait_for_times(text, 1, timeout)
    }

    /// How often the log has a text.
    pub(crate) fn count(&self, text: &str) -> usize {
        self.log().matches(text).count()
    }

    /// Waits until the log has a text so many times.
    ///
    /// # Errors
    /// When it has not in time.
    pub(crate) fn wait_for_times(&self, text: &str, times: usize, timeout: Duration) -> anyhow::Result<()> {
        let deadline = Instant::now() + timeout;
        while self.count(text) < times {
            ensure!(Instant::now() < deadline, "`{text}` not {times} times after {timeout:?} in: {}", self.log());
            std::thread::sleep(Duration::from_millis(20));
        }
        Ok(())
    }
}

impl Drop for Node {
    fn drop(&mut self) {
        // An error means that it has ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

pub(crate) fn parameters() -> String {
    repository().join("config/replay.yaml").display().to_string()
}

/// Replays the first seconds of the bundled sequence, lossless.
pub(crate) fn replay(domain: &Domain, folder: &Path, subscribers: u32, more: &[&str]) -> Node {
    let sequence = format!("sequence:={}", bundled_sequence().display());
    let wait = format!("wait_for_subscribers:={subscribers}");
    let file = parameters();
    let mut args = vec!["--params-file", &file, "-p", &sequence, "-p", "rate:=0.0", "-p", &wait];
    args.extend(more);
    Node::start("bag_replay_node", domain, folder, &args).unwrap()
}

pub(crate) fn slam(name: &str, domain: &Domain, folder: &Path) -> Node {
    slam_in_mode("pfd", name, domain, folder)
}

pub(crate) fn slam_in_mode(mode: &str, name: &str, domain: &Domain, folder: &Path) -> Node {
    let trajectory = format!("trajectory_file:={}", folder.join("trajectory.txt").display());
    let frames = format!("frames_file:={}", folder.join(format!("{name}.csv")).display());
    let mode = format!("mode:={mode}");
    let args = ["--params-file", &parameters(), "-p", &trajectory, "-p", &frames, "-p", &mode];
    Node::start(name, domain, folder, &args).unwrap()
}

/// Where the peers of the tests are: `$PFD_PEERS`, else `target/peers`.
fn peers() -> PathBuf {
    std::env::var_os("PFD_PEERS").map_or_else(|| repository().join("target/peers"), PathBuf::from)
}

/// The Python of a ROS 2 or DDS installation for tests, made by `tests/python/ros_install_peers.sh`.
pub(crate) fn peer_python(peer: &str) -> Option<PathBuf> {
    let python = peers().join(peer).join("bin/python");
    if !python.exists() {
        skip(&format!("no peer {} (tests/python/ros_install_peers.sh makes it)", python.display()));
        return None;
    }
    Some(python)
}

/// Environment in which rclpy finds `pfd_slam_msgs`, made by `tests/python/ros_build_msgs.sh`.
pub(crate) fn own_messages() -> Option<Vec<(&'static str, PathBuf)>> {
    let prefix = peers().join("pfd_slam_msgs");
    let packages = std::fs::read_dir(prefix.join("lib")).into_iter().flatten().flatten();
    let Some(python) = packages.map(|e| e.path().join("site-packages")).find(|path| path.exists()) else {
        skip(&format!("no {} (tests/python/ros_build_msgs.sh makes it)", prefix.display()));
        return None;
    };
    Some(vec![("LD_LIBRARY_PATH", prefix.join("lib")), ("AMENT_PREFIX_PATH", prefix), ("PYTHONPATH", python)])
}

/// Runs a peer's script and reads the JSON that it prints.
///
/// # Errors
/// When it fails or prints something else.
pub(crate) fn run_peer(
    python: &Path,
    script: &str,
    domain: &Domain,
    args: &[&str],
    environment: &[(&str, PathBuf)],
) -> anyhow::Result<serde_json::Value> {
    let scripts = repository().join("tests/python");
    let profile = scripts.join("ros_fastdds.xml");
    let output = Command::new(python)
        .arg(scripts.join(script))
        .args(args)
        .env("ROS_DOMAIN_ID", domain.to_string())
        .envs([("ROS_DISTRO", "jazzy"), ("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")])
        .env("FASTDDS_DEFAULT_PROFILES_FILE", &profile)
        .env("FASTRTPS_DEFAULT_PROFILES_FILE", &profile)
        .envs(environment.iter().map(|(name, value)| (name, value)))
        .output()?;
    let text = String::from_utf8_lossy(&output.stdout);
    let line = text.lines().last().with_context(|| String::from_utf8_lossy(&output.stderr).into_owned())?;
    serde_json::from_str(line).with_context(|| format!("{text}\n{}", String::from_utf8_lossy(&output.stderr)))
}
