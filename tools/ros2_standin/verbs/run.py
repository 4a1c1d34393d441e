# SPDX-License-Identifier: Apache-2.0
"""Run a package specific executable"""

import argparse
import os
import shlex
import sys

from ros2_standin.verbs.pkg import executables_of

NAME = "run"


def run(args: argparse.Namespace) -> None:
    paths = [path for path in executables_of(args.package_name) if os.path.basename(path) == args.executable_name]
    if not paths:
        raise RuntimeError("No executable found")
    if len(paths) > 1:
        raise RuntimeError("\n- ".join(["Multiple executables found:", *paths]))
    command = [*shlex.split(args.prefix or ""), paths[0], *args.argv]
    sys.stdout.flush()
    # This process becomes the node: Ctrl-C, SIGTERM and SIGKILL reach it, and its exit code is the node's own.
    os.execvp(command[0], command)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--prefix",
        help="Prefix command, which should go before the executable. Command must be wrapped in quotes if it contains "
        "spaces (e.g. --prefix 'gdb -ex run --args').",
    )
    parser.add_argument("package_name", help="Name of the ROS package")
    parser.add_argument("executable_name", help="Name of the executable")
    parser.add_argument("argv", nargs=argparse.REMAINDER, help="Pass arbitrary arguments to the executable")
    parser.set_defaults(call=run)
