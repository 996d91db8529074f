#!/usr/bin/env bash
# SLAM beside an ASUS Xtion or another OpenNI 2 camera: xtion.sh [ROS arguments]. How to start its driver: see config/xtion.yaml.
# PFD_SLAM_SEPARATE=1 starts segmentation and tracking as separate processes.
source "$(dirname "$(realpath "${BASH_SOURCE[0]}")")/nodes.sh"
start_slam "$config/xtion.yaml" "$@"
wait -n
