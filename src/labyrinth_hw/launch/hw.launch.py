# SPDX-License-Identifier: Apache-2.0
"""The hardware node: `ros2 launch labyrinth_hw hw.launch.py config:=/path/to/my_rig.yaml`.

It configures itself and is then armed by `ros2 service call /real/arm std_srvs/srv/SetBool "{data: true}"`, by
`ros2 lifecycle set /hw_node activate`, or from the start by arm:=true.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterValue


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="", description="ROS namespace of the whole rig."),
            DeclareLaunchArgument("config", default_value="paper", description="Name or path of a config/hw file."),
            DeclareLaunchArgument("arm", default_value="false", description="Whether commands move it from the start."),
            DeclareLaunchArgument(
                "disarm_after", default_value="60.0", description="Silence after which it disarms itself, s; 0: never."
            ),
            # The node configures itself (its parameter `autostart`), so that it does so without launch, too.
            LifecycleNode(
                package="labyrinth_hw",
                executable="hw_node",
                name="hw_node",
                namespace=LaunchConfiguration("namespace"),
                output="screen",
                parameters=[
                    {
                        "config": LaunchConfiguration("config"),
                        "arm": ParameterValue(LaunchConfiguration("arm"), value_type=bool),
                        "disarm_after": ParameterValue(LaunchConfiguration("disarm_after"), value_type=float),
                    }
                ],
            ),
        ]
    )
