//! Quality of service.

use pfd_parameters::Reliability;
use rustdds::policy::{Durability, History, ResourceLimits};
use rustdds::{Duration, QosPolicies, QosPolicyBuilder};

/// What a topic promises.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Qos {
    /// Whether lost messages are sent again.
    pub reliability: Reliability,
    /// Whether late subscribers get the last messages.
    pub transient_local: bool,
    /// How many messages are kept.
    pub depth: i32,
    /// Unacknowledged messages after which a reliable publisher drops the oldest.
    pub window: i32,
}

/// Unacknowledged messages that a reliable publisher of small messages keeps for a slow subscriber. The middleware's own bound is
/// 8192 whatever the history depth: a subscriber that hangs would make the publisher grow until its lease ends.
const SMALL_WINDOW: i32 = 1024;
/// The same for images: 2 s at 30 Hz, 70 MB of floating-point depth.
const IMAGE_WINDOW: i32 = 60;
/// The same for whole maps, which are sent once a second.
const MAP_WINDOW: i32 = 32;

impl Qos {
    /// Images of a live camera: best effort unless the parameter says otherwise.
    pub const fn images(reliability: Reliability) -> Self {
        Self { reliability, transient_local: false, depth: 5, window: IMAGE_WINDOW }
    }

    /// Small messages: reliable, the last `depth`.
    pub const fn reliable(depth: i32) -> Self {
        Self { reliability: Reliability::Reliable, transient_local: false, depth, window: SMALL_WINDOW }
    }

    /// Masks: reliable, the last 5.
    pub const fn masks() -> Self {
        Self { reliability: Reliability::Reliable, transient_local: false, depth: 5, window: IMAGE_WINDOW }
    }

    /// State that late subscribers want as well: reliable, transient local, the last one.
    pub const fn latched() -> Self {
        Self { reliability: Reliability::Reliable, transient_local: true, depth: 1, window: MAP_WINDOW }
    }

    /// Static transforms as subscribed: several nodes publish them.
    pub const fn latched_from_many() -> Self {
        Self { reliability: Reliability::Reliable, transient_local: true, depth: 100, window: SMALL_WINDOW }
    }

    /// Best effort, the last `depth`: for subscriptions that take what there is.
    pub const fn best_effort(depth: i32) -> Self {
        Self { reliability: Reliability::BestEffort, transient_local: false, depth, window: SMALL_WINDOW }
    }

    pub(crate) fn policies(self) -> QosPolicies {
        let durability = if self.transient_local { Durability::TransientLocal } else { Durability::Volatile };
        let limit = self.window.max(self.depth);
        let limits = ResourceLimits { max_samples: limit, max_instances: 1, max_samples_per_instance: limit };
        let builder = QosPolicyBuilder::new()
            .durability(durability)
            .history(History::KeepLast { depth: self.depth })
            .resource_limits(limits);
        match self.reliability {
            // The publishing thread never waits for a subscriber.
            Reliability::Reliable => builder.reliable(Duration::ZERO).build(),
            Reliability::BestEffort => builder.best_effort().build(),
        }
    }
}
