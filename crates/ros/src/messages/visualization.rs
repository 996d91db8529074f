//! `visualization_msgs`.

use bytes::Bytes;
use serde::{Deserialize, Serialize};

use super::geometry::{Pose, Vector3};
use super::messages;
use super::standard::{ColorRgba, Duration, Header};

/// `visualization_msgs/UVCoordinate`
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct UvCoordinate {
    /// Column, 0 to 1.
    pub u: f32,
    /// Row, 0 to 1.
    pub v: f32,
}

/// `visualization_msgs/MeshFile`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct MeshFile {
    /// File name.
    pub filename: String,
    /// Its content.
    pub data: Bytes,
}

/// `visualization_msgs/Marker` (humble and later)
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Marker {
    /// Stamp and frame.
    pub header: Header,
    /// Namespace of the id.
    pub ns: String,
    /// Identifies the marker.
    pub id: i32,
    /// Shape; [`Marker::LINE_LIST`], [`Marker::LINE_STRIP`].
    pub r#type: i32,
    /// 0 adds or changes.
    pub action: i32,
    /// Pose of the points.
    pub pose: Pose,
    /// For lines: x is the width, metres.
    pub scale: Vector3,
    /// Colour of the whole.
    pub color: ColorRgba,
    /// 0 for ever.
    pub lifetime: Duration,
    /// Whether it moves with its frame.
    pub frame_locked: bool,
    /// Points of lines.
    pub points: Vec<Vector3>,
    /// Colour of each point; empty for one colour.
    pub colors: Vec<ColorRgba>,
    /// Texture.
    pub texture_resource: String,
    /// Texture.
    pub texture: super::sensor::CompressedImage,
    /// Texture.
    pub uv_coordinates: Vec<UvCoordinate>,
    /// Text.
    pub text: String,
    /// Mesh.
    pub mesh_resource: String,
    /// Mesh.
    pub mesh_file: MeshFile,
    /// Mesh.
    pub mesh_use_embedded_materials: bool,
}

impl Marker {
    /// Points joined one after the other.
    pub const LINE_STRIP: i32 = 4;
    /// Points joined in pairs.
    pub const LINE_LIST: i32 = 5;
}

/// `visualization_msgs/MarkerArray`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MarkerArray {
    /// The markers.
    pub markers: Vec<Marker>,
}

messages!("visualization_msgs": MarkerArray);
