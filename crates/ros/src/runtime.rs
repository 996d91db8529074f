//! The life of a node process: join, work, rejoin when the middleware dies, leave on a signal.

use std::future::Future;
use std::sync::Arc;
use std::time::Duration;

use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::Notify;

use crate::messages::standard::Clock as ClockMessage;
use crate::network::Networks;
use crate::{Arguments, Clock, Names, Node, Qos, RosError, network, rosout};

/// Time that service requests under way may take on the way out.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(2);
/// Threads that move messages; the work is done elsewhere.
const IO_THREADS: usize = 2;

/// What is needed to join the network, again and again.
#[derive(Clone, Debug)]
pub struct Setup {
    /// Names of the node and its topics.
    pub names: Names,
    /// `ROS_DOMAIN_ID`.
    pub domain: u16,
    /// Networks to talk on.
    pub networks: Networks,
    /// The node's time.
    pub clock: Clock,
    /// Whether to log to `/rosout`.
    pub rosout: bool,
}

impl Setup {
    /// Settings from the command line, the environment, and the parameters `network` and `use_sim_time`.
    ///
    /// # Errors
    /// [`RosError`] when one of them makes no sense.
    pub fn new(args: &Arguments, names: Names, network: &str, use_sim_time: bool) -> Result<Self, RosError> {
        let environment = |name: &str| std::env::var(name).ok();
        Ok(Self {
            names,
            domain: network::domain(environment)?,
            networks: Networks::choose(network, environment)?,
            clock: Clock::new(use_sim_time),
            rosout: args.rosout,
        })
    }
}

/// Runs a node until SIGINT, SIGTERM or `done`. `attach` makes its endpoints; it is called again with a new node whenever the
/// middleware has died and everything on the network has to be made anew.
///
/// # Errors
/// What `attach` returns, and [`RosError`] when the network cannot be joined.
pub fn run<E: From<RosError>>(
    setup: &Setup,
    done: &Arc<Notify>,
    attach: impl FnMut(&mut Node) -> Result<(), E>,
) -> Result<(), E> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(IO_THREADS)
        .thread_name("ros-io")
        .enable_all()
        .build()
        .map_err(|e| RosError::Participant { domain: setup.domain, reason: e.to_string() })?;
    let result = runtime.block_on(live(setup, done, attach));
    runtime.shutdown_timeout(SHUTDOWN_TIMEOUT);
    result
}

async fn live<E: From<RosError>>(
    setup: &Setup,
    done: &Arc<Notify>,
    mut attach: impl FnMut(&mut Node) -> Result<(), E>,
) -> Result<(), E> {
    if let Some(advice) = network::buffer_advice() {
        tracing::warn!("{advice}");
    }
    let mut stop = std::pin::pin!(stop_signal());
    setup.networks.check()?;
    loop {
        let mut node = Node::open(setup)?;
        let connection = rosout::connect(&mut node, setup.rosout)?;
        subscribe_clock(&mut node)?;
        attach(&mut node)?;
        tracing::info!("{} on {}, domain {}", setup.names.node(), setup.networks, setup.domain);
        tokio::select! {
            () = &mut stop => return Ok(()),
            () = done.notified() => return Ok(()),
            () = node.supervise() => tracing::warn!("the middleware has stopped, or the process was suspended: joining anew"),
        }
        drop((connection, node));
        // After a computer woke up its network may take a while.
        tokio::select! {
            () = &mut stop => return Ok(()),
            () = setup.networks.available() => {}
        }
    }
}

/// Follows `/clock`, which counts while `use_sim_time` is set.
fn subscribe_clock(node: &mut Node) -> Result<(), RosError> {
    /// Only the newest time is of use.
    const DEPTH: i32 = 1;
    let clock = node.clock().clone();
    node.subscribe::<ClockMessage>("/clock", Qos::best_effort(DEPTH), move |m| clock.set_time(m.clock.into()))?;
    Ok(())
}

/// Waits for SIGINT or SIGTERM.
fn stop_signal() -> impl Future<Output = ()> {
    let (interrupt, terminate) = (signal(SignalKind::interrupt()), signal(SignalKind::terminate()));
    async move {
        let (Ok(mut interrupt), Ok(mut terminate)) = (interrupt, terminate) else {
            tracing::error!("signals cannot be caught: the node will not stop cleanly");
            return std::future::pending().await;
        };
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
        }
        tracing::info!("stopping");
    }
}
