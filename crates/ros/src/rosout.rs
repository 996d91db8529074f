//! Log messages: to the terminal and to `/rosout`.

use std::fmt::{self, Write as _};
use std::io::Write as _;
use std::sync::{Mutex, PoisonError};

use tracing::field::{Field, Visit};
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::layer::{Context, SubscriberExt};
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Layer};

use crate::messages::rcl::Log;
use crate::{Arguments, LogLevel, Node, Publisher, Qos, RosError, clock};

/// Messages that `/rosout` keeps for late subscribers, as rcl does.
const DEPTH: i32 = 1000;

/// Where log messages go. The logging interface of the process is global by nature, and so is this.
static ROSOUT: Mutex<Option<Publisher<Log>>> = Mutex::new(None);

/// Starts logging for the process. A second call changes nothing.
///
/// # Errors
/// [`RosError::Arguments`] when a logger's name in `--log-level` is malformed.
pub fn start(args: &Arguments, node_name: &str) -> Result<(), RosError> {
    let level = args.log_level.unwrap_or(LogLevel::Info).filter();
    // RustDDS warns about every datagram beyond 1500 bytes (on loopback every one), and reports an error for every fragment that a
    // slow subscriber asks for too late and for every endpoint of a participant that has died. What matters of it is said by the
    // watchdog and the graph; `--log-level rustdds:=debug` shows the rest.
    let mut directives = format!("{level},rustdds=off,ros2_client=error");
    for (logger, level) in &args.logger_levels {
        // A node's logger has the node's name; ours is the only node.
        let target = if logger == node_name { String::new() } else { format!("{logger}=") };
        let _ = write!(directives, ",{target}{}", level.filter());
    }
    let filter = EnvFilter::try_new(&directives).map_err(|e| RosError::Arguments(format!("--log-level: {e}")))?;
    let layer = RosLayer { name: node_name.to_owned(), to_terminal: args.stdout };
    // An error means that logging was started before, which is as good.
    let _ = tracing_subscriber::registry().with(layer.with_filter(filter)).try_init();
    Ok(())
}

/// While it lives log messages go to `/rosout` as well. A static is never dropped: without this a node would keep its publisher, and
/// with it the participant, to the end of the process, and leave without a goodbye.
#[must_use]
pub(crate) struct Connection;

impl Drop for Connection {
    fn drop(&mut self) {
        *ROSOUT.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}

/// Connects the log to `/rosout`.
///
/// # Errors
/// [`RosError`] when the middleware refuses.
pub(crate) fn connect(node: &mut Node, enabled: bool) -> Result<Connection, RosError> {
    if enabled {
        let qos = Qos { depth: DEPTH, ..Qos::latched() };
        let publisher = node.publisher("/rosout", qos)?;
        *ROSOUT.lock().unwrap_or_else(PoisonError::into_inner) = Some(publisher);
    }
    Ok(Connection)
}

struct RosLayer {
    name: String,
    to_terminal: bool,
}

impl<S: Subscriber> Layer<S> for RosLayer {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        let mut text = Text::default();
        event.record(&mut text);
        let metadata = event.metadata();
        let (level, word) = severity(*metadata.level());
        let now = clock::system_time();
        if self.to_terminal {
            // There is nobody to tell when the terminal is gone.
            let _ = writeln!(std::io::stderr(), "[{word}] [{now}] [{}]: {}", self.name, text.message);
        }
        // The middleware's own messages come through the `log` crate; sending them through the middleware would never end.
        if metadata.target().starts_with("pfd") {
            let log = Log {
                stamp: now.into(),
                level,
                name: self.name.clone(),
                msg: text.message,
                file: metadata.file().unwrap_or_default().to_owned(),
                function: metadata.target().to_owned(),
                line: metadata.line().unwrap_or_default(),
            };
            send(log);
        }
    }
}

/// Skipped while the publisher is busy with another message: if that is of this thread, a failure to log, it could never be logged.
fn send(log: Log) {
    if let Ok(publisher) = ROSOUT.try_lock()
        && let Some(publisher) = publisher.as_ref()
    {
        publisher.publish(log);
    }
}

fn severity(level: Level) -> (u8, &'static str) {
    match level {
        Level::ERROR => (40, "ERROR"),
        Level::WARN => (30, "WARN"),
        Level::INFO => (20, "INFO"),
        _ => (10, "DEBUG"),
    }
}

/// Collects the text of an event; other fields follow as `name=value`.
#[derive(Default)]
struct Text {
    message: String,
}

impl Visit for Text {
    fn record_debug(&mut self, field: &Field, value: &dyn fmt::Debug) {
        let _ = match field.name() {
            "message" => write!(self.message, "{value:?}"),
            name if name.starts_with("log.") => Ok(()),
            name => write!(self.message, " {name}={value:?}"),
        };
    }
}
