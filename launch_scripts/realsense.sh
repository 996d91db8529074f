#!/usr/bin/env bash
# SLAM beside an Intel RealSense: realsense.sh [ROS arguments]. How to start its driver: see config/realsense.yaml.
# PFD_SLAM_SEPARATE=1 starts segmentation and tracking as separate processes.
source "$(dirname "$(realpath "${BASH_SOURCE[0]}")")/nodes.sh"
start_slam "$config/realsense.yaml" "$@"
wait -n
