//! Sparse non-linear least squares on faer; knows no SLAM
