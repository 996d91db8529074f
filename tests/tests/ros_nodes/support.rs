//! Running nodes, each test in a DDS domain of its own, on loopback.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, ensure};

use pfd_tests::{programs, repository, skip};

/// A DDS domain for one test of this process: tests run in parallel, and others may run on the machine.
pub(crate) fn domain(test: u32) -> String {
    /// Ports of domains beyond it do not fit into 16 bits.
    const DOMAINS: u32 = 232;
    /// Low domains are those that people use.
    const FIRST: u32 = 20;
    (FIRST + (std::process::id() * 8 + test) % (DOMAINS - FIRST)).to_string()
}

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
    pub(crate) fn start(name: &str, domain: &str, folder: &Path, args: &[&str]) -> anyhow::Result<Self> {
        let log = folder.join(format!("{name}.log"));
        let output = std::fs::File::create(&log)?;
        let child = Command::new(programs::binary(name)?)
            .arg("--ros-args")
            .args(args)
            .env("ROS_DOMAIN_ID", domain)
            .env_remove("ROS_AUTOMATIC_DISCOVERY_RANGE")
            .env_remove("ROS_LOCALHOST_ONLY")
            .stdin(Stdio::null())
            .stderr(output)
            .spawn()?;
        Ok(Self { child, log })
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

    /// Suspends it and lets it go on until the log has a text. Once may not do: a suspension harms the middleware only while one of
    /// its threads waits in the kernel.
    ///
    /// # Errors
    /// When the text has not come in time or the process is gone.
    pub(crate) fn suspend_until(&self, text: &str, timeout: Duration) -> anyhow::Result<()> {
        /// More than the time in which the node looks after its middleware.
        const NOTICE: Duration = Duration::from_secs(5);
        let deadline = Instant::now() + timeout;
        loop {
            self.signal("STOP")?;
            self.signal("CONT")?;
            match self.wait_for(text, NOTICE) {
                Err(error) if Instant::now() >= deadline => return Err(error),
                Err(_) => {}
                Ok(()) => return Ok(()),
            }
        }
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
        let deadline = Instant::now() + timeout;
        while !self.log().contains(text) {
            ensure!(Instant::now() < deadline, "no `{text}` after {timeout:?} in: {}", self.log());
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

/// The Python of a ROS 2 or DDS installation for tests, made by `tests/python/ros_install_peers.sh`: below `$PFD_PEERS`, else
/// below `target/peers`.
pub(crate) fn peer_python(peer: &str) -> Option<PathBuf> {
    let root = std::env::var_os("PFD_PEERS").map_or_else(|| repository().join("target/peers"), PathBuf::from);
    let python = root.join(peer).join("bin/python");
    if !python.exists() {
        skip(&format!("no peer {} (tests/python/ros_install_peers.sh makes it)", python.display()));
        return None;
    }
    Some(python)
}

/// Runs a peer's script and reads the JSON that it prints.
///
/// # Errors
/// When it fails or prints something else.
pub(crate) fn run_peer(python: &Path, script: &str, domain: &str, args: &[&str]) -> anyhow::Result<serde_json::Value> {
    let scripts = repository().join("tests/python");
    let profile = scripts.join("ros_fastdds.xml");
    let output = Command::new(python)
        .arg(scripts.join(script))
        .args(args)
        .env("ROS_DOMAIN_ID", domain)
        .envs([("ROS_DISTRO", "jazzy"), ("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")])
        .env("FASTDDS_DEFAULT_PROFILES_FILE", &profile)
        .env("FASTRTPS_DEFAULT_PROFILES_FILE", &profile)
        .output()?;
    let text = String::from_utf8_lossy(&output.stdout);
    let line = text.lines().last().with_context(|| String::from_utf8_lossy(&output.stderr).into_owned())?;
    serde_json::from_str(line).with_context(|| format!("{text}\n{}", String::from_utf8_lossy(&output.stderr)))
}
