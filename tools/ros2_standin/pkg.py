# SPDX-License-Identifier: Apache-2.0
"""`ros2 pkg`: packages and their executables."""

import argparse
import os
from pathlib import Path

from ament_index_python import PackageNotFoundError, get_package_prefix, get_packages_with_prefixes

from ros2_standin.cli import argument, flag, verb


def executables_of(package: str) -> list[str]:
    """Paths of the package's executables, sorted. Raises RuntimeError for an unknown package."""
    try:
        folder = Path(get_package_prefix(package)) / "lib" / package
    except (PackageNotFoundError, ValueError):
        raise RuntimeError(f"Package '{package}' not found") from None
    return sorted(
        str(file)
        for file in folder.rglob("*")
        if file.is_file() and os.access(file, os.X_OK) and not any(p.startswith(".") for p in file.parent.parts)
    )


def executable(package: str, name: str) -> str:
    """Path of one executable. Raises RuntimeError where there is none, or more than one."""
    paths = [path for path in executables_of(package) if os.path.basename(path) == name]
    if len(paths) > 1:
        raise RuntimeError("\n- ".join(["Multiple executables found:", *paths]))
    if not paths:
        raise RuntimeError("No executable found")
    return paths[0]


@verb(
    argument("package_name", nargs="?", help="The package name"),
    flag("--full-path", help="Show full path of each executable"),
)
def executables(args: argparse.Namespace) -> None:
    """Output a list of package specific executables"""
    for package in [args.package_name] if args.package_name else sorted(get_packages_with_prefixes()):
        for path in executables_of(package):
            print(path if args.full_path else f"{package} {os.path.basename(path)}")


@verb()
def list_(args: argparse.Namespace) -> None:
    """Output a list of available packages"""
    print(*sorted(get_packages_with_prefixes()), sep="\n")


@verb(
    argument("package_name", help="The package name"),
    flag("--share", help="Show share directory for the package"),
)
def prefix(args: argparse.Namespace) -> str | None:
    """Output the prefix path of a package"""
    try:
        path = get_package_prefix(args.package_name)
    except (PackageNotFoundError, ValueError):
        return "Package not found"
    print(os.path.join(path, "share", args.package_name) if args.share else path)
    return None
