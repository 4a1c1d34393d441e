# SPDX-License-Identifier: Apache-2.0
"""The emulated testbed and the hardware node on it: `ros2 launch labyrinth_hw testbed.launch.py config:=paper`.

Nothing can be harmed here, so it starts armed.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    hardware = PathJoinSubstitution([FindPackageShare("labyrinth_hw"), "launch", "hw.launch.py"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="", description="ROS namespace of the whole rig."),
            DeclareLaunchArgument(
                "config", default_value="paper", description="Name or path of a config/testbed file."
            ),
            DeclareLaunchArgument("hw_config", default_value="paper", description="Name or path of a config/hw file."),
            DeclareLaunchArgument("arm", default_value="true", description="Whether commands move it from the start."),
            DeclareLaunchArgument(
                "disarm_after", default_value="0.0", description="Silence after which it disarms itself, s; 0: never."
            ),
            DeclareLaunchArgument("seed", default_value="1", description="Seed of the testbed's noise."),
            Node(
                package="labyrinth_hw",
                executable="testbed",
                output="screen",
                arguments=["--config", LaunchConfiguration("config"), "--seed", LaunchConfiguration("seed")],
            ),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(hardware),
                launch_arguments={
                    "namespace": LaunchConfiguration("namespace"),
                    "config": LaunchConfiguration("hw_config"),
                    "arm": LaunchConfiguration("arm"),
                    "disarm_after": LaunchConfiguration("disarm_after"),
                }.items(),
            ),
        ]
    )
