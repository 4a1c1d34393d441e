# SPDX-License-Identifier: Apache-2.0
"""Both sides, the analysis and the player.

On the emulated rig: `ros2 launch eps_tunnel_analysis study.launch.py sequence:=paper_8s record:=true`.
On a real one: `... emulated:=false hw_config:=/path/to/my_rig.yaml`.
Faster than real time, the simulation alone: `... real:=false real_time_factor:=4.0 use_sim_time:=true`.
Without a sequence the player waits for goals on play_sequence.
"""

from launch import LaunchDescription, SomeSubstitutionsType
from launch.actions import DeclareLaunchArgument, GroupAction, IncludeLaunchDescription
from launch.conditions import IfCondition, UnlessCondition
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

ARGUMENTS: dict[str, tuple[SomeSubstitutionsType, str]] = {
    "namespace": ("", "ROS namespace of the whole rig, simulation and analysis with it."),
    "real": ("true", "Whether a rig takes part; false plays on the simulation alone."),
    "emulated": ("true", "Whether the emulated testbed stands in for the rig."),
    "testbed_config": ("paper", "Name or path of a config/testbed file, where emulated."),
    "hw_config": ("paper", "Name or path of a config/hw file."),
    "model": ("labyrinth", "Name or path of the model that is compared with the rig."),
    "real_time_factor": ("1.0", "Simulated over real seconds; if it is not 1, give use_sim_time:=true."),
    "publish_clock": ("false", "Whether the simulation publishes /clock even at a factor of 1."),
    "use_sim_time": ("false", "Whether player and analysis_node follow /clock."),
    "params_file": (
        PathJoinSubstitution([FindPackageShare("eps_tunnel_analysis"), "config", "nodes", "eps_tunnel_analysis.yaml"]),
        "Parameters of player and analysis_node.",
    ),
    "sequence": ("", "Name or path of a sequence to play at once; empty: wait for goals."),
    "trials": ("0", "Number of trials; 0: as the sequence says."),
    "record": ("false", "Whether one bag per side is recorded."),
    "folder": ("", "Folder for the bags; empty: a new one under out/."),
    "monitor": ("false", "Whether the web page is served, on http://localhost:8765/."),
}


def part(package: str, file: str, arguments: dict[str, str], condition: object = None) -> IncludeLaunchDescription:
    """Another launch file, with its arguments taken from ours."""
    path = PathJoinSubstitution([FindPackageShare(package), "launch", file])
    given = {name: LaunchConfiguration(ours) for name, ours in arguments.items()}
    return IncludeLaunchDescription(
        PythonLaunchDescriptionSource(path), launch_arguments=given.items(), condition=condition
    )


def generate_launch_description() -> LaunchDescription:
    real, emulated = LaunchConfiguration("real"), LaunchConfiguration("emulated")
    time = {"use_sim_time": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)}
    play = {
        "sequence": ParameterValue(LaunchConfiguration("sequence"), value_type=str),
        "trials": ParameterValue(LaunchConfiguration("trials"), value_type=int),
        "record": ParameterValue(LaunchConfiguration("record"), value_type=bool),
        "folder": ParameterValue(LaunchConfiguration("folder"), value_type=str),
        **time,
    }
    file, space = LaunchConfiguration("params_file"), LaunchConfiguration("namespace")
    testbed = {"config": "testbed_config", "hw_config": "hw_config", "namespace": "namespace"}
    hardware = {"config": "hw_config", "namespace": "namespace"}
    simulation = {name: name for name in ("namespace", "model", "real_time_factor", "publish_clock")}

    def node(executable: str, *parameters: object, condition: object = None) -> Node:
        return Node(
            package="eps_tunnel_analysis",
            executable=executable,
            namespace=space,
            output="screen",
            parameters=[file, *parameters],
            condition=condition,
        )

    return LaunchDescription(
        [
            *(DeclareLaunchArgument(n, default_value=v, description=d) for n, (v, d) in ARGUMENTS.items()),
            GroupAction(
                [
                    part("labyrinth_hw", "testbed.launch.py", testbed, IfCondition(emulated)),
                    part("labyrinth_hw", "hw.launch.py", hardware, UnlessCondition(emulated)),
                ],
                condition=IfCondition(real),
            ),
            part("labyrinth_sim", "sim.launch.py", simulation),
            node("analysis_node", time),
            node("player", play, condition=IfCondition(real)),
            node("player", play, {"sides": ["sim"]}, condition=UnlessCondition(real)),
            node("monitor", condition=IfCondition(LaunchConfiguration("monitor"))),
        ]
    )
