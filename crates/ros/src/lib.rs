//! ROS 2 transport; the only crate that knows ros2-client
