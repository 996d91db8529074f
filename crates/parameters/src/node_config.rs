//! Parameters of the nodes themselves, beside those of the algorithms.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::ParameterError;

/// Reliability of image topics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Reliability {
    /// Lost images stay lost: right for live cameras. A subscriber with it hears publishers of either kind.
    #[default]
    BestEffort,
    /// Lost images are sent again: right for replay without loss.
    Reliable,
}

/// What happens to images that arrive faster than they are worked on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Queue {
    /// The newest image replaces the waiting one; drops are counted. Nor does a frame wait for a bundle adjustment that is late: what
    /// comes out depends on the machine's load.
    #[default]
    Newest,
    /// Every image waits for its turn: every run gives the same.
    All,
}

/// How depth images are sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum DepthEncoding {
    /// Metres as 32-bit floats: exact for every sequence.
    #[default]
    #[serde(rename = "32FC1")]
    Metres,
    /// Millimetres as 16-bit integers, as most cameras send: rounds the 0.2 mm steps of TUM sequences.
    #[serde(rename = "16UC1")]
    Millimetres,
}

/// Parameters of `segmentation_node`, `tracking_node` and `slam_node`.
#[allow(clippy::struct_excessive_bools)] // Parameters are named one by one, never passed as a row of arguments.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct NodeConfig {
    /// Take the time from `/clock` instead of the system.
    pub use_sim_time: bool,
    /// Networks to talk on: `auto` (what `ROS_AUTOMATIC_DISCOVERY_RANGE` or `ROS_LOCALHOST_ONLY` say, else loopback), `loopback`,
    /// `subnet` (all interfaces), or IPv4 addresses of interfaces separated by commas.
    pub network: String,
    /// Topic of the colour images. Names of topics are expanded and remapped like any other.
    pub rgb_topic: String,
    /// Topic of the depth images, which must be registered to the colour images.
    pub depth_topic: String,
    /// Topic of the colour camera's calibration.
    pub camera_info_topic: String,
    /// Whether the colour images are rectified (topics named `image_rect…`), and depth is registered to those: of camera_info the
    /// projection matrix counts then, without distortion.
    pub rectified: bool,
    /// Reliability with which images and camera_info are subscribed.
    pub qos: Reliability,
    /// Reliability with which `overlay` is published; some viewers ask for `reliable`.
    pub overlay_qos: Reliability,
    /// What happens to images that arrive faster than they are worked on. `all` together with `qos: reliable` loses nothing.
    pub queue: Queue,
    /// Largest difference between the stamps of a colour image and its depth image, seconds.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub sync_tolerance: f64,
    /// Subscribe colour as `sensor_msgs/CompressedImage` (JPEG or PNG) on the colour topic with `/compressed` appended.
    pub compressed_rgb: bool,
    /// Subscribe depth as `sensor_msgs/CompressedImage` (compressedDepth) on the depth topic with
    /// `/compressedDepth` appended.
    pub compressed_depth: bool,
    /// How long tracking waits for the mask of an image before it goes on without, seconds. No waiting while nobody publishes
    /// masks. With `queue: all`, which is to lose nothing, it waits for at least 10 s.
    #[schemars(range(min = 0.0, max = 60.0))]
    pub mask_timeout: f64,
    /// Whether to publish `/tf`; off when another node does.
    pub publish_tf: bool,
    /// Frame of the map, z up.
    pub map_frame: String,
    /// Frame of the odometry: continuous, drifts.
    pub odom_frame: String,
    /// Base frame of the robot; connected to the camera by `/tf_static`. Where it is not, the root of the tree that holds the camera
    /// stands in, and without one the camera's own frame.
    pub base_frame: String,
    /// How many of the last poses `path` carries.
    #[schemars(range(min = 1, max = 100_000))]
    pub path_length: u32,
    /// File that receives the trajectory (TUM format, camera in the world of the tracker) at shutdown; empty for none.
    pub trajectory_file: String,
    /// File that receives one CSV line a frame at shutdown; empty for none.
    pub frames_file: String,
    /// Folder that receives the masks as `<stamp>.png`; empty for none.
    pub mask_directory: String,
}

impl NodeConfig {
    /// Whether a frame is one that the nodes publish themselves.
    pub fn is_own_frame(&self, frame: &str) -> bool {
        [&self.map_frame, &self.odom_frame].into_iter().any(|own| own == frame)
    }

    /// Whether the frames make a tree: tf2 refuses every transform from a frame to itself, and every one without a name. For a base that
    /// is not there, and so for none, another frame stands in.
    ///
    /// # Errors
    /// [`ParameterError::Inconsistent`] that names the parameters.
    pub fn check_frames(&self) -> Result<(), ParameterError> {
        let frames =
            [("map_frame", &self.map_frame), ("odom_frame", &self.odom_frame), ("base_frame", &self.base_frame)];
        for (i, (name, frame)) in frames.iter().enumerate() {
            if frame.is_empty() && *name != "base_frame" {
                return Err(ParameterError::Inconsistent(format!("{name} is empty")));
            }
            if let Some((other, _)) = frames[..i].iter().find(|(_, earlier)| earlier == frame) {
                let reason = format!("{other} and {name} are both `{frame}`: each needs a name of its own");
                return Err(ParameterError::Inconsistent(reason));
            }
        }
        Ok(())
    }
}

