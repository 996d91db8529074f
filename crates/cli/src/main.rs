//! The offline command line of PFD-SLAM.
fn main() {}
