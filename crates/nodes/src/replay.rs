//! `bag_replay_node`: a recorded sequence as if it were a camera.

use std::collections::VecDeque;
use std::ops::Range;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use crossbeam_channel::{Receiver, Sender, bounded};
use pfd_dataset::{Options, Sequence};
use pfd_geometry::{Camera, Stamp};
use pfd_parameters::{Acknowledgement, ReplayConfig};
use pfd_ros::messages::pfd::TrackingState;
use pfd_ros::messages::sensor::Image;
use pfd_ros::{Arguments, Names, Node, Qos, Setup};
use tokio::sync::Notify;

use crate::outlet::Outlet;
use crate::replay_output::{ReplayOutput, Shot};
use crate::settings::{Settings, replay_server};

/// Frames read ahead, so that decoding images does not hold up their time.
const READ_AHEAD: usize = 8;
/// How long the network must stay as it is before the first frame: the nodes find each other a little after we find them.
const SETTLE: Duration = Duration::from_secs(1);
/// Time between two looks at the network while waiting.
const LOOK: Duration = Duration::from_millis(50);
/// A time that nobody waits for.
const NEVER: Duration = Duration::from_secs(u32::MAX as u64);
/// How often a frame is sent that nobody says to have worked on.
const MAX_ATTEMPTS: u32 = 2;
/// Frames in a row without an answer after which the nodes are taken to be gone.
const MAX_UNANSWERED: u64 = 3;

/// Stamps of frames that were worked on.
type Done = (Stamp, Source);

/// Who says so.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Source {
    Tracking,
    Segmentation,
}

/// Runs the node until the sequence ends or it is told to stop.
///
/// # Errors
/// When the sequence, parameters or network are at fault, or nobody subscribes in time.
pub fn run(args: &Arguments, names: Names) -> anyhow::Result<()> {
    let settings = Settings::read(args, &names)?;
    let config = settings.replay.clone();
    let (sequence, camera) = open(&settings)?;
    let range = range(&config, &sequence)?;
    let sequence = Arc::new(sequence);
    let setup = Setup::new(args, names, &config.network, false)?;
    let (output, finished) = (Arc::new(Outlet::default()), Arc::new(Notify::new()));
    let (acknowledge, acknowledged) = bounded::<Done>(1024);
    let (stop, stopped) = bounded::<()>(0);
    let player = Player { config: config.clone(), camera, output: output.clone(), acknowledged, stopped };
    let thread = {
        let (finished, sequence) = (finished.clone(), sequence.clone());
        let play = move || {
            let result = player.play(&sequence, &range);
            finished.notify_one();
            result
        };
        std::thread::Builder::new().name("replay".into()).spawn(play)?
    };
    let parameters = replay_server(&settings);
    let result = pfd_ros::run(&setup, &finished, |node: &mut Node| {
        parameters.attach(node)?;
        attach_acknowledgements(node, &acknowledge)?;
        let publishers = ReplayOutput::new(node, &config)?;
        publishers.publish_fixed(sequence.ground_truth());
        output.set(publishers);
        Ok::<(), pfd_ros::RosError>(())
    });
    drop(stop);
    let played = thread.join().map_err(|_| anyhow::anyhow!("the replay crashed"))?;
    output.clear();
    result?;
    played
}

fn open(settings: &Settings) -> anyhow::Result<(Sequence, Camera)> {
    let config = &settings.replay;
    if config.sequence.is_empty() {
        bail!("parameter `sequence` is needed: a folder in TUM layout or its .tgz (-p sequence:=PATH)");
    }
    let options = Options { depth_offset: config.depth_offset, ..Options::default() };
    let sequence = Sequence::open_with(config.sequence.as_ref(), &options)?;
    let camera = settings.camera()?.or(sequence.camera()).with_context(|| {
        format!("{}: the camera is not known: set parameter `camera` or add calib.yaml", config.sequence)
    })?;
    Ok((sequence, camera))
}

