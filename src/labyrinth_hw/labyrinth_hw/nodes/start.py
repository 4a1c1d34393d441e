# SPDX-License-Identifier: Apache-2.0
"""How a node's program starts: its words checked, ROS begun, one line where either fails."""

import re
import sys
from collections.abc import Sequence

import rclpy
from rclpy.impl.implementation_singleton import rclpy_implementation
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
