//! `sensor_msgs`.

use bytes::Bytes;
use serde::{Deserialize, Serialize};

use super::{messages, standard::Header};

/// `sensor_msgs/Image`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Image {
    /// Stamp and optical frame.
    pub header: Header,
    /// Rows.
    pub height: u32,
    /// Columns.
    pub width: u32,
    /// Pixel format, such as `rgb8`.
    pub encoding: String,
    /// 1 when 16- and 32-bit values are big-endian.
    pub is_bigendian: u8,
    /// Bytes a row, padding included.
    pub step: u32,
    /// `step * height` bytes.
    pub data: Bytes,
}

/// `sensor_msgs/CompressedImage`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CompressedImage {
    /// Stamp and optical frame.
    pub header: Header,
    /// `jpeg`, `png`, or as image_transport writes it: `rgb8; jpeg compressed bgr8`, `16UC1; compressedDepth`.
    pub format: String,
    /// The compressed file.
    pub data: Bytes,
}

/// `sensor_msgs/RegionOfInterest`
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RegionOfInterest {
    /// Left column.
    pub x_offset: u32,
    /// Top row.
    pub y_offset: u32,
    /// Rows.
    pub height: u32,
    /// Columns.
    pub width: u32,
    /// Whether the image is to be rectified.
    pub do_rectify: bool,
}

/// `sensor_msgs/CameraInfo`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CameraInfo {
    /// Stamp of the image and optical frame.
    pub header: Header,
    /// Rows.
    pub height: u32,
    /// Columns.
    pub width: u32,
    /// `plumb_bob`, `rational_polynomial`, `equidistant`.
    pub distortion_model: String,
    /// Coefficients; for `plumb_bob` k1 k2 p1 p2 k3.
    pub d: Vec<f64>,
    /// Intrinsic matrix, row by row.
    pub k: [f64; 9],
    /// Rectification, row by row.
    pub r: [f64; 9],
    /// Projection, row by row.
    pub p: [f64; 12],
    /// Horizontal binning.
    pub binning_x: u32,
    /// Vertical binning.
    pub binning_y: u32,
    /// Part of the sensor that is sent.
    pub roi: RegionOfInterest,
}

/// `sensor_msgs/PointField`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PointField {
    /// Name, such as `x`.
    pub name: String,
    /// Byte within a point.
    pub offset: u32,
    /// Type; [`PointField::FLOAT32`].
    pub datatype: u8,
    /// Elements.
    pub count: u32,
}

impl PointField {
    /// 32-bit float.
    pub const FLOAT32: u8 = 7;
}

/// `sensor_msgs/PointCloud2`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PointCloud2 {
    /// Stamp and frame of the points.
    pub header: Header,
    /// 1 for an unordered cloud.
    pub height: u32,
    /// Number of points.
    pub width: u32,
    /// Layout of a point.
    pub fields: Vec<PointField>,
    /// Byte order.
    pub is_bigendian: bool,
    /// Bytes a point.
    pub point_step: u32,
    /// Bytes a row.
    pub row_step: u32,
    /// The points.
    pub data: Bytes,
    /// Whether no point is invalid.
    pub is_dense: bool,
}

messages!("sensor_msgs": Image, CompressedImage, CameraInfo, PointCloud2);
