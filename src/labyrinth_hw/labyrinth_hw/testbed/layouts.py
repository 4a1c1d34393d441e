# SPDX-License-Identifier: Apache-2.0
"""Walls and holes of the board by the layout's name."""

import yaml

from labyrinth_hw.config import find_geometry
from labyrinth_hw.errors import InputError
from labyrinth_hw.testbed.video_scene import Layout


def load_layout(name: str) -> Layout:
    """A layout of config/labyrinth_geometry.yaml. Raises InputError where the file or the layout is missing."""
    path = find_geometry()
    if path is None:
        raise InputError("config/labyrinth_geometry.yaml was not found; name its folder in $EPS_TUNNEL_CONFIG.")
    try:
        return Layout.load(path, name)
    except (KeyError, yaml.YAMLError) as error:
        raise InputError(f"{path}: {error}") from error
