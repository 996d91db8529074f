//! Parameters: ROS 2 parameter files, descriptions, validation
