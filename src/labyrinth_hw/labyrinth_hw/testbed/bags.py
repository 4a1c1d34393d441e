# SPDX-License-Identifier: Apache-2.0
"""Runs of the emulated rig as rosbag2 bags, as the hardware node's topics would be recorded. Needs no ROS."""

import csv
import hashlib
import os
from collections.abc import Iterator
from math import nan
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any

import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from labyrinth_hw.errors import InputError
from labyrinth_hw.testbed.offline import NEXT_TRIAL, Run
from labyrinth_hw.testbed.quantities import Array

EPOCH = 1_700_000_000  # s; a fixed date, so that the same seed writes the same messages
LATENCY = 0.002  # s from a stamp to the recorder
NAMES = ["motor_x", "motor_y"]
BOARD = ["board_x", "board_y"]
LONGEST = 4 * 3600.0  # s, of commands
START, END, LOST = 0, 1, 0  # phases of Trial, kind of BallEvent
JOINT_STATE, TRIAL = "sensor_msgs/msg/JointState", "labyrinth_msgs/msg/Trial"
BALL_STATE, BALL_EVENT = "labyrinth_msgs/msg/BallState", "labyrinth_msgs/msg/BallEvent"


def typestore() -> Typestore:
    """ROS 2's types and labyrinth_msgs', the latter from the sourced workspace or the source tree.

    Raises:
        InputError: labyrinth_msgs is in neither.
    """
    store = get_typestore(Stores.ROS2_KILTED)
    shares = [Path(part) / "share" for part in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if part]
    for root in (*shares, *Path(__file__).resolve().parents[3:5]):
        files = sorted((root / "labyrinth_msgs" / "msg").glob("*.msg"))
        if files:
            types: dict[str, Any] = {}
            for file in files:
                types |= get_types_from_msg(file.read_text(encoding="utf-8"), f"labyrinth_msgs/msg/{file.stem}")
            store.register(types)
            return store
    raise InputError("The message definitions of labyrinth_msgs were not found. Source the workspace first.")


def read_commands(path: Path, rate: float = 100.0) -> tuple[Array, Array, str]:
    """Commands from a CSV file with the columns time (s), motor_x, motor_y (rad).

    Returns:
        time (T,) s at `rate`, commands (T, 2) rad held from the last row, SHA-256 of the file's content.

    Raises:
        InputError: unreadable, columns missing, no numbers, time not increasing.
    """
    try:
        text = path.read_text(encoding="utf-8")
        rows = list(csv.DictReader(text.splitlines()))
        columns = np.array([[float(row[name]) for name in ("time", *NAMES)] for row in rows])
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error}.") from error
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        raise InputError(
            f"{path}: expected the columns time, motor_x, motor_y with numbers (s, rad): {error}."
        ) from error
    if len(columns) < 2 or not np.isfinite(columns).all() or not (np.diff(columns[:, 0]) > 0).all():
        raise InputError(f"{path}: expected at least two rows of finite numbers with increasing time.")
    seconds = float(columns[-1, 0]) - float(columns[0, 0])
    if seconds > LONGEST:
        raise InputError(f"{path}: the commands last {seconds:g} s; expected at most {LONGEST:g} s. Are times in s?")
    time = np.arange(round(seconds * rate) + 1) / rate
    held = np.searchsorted(columns[:, 0] - columns[0, 0], time + 1e-9, side="right") - 1
    return time, columns[held, 1:], hashlib.sha256(text.encode()).hexdigest()


class CheckedStorage:
    """rosbags' place for messages, filled by the mcap library: checksums on every chunk, on all data and the summary.

    Args:
        folder: of the bag; the file is named after it.
        compression: what rosbags asks for; chunks are compressed in any case.
    """

    def __init__(self, folder: Path, compression: CompressionMode) -> None:
        self.path = folder / f"{folder.name}.mcap"
        self._file = self.path.open("xb")
        self._mcap = McapWriter(self._file, compression=CompressionType.ZSTD, enable_crcs=True, enable_data_crcs=True)
        self._mcap.start("ros2")
        self._schemas: dict[str, int] = {}
        self._channels: dict[int, int] = {}

    def add_msgtype(self, connection: Connection) -> None:
        """A message's definition."""
        text = connection.msgdef.data.encode()
        self._schemas[connection.msgtype] = self._mcap.register_schema(connection.msgtype, "ros2msg", text)

    def add_connection(self, connection: Connection, offered_qos_profiles: str) -> None:
        """A topic."""
        self._channels[connection.id] = self._mcap.register_channel(
            connection.topic, "cdr", self._schemas[connection.msgtype], {"offered_qos_profiles": offered_qos_profiles}
        )

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """A message, ns."""
        self._mcap.add_message(self._channels[connection.id], timestamp, bytes(data), timestamp)

    def close(self, version: int, metadata: str) -> None:
        """Index and end of the file."""
        self._mcap.add_metadata("rosbag2", {"serialized_metadata": metadata})
        self._mcap.finish()
        self._file.close()

    def abort(self) -> None:
        """Leave the file as it is."""
        self._file.close()


