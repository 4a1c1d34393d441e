# SPDX-License-Identifier: Apache-2.0
"""How long an hour of recording takes to become Trials, against merely iterating its raw messages with rosbags."""

import gc
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import Reader

from eps_tunnel_analysis.recording import BagWriter, read_trials
from eps_tunnel_analysis.recording.decode import BALL_STATE, JOINT_STATE, typestore

SECONDS = 3600.0
RATE = 100.0
REPEATS = 5
START = 1_700_000_000_000_000_000
"""ns"""


def measure() -> dict[str, float]:
    """`read_vs_limit`: read and resample over iterate; the best of some repeats each, taken in turns."""
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "hour"
        messages = write_hour(bag)
        limit, ours = np.inf, np.inf
        for _ in range(REPEATS):
            limit = min(limit, _seconds(lambda: _iterate(bag)))
            ours = min(ours, _seconds(lambda: read_trials([bag])))
        size = sum(file.stat().st_size for file in bag.iterdir())
    return {
        "read_vs_limit": ours / limit,
        "read_seconds": ours,
        "read_limit_seconds": limit,
        "read_messages": float(messages),
        "read_bag_bytes": float(size),
    }


def write_hour(bag: Path, seconds: float = SECONDS) -> int:
    """An hour of a labyrinth: commands, two servos and two potentiometers, and the ball, at 100 Hz each."""
    store = typestore()
    types: dict[str, Any] = store.types
    header, stamp = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    joints, ball = types[JOINT_STATE], types[BALL_STATE]
    none = np.zeros(0)
    draw = np.random.default_rng(1)
    count = round(seconds * RATE)
    with BagWriter(bag) as writer:
        writer.add_topic("/real/joint_commands", JOINT_STATE)
        writer.add_topic("/real/joint_states", JOINT_STATE)
        writer.add_topic("/real/ball", BALL_STATE)
        for i in range(count):
            at = START + round(i * 1e9 / RATE)
            target = np.sin(np.array([1.0, 1.3]) * i / RATE) * 0.08
            state = np.tile(target, 2) + draw.normal(0, 1e-3, 4)
            for late, topic, make in (
                (0, "/real/joint_commands", lambda h, x=target: joints(h, ["motor_x", "motor_y"], x, none, none)),
                (
                    2_000_000,
                    "/real/joint_states",
                    lambda h, x=state: joints(h, ["motor_x", "motor_y", "board_x", "board_y"], x, x, x),
                ),
                (3_000_000, "/real/ball", lambda h, x=state: ball(h, True, x[0], x[1])),
            ):
                sec, nanosec = divmod(at + late, 1_000_000_000)
                message = make(header(stamp(sec, nanosec), ""))
                writer.write(topic, at + late, store.serialize_cdr(message, message.__msgtype__))
    return 3 * count


def _iterate(bag: Path) -> None:
    with Reader(bag) as reader:
        for _ in reader.messages():
            pass


def _seconds(work: Callable[[], object]) -> float:
    gc.collect()
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


if __name__ == "__main__":
    for name, value in measure().items():
        print(f"{name:20s} {value:.6g}")
