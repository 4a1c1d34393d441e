# SPDX-License-Identifier: Apache-2.0
"""The recent past of a quantity, to be read with a delay."""

import numpy as np

from labyrinth_hw.errors import InputError
from labyrinth_hw.testbed.parameters import Array


class History:
    """A ring of past values (n, 2), one every `step` seconds.

    Args:
        first: (n, 2), taken as the value since ever.
        step: s between values.
        span: s that can be looked back.
    """

    def __init__(self, first: Array, step: float, span: float) -> None:
        self.step = step
        self.length = int(np.ceil(span / step)) + 2
        self.ring = np.repeat(first[None], self.length, axis=0)
        self.newest = 0
        self._rows, self._columns = np.indices(first.shape)

    def push(self, value: Array) -> None:
        """Add the value of now."""
        self.newest = (self.newest + 1) % self.length
        self.ring[self.newest] = value

    def at(self, age: Array) -> Array:
        """Values `age` seconds ago, (n, 2), interpolated linearly."""
        steps = age / self.step
        whole = np.floor(steps).astype(np.intp)
        if whole.max() > self.length - 2:
            raise InputError(f"A delay of {age.max():g} s exceeds the {self.step * (self.length - 2):g} s remembered.")
        part = steps - whole
        newer = self.ring[(self.newest - whole) % self.length, self._rows, self._columns]
        older = self.ring[(self.newest - whole - 1) % self.length, self._rows, self._columns]
        return newer + part * (older - newer)

    def held(self, age: Array) -> Array:
        """Values in force `age` seconds ago, (n, 2), without interpolation."""
        whole = np.minimum(np.rint(age / self.step).astype(np.intp), self.length - 1)
        return self.ring[(self.newest - whole) % self.length, self._rows, self._columns]
