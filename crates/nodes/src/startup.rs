//! What every node that works on a camera's frames begins with.

use std::sync::Arc;

use pfd_parameters::NodeConfig;
use pfd_ros::{Arguments, Clock, Names, ParameterServer, Setup};
use tokio::sync::Notify;

use crate::camera_input::CameraInput;
use crate::recorder::Recorder;
use crate::settings::{LiveSettings, Settings};
use crate::worker::Health;

/// One frame waits where a newer one is worth more.
pub const NEWEST: usize = 1;

/// The parts that do not depend on what the node does with the frames.
pub struct Startup {
    /// Parameters of the node, as they were at the start.
    pub config: NodeConfig,
    /// How to join the network.
    pub setup: Setup,
    /// Where frames come in.
    pub input: Arc<CameraInput>,
    /// The parameters as they are.
    pub settings: LiveSettings,
    /// The parameter services.
    pub parameters: ParameterServer,
    /// Ends the node.
    pub ended: Arc<Notify>,
}

impl Startup {
    /// Reads the parameters; `changeable` says which parameters take effect while the node runs, `waiting` how many frames of a
    /// live camera may wait.
    ///
    /// # Errors
    /// When parameters, or environment are at fault.
    pub fn new(args: &Arguments, names: Names, changeable: fn(&str) -> bool, waiting: usize) -> anyhow::Result<Self> {
        let settings = Settings::read(args, &names)?;
        let config = settings.node.clone();
        let setup = Setup::new(args, names, &config.network, config.use_sim_time)?;
        let input = CameraInput::new(&config, settings.camera()?, waiting);
        let settings = LiveSettings::new(settings);
        let parameters = settings.server(setup.clock.clone(), changeable);
        Ok(Self { config, setup, input, settings, parameters, ended: Arc::new(Notify::new()) })
    }

    /// The files that the parameters ask for.
    ///
    /// # Errors
    /// When one cannot be made.
    pub fn recorder(&self) -> anyhow::Result<Recorder> {
        Recorder::new(&self.config.frames_file, &self.config.mask_directory)
    }

    /// What a worker needs beside its work.
    pub fn tools(&self, health: &Health) -> (Health, Clock, Arc<Notify>) {
        (health.clone(), self.setup.clock.clone(), self.ended.clone())
    }
}
