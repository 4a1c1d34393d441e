# SPDX-License-Identifier: Apache-2.0
"""What must hold before recordings may become trials of one experiment."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.recording.channel_map import ChannelMap
from eps_tunnel_analysis.recording.message_types import BALL_STATE
from eps_tunnel_analysis.recording.recording import Recording, StampedTopic
from eps_tunnel_analysis.recording.windows import Window
from labyrinth_sim.errors import InputError
from labyrinth_sim.trials import Array

COMMANDS_ALIKE = 0.05
"""of the commands' range; trials whose commands are further apart half of the time play different sequences"""


def seen(topic: StampedTopic) -> NDArray[np.bool_]:
    """(n,) which messages carry a measurement: a ball that is not visible is nowhere."""
    if topic.type == BALL_STATE:
        return topic.columns["visible"] != 0
    return np.ones(len(topic), dtype=np.bool_)


def usable(topic: StampedTopic, column: str) -> NDArray[np.bool_]:
    """(n,) which messages carry a finite value of a column."""
    return seen(topic) & np.isfinite(topic.columns[column])


def check_channels(recording: Recording, channels: ChannelMap) -> None:
    """Raises InputError unless every named column is there, in every message."""
    complaints: list[str] = []
    for source in (*channels.signals, *channels.commands):
        try:
            topic = recording.topic(source.topic, source.type)
        except InputError as error:
            complaints += error.complaints
            continue
        where = f"{recording.path}: topic '{source.topic}'"
        joint, _, quantity = source.column.rpartition(".")
        if source.column not in topic.columns:
            has = f"joints {', '.join(topic.joints)}" if topic.joints else ", ".join(topic.columns)
            complaints.append(
                f"{where} has no {quantity} of joint '{joint}', needed for '{source.name}'; it has {has}."
            )
        elif topic.absent.get(source.column):
            complaints.append(
                f"{where}: joint '{joint}' has no {quantity} in {topic.absent[source.column]} of {len(topic)} "
                "messages. Expected the same joints in every message; look for a second publisher on the topic."
            )
    if complaints:
        raise InputError(dict.fromkeys(complaints))


def check_finite(recording: Recording, channels: ChannelMap, found: Sequence[Window]) -> None:
    """Raises InputError where a value within a trial is NaN or infinite; what lies between trials is not used."""
    complaints: list[str] = []
    for source in (*channels.signals, *channels.commands):
        topic, stamps = recording.topics[source.topic], recording.stamps(source.topic)
        inside = np.zeros(len(topic), dtype=np.bool_)
        for window in found:
            inside |= (stamps >= window.start) & (stamps <= window.start + round(window.seconds * 1e9))
        bad = np.flatnonzero(~np.isfinite(topic.columns[source.column]) & seen(topic) & inside)
        if len(bad):
            complaints.append(
                f"{recording.path}: topic '{source.topic}': {source.column} is NaN or infinite in {len(bad)} of "
                f"{len(topic)} messages, first {(stamps[bad[0]] - stamps[0]) * 1e-9:.3f} s after the topic's first. "
                "Expected finite numbers throughout every trial; look for a broken sensor channel, or leave the signal "
                "out."
            )
    if complaints:
        raise InputError(dict.fromkeys(complaints))


def check_same_channels(recordings: Sequence[Recording], maps: Sequence[ChannelMap]) -> None:
    """Raises InputError when two recordings offer different signals or commands."""
    names = [([s.name for s in m.signals], [s.name for s in m.commands]) for m in maps]
    complaints = [
        f"{recording.path}: signals {signals} and commands {commands} differ from those of {recordings[0].path}, "
        f"{names[0][0]} and {names[0][1]}. Trials need the same; name a rig or the signals."
        for recording, (signals, commands) in zip(recordings, names, strict=True)
        if (signals, commands) != names[0]
    ]
    if complaints:
        raise InputError(complaints)


def check_same_commands(commands: Array, labels: Sequence[str]) -> None:
    """Raises InputError when commands are too far apart to be of one sequence, which needs no hash in the bag."""
    spread = np.nanmax(commands[0], axis=0, initial=-np.inf) - np.nanmin(commands[0], axis=0, initial=np.inf)
    complaints = []
    for trial in range(1, len(commands)):
        for channel in range(commands.shape[2]):
            apart = np.abs(commands[trial, :, channel] - commands[0, :, channel])
            if np.isfinite(apart).any() and np.nanmedian(apart) > COMMANDS_ALIKE * max(spread[channel], 1e-6):
                complaints.append(
                    f"{labels[trial]}: its commands are not those of {labels[0]} (they are {np.nanmedian(apart):.4g} "
                    "rad apart half of the time). Trials must play the same sequence; compare these bags separately."
                )
                break
    if complaints:
        raise InputError(complaints)
