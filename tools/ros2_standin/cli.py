# SPDX-License-Identifier: Apache-2.0
"""Parses `ros2 COMMAND VERB ...`, runs the verb and turns its outcome into an exit code."""

import argparse
import signal
import sys
from collections.abc import Sequence

from ros2_standin.verbs import action, interface, node, param, pkg, run, service, topic

COMMANDS = (action, interface, node, param, pkg, run, service, topic)

# Commands of the real ros2 that are not here, with the Debian package that has them and what serves here meanwhile.
ELSEWHERE = {
    "bag": ("ros2bag", "`eps-tunnel replay BAG` plays a bag; the action /play_sequence records one."),
    "component": ("ros2component", ""),
    "control": ("ros2controlcli", ""),
    "daemon": ("ros2cli", "No daemon is needed here: every command discovers for itself."),
    "doctor": ("ros2doctor", ""),
    "launch": ("ros2launch", "`ros2 run PACKAGE EXECUTABLE` starts the nodes one by one."),
    "lifecycle": ("ros2lifecycle", ""),
    "multicast": ("ros2multicast", ""),
    "plugin": ("ros2plugin", ""),
    "security": ("sros2", ""),
    "wtf": ("ros2doctor", ""),
}


def parser() -> argparse.ArgumentParser:
    top = argparse.ArgumentParser(
        prog="ros2",
        description="ros2 is an extensible command-line tool for ROS 2. (stand-in; install ROS 2 for all commands)",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    listing = "\n".join(f"{c.NAME:<10} {(c.__doc__ or '').splitlines()[0]}" for c in COMMANDS)
    commands = top.add_subparsers(
        title="Commands", description=listing, metavar="Call `ros2 <command> -h` for more detailed usage."
    )
    for command in COMMANDS:
        sub = commands.add_parser(command.NAME, description=(command.__doc__ or "").splitlines()[0])
        sub.set_defaults(call=None, help=sub.print_help)
        command.add_arguments(sub)
    return top


def main(argv: Sequence[str] | None = None) -> int | str | None:
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments and arguments[0] in ELSEWHERE:
        package, meanwhile = ELSEWHERE[arguments[0]]
        print(
            f"ros2: '{arguments[0]}' is not in this stand-in. Install ROS 2 and the package ros-$ROS_DISTRO-{package}, "
            f"then source its setup file; its ros2 goes before this one. {meanwhile}".rstrip(),
            file=sys.stderr,
        )
        return 2
    top = parser()
    parsed = top.parse_args(arguments)
    call = getattr(parsed, "call", None)
    if call is None:
        getattr(parsed, "help", top.print_help)()
        return 0
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    return _outcome(call, parsed)


def _outcome(call: object, parsed: argparse.Namespace) -> int | str | None:
    """What the verb returned; text means an error (printed to stderr, exit code 1), as in ros2cli."""
    from rclpy.executors import ExternalShutdownException

    try:
        return call(parsed)  # type: ignore[operator,no-any-return]
    except KeyboardInterrupt:
        return int(signal.SIGINT)
    except ExternalShutdownException:
        return int(signal.SIGTERM)
    except BrokenPipeError:
        # `ros2 topic list | head -1`: nobody reads on, so there is nothing left to say.
        sys.stdout = None  # type: ignore[assignment]
        return 0
    except RuntimeError as error:
        return str(error)
