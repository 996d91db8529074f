//! The one configuration tree of the algorithms.

use pfd_geometry::{Camera, CameraError, Distortion};
use pfd_segmentation::{Mode, SegmentationConfig};
use pfd_tracking::TrackingConfig;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Everything that can be set about the algorithms. Each stage owns its part.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SlamConfig {
    /// How moving things are found: `pfd` (the default), `paper` (as published), `single` (one object), `flow` (feature level
    /// only), `none`.
    pub mode: Mode,
    /// Seed of every random decision.
    pub seed: u64,
    /// The camera, where neither camera_info nor calib.yaml describe it.
    pub camera: Option<CameraConfig>,
    /// Segmentation of what moves.
    pub segmentation: SegmentationConfig,
    /// Tracking and mapping.
    pub tracking: TrackingConfig,
}

/// A pinhole camera with radial-tangential distortion.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CameraConfig {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Focal length in x, pixels.
    pub fx: f64,
    /// Focal length in y, pixels.
    pub fy: f64,
    /// Principal point, column, pixels.
    pub cx: f64,
    /// Principal point, row, pixels.
    pub cy: f64,
    /// Distortion k1 k2 p1 p2 k3.
    #[serde(default)]
    pub distortion: [f64; 5],
}

impl CameraConfig {
    /// The camera model.
    ///
    /// # Errors
    /// When the numbers are not those of a camera.
    pub fn to_camera(&self) -> Result<Camera, CameraError> {
        let size = (self.width as usize, self.height as usize);
        Camera::new(size, [self.fx, self.fy, self.cx, self.cy], Distortion(self.distortion))
    }
}
