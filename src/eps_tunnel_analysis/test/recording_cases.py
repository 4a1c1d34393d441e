# SPDX-License-Identifier: Apache-2.0
"""Bags for the tests of the recording: really written, with each thing that may be odd as an argument."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eps_tunnel_analysis.recording import BagWriter
from eps_tunnel_analysis.recording.decode import BALL_STATE, JOINT_STATE, TRIAL, typestore

STORE = typestore()
START = 1_700_000_000_000_000_000
SECOND = 1_000_000_000


def header(stamp: int) -> Any:
    sec, nanosec = divmod(int(stamp), SECOND)
    return STORE.types["std_msgs/msg/Header"](STORE.types["builtin_interfaces/msg/Time"](sec, nanosec), "")


def joints(stamp: int, names: Sequence[str], position: Sequence[float], *rest: Sequence[float]) -> bytes:
    """A serialised JointState; `rest` are velocity and effort."""
    values = [np.asarray(v, dtype=np.float64) for v in (position, *rest, (), ())][:3]
    return serialised(STORE.types[JOINT_STATE](header(stamp), list(names), *values))


def ball(stamp: int, visible: bool, x: float, y: float) -> bytes:
    return serialised(STORE.types[BALL_STATE](header(stamp), visible, x, y))


def mark(stamp: int, phase: int, trial: int, duration: float, sequence_hash: str = "a" * 64) -> bytes:
    return serialised(STORE.types[TRIAL](header(stamp), phase, "eight_seconds", sequence_hash, trial, duration))


def serialised(message: Any) -> bytes:
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def command(seconds: np.ndarray) -> np.ndarray:
    """(n,) rad"""
    return 0.1 * np.sin(2 * seconds)


def measured(seconds: np.ndarray) -> np.ndarray:
    """(n,) rad"""
    return 0.1 * np.sin(2 * (seconds - 0.03))


def write_bag(
    folder: Path,
    *,
    seconds: float = 2.0,
    rate: float = 100.0,
    stamps: np.ndarray | None = None,
    positions: np.ndarray | None = None,
    names: Sequence[str] = ("motor_x",),
    metadata: dict[str, str] | None = None,
    late: int = 0,
) -> Path:
    """One trial of one servo on /real: commands and states, log times `late` ns behind the header stamps."""
    time = np.arange(round(seconds * rate) + 1) / rate
    ticks = START + np.round(time * SECOND).astype(np.int64)
    state_ticks = ticks if stamps is None else stamps
    values = measured(time) if positions is None else positions
    with BagWriter(folder, metadata) as writer:
        writer.add_topic("/real/joint_commands", JOINT_STATE)
        writer.add_topic("/real/joint_states", JOINT_STATE)
        for at, target in zip(ticks, command(time), strict=True):
            writer.write("/real/joint_commands", int(at) + late, joints(at, names, [target] * len(names)))
        for log, at, value in zip(ticks, state_ticks, values, strict=True):
            writer.write("/real/joint_states", int(log) + late, joints(at, names, [value] * len(names)))
    return folder
