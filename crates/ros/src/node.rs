//! A node: publishers, subscriptions, services on one DDS participant.

use std::pin::pin;
use std::sync::{Mutex, PoisonError};

use futures_util::StreamExt;
use ros2_client::dds::{Server, ServiceMapping, Subscription};
use ros2_client::qos::{History, QosProfile};
use ros2_client::{Context, NodeOptions, ServiceTypeName};
use rustdds::TopicKind;
use tokio::task::JoinSet;

use crate::graph::{Endpoint, Graph, Side, dds_topic};
use crate::messages::{Message, Service};
use crate::watchdog::{self, Watchdog};
use crate::{Clock, Names, Qos, RosError, Setup, Throttle, TopicStatistics, network};

/// How many service requests may wait.
const SERVICE_DEPTH: usize = 10;

/// A ROS 2 node. Dropping it ends its subscriptions and services and leaves the network.
pub struct Node {
    // The order matters: tasks hold endpoints, endpoints belong to the node, the node to the context.
    tasks: JoinSet<()>,
    inner: ros2_client::Node,
    context: Context,
    names: Names,
    clock: Clock,
    graph: Graph,
    watchdog: Watchdog,
}

impl Node {
    /// Joins the network.
    ///
    /// # Errors
    /// [`RosError`] when the environment makes no sense or the network is not there.
    pub fn open(setup: &Setup) -> Result<Self, RosError> {
        let watchdog = Watchdog::start();
        let participant = network::join(setup.domain, &setup.networks)?;
        let failed = |reason: String| RosError::Participant { domain: setup.domain, reason };
        let context = Context::from_domain_participant(participant).map_err(|e| failed(e.to_string()))?;
        let name = setup.names.node();
        let ros_name = ros2_client::NodeName::new(name.namespace(), name.base()).map_err(|e| failed(e.to_string()))?;
        let options = NodeOptions::new().enable_rosout(false).start_parameter_services(false);
        let node = context.new_node(ros_name, options).map_err(|e| failed(e.to_string()))?;
        Ok(Self {
            tasks: JoinSet::new(),
            inner: node,
            context,
            names: setup.names.clone(),
            clock: setup.clock.clone(),
            graph: Graph::default(),
            watchdog,
        })
    }

    /// Names of the node and its topics.
    pub fn names(&self) -> &Names {
        &self.names
    }

    /// The node's time.
    pub fn clock(&self) -> &Clock {
        &self.clock
    }

    /// Who else is there.
    pub fn graph(&self) -> &Graph {
        &self.graph
    }

    /// Runs a task as long as the node lives.
    pub fn spawn(&mut self, task: impl Future<Output = ()> + Send + 'static) {
        self.tasks.spawn(task);
    }

    fn topic<M: Message>(&self, side: Side, name: &str, qos: Qos) -> Result<(String, rustdds::Topic), RosError> {
        let full = self.names.resolve(name)?;
        let type_name = ros2_client::MessageTypeName::new(M::PACKAGE, M::NAME).dds_msg_type();
        let participant = self.context.domain_participant();
        let topic = participant
            .create_topic(dds_topic(&full), type_name.clone(), &qos.policies(), TopicKind::NoKey)
            .map_err(|e| RosError::Endpoint { what: "topic", name: full.clone(), reason: e.to_string() })?;
        self.graph.add_own(Endpoint { side, topic: dds_topic(&full), type_name, qos: qos.policies() });
        Ok((full, topic))
    }

    /// Announces a publisher; `name` is expanded and remapped.
    ///
    /// # Errors
    /// [`RosError`] when the name is malformed or the middleware refuses.
    pub fn publisher<M: Message>(&mut self, name: &str, qos: Qos) -> Result<Publisher<M>, RosError> {
        let (full, topic) = self.topic::<M>(Side::Publisher, name, qos)?;
        let inner = self.inner.create_publisher::<M>(&topic, None).map_err(|e| RosError::Endpoint {
            what: "publisher",
            name: full.clone(),
            reason: e.to_string(),
        })?;
        Ok(Publisher { inner, topic: full, graph: self.graph.clone(), refused: Mutex::new(Throttle::default()) })
    }

