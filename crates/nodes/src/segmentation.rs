//! `segmentation_node`: camera in, mask of what moves out.

use std::sync::Arc;

use pfd_parameters::NodeConfig;
use pfd_ros::convert::regions::{matrix_to_rows, vector_to_array};
use pfd_ros::convert::{mask_to_image, rgb_to_image};
use pfd_ros::diagnostics::Level;
use pfd_ros::messages::pfd::{DynamicRegion, DynamicRegions};
use pfd_ros::messages::sensor::{Image, RegionOfInterest};
use pfd_ros::messages::standard::Header;
use pfd_ros::{Arguments, Names, Node, Publisher, Qos, RosError};
use pfd_segmentation::{Segmentation, Status};

use crate::camera_input::{RawFrame, frames};
use crate::node_diagnostics;
use crate::outlet::Outlet;
use crate::overlay;
use crate::recorder::{FrameRecord, Recorder};
use crate::segmentation_stage::SegmentationStage;
use crate::settings::is_changeable_in_segmentation;
use crate::startup::{NEWEST, Startup};
use crate::worker::{Frame, Health, Processor, Worker};

/// Publishers of what the segmentation found.
pub struct MaskOutput {
    mask: Publisher<Image>,
    regions: Publisher<DynamicRegions>,
    overlay: Publisher<Image>,
}

impl MaskOutput {
    /// Announces the topics.
    ///
    /// # Errors
    /// [`RosError`] when the middleware refuses.
    pub fn new(node: &mut Node, config: &NodeConfig) -> Result<Self, RosError> {
        /// `dynamic_regions` keeps as many as `dynamic_mask`.
        const REGION_DEPTH: i32 = 5;
        Ok(Self {
            mask: node.publisher("dynamic_mask", Qos::masks())?,
            regions: node.publisher("dynamic_regions", Qos::reliable(REGION_DEPTH))?,
            overlay: node.publisher("overlay", Qos::images(config.overlay_qos))?,
        })
    }

    /// Publishes a result; the overlay only while someone listens.
    pub fn publish(&self, frame: &Frame, segmentation: &Segmentation) {
        let (stamp, id) = (segmentation.stamp, &frame.frame_id);
        self.mask.publish(mask_to_image(&segmentation.mask, stamp, id));
        self.regions.publish(regions_to_message(segmentation, id));
        if self.overlay.subscribers() > 0 {
            let drawn = overlay::draw(frame.images.rgb(), segmentation);
            self.overlay.publish(rgb_to_image(&drawn, stamp, id));
        }
    }
}

fn regions_to_message(segmentation: &Segmentation, frame_id: &str) -> DynamicRegions {
    let regions = segmentation.regions.iter().map(|r| DynamicRegion {
        id: r.id,
        bounding_box: RegionOfInterest {
            x_offset: r.bounding_box.x,
            y_offset: r.bounding_box.y,
            height: r.bounding_box.height,
            width: r.bounding_box.width,
            do_rectify: false,
        },
        depth_min: r.depth_interval[0],
        depth_max: r.depth_interval[1],
        pixel_count: r.pixel_count,
        particle_mean: vector_to_array(&r.particle_mean),
        particle_covariance: matrix_to_rows(&r.particle_covariance),
        image_velocity: r.image_velocity.into(),
    });
    DynamicRegions { header: Header::new(segmentation.stamp, frame_id), regions: regions.collect() }
}

/// How the segmentation is doing, for diagnostics.
pub fn judge(segmentation: &Segmentation) -> (Level, String) {
    match segmentation.status {
        Status::FirstFrame => (Level::Ok, "first frame".into()),
        Status::Segmented => (Level::Ok, "segmenting".into()),
        Status::FailedOpen(reason) => (Level::Warn, format!("mask left empty: {reason}")),
    }
}

/// Figures of a result for diagnostics.
pub fn figures(segmentation: &Segmentation) -> Vec<(&'static str, String)> {
    let mut values = vec![
        ("masked, %", format!("{:.1}", segmentation.mask.fraction() * 100.0)),
        ("moving objects", segmentation.regions.len().to_string()),
    ];
    values.extend(segmentation.timing.0.iter().map(|(stage, ms)| (*stage, format!("{ms:.2} ms"))));
    values
}

/// The work of the node.
struct SegmentationProcessor {
    stage: SegmentationStage,
    recorder: Recorder,
}

impl Processor for SegmentationProcessor {
    type Job = RawFrame;

    fn process(&mut self, raw: RawFrame) -> anyhow::Result<()> {
        let segmentation = self.stage.segment(&Frame::decode(&raw)?)?;
        let record = FrameRecord {
            stamp: segmentation.stamp,
            segmentation_ms: segmentation.timing.total(),
            mask_fraction: segmentation.mask.fraction(),
            objects: segmentation.regions.len(),
            ..FrameRecord::default()
        };
        self.recorder.record(&record, Some(&segmentation.mask));
        Ok(())
    }

    fn finish(&mut self) -> anyhow::Result<()> {
        self.recorder.finish()
    }
}

/// Runs the node until it is told to stop.
///
/// # Errors
/// When parameters, network or files are at fault.
pub fn run(args: &Arguments, names: Names) -> anyhow::Result<()> {
    let start = Startup::new(args, names, is_changeable_in_segmentation, NEWEST)?;
    let (output, health) = (Arc::new(Outlet::default()), Health::default());
    let (tools, recorder) = (start.tools(&health), start.recorder()?);
    let stage = SegmentationStage::new(start.settings, output.clone(), health.clone());
    let processor = SegmentationProcessor { stage, recorder };
    let input = start.input;
    let worker = Worker::start("segmentation", frames(&input), tools, processor)?;
    let result = pfd_ros::run(&start.setup, &start.ended, |node: &mut Node| {
        output.set(MaskOutput::new(node, &start.config)?);
        start.parameters.attach(node)?;
        node_diagnostics::attach(node, input.clone(), vec![("segmentation", health.clone())])?;
        input.attach(node)
    });
    // What waits is worked off, and its masks published: a tracking node may wait for them.
    input.slot.close();
    let finished = worker.finish();
    output.clear();
    finished?;
    Ok(result?)
}
