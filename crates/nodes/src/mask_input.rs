//! Masks from another node.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use pfd_geometry::Stamp;
use pfd_parameters::Queue;
use pfd_ros::convert::mask_from_image;
use pfd_ros::messages::sensor::Image;
use pfd_ros::{Graph, Node, Qos, RosError, Throttle};

use crate::mask_box::{MaskBox, Taken};

/// How long to wait for the mask of an image when nothing is to be lost.
const LOSSLESS_TIMEOUT: Duration = Duration::from_secs(10);
/// For so long after the first image the publisher of masks may still be unknown to discovery.
const DISCOVERY: Duration = Duration::from_secs(2);

/// Receives masks and hands each out for the image with its stamp.
pub struct MaskInput {
    masks: Arc<MaskBox>,
    source: Mutex<Option<(Graph, String)>>,
    started: Mutex<Option<Instant>>,
    queue: Queue,
}

impl MaskInput {
    /// An input that is not connected yet.
    pub fn new(queue: Queue) -> Self {
        Self { masks: Arc::default(), source: Mutex::default(), started: Mutex::default(), queue }
    }

    /// Subscribes `dynamic_mask`.
    ///
    /// # Errors
    /// [`RosError`] when the middleware refuses.
    pub fn attach(&self, node: &mut Node) -> Result<(), RosError> {
        let masks = self.masks.clone();
        let mut complaints = Throttle::default();
        let topic = node.names().resolve("dynamic_mask")?;
        let name = topic.clone();
        node.subscribe::<Image>("dynamic_mask", Qos::masks(), move |message| match mask_from_image(&message) {
            Ok(mask) => masks.put(message.header.stamp.into(), mask),
            Err(error) => {
                if complaints.pass().is_some() {
                    tracing::error!("{name}: {error}");
                }
            }
        })?;
        *self.source.lock().unwrap_or_else(PoisonError::into_inner) = Some((node.graph().clone(), topic));
        Ok(())
    }

    /// The mask of the image with `stamp`; waits up to `timeout` (longer when nothing is to be lost) if somebody publishes masks.
    pub fn take(&self, stamp: Stamp, timeout: Duration) -> Taken {
        let timeout = if self.queue == Queue::All { timeout.max(LOSSLESS_TIMEOUT) } else { timeout };
        let started = *self.started.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_with(Instant::now);
        let patience =
            if self.is_published() { timeout } else { timeout.min(DISCOVERY.saturating_sub(started.elapsed())) };
        self.masks.take(stamp, patience)
    }

    /// Whether somebody publishes masks.
    pub fn is_published(&self) -> bool {
        let source = self.source.lock().unwrap_or_else(PoisonError::into_inner);
        source.as_ref().is_some_and(|(graph, topic)| graph.publishers(topic) > 0)
    }

    /// Forgets all masks, and whom they come from.
    pub fn clear(&self) {
        self.masks.clear();
        *self.source.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }

    /// Forgets all masks: time was set back.
    pub fn restart(&self) {
        self.masks.clear();
    }
}
