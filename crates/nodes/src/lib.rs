//! ROS 2 nodes: segmentation, tracking, bag replay, composed
