# SPDX-License-Identifier: Apache-2.0
"""Free curves: smooth functions of one variable by a table of values, for effects that have no name yet.

Between the knots the curve is the cubic of Keys (1981) through them, whose slope at a knot is that between its
neighbours, or that of the parabola through the last three; before the first knot and after the last it is constant.
"""

from typing import Any

import numba
import numpy as np
from numba.extending import register_jitable

from labyrinth_sim.effect import Parameter, Values
from labyrinth_sim.law import State
from labyrinth_sim.trials import Array

KNOTS = 10
NAMES = tuple(f"k{i + 1}" for i in range(KNOTS))
PLACES: Array = np.arange(KNOTS) / (KNOTS - 1)
CROWDED = 50.0  # times as crowded as evenly spaced ones are the knots over a speed about zero


def knots(unit: str, low: float, high: float, typical: Array, why: str) -> tuple[Parameter, ...]:
    """The table's values as parameters `k1` to `k10`, off at 0, typically (10,)."""
    return tuple(
        Parameter(name, unit, low, high, 0.0, float(value), why) for name, value in zip(NAMES, typical, strict=True)
    )


def bounds_of_range(name: str, unit: str, low: float, high: float, typical: float) -> Parameter:
    """One number of the range that the table covers; stated when the curve is added, and never fitted."""
    return Parameter(name, unit, low, high, None, typical, "the range that the recordings visit", fitted=False)


@register_jitable  # type: ignore[untyped-decorator]
def _beyond(last: Any, second: Any, third: Any) -> Any:
    """The value one knot beyond the last of three on a parabola; numbers or arrays."""
    return 3.0 * last - 3.0 * second + third


@register_jitable  # type: ignore[untyped-decorator]
def _cubic(before: Any, here: Any, there: Any, after: Any) -> tuple[Any, Any, Any]:
    """Factors of t, t^2 and t^3 of Keys' cubic from `here` at t = 0 to `there` at t = 1; numbers or arrays."""
    third = 0.5 * (after - before) + 1.5 * (here - there)
    return 0.5 * (there - before), before - 2.5 * here + 2.0 * there - 0.5 * after, third


@register_jitable  # type: ignore[untyped-decorator]
def share_about(variable: Any, centre: Any, half: Any) -> Any:
    """Share of the range `centre` - `half` to `centre` + `half`; numbers or arrays."""
    return 0.5 + 0.5 * (variable - centre) / half


@register_jitable  # type: ignore[untyped-decorator]
def _crowded(speed: Any, most: Any) -> tuple[Any, Any]:
    """The x from -1 to 1 of a speed = x (|x| + c) / (1 + c) most, with c = 1 / CROWDED, and a root; numbers or arrays.

    The slope of x by the speed is (CROWDED + 1) / (root most).
    """
    root = np.sqrt(1.0 + 4.0 * CROWDED * (CROWDED + 1.0) * np.abs(speed) / most)
    return np.copysign(root - 1.0, speed) / (2.0 * CROWDED), root


def curve(values: Values, share: Array) -> Array:
    """Values of the curve of many simulations.

    Args:
        values: of its parameters, each (nsim,).
        share: (nsim,) or (nsim, K) of the range, 0 at the first knot and 1 at the last.
    """
    table = np.stack([values[name] for name in NAMES], axis=1)
    place = (KNOTS - 1) * np.clip(np.nan_to_num(share), 0.0, 1.0)
    low = np.minimum(place.astype(np.int64), KNOTS - 2)
    t = place - low
    rows = np.arange(len(table)).reshape((-1,) + (1,) * (place.ndim - 1))
    # One more knot at either end, where the parabola through the last three lies, as Keys (1981) has it.
    table = np.column_stack([_beyond(*table.T[:3]), table, _beyond(*table.T[:-4:-1])])
    before, here, there, after = (table[rows, low + k] for k in range(4))
    first, second, third = _cubic(before, here, there, after)
    return np.asarray(((third * t + second) * t + first) * t + here)


@numba.njit  # type: ignore[untyped-decorator]
def curve_and_slope(values: Array, share: float) -> tuple[float, float]:
    """The same of one simulation, whose values begin with the table, as a law sees it; and its slope by the share."""
    if not 0.0 < share < 1.0:
        return (values[KNOTS - 1] if share >= 1.0 else values[0]), 0.0
    place = (KNOTS - 1) * share
    low = min(int(place), KNOTS - 2)
    t = place - low
    here, there = values[low], values[low + 1]
    before = values[low - 1] if low > 0 else _beyond(here, there, values[2])
    after = values[low + 2] if low < KNOTS - 2 else _beyond(there, here, values[KNOTS - 3])
    first, second, third = _cubic(before, here, there, after)
    value = ((third * t + second) * t + first) * t + here
    return value, (KNOTS - 1) * ((3.0 * third * t + 2.0 * second) * t + first)


@numba.njit  # type: ignore[untyped-decorator]
def over_angle(values: Array, angle: float) -> float:
    """The curve at an angle; `centre` and `half` of its range follow the table."""
    value, _ = curve_and_slope(values, share_about(angle, values[KNOTS], values[KNOTS + 1]))
    return value


@numba.njit  # type: ignore[untyped-decorator]
def from_zero(values: Array, variable: float) -> float:
    """The curve at what is never negative; the end of its range follows the table."""
    value, _ = curve_and_slope(values, variable / values[KNOTS])
    return value


@numba.njit  # type: ignore[untyped-decorator]
def over_speed(values: Array, speed: float) -> tuple[float, float]:
    """The curve at a speed, and its slope; `most`, at which its range ends on either side, follows the table.

    Its knots are evenly spaced over `_crowded`, because dry friction changes about zero and hardly elsewhere. So
    friction and drag are polynomials between them.
    """
    x, root = _crowded(speed, values[KNOTS])
    value, slope = curve_and_slope(values, 0.5 + 0.5 * x)
    return value, 0.5 * slope * (CROWDED + 1.0) / (root * values[KNOTS])


@numba.njit  # type: ignore[untyped-decorator]
def other_angle(s: State) -> float:
    """Angle of the first of the other axes' joints, rad."""
    return s.qpos[s.drives[1 if s.channel == 0 else 0, 2]]


def angle_share(angle: Array, values: Values) -> Array:
    """Share of the range `centre` - `half` to `centre` + `half`; an angle (nsim,) or (nsim, K)."""
    shape = (-1,) + (1,) * (angle.ndim - 1)
    centre, half = values["centre"].reshape(shape), values["half"].reshape(shape)
    return np.asarray(share_about(angle, centre, half))


def speed_share(speed: Array, values: Values) -> Array:
    """Share of the range -`most` to `most` by which a curve over a speed is read; a speed (nsim,) or (nsim, K)."""
    most = values["most"].reshape((-1,) + (1,) * (speed.ndim - 1))
    return np.asarray(0.5 + 0.5 * _crowded(speed, most)[0])


def speed_knots(most: float) -> Array:
    """(10,) where the knots of a curve over a speed lie."""
    x = 2.0 * PLACES - 1.0
    return np.asarray(most * x * (CROWDED * np.abs(x) + 1.0) / (CROWDED + 1.0))


def falling(size: float) -> Array:
    """(10,) from `size` at the first knot to -`size` at the last, half a wave."""
    return np.round(size * np.cos(np.pi * PLACES), 6)


def rising(size: float) -> Array:
    """(10,) from 0.4 `size` to `size`."""
    return np.round(size * (0.4 + 0.6 * PLACES), 6)
