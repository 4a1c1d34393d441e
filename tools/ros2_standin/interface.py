# SPDX-License-Identifier: Apache-2.0
"""`ros2 interface`: definitions of messages, services and actions."""

import argparse
import re
import sys
from pathlib import Path

from ament_index_python import PackageNotFoundError, get_package_share_directory, get_resource, get_resources

from ros2_standin.cli import argument, flag, verb

NESTED = re.compile(r"^\s*(?:(?P<package>[a-z]\w*)/)?(?P<name>[A-Z]\w*)(\[\S*\])?\s+[a-z]\w*\s*(#.*)?$")
KINDS = {"msg": "Messages", "srv": "Services", "action": "Actions"}


@verb(
    flag("-m", "--only-msgs", dest="msg", help="Print out only the message types"),
    flag("-s", "--only-srvs", dest="srv", help="Print out only the service types"),
    flag("-a", "--only-actions", dest="action", help="Print out only the action types"),
)
def list_(args: argparse.Namespace) -> None:
    """List all interface types available"""
    chosen = [kind for kind in KINDS if getattr(args, kind)] or list(KINDS)
    for kind in chosen:
        print(f"{KINDS[kind]}:")
        for package in sorted(get_resources("rosidl_interfaces")):
            lines, _ = get_resource("rosidl_interfaces", package)
            # An action's own messages and services are hidden, as in ros2cli.
            names = {str(Path(line).with_suffix("")) for line in lines.splitlines() if line.startswith(f"{kind}/")}
            for name in sorted(names):
                if "_" not in name:
                    print(f"    {package}/{name}")


@verb(
    flag("--all-comments", help="Show all comments, including for nested interfaces"),
    flag("--no-comments", help="Show no comments or whitespace"),
    argument("type", help="Interface (e.g. 'example_interfaces/msg/String'); - reads stdin"),
)
def show(args: argparse.Namespace) -> str | None:
    """Output the interface definition"""
    name = sys.stdin.readline().strip() if args.type == "-" else args.type
    try:
        _show(name, not args.no_comments, args.all_comments, 0)
    except (ValueError, LookupError) as error:
        return str(error)
    return None


def path_of(name: str) -> Path:
    """The file that defines `package/kind/Name`. Raises ValueError or LookupError, in ros2cli's words."""
    package, *kind = name.split("/")
    if len(kind) != 2:
        raise ValueError(f"Invalid name '{name}'. Expected three parts separated by '/'")
    try:
        path = Path(get_package_share_directory(package), kind[0], f"{kind[1]}.{kind[0]}")
    except PackageNotFoundError:
        raise LookupError(f"Unknown package '{package}'") from None
    if not path.is_file():
        raise LookupError(f"Could not find the interface '{path}'")
    return path


def _show(name: str, comments: bool, nested_comments: bool, indent: int) -> None:
    for line in path_of(name).read_text(encoding="utf-8").splitlines():
        text = line.rstrip() if comments else line.split("#")[0].strip()
        if text or comments:
            print("\t" * indent + text)
        if inner := NESTED.match(line):
            package = inner["package"] or name.split("/")[0]
            _show(f"{package}/msg/{inner['name']}", nested_comments, nested_comments, indent + 1)
