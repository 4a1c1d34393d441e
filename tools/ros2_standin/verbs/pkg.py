# SPDX-License-Identifier: Apache-2.0
"""Various package related sub-commands"""

import argparse
import os
from pathlib import Path

from ament_index_python import PackageNotFoundError, get_package_prefix, get_packages_with_prefixes

from ros2_standin.verbs import add_verbs

NAME = "pkg"


def executables_of(package: str) -> list[str]:
    """Paths of the package's executables, sorted. Raises RuntimeError for an unknown package."""
    try:
        folder = Path(get_package_prefix(package)) / "lib" / package
    except (PackageNotFoundError, ValueError):
        raise RuntimeError(f"Package '{package}' not found") from None
    found = []
    for parent, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]
        found += [path for name in files if os.access(path := os.path.join(parent, name), os.X_OK)]
    return sorted(found)


def executables(args: argparse.Namespace) -> None:
    """Output a list of package specific executables"""
    packages = [args.package_name] if args.package_name else sorted(get_packages_with_prefixes())
    for package in packages:
        for path in executables_of(package):
            print(path if args.full_path else f"{package} {os.path.basename(path)}")


def list_(args: argparse.Namespace) -> None:
    """Output a list of available packages"""
    for name in sorted(get_packages_with_prefixes()):
        print(name)


def prefix(args: argparse.Namespace) -> str | None:
    """Output the prefix path of a package"""
    try:
        path = get_package_prefix(args.package_name)
    except (PackageNotFoundError, ValueError):
        return "Package not found"
    print(os.path.join(path, "share", args.package_name) if args.share else path)
    return None


def _executables_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("package_name", nargs="?", help="The package name")
    parser.add_argument("--full-path", action="store_true", help="Show full path of each executable")


def _prefix_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("package_name", help="The package name")
    parser.add_argument("--share", action="store_true", help="Show share directory for the package")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_verbs(
        parser,
        NAME,
        {
            "executables": (executables, _executables_arguments),
            "list": (list_, lambda parser: None),
            "prefix": (prefix, _prefix_arguments),
        },
    )
