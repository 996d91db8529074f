"""SLAM beside the driver of config/xtion.yaml: ros2 launch pfd_slam xtion.launch.py [separate:=true]."""

import os
import sys

sys.path.insert(0, os.path.dirname(__file__))

from slam_launch import describe  # noqa: E402


def generate_launch_description():
    return describe("xtion.yaml")
