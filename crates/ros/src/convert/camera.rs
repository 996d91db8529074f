//! `sensor_msgs/CameraInfo`.

use pfd_geometry::{Camera, Distortion, Stamp};

use super::ConvertError;
use crate::messages::{sensor::CameraInfo, standard::Header};

/// The camera of a message: `K` and the `plumb_bob` distortion, or for images that were `rectified` the projection matrix `P`. A
/// message describes the raw images as well as those; which of them a topic carries it does not say.
///
/// # Errors
/// [`ConvertError::Camera`] when the camera is not calibrated, distorts in a way that is not supported, or its images are binned or cut
/// out.
pub fn camera_from_info(info: &CameraInfo, rectified: bool) -> Result<Camera, ConvertError> {
    check_whole(info)?;
    let size = (info.width as usize, info.height as usize);
    let ([fx, _, cx, _, fy, cy, ..], [px, _, pcx, _, _, py, pcy, ..]) = (info.k, info.p);
    let (intrinsics, distortion) =
        if rectified { ([px, py, pcx, pcy], Distortion::default()) } else { ([fx, fy, cx, cy], distortion(info)?) };
    Camera::new(size, intrinsics, distortion).map_err(|e| ConvertError::Camera(e.to_string()))
}

/// Whether the images are those that the intrinsics are for, and no part of them and not smaller.
fn check_whole(info: &CameraInfo) -> Result<(), ConvertError> {
    let refused = |what: String| Err(ConvertError::Camera(format!("{what} is not supported: publish whole images")));
    if info.binning_x > 1 || info.binning_y > 1 {
        return refused(format!("binning {}x{}", info.binning_x, info.binning_y));
    }
    let roi = &info.roi;
    let is_whole = |offset, size, whole| offset == 0 && (size == 0 || size == whole);
    if is_whole(roi.x_offset, roi.width, info.width) && is_whole(roi.y_offset, roi.height, info.height) {
        return Ok(());
    }
    refused(format!("a region of interest ({}x{} at {}, {})", roi.width, roi.height, roi.x_offset, roi.y_offset))
}

fn distortion(info: &CameraInfo) -> Result<Distortion, ConvertError> {
    if info.d.iter().all(|&c| c == 0.0) {
        return Ok(Distortion::default());
    }
    let mut coefficients = [0.0; 5];
    let is_plumb_bob = matches!(info.distortion_model.as_str(), "plumb_bob" | "");
    let higher_are_zero = info.d.iter().skip(coefficients.len()).all(|&c| c == 0.0);
    // A rational model without its denominator is a plumb bob.
    let is_reduced = info.distortion_model == "rational_polynomial" && higher_are_zero;
    if !(is_plumb_bob || is_reduced) {
        let reason = "is not supported: use plumb_bob, or subscribe rectified images and set parameter `rectified`";
        return Err(ConvertError::Camera(format!("distortion model `{}` {reason}", info.distortion_model)));
    }
    coefficients.iter_mut().zip(&info.d).for_each(|(to, &from)| *to = from);
    Ok(Distortion(coefficients))
}

/// The message of a camera; every number goes over exactly.
pub fn camera_to_info(camera: &Camera, stamp: Stamp, frame: &str) -> CameraInfo {
    let Camera { fx, fy, cx, cy, .. } = *camera;
    CameraInfo {
        header: Header::new(stamp, frame),
        height: camera.height as u32,
        width: camera.width as u32,
        distortion_model: "plumb_bob".to_owned(),
        d: camera.distortion.0.to_vec(),
        k: [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
        ..CameraInfo::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn freiburg1() -> Camera {
        let distortion = Distortion([0.2624, -0.9531, -0.0054, 0.0026, 1.1633]);
        Camera::new((640, 480), [517.3, 516.5, 318.6, 255.3], distortion).unwrap()
    }

    #[test]
    fn cameras_go_over_exactly() {
        let info = camera_to_info(&freiburg1(), Stamp::default(), "c");
        assert_eq!(camera_from_info(&info, false).unwrap(), freiburg1());
    }

    #[test]
    fn rectified_images_have_the_projection_matrix_and_no_distortion() {
        let mut info = camera_to_info(&freiburg1(), Stamp::default(), "c");
        info.distortion_model = "equidistant".into();
        info.p = [500.0, 0.0, 320.0, 0.0, 0.0, 501.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0];
        let rectified = Camera::new((640, 480), [500.0, 501.0, 320.0, 240.0], Distortion::default()).unwrap();
        assert_eq!(camera_from_info(&info, true).unwrap(), rectified);
    }

    #[test]
    fn what_cannot_be_used_is_refused() {
        let good = camera_to_info(&freiburg1(), Stamp::default(), "c");
        let fisheye = CameraInfo { distortion_model: "equidistant".into(), ..good.clone() };
        assert!(camera_from_info(&fisheye, false).unwrap_err().to_string().contains("equidistant"));
        assert!(camera_from_info(&CameraInfo { k: [0.0; 9], ..good.clone() }, false).is_err(), "uncalibrated");
        assert!(camera_from_info(&CameraInfo { p: [0.0; 12], ..good.clone() }, true).is_err(), "not rectified");
        let binned = CameraInfo { binning_x: 2, ..good.clone() };
        assert!(camera_from_info(&binned, false).unwrap_err().to_string().contains("binning 2x0"));
        let mut whole = good.clone();
        (whole.roi.width, whole.roi.height) = (640, 480);
        assert!(camera_from_info(&whole, false).is_ok());
        whole.roi.height = 240;
        assert!(camera_from_info(&whole, false).unwrap_err().to_string().contains("640x240 at 0, 0"));
        let mut rational = CameraInfo { distortion_model: "rational_polynomial".into(), ..good };
        rational.d.extend([0.0; 3]);
        assert_eq!(camera_from_info(&rational, false).unwrap(), freiburg1());
        rational.d[7] = 0.1;
        assert!(camera_from_info(&rational, false).is_err());
    }

    proptest! {
        #[test]
        fn any_message_is_a_camera_or_refused(
            k in prop::array::uniform9(any::<f64>()), d in prop::collection::vec(any::<f64>(), 0..9),
            width in any::<u32>(), height in any::<u32>(), model in ".{0,4}", rectified in any::<bool>(),
        ) {
            let info = CameraInfo { k, d, width, height, distortion_model: model, ..CameraInfo::default() };
            if let Ok(camera) = camera_from_info(&info, rectified) {
                prop_assert!(camera.fx > 0.0 && camera.width <= Camera::MAX_SIDE);
            }
        }
    }
}
