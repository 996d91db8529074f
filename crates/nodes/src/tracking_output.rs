//! Poses, transforms and the map, published.
//!
//! Frames: the tracker's world is the optical frame of the first camera. The map frame is upright (REP-103: x forward, y left,
//! z up): it is the robot's base at the start where `/tf_static` connects it to the camera, otherwise the first camera turned so
//! that its image is upright. REP-105: `map → odom` takes up the corrections, `odom → base` is continuous.
#![allow(non_snake_case)]

use std::time::{Duration, Instant};

use pfd_geometry::{Camera, Mask, Pose, Stamp};
use pfd_parameters::NodeConfig;
use pfd_ros::convert::map::{cloud, keyframe_markers};
use pfd_ros::convert::pose::{
    align_covariance, covariance_to_message, move_covariance, move_twist, pose_to_message, pose_to_transform, vector,
};
use pfd_ros::messages::geometry::{
    PoseStamped, PoseWithCovariance, TfMessage, TransformStamped, Twist, TwistWithCovariance,
};
use pfd_ros::messages::nav::{Odometry, Path};
use pfd_ros::messages::pfd::{StageTime, TrackingState as StateMessage};
use pfd_ros::messages::sensor::PointCloud2;
use pfd_ros::messages::standard::Header;
use pfd_ros::messages::visualization::MarkerArray;
use pfd_ros::{Node, Publisher, Qos, RosError, StaticTransforms, upright_map};
use pfd_tracking::{TrackedFrame, Tracker, TrackingState};

use crate::slam_processor::Outcome;

/// Messages kept of poses and states.
const DEPTH: i32 = 10;
/// Messages kept of `/tf`, as tf2 does.
const TF_DEPTH: i32 = 100;

/// `/tf` waits so long after the first frame for `/tf_static` to connect the base frame with the camera. Static transforms come with a
/// handshake, images without one. A stand-in for the base that is given up a moment later would leave a broken tree behind: whoever
/// heard that the camera hangs below `odom` has forgotten what `/tf_static` said of it.
const PATIENCE: Duration = Duration::from_secs(2);

/// Where the robot's base is on the camera, and the map's axes.
#[derive(Clone, Debug, Default)]
pub struct FrameNames {
    base: String,
    T_base_camera: Pose,
    /// Until when the base frame is waited for.
    deadline: Option<Instant>,
    /// Whether the base is no longer waited for: it is connected, or something stands in for it.
    is_settled: bool,
    /// Fixed once the base is settled.
    T_map_world: Option<Pose>,
    /// The last pose of the camera in the odometry frame.
    T_odom_camera: Option<Pose>,
    /// The last correction, which holds while the pose is not known.
    T_map_odom: Pose,
}

impl FrameNames {
    /// Looks the base up in the static transforms.
    pub fn update(&mut self, transforms: &StaticTransforms, camera_frame: &str, config: &NodeConfig, now: Instant) {
        let named = transforms.lookup(&config.base_frame, camera_frame).map(|pose| (config.base_frame.clone(), pose));
        let is_connected = named.is_some();
        let root = || transforms.root(camera_frame);
        // A frame has one parent: where the base has one already, `odom` leads to the top of what stands still with it.
        let above = transforms.root(&config.base_frame).filter(|(top, _)| is_connected && !config.is_own_frame(top));
        let top = above.and_then(|_| root());
        let (base, pose) = top.or(named).or_else(root).unwrap_or_else(|| (camera_frame.to_owned(), Pose::identity()));
        if self.is_settled && base != self.base {
            tracing::warn!("`odom` now leads to {base} and no longer to {}: restart what listens to /tf", self.base);
        }
        (self.base, self.T_base_camera) = (base, pose);
        let deadline = *self.deadline.get_or_insert(now + PATIENCE);
        if !self.is_settled && (is_connected || now >= deadline) {
            self.is_settled = true;
            if is_connected && self.base != config.base_frame {
                let (base, wanted) = (&self.base, &config.base_frame);
                tracing::info!("`odom` leads to {base}, to which /tf_static fixes {wanted} (parameter base_frame)");
            }
            if !is_connected {
                let wanted = &config.base_frame;
                tracing::warn!(
                    "/tf_static does not connect {wanted} (parameter base_frame) with {camera_frame}: {} stands in for it",
                    self.base
                );
            }
            let is_optical = self.base == camera_frame;
            self.T_map_world = Some(if is_optical { upright_map() } else { self.T_base_camera });
        }
    }

    /// What is known of the frames when time was set back and a new map begins.
    #[must_use]
    pub fn restarted(&self) -> Self {
        Self { deadline: self.deadline, ..Self::default() }
    }

    /// Tracker's world to map frame.
    fn T_map_world(&self) -> Pose {
        self.T_map_world.unwrap_or_else(upright_map)
    }
}

/// The publishers.
pub struct TrackingOutput {
    pose: Publisher<PoseStamped>,
    odometry: Publisher<Odometry>,
    path: Publisher<Path>,
    map_points: Publisher<PointCloud2>,
    keyframes: Publisher<MarkerArray>,
    state: Publisher<StateMessage>,
    tf: Publisher<TfMessage>,
}

