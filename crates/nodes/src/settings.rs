//! Parameters of a node: files, command line, services.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use pfd_geometry::{Camera, Stamp};
use pfd_parameters::{NodeConfig, NodeName, ParameterError, ParameterTree, ReplayConfig, Value, describe, values};
use pfd_pipeline::SlamConfig;
use pfd_ros::{Arguments, Clock, Names, ParameterServer, ParameterServerOptions};

/// Everything a node was told at its start.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Of the algorithms.
    pub slam: SlamConfig,
    /// Of the node.
    pub node: NodeConfig,
    /// Of the replay.
    pub replay: ReplayConfig,
}

impl Settings {
    /// Reads files and overrides; keys that no node knows are an error.
    ///
    /// # Errors
    /// [`ParameterError`] that names file and key.
    pub fn read(args: &Arguments, names: &Names) -> Result<Self, ParameterError> {
        let files: Vec<&Path> = args.parameter_files.iter().map(AsRef::as_ref).collect();
        let is_mine = |node: &Option<String>| node.as_deref().is_none_or(|n| n == names.node().base());
        let mine = args.parameters.iter().filter(|p| is_mine(&p.node));
        let overrides: Vec<(String, Value)> = mine.map(|p| (p.name.clone(), p.value.clone())).collect();
        Self::from_tree(&files, names.node(), &overrides)
    }

    fn from_tree(files: &[&Path], node: &NodeName, overrides: &[(String, Value)]) -> Result<Self, ParameterError> {
        let mut tree = ParameterTree::read(files, node, overrides)?;
        let mut shared = tree.clone();
        let slam = tree.take()?;
        let node: NodeConfig = tree.take()?;
        node.check_frames()?;
        // `qos` and `network` are parameters of both kinds of nodes.
        tree.check::<ReplayConfig>()?;
        tree.finish()?;
        shared.check::<SlamConfig>()?;
        Ok(Self { slam, node, replay: shared.take()? })
    }

    /// The camera by the parameters, if they describe one.
    ///
    /// # Errors
    /// When the numbers are not those of a camera.
    pub fn camera(&self) -> anyhow::Result<Option<Camera>> {
        self.slam
            .camera
            .as_ref()
            .map(|c| c.to_camera().map_err(|e| anyhow::anyhow!("parameter `camera`: {e}")))
            .transpose()
    }
}

/// A step back by more than this (seconds) is no reordering: a new recording, a bag that loops.
const SET_BACK: f64 = 1.0;

/// Whether time was set back between two frames.
pub fn is_set_back(last: Stamp, now: Stamp) -> bool {
    last.seconds_since(now) > SET_BACK
}

/// Parameters of `tracking_node` that take effect while the node runs.
pub fn is_changeable_in_tracking(name: &str) -> bool {
    ["mode", "mask_timeout", "publish_tf", "path_length", "use_sim_time"].contains(&name)
}

/// Parameters of `slam_node` that take effect while the node runs.
pub fn is_changeable_in_slam(name: &str) -> bool {
    is_changeable_in_tracking(name) || is_changeable_in_segmentation(name)
}

/// Parameters of `segmentation_node` that take effect while the node runs.
pub fn is_changeable_in_segmentation(name: &str) -> bool {
    ["mode", "use_sim_time"].contains(&name) || name.starts_with("segmentation.")
}

/// The configuration as it is now; clones share it.
#[derive(Clone, Debug)]
pub struct LiveSettings {
    shared: Arc<Mutex<Settings>>,
}

impl LiveSettings {
    /// Starts with what was read.
    pub fn new(settings: Settings) -> Self {
        Self { shared: Arc::new(Mutex::new(settings)) }
    }

