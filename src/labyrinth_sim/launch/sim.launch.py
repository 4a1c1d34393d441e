# SPDX-License-Identifier: Apache-2.0
"""The MuJoCo simulation: `ros2 launch labyrinth_sim sim.launch.py model:=labyrinth`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterValue


def generate_launch_description() -> LaunchDescription:
    factor = ParameterValue(LaunchConfiguration("real_time_factor"), value_type=float)
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="", description="ROS namespace of the whole rig."),
            DeclareLaunchArgument("model", default_value="labyrinth", description="Name or path of a model."),
            DeclareLaunchArgument("real_time_factor", default_value="1.0", description="Simulated over real seconds."),
            DeclareLaunchArgument(
                "publish_clock", default_value="false", description="Whether /clock is published even at a factor of 1."
            ),
            # The node configures itself (its parameter `autostart`), so that it does so without launch, too.
            LifecycleNode(
                package="labyrinth_sim",
                executable="sim_node",
                name="sim_node",
                namespace=LaunchConfiguration("namespace"),
                output="screen",
                parameters=[
                    {
                        "model": LaunchConfiguration("model"),
                        "real_time_factor": factor,
                        "publish_clock": ParameterValue(LaunchConfiguration("publish_clock"), value_type=bool),
                    }
                ],
            ),
        ]
    )
