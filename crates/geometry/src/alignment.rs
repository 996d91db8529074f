//! Rigid alignment of two point sets.

use crate::Pose;
use nalgebra::{Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// The rigid motion `T_a_b` that minimises `Σ |a_i − T_a_b b_i|²` (Umeyama, PAMI 1991, eq. 40–42, with scale 1).
///
/// `None` when there are fewer than three pairs. For points on a line the rotation about it is arbitrary; the residual is still
/// the least.
pub fn align(pairs: &[(Point3<f64>, Point3<f64>)]) -> Option<Pose> {
    if pairs.len() < 3 {
        return None;
    }
    let (mean_a, mean_b) = centroids(pairs);
    let covariance: Matrix3<f64> =
        pairs.iter().map(|(a, b)| (a.coords - mean_a) * (b.coords - mean_b).transpose()).sum();
    let svd = covariance.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    // A reflection is turned into a rotation along the direction of least variance (singular values are sorted).
    let sign = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * sign * v_t));
    let translation = Translation3::from(mean_a - rotation * mean_b);
    Some(Pose::from_parts(translation, rotation))
}

fn centroids(pairs: &[(Point3<f64>, Point3<f64>)]) -> (Vector3<f64>, Vector3<f64>) {
    let count = pairs.len() as f64;
    let mean_a = pairs.iter().map(|(a, _)| a.coords).sum::<Vector3<f64>>() / count;
    let mean_b = pairs.iter().map(|(_, b)| b.coords).sum::<Vector3<f64>>() / count;
    (mean_a, mean_b)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn finds_the_motion(
            points in prop::collection::vec(prop::array::uniform3(-5.0..5.0_f64), 4..20),
            axis in prop::array::uniform3(-2.0..2.0_f64),
            shift in prop::array::uniform3(-9.0..9.0_f64),
        ) {
            let motion = Pose::new(Vector3::from(shift), Vector3::from(axis));
            let pairs: Vec<_> = points.iter().map(|p| Point3::from(*p)).map(|p| (motion * p, p)).collect();
            let found = align(&pairs).unwrap();
            for (a, b) in pairs {
                prop_assert!((found * b - a).norm() < 1e-6);
            }
        }
    }

    /// Mirrored corners of a box, which no rotation maps onto each other.
    fn mirrored() -> Vec<(Point3<f64>, Point3<f64>)> {
        let points = [[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0], [0.0, 0.0, 0.0]];
        points.map(|p| (Point3::new(-p[0], p[1], p[2]), Point3::from(p))).to_vec()
    }

    /// `Σ |a_i − T_a_b b_i|²`.
    fn cost(pairs: &[(Point3<f64>, Point3<f64>)], motion: &Pose) -> f64 {
        pairs.iter().map(|(a, b)| (a - motion * b).norm_squared()).sum()
    }

    proptest! {
        #[test]
        fn a_mirrored_set_gets_the_best_rotation(axis in prop::array::uniform3(-2.0..2.0_f64)) {
            let pairs = mirrored();
            let found = align(&pairs).unwrap();
            let (mean_a, mean_b) = centroids(&pairs);
            // Near the motion found and far from it; the centroids on each other.
            for scale in [0.01, 0.1, 1.0] {
                let rotation = UnitQuaternion::new(scale * Vector3::from(axis)) * found.rotation;
                let other = Pose::from_parts(Translation3::from(mean_a - rotation * mean_b), rotation);
                prop_assert!(cost(&pairs, &found) <= cost(&pairs, &other) + 1e-9);
            }
        }
    }

    #[test]
    fn two_pairs_are_too_few() {
        assert!(align(&mirrored()[..2]).is_none());
    }
}