    /// Subscribes; `callback` gets every message, and must be quick. Messages that cannot be read are counted and reported.
    ///
    /// # Errors
    /// [`RosError`] when the name is malformed or the middleware refuses.
    pub fn subscribe<M: Message>(
        &mut self,
        name: &str,
        qos: Qos,
        callback: impl FnMut(M) + Send + 'static,
    ) -> Result<TopicStatistics, RosError> {
        let (full, topic) = self.topic::<M>(Side::Subscription, name, qos)?;
        let subscription = self.inner.create_subscription::<M>(&topic, None).map_err(|e| RosError::Endpoint {
            what: "subscription",
            name: full.clone(),
            reason: e.to_string(),
        })?;
        let statistics = TopicStatistics::new(full);
        self.spawn(receive(subscription, statistics.clone(), callback));
        Ok(statistics)
    }

    /// Offers a service; `handler` runs on a thread of its own where it may take its time.
    ///
    /// # Errors
    /// [`RosError`] when the name is malformed or the middleware refuses.
    pub fn serve<S: Service + 'static>(
        &mut self,
        name: &str,
        handler: impl Fn(S::Request) -> S::Response + Clone + Send + 'static,
    ) -> Result<(), RosError> {
        let full = self.names.resolve(name)?;
        let failed = |reason: String| RosError::Endpoint { what: "service", name: full.clone(), reason };
        let qos = QosProfile::publisher_default().history(History::KeepLast { depth: SERVICE_DEPTH });
        let ros_name = ros2_client::Name::parse(&full).map_err(|e| failed(e.to_string()))?;
        let type_name = ServiceTypeName::new(S::PACKAGE, S::NAME);
        let server = self
            .inner
            .create_server(ServiceMapping::Enhanced, &ros_name, &type_name, qos.clone(), qos)
            .map_err(|e| failed(e.to_string()))?;
        self.spawn(answer::<S>(server, full, handler));
        Ok(())
    }

    /// Watches the graph and the middleware; returns when the middleware has died.
    pub(crate) async fn supervise(&mut self) {
        let mut ticks = tokio::time::interval(watchdog::PERIOD);
        ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            ticks.tick().await;
            if self.watchdog.is_dead() {
                return;
            }
            for obstacle in self.graph.refresh(&self.context.domain_participant()) {
                tracing::warn!("{obstacle}");
            }
        }
    }
}

async fn receive<M: Message>(
    subscription: Subscription<M>,
    statistics: TopicStatistics,
    mut callback: impl FnMut(M) + Send,
) {
    let mut complaints = Throttle::default();
    let mut messages = pin!(subscription.async_stream());
    while let Some(message) = messages.next().await {
        match message {
            Ok((message, _)) => {
                statistics.count_received();
                callback(message);
            }
            Err(error) => {
                statistics.count_refused();
                if let Some(more) = complaints.pass() {
                    let topic = statistics.topic();
                    tracing::warn!(
                        "{topic}: a message is not {}/{}: {error} ({more} more like it)",
                        M::PACKAGE,
                        M::NAME
                    );
                }
            }
        }
    }
}

async fn answer<S: Service>(
    server: Server<S::Request, S::Response>,
    name: String,
    handler: impl Fn(S::Request) -> S::Response + Clone + Send + 'static,
) {
    let mut requests = server.receive_request_stream();
    while let Some(request) = requests.next().await {
        let Ok((id, request)) = request else {
            tracing::warn!("{name}: a request could not be read");
            continue;
        };
        let handler = handler.clone();
        let Ok(response) = tokio::task::spawn_blocking(move || handler(request)).await else {
            tracing::error!("{name}: the request could not be answered");
            continue;
        };
        if let Err(error) = server.async_send_response(id, response).await {
            tracing::warn!("{name}: the answer could not be sent: {error}");
        }
    }
}

/// Sends messages of one type on one topic.
pub struct Publisher<M: Message> {
    inner: ros2_client::dds::Publisher<M>,
    topic: String,
    graph: Graph,
    refused: Mutex<Throttle>,
}

impl<M: Message> Publisher<M> {
    /// Sends without waiting; a subscriber that hangs loses the oldest messages. What the middleware does not take is dropped with
    /// a complaint.
    pub fn publish(&self, message: M) {
        let Err(error) = self.inner.publish(message) else { return };
        let mut complaints = self.refused.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(more) = complaints.pass() {
            let reason = error.forget_data();
            tracing::warn!("{}: not sent: {reason} ({more} more like it)", self.topic);
        }
    }

    /// Full name of the topic.
    pub fn topic(&self) -> &str {
        &self.topic
    }

    /// How many others subscribe.
    pub fn subscribers(&self) -> usize {
        self.graph.subscribers(&self.topic)
    }
}
