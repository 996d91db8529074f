//! Why nothing arrives: the camera's topics judged.

use pfd_ros::SyncCounters;
use pfd_ros::diagnostics::{Level, TopicReport, status};
use pfd_ros::messages::diagnostic::DiagnosticStatus;

/// A topic that was silent for so many of its periods, …
const SILENT_PERIODS: f64 = 3.0;
/// … and for this long (seconds), has stopped.
const SILENT_AFTER: f64 = 0.5;
/// Time set back more often than this in a second is no bag that loops: two clocks are at work.
const MAX_RESETS: u64 = 2;

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
    /// Frames of colour and depth, where they are not the same.
    pub frames: Option<[String; 2]>,
    /// Frames replaced by newer ones.
    pub dropped: u64,
    /// What happened since the last look.
    pub lately: Lately,
}

/// What happened to colour images in the last second.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lately {
    /// Paired with depth.
    pub pairs: u64,
    /// Left without depth.
    pub unpaired: u64,
    /// Images of both kinds that were left out because of a stamp that is not newer than the one before.
    pub stale: u64,
    /// How often time was set back.
    pub resets: u64,
    /// Pairs that were replaced by newer ones.
    pub dropped: u64,
}

impl Lately {
    /// What was counted since `before`.
    pub fn between(before: (SyncCounters, u64), now: (SyncCounters, u64)) -> Self {
        Self {
            pairs: now.0.pairs - before.0.pairs,
            unpaired: now.0.first_unpaired - before.0.first_unpaired,
            stale: (now.0.late + now.0.duplicates) - (before.0.late + before.0.duplicates),
            resets: now.0.resets - before.0.resets,
            dropped: now.1 - before.1,
        }
    }
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
        if self.lately.resets > MAX_RESETS {
            let remedy = "look for a second publisher of these topics, or a camera whose clock jumps";
            return (Level::Error, format!("time was set back {} times in a second: {remedy}", self.lately.resets));
        }
        if self.lately.pairs == 0 && self.lately.unpaired > 0 {
            return (Level::Error, self.mismatch());
        }
        if self.lately.pairs == 0 && self.lately.stale > 0 {
            let remedy = "the driver must stamp each image with the time at which it was taken";
            return (
                Level::Error,
                format!("stamps repeat or go back on {} images in a second: {remedy}", self.lately.stale),
            );
        }
        match self.lately {
            Lately { dropped: 0, .. } => match &self.frames {
                None => (Level::Ok, "receiving".into()),
                Some(frames) => (Level::Warn, other_frames(frames)),
            },
            Lately { pairs, dropped, .. } => (
                Level::Warn,
                format!(
                    "{dropped} of the last {pairs} frames were dropped: they come faster than they are worked on; lower the \
                     camera's rate, or see what else runs"
                ),
            ),
        }
    }

    /// Why colour and depth do not pair.
    fn mismatch(&self) -> String {
        let offset = self.offset.map_or("an unknown time".into(), |offset| format!("{offset:.4} s"));
        let remedy = "raise sync_tolerance, or check that both come from the same camera and clock";
        format!("rgb and depth stamps differ by {offset}, tolerance {} s: {remedy}", self.tolerance)
    }
}

/// What to do where colour and depth are given in different frames.
pub fn other_frames([colour, depth]: &[String; 2]) -> String {
    format!(
        "the depth image is in frame `{depth}`, colour in `{colour}`: if depth is not registered to colour, switch that on in the driver \
         (RealSense: align_depth.enable), or subscribe the topic that is"
    )
}

fn silence(topic: &TopicHealth) -> Option<String> {
    let r = &topic.report;
    let name = &r.topic;
    match r.age {
        Some(age) if age < SILENT_AFTER.max(SILENT_PERIODS * r.period.unwrap_or(0.0)) => None,
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
        let report =
            TopicReport { topic: name.into(), received: 1, refused: 0, rate: 30.0, period: Some(1.0 / 30.0), age };
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
            frames: None,
            dropped: 0,
            lately: Lately { pairs: 30, ..Lately::default() },
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
        skewed.lately = Lately { unpaired: 4, ..Lately::default() };
        skewed.offset = Some(0.033);
        assert!(skewed.verdict().1.contains("differ by 0.0330 s"));
        assert_eq!(skewed.status("n").level, 2);
        let slow = CameraHealth { lately: Lately { pairs: 30, dropped: 4, ..Lately::default() }, ..good.clone() };
        assert!(slow.verdict().0 == Level::Warn && slow.verdict().1.starts_with("4 of the last 30 frames"));
        let frames = Some(["colour_optical".to_owned(), "depth_optical".to_owned()]);
        let (level, why) = CameraHealth { frames, ..good.clone() }.verdict();
        assert!(level == Level::Warn && why.contains("`depth_optical`") && why.contains("registered"), "{why}");
        let frozen = CameraHealth { lately: Lately { stale: 60, ..Lately::default() }, ..good.clone() };
        assert!(frozen.verdict().0 == Level::Error && frozen.verdict().1.contains("go back on 60 images"));
        let jumping = CameraHealth { lately: Lately { resets: 30, ..Lately::default() }, ..good };
        assert!(jumping.verdict().1.contains("set back 30 times"));
    }

    #[test]
    fn a_topic_is_silent_by_its_own_rate() {
        let with = |age, period| {
            let mut slow = topic("/rgb", Some(age), 1);
            slow.report.period = period;
            silence(&slow).is_some()
        };
        assert_eq!([0.1, 0.6].map(|age| with(age, Some(0.033))), [false, true]);
        assert_eq!([0.6, 2.9, 3.1].map(|age| with(age, Some(1.0))), [false, false, true]);
        assert!(with(0.6, None), "a single message has no period");
    }
}
