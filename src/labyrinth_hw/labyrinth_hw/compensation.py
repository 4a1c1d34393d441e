# SPDX-License-Identifier: Apache-2.0
"""The paper's extended motor control: a map of each servo's local positioning error, and the belt's slack.

Both turn the wanted angle of the board into the goal that the servo must get for it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labyrinth_hw.errors import InputError


@dataclass(frozen=True)
class Compensation:
    """Of one motor.

    Attributes:
        angles: rad, increasing; goals at which the error was measured.
        errors: rad; where the board went minus the goal, mean of both directions.
        slack: rad; total slack of the belt, the difference between coming from above and from below.
    """

    angles: tuple[float, ...] = ()
    errors: tuple[float, ...] = ()
    slack: float = 0.0

    def __post_init__(self) -> None:
        complaints = []
        if len(self.angles) != len(self.errors):
            complaints.append(
                f"The error map needs as many errors as angles, got {len(self.errors)} and {len(self.angles)}."
            )
        if any(b <= a for a, b in zip(self.angles, self.angles[1:], strict=False)):
            complaints.append("The angles of the error map must increase.")
        if not np.isfinite([*self.angles, *self.errors, self.slack]).all() or self.slack < 0:
            complaints.append(f"Angles, errors and slack must be finite and slack >= 0, got slack {self.slack}.")
        if complaints:
            raise InputError(complaints)

    def error(self, angle: float) -> float:
        """Positioning error at this goal, rad, linear between the measured angles and constant outside."""
        return float(np.interp(angle, self.angles, self.errors)) if self.angles else 0.0


class Compensator:
    """Applies compensations to a stream of goals; remembers the direction of travel of each motor.

    Args:
        maps: by motor; motors without one pass unchanged.
        position_error, slack: which of the two are on.
    """

    def __init__(self, maps: Mapping[str, Compensation], *, position_error: bool, slack: bool) -> None:
        self.maps, self.position_error, self.slack = dict(maps), position_error, slack
        self._last: dict[str, float] = {}
        self._direction: dict[str, float] = {}

    def goals(self, wanted: Mapping[str, float]) -> dict[str, float]:
        """Goals for the servos, rad, from wanted angles, rad."""
        result = {}
        for name, angle in wanted.items():
            if angle != (last := self._last.get(name, angle)):
                self._direction[name] = 1.0 if angle > last else -1.0
            self._last[name] = angle
            entry = self.maps.get(name, Compensation())
            goal = angle - entry.error(angle) if self.position_error else angle
            result[name] = goal + 0.5 * entry.slack * self._direction.get(name, 0.0) if self.slack else goal
        return result


def measured_map(goals: Sequence[float], rising: Sequence[float], falling: Sequence[float]) -> Compensation:
    """A compensation from rest positions of the board.

    Args:
        goals: (n,) rad, increasing; goals sent.
        rising: (n,) rad; where the board rested when the goal was approached from below.
        falling: (n,) rad; the same from above.
    """
    sent, up, down = (np.asarray(values, dtype=float) for values in (goals, rising, falling))
    if not sent.shape == up.shape == down.shape or sent.ndim != 1 or len(sent) < 2:
        raise InputError(
            f"A map needs two goals or more and a rest from each side, got {sent.shape}, {up.shape}, {down.shape}."
        )
    # An offset that is the same everywhere (the potentiometer's zero) stays in the map: the board is to be level.
    slack = max(0.0, float(np.median(down - up)))
    return Compensation(tuple(sent), tuple(0.5 * (up + down) - sent), slack)
