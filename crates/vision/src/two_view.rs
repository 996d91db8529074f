//! Relations between two views of the same scene: fundamental matrix and homography, both by RANSAC.

use nalgebra::{Matrix3, Vector3};
use opencv::calib3d::{FM_RANSAC, RANSAC, find_fundamental_mat, find_homography_ext};
use opencv::core::{Mat, MatTraitConst, MatTraitConstManual, Point2f, Vector};

use crate::VisionError;

/// Iterations after which RANSAC gives up.
const MAX_ITERATIONS: i32 = 2000;
/// Probability with which RANSAC should have seen one sample without outliers.
const CONFIDENCE: f64 = 0.995;
/// Fewest pairs for the eight-point algorithm.
const MIN_FUNDAMENTAL_PAIRS: usize = 8;
/// Fewest pairs for a homography.
const MIN_HOMOGRAPHY_PAIRS: usize = 4;

/// A 3×3 relation between two views and which pairs agree with it.
#[derive(Clone, Debug, PartialEq)]
pub struct TwoView {
    /// `F` with `bᵀ F a = 0`, or `H` with `b ~ H a`.
    pub matrix: Matrix3<f64>,
    /// For each pair whether it agrees.
    pub inliers: Vec<bool>,
}

/// The fundamental matrix of pairs `a[i]` ↔ `b[i]`; `threshold` is the largest distance to the epipolar line, pixels.
/// `None` when there are too few pairs or they are degenerate.
///
/// # Errors
/// When OpenCV refuses.
pub fn fundamental(a: &[[f32; 2]], b: &[[f32; 2]], threshold: f64) -> Result<Option<TwoView>, VisionError> {
    if a.len() != b.len() || a.len() < MIN_FUNDAMENTAL_PAIRS {
        return Ok(None);
    }
    let mut inliers = Vector::<u8>::new();
    let (a, b) = (to_vector(a), to_vector(b));
    let f = find_fundamental_mat(&a, &b, FM_RANSAC, threshold, CONFIDENCE, MAX_ITERATIONS, &mut inliers)?;
    relation(&f, &inliers)
}

/// The homography of pairs `a[i]` → `b[i]`; `threshold` is the largest reprojection error, pixels.
/// `None` when there are too few pairs or they are degenerate.
///
/// # Errors
/// When OpenCV refuses.
pub fn homography(a: &[[f32; 2]], b: &[[f32; 2]], threshold: f64) -> Result<Option<TwoView>, VisionError> {
    if a.len() != b.len() || a.len() < MIN_HOMOGRAPHY_PAIRS {
        return Ok(None);
    }
    let mut inliers = Vector::<u8>::new();
    let (a, b) = (to_vector(a), to_vector(b));
    let h = find_homography_ext(&a, &b, RANSAC, threshold, &mut inliers, MAX_ITERATIONS, CONFIDENCE)?;
    relation(&h, &inliers)
}

/// Distance (pixels) of `b` from the epipolar line of `a`.
pub fn epipolar_distance(fundamental: &Matrix3<f64>, a: [f32; 2], b: [f32; 2]) -> f64 {
    let line = fundamental * Vector3::new(f64::from(a[0]), f64::from(a[1]), 1.0);
    let distance = line.x * f64::from(b[0]) + line.y * f64::from(b[1]) + line.z;
    distance.abs() / line.x.hypot(line.y).max(f64::MIN_POSITIVE)
}

/// The image of `p` under the homography; `None` at infinity.
pub fn map_point(homography: &Matrix3<f64>, p: [f32; 2]) -> Option<[f32; 2]> {
    let q = homography * Vector3::new(f64::from(p[0]), f64::from(p[1]), 1.0);
    (q.z.abs() > f64::EPSILON).then(|| [(q.x / q.z) as f32, (q.y / q.z) as f32])
}

fn relation(matrix: &Mat, inliers: &Vector<u8>) -> Result<Option<TwoView>, VisionError> {
    if matrix.rows() != 3 || matrix.cols() != 3 {
        return Ok(None);
    }
    let matrix = Matrix3::from_row_slice(matrix.data_typed::<f64>()?);
    let finite = matrix.iter().all(|x| x.is_finite());
    Ok(finite.then(|| TwoView { matrix, inliers: inliers.iter().map(|x| x != 0).collect() }))
}

fn to_vector(points: &[[f32; 2]]) -> Vector<Point2f> {
    points.iter().map(|&[x, y]| Point2f::new(x, y)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points of a grid and their image under `h`, the last one moved by 20 pixels.
    fn pairs(h: &Matrix3<f64>) -> (Vec<[f32; 2]>, Vec<[f32; 2]>) {
        let a: Vec<[f32; 2]> = (0..30).map(|i| [(i % 6) as f32 * 50.0, (i / 6) as f32 * 60.0]).collect();
        let mut b: Vec<[f32; 2]> = a.iter().map(|&p| map_point(h, p).unwrap()).collect();
        b[29][0] += 20.0;
        (a, b)
    }

    #[test]
    fn homography_of_known_points() {
        let truth = Matrix3::new(1.02, 0.03, 5.0, -0.02, 0.98, -3.0, 1e-5, 2e-5, 1.0);
        let (a, b) = pairs(&truth);
        let found = homography(&a, &b, 1.0).unwrap().unwrap();
        assert!((found.matrix / found.matrix[(2, 2)] - truth).norm() < 1e-2, "{}", found.matrix);
        assert!(found.inliers[..29].iter().all(|&x| x));
        assert!(!found.inliers[29]);
    }

    #[test]
    fn fundamental_of_a_sideways_camera() {
        // A camera moving along x by 0.1 m: rows stay, columns move by f·b/z.
        let a: Vec<[f32; 2]> = (0..40).map(|i| [(i * 37 % 640) as f32, (i * 53 % 480) as f32]).collect();
        let mut b: Vec<[f32; 2]> =
            a.iter().enumerate().map(|(i, p)| [p[0] - 50.0 / (1.0 + (i % 7) as f32 * 0.3), p[1]]).collect();
        b[3][1] += 15.0;
        let found = fundamental(&a, &b, 1.0).unwrap().unwrap();
        assert!(!found.inliers[3]);
        assert!(epipolar_distance(&found.matrix, a[5], b[5]) < 0.1);
        assert!(epipolar_distance(&found.matrix, a[3], b[3]) > 5.0);
    }

    #[test]
    fn too_few_pairs_have_no_relation() {
        assert_eq!(fundamental(&[[0.0; 2]; 7], &[[0.0; 2]; 7], 1.0).unwrap(), None);
        assert_eq!(homography(&[[0.0; 2]; 3], &[[0.0; 2]; 3], 1.0).unwrap(), None);
    }
}
