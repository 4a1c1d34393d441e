# SPDX-License-Identifier: Apache-2.0
"""Action sequences: what is played on the rig and on its simulation."""

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.sequence_shapes import Shape
from labyrinth_sim.errors import InputError, unknown_name

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Command:
    """What is played in one trial: for each channel shapes one after another. The last target is held to the end.

    Attributes:
        name: `SEQUENCE`, or `SEQUENCE/COMMAND` where the file holds several.
        channels: u names, as in NS/joint_commands.
        initial: u targets in rad, held before time zero.
        shapes: u tuples of shapes, the first of each beginning at time zero.
    """

    name: str
    channels: tuple[str, ...]
    initial: tuple[float, ...]
    shapes: tuple[tuple[Shape, ...], ...]

    @property
    def duration(self) -> float:
        """s, of the longest channel."""
        return max(math.fsum(shape.lasts for shape in row) for row in self.shapes)

    @property
    def hash(self) -> str:
        """SHA-256 over what is played: channels, initial pose, shapes. Names and the file's layout do not count."""
        rows = [[[shape.word, _rounded(asdict(shape))] for shape in row] for row in self.shapes]
        content = json.dumps([self.channels, [round(v, 12) for v in self.initial], rows], sort_keys=True)
        return hashlib.sha256(content.encode()).hexdigest()

    def sample(self, rate: float) -> tuple[Array, Array]:
        """time (T,) in s from zero up to but without the duration, and commands (T, u) in rad, at `rate` Hz."""
        # The small term keeps a shape that starts on a sample from being seen a sample late by rounding.
        time = np.arange(math.ceil(self.duration * rate - 1e-6)) / rate
        return time, np.column_stack([self._channel(column, time + 1e-9) for column in range(len(self.channels))])

    def _channel(self, column: int, time: Array) -> Array:
        base, start = self.initial[column], 0.0
        values = np.full(time.shape, base)
        for shape in self.shapes[column]:
            inside = (time >= start) & (time < start + shape.lasts)
            values[inside] = shape.values(time[inside] - start, base)
            base, start = shape.end(base), start + shape.lasts
            values[time >= start] = base
        return values

    def reach(self) -> dict[str, tuple[float, float]]:
        """The lowest and the highest target of each channel in rad, the initial pose included."""
        reach = {}
        for channel, base, row in zip(self.channels, self.initial, self.shapes, strict=True):
            low, high = base, base
            for shape in row:
                shape_low, shape_high = shape.reach(base)
                low, high, base = min(low, shape_low), max(high, shape_high), shape.end(base)
            reach[channel] = (low, high)
        return reach


@dataclass(frozen=True)
class Sequence:
    """Attributes: name: of the file; commands: at least one; trials: how often each is played."""

    name: str
    description: str
    commands: tuple[Command, ...]
    trials: int

    @property
    def hash(self) -> str:
        """The command's hash; where there are several, SHA-256 over theirs."""
        hashes = [command.hash for command in self.commands]
        return hashes[0] if len(hashes) == 1 else hashlib.sha256(" ".join(hashes).encode()).hexdigest()

    def command(self, name: str) -> Command:
        """The command of this name, with or without `SEQUENCE/`. Raises InputError listing the names."""
        name = f"{self.name}/{name.removeprefix(f'{self.name}/')}"
        for command in self.commands:
            if command.name == name:
                return command
        raise InputError(unknown_name("command", name, [command.name for command in self.commands]))

    def check_limits(self, limits: Mapping[str, tuple[float, float]]) -> None:
        """Raises InputError with every target outside `limits` (rad, by channel), and every channel without one."""
        complaints = []
        for command in self.commands:
            for channel, (low, high) in command.reach().items():
                if channel not in limits:
                    complaints.append(unknown_name("channel", channel, limits))
                    continue
                least, most = limits[channel]
                if low < least - 1e-9 or high > most + 1e-9:
                    complaints.append(
                        f"{command.name} moves {channel} from {math.degrees(low):.4g} to {math.degrees(high):.4g} deg; "
                        f"allowed are {math.degrees(least):.4g} to {math.degrees(most):.4g} deg. "
                        f"Lower the amplitude, or raise the limit if the rig allows it."
                    )
        if complaints:
            raise InputError(dict.fromkeys(complaints))


def _rounded(values: Mapping[str, float]) -> dict[str, float]:
    # A degree and its value in rad differ in the last digits; both are the same command.
    return {key: value if isinstance(value, int) else round(value, 12) for key, value in values.items()}
