# SPDX-License-Identifier: Apache-2.0
"""MJCF and URDF files: parsed and compiled, with MuJoCo's reason if that fails."""

from functools import lru_cache
from pathlib import Path

import mujoco

from labyrinth_sim.errors import InputError


def read_spec(source: Path) -> mujoco.MjSpec:
    """Parses a file. Raises InputError."""
    try:
        return mujoco.MjSpec.from_file(str(source))
    except (ValueError, OSError) as error:
        raise InputError(f"{source} is no valid MJCF: {error}") from error


def compile_spec(spec: mujoco.MjSpec, source: Path) -> mujoco.MjModel:
    """Compiles. Raises InputError."""
    try:
        return spec.compile()
    except (ValueError, RuntimeError, mujoco.FatalError) as error:
        raise InputError(f"{source} does not compile: {error}") from error


def slide_joints(source: Path) -> frozenset[str]:
    """Names of the joints of a file that slide, in m and N. Raises InputError if it cannot be parsed."""
    return _slide_joints(source, source.stat().st_mtime_ns)


@lru_cache(maxsize=64)
def _slide_joints(source: Path, _version: int) -> frozenset[str]:
    joints = read_spec(source).joints
    return frozenset(joint.name for joint in joints if joint.type == mujoco.mjtJoint.mjJNT_SLIDE)
