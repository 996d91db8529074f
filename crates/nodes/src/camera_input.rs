//! The camera as the nodes see it: colour and depth paired by stamp, with the camera's calibration.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use pfd_geometry::{Camera, DepthImage, FrameError, RgbImage, RgbdFrame, Stamp};
use pfd_parameters::{NodeConfig, Queue};
use pfd_ros::convert::{
    ConvertError, camera_from_info, depth_from_compressed, depth_from_image, rgb_from_compressed, rgb_from_image,
};
use pfd_ros::messages::diagnostic::DiagnosticStatus;
use pfd_ros::messages::sensor::{CameraInfo, CompressedImage, Image};
use pfd_ros::messages::standard::Header;
use pfd_ros::{Graph, Node, Qos, RosError, Slot, SyncCounters, Synchronizer, Throttle, TopicStatistics};

use crate::camera_health;

/// Pairs that wait for the first camera_info when nothing is to be dropped.
const MAX_PENDING: usize = 64;

/// A colour image as received.
#[derive(Clone, Debug)]
pub enum ColourMessage {
    /// `sensor_msgs/Image`
    Raw(Image),
    /// `sensor_msgs/CompressedImage`
    Compressed(CompressedImage),
}

/// A depth image as received.
#[derive(Clone, Debug)]
pub enum DepthMessage {
    /// `sensor_msgs/Image`
    Raw(Image),
    /// `sensor_msgs/CompressedImage`
    Compressed(CompressedImage),
}

impl ColourMessage {
    fn header(&self) -> &Header {
        match self {
            Self::Raw(image) => &image.header,
            Self::Compressed(image) => &image.header,
        }
    }

    fn decode(&self) -> Result<RgbImage, ConvertError> {
        match self {
            Self::Raw(image) => rgb_from_image(image),
            Self::Compressed(image) => rgb_from_compressed(image),
        }
    }
}

impl DepthMessage {
    fn header(&self) -> &Header {
        match self {
            Self::Raw(image) => &image.header,
            Self::Compressed(image) => &image.header,
        }
    }

    fn decode(&self) -> Result<DepthImage, ConvertError> {
        match self {
            Self::Raw(image) => depth_from_image(image),
            Self::Compressed(image) => depth_from_compressed(image),
        }
    }
}

/// A pair of messages on its way to the worker.
#[derive(Clone, Debug)]
pub struct RawFrame {
    colour: ColourMessage,
    depth: DepthMessage,
    /// When the second of the two arrived, or the camera became known.
    pub received: Instant,
    /// The camera that took it.
    pub camera: Camera,
}

/// A pair of messages that is no frame.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// The colour message cannot be used.
    #[error("colour image: {0}")]
    Colour(ConvertError),
    /// The depth message cannot be used.
    #[error("depth image: {0}")]
    Depth(ConvertError),
    /// The images do not belong together, or not to the camera.
    #[error(transparent)]
    Frame(#[from] FrameError),
}

impl RawFrame {
    /// Stamp of the colour image.
    pub fn stamp(&self) -> Stamp {
        self.colour.header().stamp.into()
    }

    /// Frame of the colour image.
    pub fn frame_id(&self) -> &str {
        &self.colour.header().frame_id
    }

    /// The images, checked against each other and the camera.
    ///
    /// # Errors
    /// [`DecodeError`] that says which image is at fault.
    pub fn decode(&self) -> Result<RgbdFrame, DecodeError> {
        let rgb = self.colour.decode().map_err(DecodeError::Colour)?;
        let depth = self.depth.decode().map_err(DecodeError::Depth)?;
        let frame = RgbdFrame::new(self.stamp(), rgb, depth)?;
        frame.check_camera(&self.camera)?;
        Ok(frame)
    }
}

/// Hands out the frames of an input until it is closed.
pub fn frames(input: &Arc<CameraInput>) -> impl FnMut() -> Option<RawFrame> + Send + 'static {
    let input = input.clone();
    move || input.slot.take()
}

/// Receives and pairs the camera's messages.
pub struct CameraInput {
    state: Mutex<State>,
    /// Frames for the worker.
    pub slot: Slot<RawFrame>,
    config: NodeConfig,
    /// Calibration from the parameters; camera_info is not needed then.
    fixed_camera: Option<Camera>,
}

struct State {
    synchronizer: Synchronizer<ColourMessage, DepthMessage>,
    camera: Option<Camera>,
    pending: VecDeque<(ColourMessage, DepthMessage)>,
    pending_dropped: u64,
    /// Frames of colour and depth of the last pair, if they were not the same.
    frames: Option<[String; 2]>,
    /// Counters and drops at the last look of the diagnostics.
    last_look: (SyncCounters, u64),
    statistics: Vec<TopicStatistics>,
    graph: Option<Graph>,
    complaints: Throttle,
}

impl State {
    /// Says so once where depth is in another frame than colour: only its size tells otherwise whether it is registered.
    fn note_frames(&mut self, colour: &Header, depth: &Header) {
        let frames = [colour, depth].map(|header| header.frame_id.clone());
        let differ = frames[0] != frames[1];
        if differ && self.frames.is_none() {
            tracing::warn!("{}", camera_health::other_frames(&frames));
        }
        self.frames = differ.then_some(frames);
    }
}

