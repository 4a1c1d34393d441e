# SPDX-License-Identifier: Apache-2.0
"""The pieces a command is made of: one channel's target over a stretch of time.

Each shape starts from the base, the target held before it. Holds, steps and ramps end at a target of their own, which
is the base of the next shape; sines, triangles, chirps and PRBS swing about the base and give it back.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy import signal

Array = NDArray[np.float64]


def _number(unit: str, **bounds: float) -> Any:
    """A field with its unit ("rad", "s", "Hz", "1") and its bounds (`above`, `least`, `most`)."""
    return field(metadata={"unit": unit, **bounds})


@dataclass(frozen=True)
class Shape(ABC):
    """Attributes: lasts: s, how long the shape is played."""

    word: ClassVar[str]
    lasts: float = _number("s", above=0.0)

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
    frequency: float = _number("Hz", above=0.0)

    def values(self, t: Array, base: float) -> Array:
        return base + self.amplitude * np.sin(2 * np.pi * self.frequency * t)


@dataclass(frozen=True)
class Triangle(Swing):
    """Constant speed up and down, in phase with the sine of the same frequency."""

    word = "triangle"
    frequency: float = _number("Hz", above=0.0)

    def values(self, t: Array, base: float) -> Array:
        wave = signal.sawtooth(2 * np.pi * self.frequency * t + np.pi / 2, width=0.5)
        return base + self.amplitude * np.asarray(wave, dtype=np.float64)


@dataclass(frozen=True)
class Chirp(Swing):
    """A sine whose frequency moves linearly from one value to another."""

    word = "chirp"
    start_frequency: float = _number("Hz", least=0.0)
    end_frequency: float = _number("Hz", least=0.0)

    def values(self, t: Array, base: float) -> Array:
        # The phase of -90 degrees makes a sine of scipy's cosine.
        wave = signal.chirp(t, f0=self.start_frequency, t1=self.lasts, f1=self.end_frequency, phi=-90)
        return base + self.amplitude * np.asarray(wave, dtype=np.float64)


@dataclass(frozen=True)
class Prbs(Swing):
    """Pseudo-random binary sequence: base +- amplitude, a maximum-length sequence of 2^register - 1 bits, repeated."""

    word = "prbs"
    bit: float = _number("s", above=0.0)
    register: int = _number("1", least=2, most=16)

    def values(self, t: Array, base: float) -> Array:
        bits = np.asarray(signal.max_len_seq(self.register)[0], dtype=np.float64)
        # The small term keeps a bit that starts on a sample from falling to the sample before it by rounding.
        index = np.floor(t / self.bit + 1e-9).astype(int) % len(bits)
        return np.asarray(base + self.amplitude * (2.0 * bits[index] - 1.0))


SHAPES: dict[str, type[Shape]] = {shape.word: shape for shape in (Hold, Step, Ramp, Sine, Triangle, Chirp, Prbs)}