/// Indices of the frames to play.
fn range(config: &ReplayConfig, sequence: &Sequence) -> anyhow::Result<Range<usize>> {
    let pairs = sequence.pairs();
    let [first, last] = [pairs.first(), pairs.last()].map(|p| p.map_or(Stamp::default(), |p| p.rgb_stamp));
    let start = first.offset_by(config.start);
    let end = start.offset_by(if config.duration > 0.0 { config.duration } else { f64::from(u32::MAX) });
    let range = pairs.partition_point(|p| p.rgb_stamp < start)..pairs.partition_point(|p| p.rgb_stamp < end);
    if range.is_empty() {
        bail!(
            "parameters `start` ({} s) and `duration` ({} s; 0 is to the end) leave no frame of {}, which has {} in {:.3} s",
            config.start,
            config.duration,
            config.sequence,
            pairs.len(),
            last.seconds_since(first)
        );
    }
    Ok(range)
}

/// Listens for who has worked on what.
fn attach_acknowledgements(node: &mut Node, done: &Sender<Done>) -> Result<(), pfd_ros::RosError> {
    /// More than are ever on their way.
    const DEPTH: i32 = 10;
    // A full channel means that nobody waits for acknowledgements.
    let tracked = done.clone();
    node.subscribe::<TrackingState>("tracking_state", Qos::reliable(DEPTH), move |m| {
        let _ = tracked.try_send((m.header.stamp.into(), Source::Tracking));
    })?;
    let segmented = done.clone();
    node.subscribe::<Image>("dynamic_mask", Qos::masks(), move |m| {
        let _ = segmented.try_send((m.header.stamp.into(), Source::Segmentation));
    })?;
    Ok(())
}

struct Player {
    config: ReplayConfig,
    camera: Camera,
    output: Arc<Outlet<ReplayOutput>>,
    acknowledged: Receiver<Done>,
    stopped: Receiver<()>,
}

/// Told to stop; no error.
struct Stopped;

impl Player {
    fn play(&self, sequence: &Arc<Sequence>, range: &Range<usize>) -> anyhow::Result<()> {
        let Ok(()) = self.wait_for_subscribers()? else { return Ok(()) };
        tracing::info!("{}: {} frames", sequence.name(), range.len());
        let mut counts = Counts::default();
        loop {
            let before = counts.sent;
            let Ok(()) = self.play_once(sequence, range.clone(), &mut counts)? else { break };
            if counts.sent == before {
                bail!("{}: none of {} frames can be read", self.config.sequence, range.len());
            }
            if !self.config.repeat {
                break;
            }
            tracing::info!("again from the start");
        }
        let Counts { sent, resent, given_up, broken, .. } = counts;
        tracing::info!("{sent} frames sent, {resent} sent again, {given_up} given up, {broken} unreadable");
        Ok(())
    }

    fn play_once(
        &self,
        sequence: &Arc<Sequence>,
        range: Range<usize>,
        counts: &mut Counts,
    ) -> anyhow::Result<Result<(), Stopped>> {
        let shots = self.read_ahead(sequence.clone(), range)?;
        let mut pace = Pace::default();
        for shot in shots {
            let shot = match shot {
                Ok(shot) => shot,
                Err(error) => {
                    tracing::warn!("skipped: {error:#}");
                    counts.broken += 1;
                    if self.wait_until(Instant::now()).is_err() {
                        return Ok(Err(Stopped));
                    }
                    continue;
                }
            };
            let sent = if self.config.rate > 0.0 {
                self.send_in_time(&shot, &mut pace, counts)
            } else {
                self.send_and_wait(&shot, counts)?
            };
            if sent.is_err() {
                return Ok(Err(Stopped));
            }
            counts.sent += 1;
        }
        Ok(Ok(()))
    }

    /// Reads and encodes frames on a thread of its own.
    fn read_ahead(
        &self,
        sequence: Arc<Sequence>,
        range: Range<usize>,
    ) -> anyhow::Result<Receiver<anyhow::Result<Shot>>> {
        let (send, receive) = bounded(READ_AHEAD);
        let (config, camera) = (self.config.clone(), self.camera);
        let read = move || {
            for i in range {
                let shot = Shot::read(&sequence, i, &camera, &config);
                // Nobody receives any more: stopped.
                if send.send(shot).is_err() {
                    return;
                }
            }
        };
        std::thread::Builder::new().name("read-ahead".into()).spawn(read)?;
        Ok(receive)
    }

    fn send(&self, shot: &Shot) {
        if let Some(output) = self.output.get() {
            output.publish(shot);
        }
    }

