# SPDX-License-Identifier: Apache-2.0
"""Versions, as --version and the reports tell them."""

import platform
from importlib import metadata

TOLD = ("mujoco", "numpy", "rosbags", "scipy")


def version() -> str:
    """Of this package."""
    return _version("eps_tunnel_analysis") or "(run from source)"


def versions() -> dict[str, str]:
    """Of this package, Python, and the libraries on which figures depend."""
    found = {name: _version(name) for name in TOLD}
    return {
        "eps_tunnel_analysis": version(),
        "python": platform.python_version(),
        **{name: v for name, v in found.items() if v},
    }


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
