"""Replays a sequence in TUM layout: ros2 launch pfd_slam replay.launch.py sequence:=PATH [rate:=1.0] [separate:=true]."""

import os
import sys

sys.path.insert(0, os.path.dirname(__file__))

from launch.actions import DeclareLaunchArgument, EmitEvent  # noqa: E402
from launch.events import Shutdown  # noqa: E402
from launch.substitutions import LaunchConfiguration, PythonExpression  # noqa: E402
from launch_ros.actions import Node  # noqa: E402
from launch_ros.parameter_descriptions import ParameterValue  # noqa: E402

from slam_launch import describe  # noqa: E402


def generate_launch_description():
    description = describe("replay.yaml")
    # The first frames are for all of them.
    nodes = PythonExpression(["2 if '", LaunchConfiguration("separate"), "'.lower() in ('true', '1') else 1"])
    description.add_action(DeclareLaunchArgument("sequence", description="folder in TUM layout, or its .tgz"))
    description.add_action(DeclareLaunchArgument("rate", default_value="1.0", description="0: as fast as possible"))
    description.add_action(Node(
        package="pfd_slam",
        executable="bag_replay_node",
        namespace=LaunchConfiguration("namespace"),
        parameters=[LaunchConfiguration("params_file"), {
            "sequence": LaunchConfiguration("sequence"),
            "rate": ParameterValue(LaunchConfiguration("rate"), value_type=float),
            "wait_for_subscribers": ParameterValue(nodes, value_type=int),
        }],
        output="screen",
        on_exit=EmitEvent(event=Shutdown(reason="the sequence has ended")),
    ))
    return description
