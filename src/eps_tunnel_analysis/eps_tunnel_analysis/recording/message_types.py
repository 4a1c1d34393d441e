# SPDX-License-Identifier: Apache-2.0
"""Which message types can be read, and where their definitions come from."""

import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.typesys import (
    Stores,
    get_types_from_idl,
    get_types_from_msg,
    get_typestore,
)
from rosbags.typesys.store import Typestore

JOINT_STATE = "sensor_msgs/msg/JointState"
BALL_STATE = "labyrinth_msgs/msg/BallState"
BALL_EVENT = "labyrinth_msgs/msg/BallEvent"
TRIAL = "labyrinth_msgs/msg/Trial"
READABLE = (JOINT_STATE, BALL_STATE, BALL_EVENT, TRIAL)
SAMPLED = (JOINT_STATE, BALL_STATE)
"""Measured or sent in a steady rhythm, so no two messages share a stamp; events may"""


def labyrinth_definitions() -> Iterator[tuple[str, str]]:
    """(type name, definition) of labyrinth_msgs, from the sourced workspace or, failing that, this source tree."""
    prefixes = [Path(p) / "share" for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    for root in (*prefixes, *Path(__file__).resolve().parents[3:5]):
        files = sorted((root / "labyrinth_msgs" / "msg").glob("*.msg"))
        if files:
            yield from ((f"labyrinth_msgs/msg/{file.stem}", file.read_text(encoding="utf-8")) for file in files)
            return


def typestore(definitions: Iterable[tuple[str, MessageDefinition]] = ()) -> Typestore:
    """ROS 2's own types, then those that a bag defines itself, then those of labyrinth_msgs where still unknown.

    Raises:
        TypesysError: a definition cannot be read.
    """
    store = get_typestore(Stores.ROS2_KILTED)
    own = [(name, MessageDefinition(MessageDefinitionFormat.MSG, text)) for name, text in labyrinth_definitions()]
    for name, definition in (*definitions, *own):
        if name not in store.fielddefs and definition.format != MessageDefinitionFormat.NONE:
            register(store, name, definition)
    return store


def register(store: Typestore, name: str, definition: MessageDefinition) -> None:
    """Adds a type and those it uses, as far as the store does not know them. Raises TypesysError."""
    if definition.format == MessageDefinitionFormat.MSG:
        types = get_types_from_msg(definition.data, name)
    else:
        types = get_types_from_idl(definition.data)
    store.register({key: value for key, value in types.items() if key not in store.fielddefs})