impl TrackingOutput {
    /// Announces the topics.
    ///
    /// # Errors
    /// [`RosError`] when the middleware refuses.
    pub fn new(node: &mut Node) -> Result<Self, RosError> {
        Ok(Self {
            pose: node.publisher("pose", Qos::reliable(DEPTH))?,
            odometry: node.publisher("odometry", Qos::reliable(DEPTH))?,
            path: node.publisher("path", Qos::latched())?,
            map_points: node.publisher("map_points", Qos::latched())?,
            keyframes: node.publisher("keyframes", Qos::latched())?,
            state: node.publisher("tracking_state", Qos::reliable(DEPTH))?,
            tf: node.publisher("/tf", Qos::reliable(TF_DEPTH))?,
        })
    }

    /// `pose`, `odometry`, `/tf`. While the pose is not known `/tf` repeats the last transforms and the others are silent; while the base
    /// is waited for `/tf` is silent.
    pub fn publish_pose(&self, names: &mut FrameNames, tracked: &TrackedFrame, config: &NodeConfig) {
        let T_map_world = names.T_map_world();
        if let (Some(T_world_camera), Some(T_odom_camera)) = (tracked.T_world_camera, tracked.T_odom_camera) {
            let T_map_camera = T_map_world * T_world_camera;
            let T_odom_camera = T_map_world * T_odom_camera;
            names.T_map_odom = T_map_camera * T_odom_camera.inverse();
            let header = Header::new(tracked.stamp, &config.map_frame);
            self.pose.publish(PoseStamped { header, pose: pose_to_message(&T_map_camera) });
            let T_odom_base = T_odom_camera * names.T_base_camera.inverse();
            self.odometry.publish(odometry(names, tracked, &T_odom_base, config));
            names.T_odom_camera = Some(T_odom_camera);
        }
        let is_due = config.publish_tf && names.is_settled;
        if let Some(T_odom_camera) = names.T_odom_camera.filter(|_| is_due) {
            let T_odom_base = T_odom_camera * names.T_base_camera.inverse();
            self.tf.publish(transforms(names, tracked.stamp, &T_odom_base, config));
        }
    }

    /// `tracking_state`
    pub fn publish_state(&self, frame_id: &str, outcome: &Outcome, mask: Option<&Mask>) {
        let t = &outcome.tracked;
        let stages = t.timing.0.iter().map(|&(name, milliseconds)| StageTime { name: name.to_owned(), milliseconds });
        self.state.publish(StateMessage {
            header: Header::new(t.stamp, frame_id),
            state: state_code(t.state),
            features: t.features,
            inliers: t.inliers,
            keyframes: t.keyframes,
            map_points: t.map_points,
            is_keyframe: t.is_keyframe,
            mask_used: t.mask_used && mask.is_some(),
            mask_fraction: mask.map_or(0.0, |m| m.fraction() as f32),
            segmentation_ms: outcome.segmentation_ms(),
            tracking_ms: outcome.tracking_ms,
            stages: stages.collect(),
        });
    }

    /// `tracking_state` of a frame that could not be worked on.
    pub fn publish_failure(&self, frame_id: &str, stamp: Stamp) {
        let header = Header::new(stamp, frame_id);
        self.state.publish(StateMessage { header, state: StateMessage::LOST, ..StateMessage::default() });
    }

    /// `path`, `map_points`, `keyframes`
    pub fn publish_map(
        &self,
        names: &FrameNames,
        tracker: &Tracker,
        camera: &Camera,
        stamp: Stamp,
        config: &NodeConfig,
    ) {
        let T_map_world = names.T_map_world();
        let header = Header::new(stamp, &config.map_frame);
        let recent = tracker.recent_trajectory(config.path_length as usize);
        let poses = recent.iter().map(|p| PoseStamped {
            header: Header::new(p.stamp, &config.map_frame),
            pose: pose_to_message(&(T_map_world * p.pose)),
        });
        self.path.publish(Path { header: header.clone(), poses: poses.collect() });
        let points = tracker.map_points();
        let points = points.iter().map(|p| (T_map_world * p.position, p.color));
        self.map_points.publish(cloud(points, header.clone()));
        let keyframes: Vec<Pose> = tracker.keyframe_poses().iter().map(|k| T_map_world * k.pose).collect();
        self.keyframes.publish(keyframe_markers(&keyframes, camera, &header));
    }
}

fn state_code(state: TrackingState) -> u8 {
    match state {
        TrackingState::NotInitialized => StateMessage::NOT_INITIALIZED,
        TrackingState::Ok => StateMessage::OK,
        TrackingState::Lost => StateMessage::LOST,
        TrackingState::Relocalized => StateMessage::RELOCALIZED,
    }
}

