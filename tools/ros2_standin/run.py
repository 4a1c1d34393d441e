# SPDX-License-Identifier: Apache-2.0
"""`ros2 run`."""

import argparse
import os
import shlex
import sys

from ros2_standin.cli import argument, verb
from ros2_standin.pkg import executable


@verb(
    argument("--prefix", default="", help="Command that goes before the executable (e.g. 'gdb -ex run --args')"),
    argument("package_name", help="Name of the ROS package"),
    argument("executable_name", help="Name of the executable"),
    argument("argv", nargs=argparse.REMAINDER, help="Pass arbitrary arguments to the executable"),
)
def run(args: argparse.Namespace) -> None:
    """Run a package specific executable"""
    command = [*shlex.split(args.prefix), executable(args.package_name, args.executable_name), *args.argv]
    sys.stdout.flush()
    # This process becomes the node: Ctrl-C, SIGTERM and SIGKILL reach it, and its exit code is the node's own.
    os.execvp(command[0], command)
