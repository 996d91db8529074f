//! Who else publishes and subscribes, and why a connection that should be there is not.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use rustdds::policy::{Durability, Reliability};
use rustdds::{DomainParticipant, QosPolicies};

/// Publisher or subscription.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Side {
    /// Sends.
    Publisher,
    /// Receives.
    Subscription,
}

/// An endpoint, ours or another's.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Endpoint {
    pub(crate) side: Side,
    /// DDS name, such as `rt/pose`.
    pub(crate) topic: String,
    /// DDS name of the type.
    pub(crate) type_name: String,
    pub(crate) qos: QosPolicies,
}

/// The last known state of the network. Clones share it; none of them keeps the participant alive, which says goodbye to others when
/// it is dropped.
#[derive(Clone, Default)]
pub struct Graph {
    state: Arc<Mutex<State>>,
}

#[derive(Default)]
struct State {
    others: Vec<Endpoint>,
    ours: Vec<Endpoint>,
    reported: BTreeSet<String>,
}

impl Graph {
    pub(crate) fn add_own(&self, endpoint: Endpoint) {
        self.lock().ours.push(endpoint);
    }

    /// Looks again; returns what is newly found to hinder a connection.
    pub(crate) fn refresh(&self, participant: &DomainParticipant) -> Vec<String> {
        let readers = participant.discovered_readers().into_iter().map(|r| {
            let data = r.subscription_topic_data;
            let (topic, type_name) = (data.topic_name().clone(), data.type_name().clone());
            Endpoint { side: Side::Subscription, topic, type_name, qos: data.qos() }
        });
        let writers = participant.discovered_writers().into_iter().map(|w| {
            let data = w.publication_topic_data;
            let qos = data.qos();
            Endpoint { side: Side::Publisher, topic: data.topic_name, type_name: data.type_name, qos }
        });
        let others: Vec<Endpoint> = readers.chain(writers).collect();
        let mut state = self.lock();
        let pairs = state.ours.iter().flat_map(|our| others.iter().map(move |other| (our, other)));
        let found: BTreeSet<String> = pairs.filter_map(|(our, other)| obstacle(our, other)).collect();
        let new = found.difference(&state.reported).cloned().collect();
        state.reported.extend(found);
        state.others = others;
        new
    }

    /// Subscriptions of others to a topic (full name), as of the last look.
    pub fn subscribers(&self, topic: &str) -> usize {
        self.count(Side::Subscription, topic)
    }

    /// Publishers of others on a topic (full name), as of the last look.
    pub fn publishers(&self, topic: &str) -> usize {
        self.count(Side::Publisher, topic)
    }

    fn count(&self, side: Side, topic: &str) -> usize {
        let name = dds_topic(topic);
        self.lock().others.iter().filter(|e| e.side == side && e.topic == name).count()
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// `/a/b` → `rt/a/b`
pub(crate) fn dds_topic(topic: &str) -> String {
    format!("rt{topic}")
}

/// Why two endpoints of a topic do not connect although they should.
fn obstacle(our: &Endpoint, other: &Endpoint) -> Option<String> {
    if our.topic != other.topic || our.side == other.side {
        return None;
    }
    let topic = our.topic.trim_start_matches("rt");
    let (who, (offered, requested)) = match other.side {
        Side::Publisher => ("a publisher", (&other.qos, &our.qos)),
        Side::Subscription => ("a subscriber", (&our.qos, &other.qos)),
    };
    if our.type_name != other.type_name {
        return Some(format!(
            "{topic}: {who} uses type {} but this node {}: check the topic's name",
            ros_type(&other.type_name),
            ros_type(&our.type_name)
        ));
    }
    let what = incompatibility(offered, requested)?;
    Some(format!("{topic}: {who} does not connect: {what}"))
}

fn incompatibility(offered: &QosPolicies, requested: &QosPolicies) -> Option<&'static str> {
    let reliable = |qos: &QosPolicies| matches!(qos.reliability(), Some(Reliability::Reliable { .. }));
    let latched = |qos: &QosPolicies| !matches!(qos.durability(), None | Some(Durability::Volatile));
    if reliable(requested) && !reliable(offered) {
        return Some(
            "the publisher is best effort, the subscriber wants reliable; make both the same (parameter `qos` for images that come in, `overlay_qos` for `overlay`)",
        );
    }
    if latched(requested) && !latched(offered) {
        return Some("the publisher is volatile, the subscriber wants transient local; make both the same");
    }
    None
}

/// `sensor_msgs::msg::dds_::Image_` → `sensor_msgs/msg/Image`
fn ros_type(dds: &str) -> String {
    dds.replace("::dds_::", "/").replace("::", "/").trim_end_matches('_').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Qos;
    use pfd_parameters::Reliability as Kind;

    fn endpoint(side: Side, type_name: &str, qos: Qos) -> Endpoint {
        Endpoint { side, topic: "rt/rgb/image".into(), type_name: type_name.into(), qos: qos.policies() }
    }

    #[test]
    fn obstacles_are_named_with_their_remedy() {
        let image = "sensor_msgs::msg::dds_::Image_";
        let ours = endpoint(Side::Subscription, image, Qos::images(Kind::Reliable));
        let best_effort = endpoint(Side::Publisher, image, Qos::images(Kind::BestEffort));
        let message = obstacle(&ours, &best_effort).unwrap();
        assert!(message.starts_with("/rgb/image: a publisher does not connect"), "{message}");
        let other = endpoint(Side::Publisher, "std_msgs::msg::dds_::String_", Qos::images(Kind::Reliable));
        assert!(obstacle(&ours, &other).unwrap().contains("std_msgs/msg/String but this node sensor_msgs/msg/Image"));
        let latched = endpoint(Side::Subscription, image, Qos::latched());
        let volatile = endpoint(Side::Publisher, image, Qos::reliable(1));
        assert!(obstacle(&volatile, &latched).unwrap().contains("transient local"));
        assert_eq!(obstacle(&ours, &volatile), None);
        assert_eq!(obstacle(&ours, &ours), None);
    }
}