fn odometry(names: &FrameNames, tracked: &TrackedFrame, T_odom_base: &Pose, config: &NodeConfig) -> Odometry {
    let of_base = move_covariance(&tracked.covariance, &names.T_base_camera);
    let twist = move_twist(&tracked.twist, &names.T_base_camera);
    let twist_covariance = move_covariance(&tracked.twist_covariance, &names.T_base_camera);
    let (linear, angular) = (twist.fixed_rows::<3>(0).into_owned(), twist.fixed_rows::<3>(3).into_owned());
    Odometry {
        header: Header::new(tracked.stamp, &config.odom_frame),
        child_frame_id: names.base.clone(),
        pose: PoseWithCovariance {
            pose: pose_to_message(T_odom_base),
            covariance: covariance_to_message(&align_covariance(&of_base, T_odom_base)),
        },
        twist: TwistWithCovariance {
            twist: Twist { linear: vector(&linear), angular: vector(&angular) },
            covariance: covariance_to_message(&twist_covariance),
        },
    }
}

fn transforms(names: &FrameNames, stamp: Stamp, T_odom_base: &Pose, config: &NodeConfig) -> TfMessage {
    let transform = |parent: &str, child: &str, pose: &Pose| TransformStamped {
        header: Header::new(stamp, parent),
        child_frame_id: child.to_owned(),
        transform: pose_to_transform(pose),
    };
    TfMessage {
        transforms: vec![
            transform(&config.map_frame, &config.odom_frame, &names.T_map_odom),
            transform(&config.odom_frame, &names.base, T_odom_base),
        ],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;

    #[test]
    fn the_base_is_the_named_frame_or_the_root_or_the_camera() {
        let (config, start) = (NodeConfig::default(), Instant::now());
        let mut tree = StaticTransforms::default();
        let mut names = FrameNames::default();
        names.update(&tree, "optical", &config, start);
        assert_eq!((names.base.as_str(), names.T_map_world(), names.is_settled), ("optical", upright_map(), false));
        tree.insert("camera_link", "optical", Pose::translation(0.1, 0.0, 0.0));
        names.update(&tree, "optical", &config, start);
        assert_eq!((names.base.as_str(), names.is_settled), ("camera_link", false), "base_link may still come");
        let mut late = names.clone();
        tree.insert("base_link", "camera_link", Pose::translation(1.0, 0.0, 0.0));
        names.update(&tree, "optical", &config, start);
        assert_eq!((names.base.as_str(), names.is_settled), ("base_link", true));
        assert!((names.T_base_camera.translation.x - 1.1).abs() < 1e-12);
        assert_eq!(names.T_map_world(), names.T_base_camera);
        late.update(&StaticTransforms::default(), "optical", &config, start + PATIENCE);
        assert_eq!((late.base.as_str(), late.is_settled), ("optical", true));
        late.update(&tree, "optical", &config, start + PATIENCE);
        assert_eq!(
            (late.base.as_str(), late.T_map_world()),
            ("base_link", upright_map()),
            "the map does not turn in use"
        );
    }

    #[test]
    fn a_base_that_has_a_parent_gets_no_second_one() {
        let base = |parent: &str| {
            let mut tree = StaticTransforms::default();
            tree.insert("base_link", "optical", Pose::translation(1.0, 0.0, 0.0));
            tree.insert(parent, "base_link", Pose::translation(0.0, 0.0, 0.2));
            let mut names = FrameNames::default();
            names.update(&tree, "optical", &NodeConfig::default(), Instant::now());
            assert!(names.is_settled);
            (names.base, names.T_base_camera.translation.vector.z)
        };
        assert_eq!(base("base_footprint"), ("base_footprint".to_owned(), 0.2));
        assert_eq!(base("map"), ("base_link".to_owned(), 0.0), "a frame of ours cannot hang below itself");
    }

    #[test]
    fn odometry_is_about_the_base() {
        let names = FrameNames { base: "base_link".into(), T_base_camera: upright_map(), ..FrameNames::default() };
        let tracked = TrackedFrame {
            stamp: Stamp::from_nanos(500_000_000),
            state: TrackingState::Ok,
            T_world_camera: None,
            T_odom_camera: None,
            is_apart: false,
            mask_used: false,
            covariance: nalgebra::Matrix6::from_diagonal(&Vector6::new(1.0, 2.0, 3.0, 0.1, 0.2, 0.3)),
            twist: Vector6::new(0.0, 0.0, 2.0, 0.0, 0.0, 0.0),
            twist_covariance: nalgebra::Matrix6::from_diagonal(&Vector6::new(4.0, 5.0, 6.0, 0.1, 0.2, 0.3)),
            features: 0,
            inliers: 0,
            keyframes: 0,
            map_points: 0,
            is_keyframe: false,
            timing: pfd_geometry::StageTimes::default(),
        };
        let message = odometry(&names, &tracked, &Pose::translation(1.0, 0.0, 0.0), &NodeConfig::default());
        // Forward is the camera's z.
        assert!((message.twist.twist.linear.x - 2.0).abs() < 1e-9);
        assert!((message.twist.covariance[0][0] - 6.0).abs() < 1e-9);
        assert!((message.pose.covariance[0][0] - 3.0).abs() < 1e-9);
        assert_eq!((message.header.frame_id.as_str(), message.child_frame_id.as_str()), ("odom", "base_link"));
    }
}
