# SPDX-License-Identifier: Apache-2.0
"""Show information about ROS interfaces"""

import argparse
import re
import sys
from pathlib import Path

from ament_index_python import PackageNotFoundError, get_package_share_directory

from ros2_standin.verbs import add_verbs

NAME = "interface"
NESTED = re.compile(r"^\s*(?P<package>[a-z]\w*)/(?P<name>[A-Z]\w*)(\[\S*\])?\s+\w+")
OWN = re.compile(r"^\s*(?P<name>[A-Z]\w*)(\[\S*\])?\s+[a-z]\w*\s*(#.*)?$")


def show(args: argparse.Namespace) -> str | None:
    """Output the interface definition"""
    name = sys.stdin.readline().strip() if args.type == "-" else args.type
    try:
        _show(name, comments=not args.no_comments, nested_comments=args.all_comments, indent=0)
    except (ValueError, LookupError) as error:
        return str(error)
    return None


def path_of(name: str) -> Path:
    """The file that defines `package/kind/Name`. Raises ValueError or LookupError, in ros2cli's words."""
    parts = name.split("/")
    if len(parts) != 3:
        raise ValueError(f"Invalid name '{name}'. Expected three parts separated by '/'")
    try:
        path = Path(get_package_share_directory(parts[0])) / f"{name.removeprefix(parts[0] + '/')}.{parts[1]}"
    except PackageNotFoundError:
        raise LookupError(f"Unknown package '{parts[0]}'") from None
    if not path.is_file():
        raise LookupError(f"Could not find the interface '{path}'")
    return path


def _show(name: str, comments: bool, nested_comments: bool, indent: int) -> None:
    for line in path_of(name).read_text().splitlines():
        text = line.rstrip() if comments else line.split("#")[0].strip()
        if text:
            print("\t" * indent + text)
        elif comments:
            print()
        if inner := NESTED.match(line):
            package = inner["package"]
        elif inner := OWN.match(line):
            package = name.split("/")[0]
        else:
            continue
        _show(f"{package}/msg/{inner['name']}", nested_comments, nested_comments, indent + 1)


def _show_arguments(parser: argparse.ArgumentParser) -> None:
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--all-comments", action="store_true", help="Show all comments, including for nested interfaces")
    which.add_argument("--no-comments", action="store_true", help="Show no comments or whitespace")
    parser.add_argument(
        "type", help="Show an interface definition (e.g. 'example_interfaces/msg/String'); - reads stdin"
    )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_verbs(parser, NAME, {"show": (show, _show_arguments)})