class BagWriter(Writer):
    """rosbags' writer of rosbag2 folders, with checksums in the file."""

    STORAGE_PLUGINS = MappingProxyType({StoragePlugin.MCAP: CheckedStorage})


def write_bag(folder: Path, run: Run, sequence: str, sequence_hash: str, namespace: str = "/real") -> Path:
    """Write all trials of a run into one new MCAP bag, with trial marks. It appears whole or not at all.

    Raises:
        InputError: the folder exists (nothing is overwritten), or it cannot be written.
    """
    if folder.exists():
        raise InputError(f"{folder} exists and is left as it is; name another folder.")
    store = typestore()
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as scratch:
            _write(Path(scratch) / folder.name, store, run, sequence, sequence_hash, namespace)
            (Path(scratch) / folder.name).rename(folder)
    except OSError as error:
        raise InputError(f"{folder} cannot be written: {error.strerror or error}. Nothing is left of it.") from error
    return folder


def _write(folder: Path, store: Typestore, run: Run, sequence: str, sequence_hash: str, namespace: str) -> None:
    writer = BagWriter(folder, version=9, storage_plugin=StoragePlugin.MCAP)
    topics = {"joint_commands": JOINT_STATE, "joint_states": JOINT_STATE, "trial": TRIAL}
    if run.tilt is not None:
        topics["board_states"] = JOINT_STATE
    if run.ball is not None:
        topics |= {"ball": BALL_STATE, "ball_event": BALL_EVENT}
    with writer:
        connections = {
            t: writer.add_connection(f"{namespace}/{t}", kind, typestore=store) for t, kind in topics.items()
        }
        for stamp, topic, message in sorted(_messages(store, run, sequence, sequence_hash), key=lambda entry: entry[0]):
            data = store.serialize_cdr(message, topics[topic])
            writer.write(connections[topic], _nanoseconds(stamp + LATENCY), data)


def _nanoseconds(stamp: float) -> int:
    return EPOCH * 10**9 + round(stamp * 1e9)


def _messages(store: Typestore, run: Run, sequence: str, sequence_hash: str) -> Iterator[tuple[float, str, Any]]:
    kinds = store.types
    joint, ball, event, mark = (kinds[name] for name in (JOINT_STATE, BALL_STATE, BALL_EVENT, TRIAL))
    joints = 4 if run.tilt is None else 2
    duration = float(2 * run.command_stamps[-1] - run.command_stamps[-2])
    for trial, stamps in enumerate(run.stamps):
        begin = 1.0 + trial * (duration + NEXT_TRIAL)
        for phase, at in ((START, begin), (END, begin + duration)):
            yield at, "trial", mark(
                header=_header(kinds, at), phase=phase, sequence=sequence, sequence_hash=sequence_hash, trial=trial,
                duration=duration,
            )  # fmt: skip
        for at, command in zip(begin + run.command_stamps, run.commands, strict=True):
            none = np.array([])
            yield (
                at,
                "joint_commands",
                joint(header=_header(kinds, at), name=NAMES, position=np.array(command), velocity=none, effort=none),
            )
        if run.tilt is not None and run.tilt_stamps is not None:
            for stamp, tilt in zip(run.tilt_stamps[trial], run.tilt[trial], strict=True):
                unknown = np.full(2, nan)
                header = _header(kinds, begin + stamp)
                yield begin + stamp, "board_states", joint(
                    header=header, name=BOARD, position=np.array(tilt), velocity=unknown, effort=unknown
                )  # fmt: skip
        fallen = False
        for k, stamp in enumerate(stamps):
            at = begin + stamp
            header = _header(kinds, at)
            yield (
                at,
                "joint_states",
                joint(
                    header=header,
                    name=[*NAMES, *BOARD][:joints],
                    position=np.concatenate([run.motor[trial, k], run.board[trial, k]])[:joints],
                    velocity=np.concatenate([run.motor_speed[trial, k], [nan, nan]])[:joints],
                    effort=np.concatenate([run.effort[trial, k], [nan, nan]])[:joints],
                ),
            )
            if run.ball is not None:
                x, y = (float(v) for v in run.ball[trial, k])
                seen = bool(np.isfinite(x))
                header = _header(kinds, at, "board_origin")
                yield at, "ball", ball(header=header, visible=seen, x=x if seen else 0.0, y=y if seen else 0.0)
                if not seen and not fallen:
                    fallen = True
                    yield at, "ball_event", event(header=header, kind=LOST, hole=int(run.hole[trial]))


def _header(kinds: Any, at: float, frame: str = "") -> Any:
    nanoseconds = _nanoseconds(at)
    time = kinds["builtin_interfaces/msg/Time"](sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
    return kinds["std_msgs/msg/Header"](stamp=time, frame_id=frame)
