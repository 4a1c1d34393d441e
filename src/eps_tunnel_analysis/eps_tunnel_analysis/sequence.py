# SPDX-License-Identifier: Apache-2.0
"""Action sequences: what is played on the rig and on its simulation."""

import hashlib
import json
import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar

import numpy as np

from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.shown import shown
from labyrinth_sim.trials import Array

LONGEST_SHAPE = 3600.0  # s
FASTEST_SHAPE = 1e4  # Hz, and bits per s


def _number(unit: str, **bounds: float) -> Any:
    """A field with its unit ("rad", "s", "Hz", "1"; rad is m on a slide joint) and its bounds, named as in pydantic."""
    return field(metadata={"unit": unit, "bounds": bounds})


@dataclass(frozen=True)
class Shape(ABC):
    """Attributes: lasts: s, how long the shape is played."""

    word: ClassVar[str]
    lasts: float = _number("s", gt=0.0, le=LONGEST_SHAPE)

    @abstractmethod
    def values(self, t: Array, base: float) -> Array:
        """Targets (n,) in rad at the times t (n,) in s since the shape began."""

    def end(self, base: float) -> float:
        """The target in rad that is held once the shape is over."""
        return base

    def reach(self, base: float) -> tuple[float, float]:
        """The lowest and the highest target in rad."""
        return min(base, self.end(base)), max(base, self.end(base))


@dataclass(frozen=True)
class Hold(Shape):
    """Stays at the base."""

    word = "hold"

    def values(self, t: Array, base: float) -> Array:
        return np.full(t.shape, base)


@dataclass(frozen=True)
class Step(Shape):
    """Jumps to a target and stays there."""

    word = "step"
    to: float = _number("rad")

    def values(self, t: Array, base: float) -> Array:
        return np.full(t.shape, self.to)

    def end(self, base: float) -> float:
        return self.to


@dataclass(frozen=True)
class Ramp(Shape):
    """Moves to a target at a constant speed."""

    word = "ramp"
    to: float = _number("rad")

    def values(self, t: Array, base: float) -> Array:
        return base + (self.to - base) * t / self.lasts

    def end(self, base: float) -> float:
        return self.to


@dataclass(frozen=True)
class Swing(Shape):
    """A shape about the base. A negative amplitude starts downwards."""

    amplitude: float = _number("rad")

    def reach(self, base: float) -> tuple[float, float]:
        return base - abs(self.amplitude), base + abs(self.amplitude)


@dataclass(frozen=True)
class Sine(Swing):
    """base + amplitude sin(2 pi f t)."""

    word = "sine"
    frequency: float = _number("Hz", gt=0.0, le=FASTEST_SHAPE)

    def values(self, t: Array, base: float) -> Array:
        return base + self.amplitude * np.sin(2 * np.pi * self.frequency * t)


@dataclass(frozen=True)
class Triangle(Swing):
    """Constant speed up and down, in phase with the sine of the same frequency."""

    word = "triangle"
    frequency: float = _number("Hz", gt=0.0, le=FASTEST_SHAPE)

    def values(self, t: Array, base: float) -> Array:
        phase = np.mod(2 * np.pi * self.frequency * t + np.pi / 2, 2 * np.pi)
        wave = np.where(phase < np.pi, phase / (0.5 * np.pi) - 1, (1.5 * np.pi - phase) / (0.5 * np.pi))
        return np.asarray(base + self.amplitude * wave)


@dataclass(frozen=True)
class Chirp(Swing):
    """A sine whose frequency moves linearly from one value to another."""

    word = "chirp"
    start_frequency: float = _number("Hz", ge=0.0, le=FASTEST_SHAPE)
    end_frequency: float = _number("Hz", ge=0.0, le=FASTEST_SHAPE)

    def values(self, t: Array, base: float) -> Array:
        from scipy import signal  # a second to import, and most sequences need it not

        # The phase of -90 degrees makes a sine of scipy's cosine.
        wave = signal.chirp(t, f0=self.start_frequency, t1=self.lasts, f1=self.end_frequency, phi=-90)
        return base + self.amplitude * np.asarray(wave, dtype=np.float64)


@dataclass(frozen=True)
class Prbs(Swing):
    """Pseudo-random binary sequence: base +- amplitude, a maximum-length sequence of 2^register - 1 bits, repeated."""

    word = "prbs"
    bit: float = _number("s", ge=1.0 / FASTEST_SHAPE, le=LONGEST_SHAPE)
    register: int = _number("1", ge=2, le=16)

    def values(self, t: Array, base: float) -> Array:
        from scipy import signal  # see Chirp

        bits = np.asarray(signal.max_len_seq(self.register)[0], dtype=np.float64)
        # The small term keeps a bit that starts on a sample from falling to the sample before it by rounding.
        index = np.floor(t / self.bit + 1e-9).astype(int) % len(bits)
        return np.asarray(base + self.amplitude * (2.0 * bits[index] - 1.0))


SHAPES: dict[str, type[Shape]] = {shape.word: shape for shape in (Hold, Step, Ramp, Sine, Triangle, Chirp, Prbs)}


@dataclass(frozen=True)
class Command:
    """What is played in one trial: for each channel shapes one after another. The last target is held to the end.

    Attributes:
        name: `SEQUENCE`, or `SEQUENCE/COMMAND` where the file holds several.
        channels: u names, as in NS/joint_commands.
        initial: u targets in rad (m on a slide joint), held before time zero.
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
        """time (T,) in s from zero up to but without the duration, and commands (T, u) in rad or m, at `rate` Hz."""
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
        """The lowest and the highest target of each channel in rad or m, the initial pose included."""
        reach = {}
        for channel, base, row in zip(self.channels, self.initial, self.shapes, strict=True):
            low, high = base, base
            for shape in row:
                shape_low, shape_high = shape.reach(base)
                low, high, base = min(low, shape_low), max(high, shape_high), shape.end(base)
            reach[channel] = (low, high)
        return reach


@shown
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

    def check_limits(self, limits: Mapping[str, tuple[float, float]], linear: Collection[str] = ()) -> None:
        """Raises InputError with every target outside `limits`, and every channel without one.

        Args:
            limits: by channel, rad; m of the channels in `linear`.
        """
        complaints = []
        for command in self.commands:
            for channel, (low, high) in command.reach().items():
                if channel not in limits:
                    complaints.append(unknown_name("channel", channel, limits))
                    continue
                least, most = limits[channel]
                if low < least - 1e-9 or high > most + 1e-9:
                    factor, unit = (1e3, "mm") if channel in linear else (math.degrees(1.0), "deg")
                    complaints.append(
                        f"{command.name} moves {channel} from {low * factor:.4g} to {high * factor:.4g} {unit}; "
                        f"allowed are {least * factor:.4g} to {most * factor:.4g} {unit}. "
                        f"Lower the amplitude, or raise the limit if the rig allows it."
                    )
        if complaints:
            raise InputError(dict.fromkeys(complaints))


def _rounded(values: Mapping[str, float]) -> dict[str, float]:
    # A degree and its value in rad differ in the last digits; both are the same command.
    return {key: value if isinstance(value, int) else round(value, 12) for key, value in values.items()}
