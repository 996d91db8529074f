//! The map for rviz: points as `PointCloud2`, keyframes as markers.

use nalgebra::Point3;
use pfd_geometry::{Camera, Pose};

use super::pose::vector;
use crate::messages::sensor::{PointCloud2, PointField};
use crate::messages::standard::{ColorRgba, Header};
use crate::messages::visualization::{Marker, MarkerArray};

/// x, y, z and the packed colour, 4 bytes each.
const POINT_STEP: u32 = 16;
/// Depth of the drawn view pyramids, metres.
const FRUSTUM_DEPTH: f64 = 0.1;
/// Width of lines, metres.
const LINE_WIDTH: f64 = 0.005;

/// A cloud with fields x, y, z (metres) and rgb (packed into a float, as PCL does).
pub fn cloud(points: impl ExactSizeIterator<Item = (Point3<f64>, [u8; 3])>, header: Header) -> PointCloud2 {
    let count = points.len() as u32;
    let mut data = Vec::with_capacity(points.len() * POINT_STEP as usize);
    for (p, [r, g, b]) in points {
        data.extend([p.x, p.y, p.z].into_iter().flat_map(|c| (c as f32).to_le_bytes()));
        data.extend([b, g, r, 0]);
    }
    let field = |(i, name): (u32, &&str)| PointField {
        name: (*name).to_owned(),
        offset: 4 * i,
        datatype: PointField::FLOAT32,
        count: 1,
    };
    PointCloud2 {
        header,
        height: 1,
        width: count,
        fields: (0..).zip(&["x", "y", "z", "rgb"]).map(field).collect(),
        is_bigendian: false,
        point_step: POINT_STEP,
        row_step: POINT_STEP * count,
        data: data.into(),
        is_dense: true,
    }
}

/// View pyramids of the keyframes and the line that joins them.
pub fn keyframe_markers(poses: &[Pose], camera: &Camera, header: &Header) -> MarkerArray {
    let line = |id, kind, points, color| Marker {
        header: header.clone(),
        ns: "keyframes".to_owned(),
        id,
        r#type: kind,
        scale: crate::messages::geometry::Vector3 { x: LINE_WIDTH, y: 0.0, z: 0.0 },
        color,
        points,
        ..Marker::default()
    };
    let blue = ColorRgba { r: 0.1, g: 0.4, b: 1.0, a: 1.0 };
    let grey = ColorRgba { r: 0.6, g: 0.6, b: 0.6, a: 0.8 };
    let pyramid = frustum(camera);
    let edges = poses.iter().flat_map(|pose| pyramid.iter().map(move |p| vector(&(pose * p).coords))).collect();
    let centres = poses.iter().map(|pose| vector(&pose.translation.vector)).collect();
    MarkerArray { markers: vec![line(0, Marker::LINE_LIST, edges, blue), line(1, Marker::LINE_STRIP, centres, grey)] }
}

/// The eight edges of a view pyramid, two points each, in the camera frame.
fn frustum(camera: &Camera) -> Vec<Point3<f64>> {
    let corner = |u: f64, v: f64| {
        let (x, y) = ((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy);
        Point3::new(x, y, 1.0) * FRUSTUM_DEPTH
    };
    let (right, bottom) = (camera.width as f64, camera.height as f64);
    let corners = [corner(0.0, 0.0), corner(right, 0.0), corner(right, bottom), corner(0.0, bottom)];
    let around = (0..4).flat_map(|i| [corners[i], corners[(i + 1) % 4]]);
    corners.iter().flat_map(|&c| [Point3::origin(), c]).chain(around).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use pfd_geometry::Distortion;

    #[test]
    fn points_are_laid_out_as_the_fields_say() {
        let points = vec![(Point3::new(1.0, 2.0, 3.0), [10, 20, 30])];
        let cloud = cloud(points.into_iter(), Header::default());
        assert_eq!(cloud.data.len(), cloud.row_step as usize);
        assert_eq!(cloud.data[8..12], 3.0_f32.to_le_bytes());
        assert_eq!(cloud.data[12..16], [30, 20, 10, 0]);
        assert_eq!(cloud.fields[3].offset, 12);
    }

    #[test]
    fn a_keyframe_has_eight_edges() {
        let camera = Camera::new((640, 480), [500.0, 500.0, 320.0, 240.0], Distortion::default()).unwrap();
        let markers = keyframe_markers(&[Pose::translation(1.0, 0.0, 0.0)], &camera, &Header::default());
        assert_eq!(markers.markers[0].points.len(), 16);
        assert!((markers.markers[0].points[0].x - 1.0).abs() < 1e-12);
    }
}
