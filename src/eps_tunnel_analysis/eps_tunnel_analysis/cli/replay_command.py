# SPDX-License-Identifier: Apache-2.0
"""replay: publishes recorded messages, so that the nodes work on bags."""

import argparse
from pathlib import Path

from eps_tunnel_analysis.cli.arguments import within
from labyrinth_sim.errors import InputError

NAME = "replay"
HELP = "Publishes a bag's messages with their timing, and /clock. Needs ROS 2."
EPILOG = """\
Messages are published as recorded, including their stamps. Start nodes with `-p use_sim_time:=true` to have them take
the time from /clock. Nothing is published on a topic on which another node publishes.

example, with `ros2 topic echo /srg` in another terminal:
  ros2 run eps_tunnel_analysis analysis_node --ros-args -p use_sim_time:=true &
  eps-tunnel replay out/paper_8s_real out/paper_8s_sim --speed 2"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("bags", nargs="+", metavar="BAG", type=Path, help="recordings, or folders of those")
    parser.add_argument(
        "--speed", type=within(1e-3, 1e3, "times"), default=1.0, metavar="X", help="1: as recorded (default: 1)"
    )
    parser.add_argument("--topics", nargs="+", default=[], metavar="TOPIC", help="publish these only")
    parser.add_argument("--most-pause", type=within(1e-3, 3600.0, "s"), default=5.0, metavar="S",
                        help="cut longer pauses, as between bags, to this (default: %(default)g)")  # fmt: skip
    parser.add_argument("--wait", type=within(0.0, 3600.0, "s"), default=2.0, metavar="S",
                        help="longest wait for subscribers before the start (default: %(default)g)")  # fmt: skip
    parser.add_argument("--no-clock", action="store_true", help="do not publish /clock")


def run(arguments: argparse.Namespace) -> None:
    try:
        from eps_tunnel_analysis.nodes.replay import Options, replay
    except ImportError as error:
        raise InputError(
            f"replay needs ROS 2, which is not found ({error}). Run `source env.bash`, or source your own ROS 2."
        ) from error
    from eps_tunnel_analysis.inputs import bags

    options = Options(
        arguments.speed, not arguments.no_clock, arguments.most_pause, arguments.wait, tuple(arguments.topics)
    )
    print(replay(bags(arguments.bags), options))
