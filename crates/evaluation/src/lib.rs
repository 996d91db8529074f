//! Trajectory and mask metrics: ATE, RPE, precision, recall, IoU