    /// Sends a frame when it is due, or when the nodes have caught up.
    fn send_in_time(&self, shot: &Shot, pace: &mut Pace, counts: &mut Counts) -> Result<(), Stopped> {
        self.wait_until(pace.due(shot.stamp, self.config.rate))?;
        let waited = Instant::now();
        while self.is_too_far_ahead(pace) {
            if !self.wait_for_any_acknowledgement(pace)? {
                tracing::warn!("nobody says to have worked on {} frames: going on", pace.on_their_way.len());
                counts.given_up += pace.on_their_way.len() as u64;
                pace.on_their_way.clear();
            }
        }
        pace.postpone(waited.elapsed());
        pace.on_their_way.push_back(shot.stamp);
        self.send(shot);
        Ok(())
    }

    fn is_too_far_ahead(&self, pace: &mut Pace) -> bool {
        let source = self.source();
        self.acknowledged.try_iter().filter(|(_, from)| *from == source).for_each(|(done, _)| pace.arrived(done));
        let limit = self.config.max_ahead as usize;
        limit > 0 && self.is_acknowledged() && pace.on_their_way.len() >= limit
    }

    /// Whether one came in time.
    fn wait_for_any_acknowledgement(&self, pace: &mut Pace) -> Result<bool, Stopped> {
        let source = self.source();
        let timeout = crossbeam_channel::after(Duration::from_secs_f64(self.config.acknowledge_timeout));
        loop {
            crossbeam_channel::select! {
                recv(self.acknowledged) -> done => {
                    if let Ok((stamp, from)) = done && from == source {
                        pace.arrived(stamp);
                        return Ok(true);
                    }
                }
                recv(timeout) -> _ => return Ok(false),
                recv(self.stopped) -> _ => return Err(Stopped),
            }
        }
    }

    fn wait_until(&self, due: Instant) -> Result<(), Stopped> {
        match self.stopped.recv_deadline(due) {
            Err(crossbeam_channel::RecvTimeoutError::Timeout) => Ok(()),
            _ => Err(Stopped),
        }
    }

    /// Sends a frame and waits until it was worked on; sends it again when nobody says so. The answer itself may be lost while a node
    /// joins anew, and an old frame is not answered twice: so one frame without an answer is no error, several in a row are.
    fn send_and_wait(&self, shot: &Shot, counts: &mut Counts) -> anyhow::Result<Result<(), Stopped>> {
        for attempt in 0..MAX_ATTEMPTS {
            counts.resent += u64::from(attempt > 0);
            self.acknowledged.try_iter().for_each(drop);
            self.send(shot);
            match self.wait_for_acknowledgement(shot.stamp) {
                Ok(true) => {
                    counts.unanswered = 0;
                    return Ok(Ok(()));
                }
                Ok(false) => tracing::warn!("frame {}: nobody says to have worked on it: sending it again", shot.stamp),
                Err(stopped) => return Ok(Err(stopped)),
            }
        }
        counts.given_up += 1;
        counts.unanswered += 1;
        if counts.unanswered < MAX_UNANSWERED {
            tracing::warn!("frame {}: going on without an answer", shot.stamp);
            return Ok(Ok(()));
        }
        bail!(
            "{MAX_UNANSWERED} frames up to {} were sent {MAX_ATTEMPTS} times and nobody says to have worked on them \
             (`tracking_state` or `dynamic_mask` with their stamps): have the nodes stopped, or are they in another namespace?",
            shot.stamp
        )
    }

    fn wait_for_acknowledgement(&self, stamp: Stamp) -> Result<bool, Stopped> {
        let source = self.source();
        let timeout = crossbeam_channel::after(Duration::from_secs_f64(self.config.acknowledge_timeout));
        loop {
            crossbeam_channel::select! {
                recv(self.acknowledged) -> done => {
                    if done.is_ok_and(|(done, from)| from == source && done == stamp) {
                        return Ok(true);
                    }
                }
                recv(timeout) -> _ => return Ok(false),
                recv(self.stopped) -> _ => return Err(Stopped),
            }
        }
    }

    /// Whether there is anybody whose word counts.
    fn is_acknowledged(&self) -> bool {
        self.output.get().is_some_and(|o| {
            let topic = if self.source() == Source::Tracking { &o.state_topic } else { &o.mask_topic };
            o.graph.publishers(topic) > 0
        })
    }

