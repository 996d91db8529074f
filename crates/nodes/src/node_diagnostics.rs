//! `/diagnostics`, once a second, and the same complaints in the log.

use std::sync::Arc;
use std::time::Duration;

use pfd_ros::messages::diagnostic::DiagnosticArray;
use pfd_ros::messages::standard::Header;
use pfd_ros::{Node, Qos, RosError, Throttle, diagnostics};

use crate::camera_input::CameraInput;
use crate::worker::Health;

/// Time between two messages.
const PERIOD: Duration = Duration::from_secs(1);
/// Messages kept for late subscribers.
const DEPTH: i32 = 10;
/// At the start the camera may take a moment.
const GRACE: usize = 5;

/// Publishes the state of the camera's topics and of each kind of work.
///
/// # Errors
/// [`RosError`] when the middleware refuses.
pub fn attach(node: &mut Node, input: Arc<CameraInput>, works: Vec<(&'static str, Health)>) -> Result<(), RosError> {
    let publisher = node.publisher::<DiagnosticArray>("/diagnostics", Qos::reliable(DEPTH))?;
    let name = node.names().node().to_string();
    let name = name.trim_start_matches('/').to_owned();
    let clock = node.clock().clone();
    node.spawn(async move {
        let mut ticks = tokio::time::interval(PERIOD);
        let mut complaints = Throttle::default();
        for count in 0_usize.. {
            ticks.tick().await;
            let mut status = input.diagnostics(&name);
            status.extend(works.iter().map(|(what, health)| health.status(format!("{name}: {what}"))));
            let worst = status.iter().max_by_key(|s| s.level).filter(|s| s.level > 0 && count >= GRACE);
            if let Some(worst) = worst
                && complaints.pass().is_some()
            {
                tracing::warn!("{}", worst.message);
            }
            publisher.publish(diagnostics::array(Header::new(clock.now(), ""), status));
        }
    });
    Ok(())
}
