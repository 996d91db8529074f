"""What the launch files have in common: slam_node, or segmentation_node and tracking_node with separate:=true."""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def node(executable, parameters, condition):
    return Node(
        package="pfd_slam",
        executable=executable,
        namespace=LaunchConfiguration("namespace"),
        parameters=[LaunchConfiguration("params_file"), *parameters],
        condition=condition,
        output="screen",
    )


def describe(config):
    """The nodes with the parameters of a file in config/."""
    default = os.path.join(get_package_share_directory("pfd_slam"), "config", config)
    common = [{"use_sim_time": LaunchConfiguration("use_sim_time")}]
    separate = LaunchConfiguration("separate")
    return LaunchDescription([
        DeclareLaunchArgument("params_file", default_value=default, description="parameter file"),
        DeclareLaunchArgument("namespace", default_value="", description="namespace of the nodes"),
        DeclareLaunchArgument("use_sim_time", default_value="false", description="take the time from /clock"),
        DeclareLaunchArgument("separate", default_value="false", description="segmentation and tracking apart"),
        node("slam_node", common, UnlessCondition(separate)),
        node("segmentation_node", common, IfCondition(separate)),
        node("tracking_node", common, IfCondition(separate)),
    ])