impl CameraInput {
    /// An input that is not connected yet. Unless all frames are to be kept, the `newest` wait.
    pub fn new(config: &NodeConfig, fixed_camera: Option<Camera>, newest: usize) -> Arc<Self> {
        let state = State {
            synchronizer: Synchronizer::new(config.sync_tolerance),
            camera: fixed_camera,
            pending: VecDeque::new(),
            pending_dropped: 0,
            frames: None,
            last_look: Default::default(),
            statistics: Vec::new(),
            graph: None,
            complaints: Throttle::default(),
        };
        let slot = Slot::new(config.queue, newest);
        Arc::new(Self { state: Mutex::new(state), slot, config: config.clone(), fixed_camera })
    }

    /// Subscribes colour, depth and camera_info.
    ///
    /// # Errors
    /// [`RosError`] when the middleware refuses.
    pub fn attach(self: &Arc<Self>, node: &mut Node) -> Result<(), RosError> {
        let (config, qos) = (&self.config, Qos::images(self.config.qos));
        let input = self.clone();
        let colour = if config.compressed_rgb {
            let topic = format!("{}/compressed", config.rgb_topic);
            node.subscribe(&topic, qos, move |m| input.add_colour(ColourMessage::Compressed(m)))?
        } else {
            node.subscribe(&config.rgb_topic, qos, move |m| input.add_colour(ColourMessage::Raw(m)))?
        };
        let input = self.clone();
        let depth = if config.compressed_depth {
            let topic = format!("{}/compressedDepth", config.depth_topic);
            node.subscribe(&topic, qos, move |m| input.add_depth(DepthMessage::Compressed(m)))?
        } else {
            node.subscribe(&config.depth_topic, qos, move |m| input.add_depth(DepthMessage::Raw(m)))?
        };
        let input = self.clone();
        let info = node.subscribe(&config.camera_info_topic, qos, move |m| input.set_camera(&m))?;
        tracing::info!("camera: {}, {}, {}", colour.topic(), depth.topic(), info.topic());
        let mut state = self.lock();
        state.statistics = vec![colour, depth, info];
        state.graph = Some(node.graph().clone());
        Ok(())
    }

    fn add_colour(&self, message: ColourMessage) {
        let mut state = self.lock();
        let pairs = state.synchronizer.add_first(message.header().stamp.into(), message);
        self.hand_over(&mut state, pairs);
    }

    fn add_depth(&self, message: DepthMessage) {
        let mut state = self.lock();
        let pairs = state.synchronizer.add_second(message.header().stamp.into(), message);
        self.hand_over(&mut state, pairs);
    }

    fn set_camera(&self, info: &CameraInfo) {
        if self.fixed_camera.is_some() {
            return;
        }
        let mut state = self.lock();
        match camera_from_info(info, self.config.rectified) {
            Ok(camera) => {
                state.camera = Some(camera);
                self.hand_over(&mut state, Vec::new());
            }
            Err(error) => {
                if let Some(more) = state.complaints.pass() {
                    tracing::error!("{error}; set parameter `camera` to go without ({more} more like it)");
                }
            }
        }
    }

    /// Hands pairs to the worker, or keeps them until the camera is known.
    fn hand_over(&self, state: &mut State, pairs: Vec<(ColourMessage, DepthMessage)>) {
        if let Some((colour, depth)) = pairs.last() {
            state.note_frames(colour.header(), depth.header());
        }
        state.pending.extend(pairs);
        let Some(camera) = state.camera else {
            let capacity = if self.config.queue == Queue::All { MAX_PENDING } else { 1 };
            while state.pending.len() > capacity {
                state.pending.pop_front();
                state.pending_dropped += 1;
            }
            return;
        };
        let received = Instant::now();
        for (colour, depth) in state.pending.drain(..) {
            self.slot.put(RawFrame { colour, depth, received, camera });
        }
    }

    /// State of the camera's topics: what comes, what does not, and why.
    pub fn diagnostics(&self, node: &str) -> Vec<DiagnosticStatus> {
        let mut state = self.lock();
        let counted = (state.synchronizer.counters(), self.slot.dropped() + state.pending_dropped);
        let before = std::mem::replace(&mut state.last_look, counted);
        let publishers = |topic: &str| state.graph.as_ref().map_or(0, |graph| graph.publishers(topic));
        let topics: Vec<_> = state
            .statistics
            .iter()
            .map(|s| {
                let report = s.report();
                let publishers = publishers(&report.topic);
                camera_health::TopicHealth { report, publishers }
            })
            .collect();
        let health = camera_health::CameraHealth {
            topics,
            camera_known: state.camera.is_some(),
            counters: counted.0,
            offset: state.synchronizer.last_offset(),
            tolerance: self.config.sync_tolerance,
            frames: state.frames.clone(),
            dropped: counted.1,
            lately: camera_health::Lately::between(before, counted),
        };
        drop(state);
        vec![health.status(node)]
    }

    /// Callbacks only store and count: nothing is left half done by a panic elsewhere.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
