# SPDX-License-Identifier: Apache-2.0
"""The labyrinth's picture is drawn where something can render, and left out with a message elsewhere."""

import os
import subprocess
import sys
from pathlib import Path

import cv2
import pytest

GEOMETRY = Path(__file__).parents[1] / "config" / "labyrinth_geometry.yaml"


def draw(out: Path, renderer: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    command = [sys.executable, "-m", "labyrinth_sim.mjcf.picture", str(GEOMETRY), str(out), *arguments]
    environment |= {"MUJOCO_GL": renderer, "PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def test_picture_shows_floor_and_landmarks(tmp_path: Path) -> None:
    done = draw(tmp_path / "labyrinth.png", "egl", "--size", "640", "480", "--layout", "medium")
    assert done.returncode == 0
    if "Left out the picture" in done.stderr:
        pytest.skip(done.stderr)
    hue, saturation, value = cv2.split(cv2.cvtColor(cv2.imread(str(tmp_path / "labyrinth.png")), cv2.COLOR_BGR2HSV))
    blue = ((hue > 105) & (hue < 120) & (saturation > 150)).astype("uint8")
    _, _, blobs, _ = cv2.connectedComponentsWithStats(blue)
    assert (blobs[1:, cv2.CC_STAT_AREA] > 5).sum() == 8  # four dots on the board, four on the frame
    assert ((hue < 25) & (value > 200)).mean() > 0.05  # the wooden floor


def test_picture_is_left_out_where_nothing_renders(tmp_path: Path) -> None:
    done = draw(tmp_path / "labyrinth.png", "glfw", "--size", "64", "48")
    assert done.returncode == 0
    assert "Left out the picture" in done.stderr
    assert not (tmp_path / "labyrinth.png").exists()


def test_unknown_layout_and_point_are_told(tmp_path: Path) -> None:
    for arguments, told in ((("--layout", "esay"), "Did you mean 'easy'?"), (("--ball", "500"), "points 0 to")):
        done = draw(tmp_path / "labyrinth.png", "egl", *arguments)
        assert done.returncode == 2
        assert told in done.stderr