impl Default for NodeConfig {
    fn default() -> Self {
        Self {
            use_sim_time: false,
            network: "auto".into(),
            rgb_topic: "rgb/image".into(),
            depth_topic: "depth/image".into(),
            camera_info_topic: "rgb/camera_info".into(),
            rectified: false,
            qos: Reliability::default(),
            overlay_qos: Reliability::default(),
            queue: Queue::default(),
            sync_tolerance: 0.02,
            compressed_rgb: false,
            compressed_depth: false,
            mask_timeout: 0.2,
            publish_tf: true,
            map_frame: "map".into(),
            odom_frame: "odom".into(),
            base_frame: "base_link".into(),
            path_length: 2000,
            trajectory_file: String::new(),
            frames_file: String::new(),
            mask_directory: String::new(),
        }
    }
}

/// Topics that say, by the stamps of their messages, that a frame has been worked on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Acknowledgement {
    /// The state where a tracker publishes it, otherwise the mask.
    #[default]
    Auto,
    /// `dynamic_mask`, of segmentation.
    DynamicMask,
    /// `tracking_state`, of tracking.
    TrackingState,
}

/// Parameters of `bag_replay_node`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ReplayConfig {
    /// Networks to talk on, as for the other nodes.
    pub network: String,
    /// The sequence: a folder in TUM layout or its `.tgz`.
    pub sequence: String,
    /// Speed: 1 is real time; 0 sends each frame when the last one has been worked on, so that nothing is lost.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub rate: f64,
    /// Begin again at the end.
    #[serde(rename = "loop")]
    pub repeat: bool,
    /// Where to begin, seconds after the first image.
    #[schemars(range(min = 0.0))]
    pub start: f64,
    /// How much to play, seconds; 0 for all.
    #[schemars(range(min = 0.0))]
    pub duration: f64,
    /// How depth is sent.
    pub depth_encoding: DepthEncoding,
    /// Stamp depth images with the stamp of their colour image, so that pairs are those of the association file; otherwise
    /// depth carries its own stamp.
    pub stamp_depth_as_rgb: bool,
    /// How many nodes must have subscribed to the colour image before the first frame is sent; 0 sends at once. With `rate` 0 at
    /// least one is waited for.
    #[schemars(range(min = 0, max = 64))]
    pub wait_for_subscribers: u32,
    /// How long to wait for them, seconds, before giving up with an error.
    #[schemars(range(min = 0.0, max = 3600.0))]
    pub wait_timeout: f64,
    /// With `rate` above 0: how many frames may be on their way before the replay waits for the nodes to catch up, so that a busy
    /// machine loses none; 0 never waits, as a camera does not.
    #[schemars(range(min = 0, max = 1000))]
    pub max_ahead: u32,
    /// How long to wait until a frame has been worked on, seconds, before it is sent again (`rate` 0) or given up (`max_ahead`).
    #[schemars(range(min = 0.01, max = 600.0))]
    pub acknowledge_timeout: f64,
    /// Topic whose messages, by their stamp, say that a frame has been worked on: `tracking_state`, `dynamic_mask`
    /// or `auto` (the state where a tracker publishes it, otherwise the mask).
    pub acknowledge_topic: Acknowledgement,
    /// Reliability with which images are published.
    pub qos: Reliability,
    /// Added to depth stamps before association, seconds.
    #[schemars(range(min = -1.0, max = 1.0))]
    pub depth_offset: f64,
    /// Frame of the colour camera (optical: z forward).
    pub camera_frame: String,
    /// Frame from which `/tf_static` leads to the camera.
    pub base_frame: String,
    /// Frame of the ground truth.
    pub ground_truth_frame: String,
}

impl Default for ReplayConfig {
    fn default() -> Self {
        Self {
            network: "auto".into(),
            sequence: String::new(),
            rate: 1.0,
            repeat: false,
            start: 0.0,
            duration: 0.0,
            depth_encoding: DepthEncoding::default(),
            stamp_depth_as_rgb: true,
            wait_for_subscribers: 1,
            wait_timeout: 60.0,
            max_ahead: 0,
            acknowledge_timeout: 10.0,
            acknowledge_topic: Acknowledgement::Auto,
            qos: Reliability::Reliable,
            depth_offset: 0.0,
            camera_frame: "camera_rgb_optical_frame".into(),
            base_frame: "camera_link".into(),
            ground_truth_frame: "world".into(),
        }
    }
}
