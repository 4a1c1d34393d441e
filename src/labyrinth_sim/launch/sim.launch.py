# SPDX-License-Identifier: Apache-2.0
"""The MuJoCo simulation: `ros2 launch labyrinth_sim sim.launch.py model:=labyrinth`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue


def generate_launch_description() -> LaunchDescription:
    factor = ParameterValue(LaunchConfiguration("real_time_factor"), value_type=float)
    return LaunchDescription(
        [
            DeclareLaunchArgument("model", default_value="labyrinth", description="Name or path of a model."),
            DeclareLaunchArgument("real_time_factor", default_value="1.0", description="Simulated over real seconds."),
            Node(
                package="labyrinth_sim",
                executable="sim_node",
                output="screen",
                parameters=[{"model": LaunchConfiguration("model"), "real_time_factor": factor}],
            ),
        ]
    )
