//! `pfd_slam_msgs`. The nodes fill the messages; only what needs care with layout is here.

use nalgebra::{Matrix4, Vector4};

/// Row by row.
pub fn matrix_to_rows(matrix: &Matrix4<f64>) -> [f64; 16] {
    std::array::from_fn(|i| matrix[(i / 4, i % 4)])
}

/// In order.
pub fn vector_to_array(vector: &Vector4<f64>) -> [f64; 4] {
    (*vector).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matrices_go_row_by_row() {
        let rows = matrix_to_rows(&Matrix4::from_fn(|r, c| (10 * r + c) as f64));
        assert_eq!((rows[1], rows[4]), (1.0, 10.0));
    }
}
