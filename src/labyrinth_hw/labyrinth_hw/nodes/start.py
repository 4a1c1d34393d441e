# SPDX-License-Identifier: Apache-2.0
"""How a node's program starts, with one line where words or ROS fail; and how it is spun until a signal ends it."""

import re
import sys
from collections.abc import Sequence

import rclpy
from rclpy.executors import Executor, ExternalShutdownException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

EXPECTED = "Expected `--ros-args -p PARAMETER:=VALUE ...`, `-r FROM:=TO` or `--params-file FILE`."


def start_ros(program: str, about: str, words: Sequence[str]) -> None:
    """Begins ROS with a program's words; signals are left to the caller.

    Args:
        about: one sentence for --help.
        words: after the program's name.

    Raises:
        SystemExit: after --help, with 0; for unknown words, with 2 and one line on stderr.
    """
    own = list(words)[: list(words).index("--ros-args") if "--ros-args" in words else len(words)]
    if "-h" in own or "--help" in own:
        print(f"{program}: {about} {EXPECTED} docs/reference.md and `ros2 param describe` list the parameters.")
        raise SystemExit(0)
    if own:
        refuse(program, f"Unknown argument '{own[0]}'.")
    try:
        rclpy.init(args=[program, *words], signal_handler_options=SignalHandlerOptions.NO)
    except rclpy_implementation.UnknownROSArgsError as error:
        refuse(program, f"Unknown ROS arguments {error}.")
    except rclpy_implementation.RCLError as error:  # what rcl expected, and where in its source, is of no help
        said = re.search(r"rcl: (.*?)(?:\. Error: (.*?))?(?:, at /.*)?$", str(error), re.DOTALL)
        refuse(program, f"{said[1]}." if said else str(error))


def refuse(program: str, complaint: str) -> None:
    """Ends the program with exit code 2."""
    print(f"{program}: {complaint} {EXPECTED}", file=sys.stderr)
    raise SystemExit(2)


def spin(node: Node, executor: Executor | None = None) -> None:
    """Serves a node's callbacks until its context is shut down, which a signal's handler may do at any moment.

    Args:
        executor: rclpy's global one if None.
    """
    try:
        rclpy.spin(node, executor)
    except ExternalShutdownException:
        pass
    except Exception:  # the context was taken away while the executor, or a callback, was using it
        if node.context.ok():
            raise
