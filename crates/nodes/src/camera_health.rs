//! Why nothing arrives: the camera's topics judged.

use pfd_ros::SyncCounters;
use pfd_ros::diagnostics::{Level, TopicReport, status};
use pfd_ros::messages::diagnostic::DiagnosticStatus;

/// A topic that was silent this long (seconds) has stopped.
const SILENT_AFTER: f64 = 2.0;

/// A topic with those who publish it.
#[derive(Clone, Debug)]
pub struct TopicHealth {
    /// What came.
    pub report: TopicReport,
    /// Publishers known.
    pub publishers: usize,
}

/// Everything known about the camera's topics: colour, depth, camera_info.
#[derive(Clone, Debug)]
pub struct CameraHealth {
    /// Colour, depth, camera_info.
    pub topics: Vec<TopicHealth>,
    /// Whether there is a calibration, from camera_info or parameters.
    pub camera_known: bool,
    /// What was paired.
    pub counters: SyncCounters,
    /// Depth stamp minus colour stamp, seconds.
    pub offset: Option<f64>,
    /// Largest offset that pairs, seconds.
    pub tolerance: f64,
    /// Frames replaced by newer ones.
    pub dropped: u64,
    /// Pairs and drops since the last look.
    pub lately: (u64, u64),
}

impl CameraHealth {
    /// The diagnostic status.
    pub fn status(&self, node: &str) -> DiagnosticStatus {
        let (level, message) = self.verdict();
        let mut values = Vec::new();
        let mut texts = Vec::new();
        for (name, topic) in ["rgb", "depth", "camera_info"].iter().zip(&self.topics) {
            let r = &topic.report;
            let age = r.age.map_or("never".to_owned(), |age| format!("{age:.2} s ago"));
            let text = format!(
                "{}: {:.1} Hz, {} received, {} refused, last {age}, {} publishers",
                r.topic, r.rate, r.received, r.refused, topic.publishers
            );
            texts.push((*name, text));
        }
        values.extend(texts);
        let c = self.counters;
        values.push(("pairs", c.pairs.to_string()));
        values.push(("rgb without depth", c.first_unpaired.to_string()));
        values.push(("depth without rgb", c.second_unpaired.to_string()));
        values.push(("duplicate stamps", c.duplicates.to_string()));
        values.push(("late", c.late.to_string()));
        values.push(("clock resets", c.resets.to_string()));
        values.push(("dropped (replaced by newer)", self.dropped.to_string()));
        values.push(("depth stamp minus rgb stamp, s", self.offset.map_or("-".into(), |o| format!("{o:.4}"))));
        status(level, format!("{node}: camera"), message, values)
    }

    /// How it is, with cause and remedy.
    pub fn verdict(&self) -> (Level, String) {
        for (i, topic) in self.topics.iter().enumerate() {
            let is_info = i == 2;
            if is_info && self.camera_known {
                continue;
            }
            if let Some(message) = silence(topic) {
                return (Level::Error, message);
            }
        }
        if !self.camera_known {
            return (Level::Error, "camera_info is received but describes no usable camera: see the log".into());
        }
        let unmatched = self.counters.pairs == 0 && self.counters.first_unpaired > 0;
        if unmatched {
            let offset = self.offset.unwrap_or(f64::NAN);
            let tolerance = self.tolerance;
            let remedy = "raise sync_tolerance, or check that both come from the same camera and clock";
            return (
                Level::Error,
                format!("rgb and depth stamps differ by {offset:.4} s, tolerance {tolerance} s: {remedy}"),
            );
        }
        match self.lately {
            (_, 0) => (Level::Ok, "receiving".into()),
            (pairs, dropped) => (
                Level::Warn,
                format!(
                    "{dropped} of the last {pairs} frames were dropped: they come faster than they are worked on; lower the \
                     camera's rate, or see what else runs"
                ),
            ),
        }
    }
}

fn silence(topic: &TopicHealth) -> Option<String> {
    let r = &topic.report;
    let name = &r.topic;
    match r.age {
        Some(age) if age < SILENT_AFTER => None,
        _ if topic.publishers == 0 => Some(format!(
            "did not receive data on {name}: nobody publishes it; check the camera driver, ROS_DOMAIN_ID, parameter `network` \
             and the name (remap with -r)"
        )),
        None if r.refused > 0 => Some(format!("{name}: all {} messages were refused: see the log", r.refused)),
        None => Some(format!(
            "did not receive data on {name} although {} publish it: check type and QoS (see the log) and net.core.rmem_max",
            topic.publishers
        )),
        Some(age) => Some(format!("{name} has been silent for {age:.1} s although {} publish it", topic.publishers)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn topic(name: &str, age: Option<f64>, publishers: usize) -> TopicHealth {
        let report = TopicReport { topic: name.into(), received: 1, refused: 0, rate: 30.0, age };
        TopicHealth { report, publishers }
    }

    fn health(topics: Vec<TopicHealth>) -> CameraHealth {
        let counters = SyncCounters { pairs: 5, ..SyncCounters::default() };
        CameraHealth {
            topics,
            camera_known: true,
            counters,
            offset: None,
            tolerance: 0.02,
            dropped: 0,
            lately: (30, 0),
        }
    }

    #[test]
    fn causes_are_named() {
        let live = |name| topic(name, Some(0.01), 1);
        let good = health(vec![live("/rgb"), live("/depth"), live("/info")]);
        assert_eq!(good.verdict().0, Level::Ok);
        let no_depth = health(vec![live("/rgb"), topic("/depth", None, 0), live("/info")]);
        assert!(no_depth.verdict().1.contains("on /depth: nobody publishes it"));
        let mismatch = health(vec![topic("/rgb", None, 1), live("/depth"), live("/info")]);
        assert!(mismatch.verdict().1.contains("check type and QoS"));
        let stopped = health(vec![topic("/rgb", Some(9.0), 1), live("/depth"), live("/info")]);
        assert!(stopped.verdict().1.contains("silent for 9.0 s"));
        let mut skewed = health(vec![live("/rgb"), live("/depth"), live("/info")]);
        skewed.counters = SyncCounters { first_unpaired: 4, ..SyncCounters::default() };
        skewed.offset = Some(0.033);
        assert!(skewed.verdict().1.contains("differ by 0.0330 s"));
        assert_eq!(skewed.status("n").level, 2);
        let slow = CameraHealth { lately: (30, 4), ..good };
        assert!(slow.verdict().0 == Level::Warn && slow.verdict().1.starts_with("4 of the last 30 frames"));
    }
}
