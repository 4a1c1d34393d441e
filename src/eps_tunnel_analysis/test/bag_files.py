# SPDX-License-Identifier: Apache-2.0
"""Small bags on disk, written by rosbags itself, as an ordinary recorder would write them."""

from pathlib import Path

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_KILTED)
Header = STORE.types["std_msgs/msg/Header"]
Time = STORE.types["builtin_interfaces/msg/Time"]
JointState = STORE.types["sensor_msgs/msg/JointState"]
String = STORE.types["std_msgs/msg/String"]
START = 1_700_000_000_000_000_000  # ns
STEP = 10_000_000  # ns, 100 Hz
SECONDS = 2.0


def command(time):
    """The target of joint `servo`, rad: a step up at 0.5 s and back at 1.2 s."""
    return np.where((time >= 0.5) & (time < 1.2), 0.1, 0.0)


def response(time, lag=0.05):
    """A first-order answer to it, rad."""
    out, state = [], 0.0
    for target in command(time):
        state += (target - state) * 0.01 / lag
        out.append(state)
    return np.array(out)


def write_bag(folder: Path, topics) -> Path:
    """A bag of {topic: (type name, [(log time ns, message)])}."""
    writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        connections = {name: writer.add_connection(name, kind, typestore=STORE) for name, (kind, _) in topics.items()}
        rows = [(t, name, message) for name, (_, messages) in topics.items() for t, message in messages]
        for t, name, message in sorted(rows, key=lambda row: row[0]):
            writer.write(connections[name], t, STORE.serialize_cdr(message, topics[name][0]))
    return folder


def joint_state(stamp: int, position: float, joint: str = "servo"):
    header = Header(stamp=Time(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="")
    return JointState(
        header=header, name=[joint], position=np.array([position]), velocity=np.array([]), effort=np.array([])
    )


def joint_states(values, joint="servo", stamps=None):
    """A JointState topic at 100 Hz; `stamps` (ns) replaces the header stamps."""
    log = START + STEP * np.arange(len(values))
    stamps = log if stamps is None else stamps
    return "sensor_msgs/msg/JointState", [
        (int(t), joint_state(int(s), float(v), joint)) for t, s, v in zip(log, stamps, values, strict=True)
    ]


def grid(seconds=SECONDS):
    return np.arange(round(seconds * 100) + 1) / 100


def servo_bag(folder: Path, noise=0.0, lag=0.05, side="/real", seconds=SECONDS, joint="servo", **changes) -> Path:
    """One trial of the servo; `changes` replace topics (states=..., commands=...; None leaves one out)."""
    time = grid(seconds)
    measured = response(time, lag) + noise * np.sin(40 * time)
    topics = {
        f"{side}/joint_commands": changes.get("commands", joint_states(command(time), joint)),
        f"{side}/joint_states": changes.get("states", joint_states(measured, joint)),
    }
    return write_bag(folder, {name: topic for name, topic in topics.items() if topic is not None})


def both_sides(folder):
    """Three trials of a real servo, the later the noisier, under real/, and a simulation that lags: sim."""
    for i in range(3):
        servo_bag(folder / "real" / f"trial_{i}", noise=0.001 * i)
    servo_bag(folder / "sim", lag=0.08, side="/sim")
    return folder
