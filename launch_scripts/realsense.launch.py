"""SLAM beside the driver of config/realsense.yaml: ros2 launch pfd_slam realsense.launch.py [separate:=true]."""

import os
import sys

sys.path.insert(0, os.path.dirname(__file__))

from slam_launch import describe  # noqa: E402


def generate_launch_description():
    return describe("realsense.yaml")
