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

    /// The mask of the image with `stamp` that arrived at `received`; waits until `timeout` (longer when nothing is to be lost) after that
    /// if masks are [expected](Self::are_expected).
    pub fn take(&self, stamp: Stamp, received: Instant, timeout: Duration) -> Taken {
        let timeout = if self.queue == Queue::All { timeout.max(LOSSLESS_TIMEOUT) } else { timeout };
        let started = *self.started.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_with(Instant::now);
        let is_published = self.is_published();
        let deadline = if !is_published {
            (received + timeout).min(started + DISCOVERY)
        } else if self.masks.is_silent() {
            received
        } else {
            received + timeout
        };
        let taken = self.masks.take(stamp, deadline);
        if is_published && taken == Taken::Missing {
            self.masks.miss();
        }
        taken
    }

    /// Whether somebody publishes masks and has not fallen silent: a publisher that was killed is known to discovery for almost a minute.
    pub fn are_expected(&self) -> bool {
        self.is_published() && !self.masks.is_silent()
    }

    /// Whether somebody publishes masks.
    pub fn is_published(&self) -> bool {
        let source = self.source.lock().unwrap_or_else(PoisonError::into_inner);
        source.as_ref().is_some_and(|(graph, topic)| graph.publishers(topic) > 0)
    }

    /// Stamp of the newest mask that came.
    pub fn newest(&self) -> Option<Stamp> {
        self.masks.newest()
    }

    /// No mask will come any more: whoever waits for one goes on, and whom they came from is forgotten.
    pub fn close(&self) {
        self.masks.close();
        *self.source.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }

    /// Time was set back to `stamp`: forgets the masks from before.
    pub fn restart(&self, stamp: Stamp) {
        self.masks.restart(stamp);
    }
}