    /// Whose word counts: tracking's, which comes last, where there is a tracker.
    fn source(&self) -> Source {
        let is_tracked = || self.output.get().is_some_and(|o| o.graph.publishers(&o.state_topic) > 0);
        match self.config.acknowledge_topic {
            Acknowledgement::TrackingState => Source::Tracking,
            Acknowledgement::Auto if is_tracked() => Source::Tracking,
            Acknowledgement::DynamicMask | Acknowledgement::Auto => Source::Segmentation,
        }
    }

    /// Waits until this node is on the network, enough others have subscribed, and the network has settled.
    fn wait_for_subscribers(&self) -> anyhow::Result<Result<(), Stopped>> {
        while self.output.get().is_none() {
            if self.wait_until(Instant::now() + LOOK).is_err() {
                return Ok(Err(Stopped));
            }
        }
        let lossless = self.config.rate <= 0.0;
        let wanted = (self.config.wait_for_subscribers as usize).max(usize::from(lossless));
        if wanted == 0 {
            return Ok(Ok(()));
        }
        let started = Instant::now();
        let mut settled: Option<(Instant, [usize; 4])> = None;
        loop {
            let counts = self.output.get().map_or([0; 4], |output| output.connections());
            let enough = counts[..3].iter().all(|&n| n >= wanted);
            settled =
                settled.filter(|(_, last)| enough && *last == counts).or(enough.then(|| (Instant::now(), counts)));
            if settled.is_some_and(|(since, _)| since.elapsed() >= SETTLE) {
                return Ok(Ok(()));
            }
            if started.elapsed().as_secs_f64() > self.config.wait_timeout {
                let [rgb, depth, info, _] = counts;
                bail!(
                    "waited {} s for {wanted} subscribers (wait_for_subscribers); there are {rgb} on rgb, {depth} on depth, \
                     {info} on camera_info: check names, ROS_DOMAIN_ID and that the nodes run",
                    self.config.wait_timeout
                );
            }
            if self.wait_until(Instant::now() + LOOK).is_err() {
                return Ok(Err(Stopped));
            }
        }
    }
}

#[derive(Clone, Copy, Debug, Default)]
struct Counts {
    sent: u64,
    resent: u64,
    given_up: u64,
    /// Frames without an answer since the last answer.
    unanswered: u64,
    broken: u64,
}

/// When frames are due, and which were sent and not worked on yet.
#[derive(Clone, Debug, Default)]
struct Pace {
    origin: Option<(Instant, Stamp)>,
    on_their_way: VecDeque<Stamp>,
}

impl Pace {
    /// When the frame with `stamp` is due, with the first one due at once.
    fn due(&mut self, stamp: Stamp, rate: f64) -> Instant {
        let (start, first) = *self.origin.get_or_insert_with(|| (Instant::now(), stamp));
        // A rate next to nothing makes it later than a clock can say.
        let after = Duration::try_from_secs_f64((stamp.seconds_since(first) / rate).max(0.0)).unwrap_or(NEVER);
        start + after.min(NEVER)
    }

    /// What is still to come keeps its distances.
    fn postpone(&mut self, delay: Duration) {
        if let Some((start, _)) = &mut self.origin {
            *start += delay;
        }
    }

    /// A frame was worked on; earlier ones were, or never will be.
    fn arrived(&mut self, stamp: Stamp) {
        self.on_their_way.retain(|&sent| sent > stamp);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_due_at_their_rate() {
        let mut pace = Pace::default();
        let first = pace.due(Stamp::from_nanos(0), 2.0);
        let second = pace.due(Stamp::from_nanos(1_000_000_000), 2.0);
        assert_eq!(second - first, Duration::from_millis(500));
        pace.postpone(Duration::from_millis(100));
        assert_eq!(pace.due(Stamp::from_nanos(1_000_000_000), 2.0) - first, Duration::from_millis(600));
    }

    #[test]
    fn what_was_worked_on_is_no_longer_on_its_way() {
        let mut pace = Pace { on_their_way: (1..5).map(Stamp::from_nanos).collect(), ..Pace::default() };
        pace.arrived(Stamp::from_nanos(3));
        assert_eq!(pace.on_their_way, [Stamp::from_nanos(4)]);
    }
}
