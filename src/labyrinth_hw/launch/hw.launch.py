# SPDX-License-Identifier: Apache-2.0
"""The hardware node: `ros2 launch labyrinth_hw hw.launch.py config:=/path/to/my_rig.yaml`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription(
        [
            DeclareLaunchArgument("config", default_value="paper", description="Name or path of a config/hw file."),
            Node(
                package="labyrinth_hw",
                executable="hw_node",
                output="screen",
                parameters=[{"config": LaunchConfiguration("config")}],
            ),
        ]
    )
