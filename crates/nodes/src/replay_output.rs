//! What the replay publishes.

use pfd_dataset::Sequence;
use pfd_geometry::{Camera, Stamp, StampedPose};
use pfd_parameters::{DepthEncoding, ReplayConfig};
use pfd_ros::convert::pose::{pose_to_message, pose_to_transform};
use pfd_ros::convert::{camera_to_info, depth_to_metres, depth_to_millimetres, rgb_to_image};
use pfd_ros::messages::geometry::{PoseStamped, TfMessage, TransformStamped};
use pfd_ros::messages::nav::Path;
use pfd_ros::messages::sensor::{CameraInfo, Image};
use pfd_ros::messages::standard::{Clock, Header};
use pfd_ros::{Graph, Node, Publisher, Qos, RosError, upright_map};

/// A frame as messages.
#[derive(Clone, Debug)]
pub struct Shot {
    /// Of the colour image.
    pub stamp: Stamp,
    rgb: Image,
    depth: Image,
    info: CameraInfo,
    ground_truth: Option<PoseStamped>,
}

impl Shot {
    /// Reads frame `i` of a sequence.
    ///
    /// # Errors
    /// When an image cannot be read.
    pub fn read(sequence: &Sequence, i: usize, camera: &Camera, config: &ReplayConfig) -> anyhow::Result<Self> {
        let frame = sequence.frame(i)?;
        let (stamp, id) = (frame.stamp(), config.camera_frame.as_str());
        let depth_stamp = sequence.pair(i).depth_stamp.offset_by(config.depth_offset);
        let depth_stamp = if config.stamp_depth_as_rgb { stamp } else { depth_stamp };
        let depth = match config.depth_encoding {
            DepthEncoding::Metres => depth_to_metres(frame.depth(), depth_stamp, id),
            DepthEncoding::Millimetres => depth_to_millimetres(frame.depth(), depth_stamp, id),
        };
        Ok(Self {
            stamp,
            rgb: rgb_to_image(frame.rgb(), stamp, id),
            depth,
            info: camera_to_info(camera, stamp, id),
            ground_truth: sequence.ground_truth().and_then(|poses| pose_at(poses, stamp, config)),
        })
    }
}

/// The recorded pose next to a stamp, if there is one near.
fn pose_at(poses: &[StampedPose], stamp: Stamp, config: &ReplayConfig) -> Option<PoseStamped> {
    /// Motion capture at 100 Hz has one within half of this, seconds.
    const MAX_DIFFERENCE: f64 = 0.02;
    let after = poses.partition_point(|p| p.stamp < stamp);
    let candidates = poses.get(after.saturating_sub(1)..(after + 1).min(poses.len()))?;
    let difference = |p: &StampedPose| p.stamp.seconds_since(stamp).abs();
    let nearest = candidates.iter().min_by(|a, b| difference(a).total_cmp(&difference(b)))?;
    (difference(nearest) <= MAX_DIFFERENCE).then(|| to_message(nearest, &config.ground_truth_frame))
}

fn to_message(pose: &StampedPose, frame: &str) -> PoseStamped {
    PoseStamped { header: Header::new(pose.stamp, frame), pose: pose_to_message(&pose.pose) }
}

/// The publishers.
pub struct ReplayOutput {
    rgb: Publisher<Image>,
    depth: Publisher<Image>,
    info: Publisher<CameraInfo>,
    clock: Publisher<Clock>,
    tf_static: Publisher<TfMessage>,
    ground_truth_pose: Publisher<PoseStamped>,
    ground_truth_path: Publisher<Path>,
    config: ReplayConfig,
    /// Who else is there.
    pub graph: Graph,
    /// Full name of the topic on which tracking says what it has worked on.
    pub state_topic: String,
    /// Full name of the topic on which segmentation says so.
    pub mask_topic: String,
}

impl ReplayOutput {
    /// Announces the topics.
    ///
    /// # Errors
    /// [`RosError`] when the middleware refuses.
    pub fn new(node: &mut Node, config: &ReplayConfig) -> Result<Self, RosError> {
        /// Small messages kept.
        const DEPTH: i32 = 10;
        let images = Qos::images(config.qos);
        Ok(Self {
            rgb: node.publisher("/camera/rgb/image_raw", images)?,
            depth: node.publisher("/camera/depth_registered/image_raw", images)?,
            info: node.publisher("/camera/rgb/camera_info", images)?,
            clock: node.publisher("/clock", Qos::reliable(DEPTH))?,
            tf_static: node.publisher("/tf_static", Qos::latched())?,
            ground_truth_pose: node.publisher("ground_truth/pose", Qos::reliable(DEPTH))?,
            ground_truth_path: node.publisher("ground_truth/path", Qos::latched())?,
            config: config.clone(),
            graph: node.graph().clone(),
            state_topic: node.names().resolve("tracking_state")?,
            mask_topic: node.names().resolve("dynamic_mask")?,
        })
    }

    /// Subscribers to colour, depth and camera_info, and publishers of what we wait for.
    pub fn connections(&self) -> [usize; 4] {
        let graph = [self.rgb.subscribers(), self.depth.subscribers(), self.info.subscribers()];
        let [rgb, depth, info] = graph;
        [rgb, depth, info, self.graph.publishers(&self.state_topic)]
    }

    /// What holds for the whole sequence: the camera's place on its base, and the recorded path.
    pub fn publish_fixed(&self, ground_truth: Option<&[StampedPose]>) {
        let transform = TransformStamped {
            header: Header::new(Stamp::default(), &self.config.base_frame),
            child_frame_id: self.config.camera_frame.clone(),
            transform: pose_to_transform(&upright_map()),
        };
        self.tf_static.publish(TfMessage { transforms: vec![transform] });
        let Some(poses) = ground_truth else { return };
        let frame = &self.config.ground_truth_frame;
        let header = Header::new(poses.first().map_or(Stamp::default(), |p| p.stamp), frame);
        self.ground_truth_path.publish(Path { header, poses: poses.iter().map(|p| to_message(p, frame)).collect() });
    }

    /// Publishes a frame; camera_info and time go first.
    pub fn publish(&self, shot: &Shot) {
        self.clock.publish(Clock { clock: shot.stamp.into() });
        self.info.publish(shot.info.clone());
        self.rgb.publish(shot.rgb.clone());
        self.depth.publish(shot.depth.clone());
        if let Some(pose) = &shot.ground_truth {
            self.ground_truth_pose.publish(pose.clone());
        }
    }
}