    /// The settings now.
    pub fn get(&self) -> Settings {
        self.shared.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The parameter services over these settings; `changeable` says which take effect while the node runs.
    pub fn server(&self, clock: Clock, changeable: fn(&str) -> bool) -> ParameterServer {
        let settings = self.get();
        let live = self.clone();
        let mut descriptions = describe::<SlamConfig>();
        descriptions.extend(describe::<NodeConfig>());
        let mut all = values(&settings.slam);
        all.extend(values(&settings.node));
        ParameterServer::new(ParameterServerOptions {
            descriptions,
            values: all,
            changeable,
            apply: Box::new(move |values| live.apply(values, &clock)),
        })
    }

    fn apply(&self, values: &BTreeMap<String, Value>, clock: &Clock) -> Result<(), String> {
        let set = values.iter().filter(|(_, value)| !value.is_null());
        let overrides: Vec<(String, Value)> = set.map(|(name, value)| (name.clone(), value.clone())).collect();
        let name = NodeName::new("/", "node").map_err(|e| e.to_string())?;
        let new = Settings::from_tree(&[], &name, &overrides).map_err(|e| format!("{:#}", anyhow::Error::from(e)))?;
        new.slam.segmentation.check().map_err(|e| e.to_string())?;
        clock.set_simulated(new.node.use_sim_time);
        let mut shared = self.shared.lock().unwrap_or_else(PoisonError::into_inner);
        *shared = Settings { replay: shared.replay.clone(), ..new };
        Ok(())
    }
}

/// The parameter services of the replay node, all of whose parameters are fixed at its start.
pub fn replay_server(settings: &Settings) -> ParameterServer {
    let is_shared = |name: &str| name == "use_sim_time" || name.starts_with("camera");
    let shared = [describe::<SlamConfig>(), describe::<NodeConfig>()].into_iter().flatten();
    let shared_values = [values(&settings.slam), values(&settings.node)].into_iter().flatten();
    ParameterServer::new(ParameterServerOptions {
        descriptions: shared.filter(|d| is_shared(&d.name)).chain(describe::<ReplayConfig>()).collect(),
        values: shared_values.filter(|(name, _)| is_shared(name)).chain(values(&settings.replay)).collect(),
        changeable: |_| false,
        apply: Box::new(|_| Ok(())),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use pfd_parameters::Reliability;

    fn settings(line: &str) -> Result<Settings, ParameterError> {
        let args = Arguments::parse(line.split_whitespace().map(str::to_owned)).unwrap();
        let names = Names::new(&args, "tracking_node").unwrap();
        Settings::read(&args, &names)
    }

    #[test]
    fn shared_names_reach_both_kinds_of_nodes() {
        let read = settings("--ros-args -p qos:=best_effort -p rate:=0 -p mask_timeout:=1 -p other:seed:=5").unwrap();
        assert_eq!((read.node.qos, read.replay.qos), (Reliability::BestEffort, Reliability::BestEffort));
        assert!(read.replay.rate.abs() < 1e-12 && (read.node.mask_timeout - 1.0).abs() < 1e-12);
        assert_eq!(read.slam.seed, SlamConfig::default().seed);
        assert!(settings("--ros-args -p nonsense:=1").is_err());
        let twice = settings("--ros-args -p odom_frame:=map").unwrap_err().to_string();
        assert!(twice.contains("map_frame and odom_frame are both `map`"), "{twice}");
        let nameless = settings("--ros-args -p odom_frame:=''").unwrap_err().to_string();
        assert!(nameless.contains("odom_frame is empty"), "{nameless}");
        assert!(settings("--ros-args -p base_frame:=''").is_ok());
    }

    #[test]
    fn changes_take_effect_or_are_refused() {
        let live = LiveSettings::new(settings("").unwrap());
        let clock = Clock::new(false);
        let mut all: BTreeMap<String, Value> = values(&live.get().slam).into_iter().collect();
        all.extend(values(&live.get().node));
        all.insert("use_sim_time".into(), true.into());
        live.apply(&all, &clock).unwrap();
        assert!(clock.is_simulated() && live.get().node.use_sim_time);
        let before = live.get();
        all.insert("mask_timeout".into(), (-1).into());
        assert!(live.apply(&all, &clock).is_err());
        assert_eq!(live.get(), before);
    }
}
