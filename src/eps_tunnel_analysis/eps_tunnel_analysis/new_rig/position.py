# SPDX-License-Identifier: Apache-2.0
"""In which unit a joint's positions are recorded, inferred from their range where it is not stated."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from eps_tunnel_analysis.new_rig.joints import Match
from labyrinth_sim.errors import InputError
from labyrinth_sim.trials import Array

TURN = 2.0 * np.pi
DEGREES = 4.0 * np.pi  # a reach beyond is hardly rad
DEGREES_MOST = 400.0
BEYOND_RANGE = 2.0  # of a joint's range in the model; a reach beyond is hardly rad
SCALES = {"rad": 1.0, "deg": TURN / 360.0, "m": 1.0, "mm": 1e-3}
TICKS = "ticks"
NORMALISED = 100.0  # at either end of what LeRobot makes of a joint's range unless set otherwise


@dataclass(frozen=True)
class Ticks:
    """Recorded ticks for one turn, and the tick at which a joint is at 0, by joint; "" for all others."""

    per_turn: float
    zeros: Mapping[str, float]

    def zero(self, joint: str) -> float:
        """The recorded value at which a joint is at 0."""
        return self.zeros.get(joint, self.zeros.get("", 0.0))


@dataclass(frozen=True)
class PositionUnit:
    """A unit of recorded positions and targets.

    Attributes:
        why: it is that.
        scale: rad or m of one recorded unit.
        zero: recorded value at which the joint is at 0.
        entry, speed_entry: how the rig file states it, for a position and a velocity; "" for SI.
        doubt: what the user should check, "" for nothing.
    """

    name: str
    why: str
    scale: float
    zero: float = 0.0
    entry: str = ""
    speed_entry: str = ""
    doubt: str = ""


def position_unit(
    match: Match, slides: bool, bounds: Array | None, seen: Array, sent: Array, given: str | None, ticks: Ticks | None
) -> PositionUnit:
    """The unit of a joint's positions.

    Args:
        bounds: (2,) of the joint in the model, rad or m; None where it has none.
        seen, sent: recorded positions and targets, (n,) each.
        given: as the user stated it; otherwise inferred from the range.
        ticks: how to convert positions in ticks.

    Raises:
        InputError: nothing fits, or the conversion of ticks is not stated.
    """
    name, why = (given, "as --position-unit says") if given else _told(slides, bounds, seen, sent)
    doubt = "" if slides else _normalised(match.recorded, seen, sent)
    if name != TICKS:
        entry = f", unit: {name}" if name in ("deg", "mm") else ""
        return PositionUnit(name, why, SCALES[name], 0.0, entry, f"{entry}/s" if entry else "", doubt)
    if slides:
        raise InputError(
            f"Joint {match.recorded} slides, and --ticks-per-turn is for joints that turn. Convert its ticks to m or "
            "mm, or write the rig file by hand with 'unit: ticks, ticks_per_m: 20000'."
        )
    if ticks is None:
        raise InputError("--position-unit ticks needs --ticks-per-turn, as 4096, and mostly --zero, as 2048.")
    zero = ticks.zero(match.joint)
    per_turn = f"ticks_per_turn: {ticks.per_turn:g}"
    why += f", {ticks.per_turn:g} a turn and {zero:g} where the joint is at 0"
    entry = f", unit: ticks, {per_turn}" + (f", zero: {zero:g}" if zero else "")
    return PositionUnit(TICKS, why, TURN / ticks.per_turn, zero, entry, f", unit: ticks/s, {per_turn}", doubt)


def _told(slides: bool, bounds: Array | None, seen: Array, sent: Array) -> tuple[str, str]:
    """Unit and why."""
    reach = float(np.abs(seen).max())
    far = float(np.abs(bounds).max()) if bounds is not None else 0.0
    if slides:
        if reach > 5.0:
            return "mm", f"reaches {reach:.4g}, which is hardly metres"
        return "m", f"reaches {reach:.3g}; ROS has metres"
    doubt = _whole(seen, sent)
    if 0.0 < BEYOND_RANGE * far < reach <= np.degrees(far):
        return "deg", f"reaches {reach:.4g}, and the model's joint {far:.3g} rad; as degrees it fits{doubt}"
    if reach > DEGREES and reach <= DEGREES_MOST:
        return "deg", f"reaches {reach:.4g}, which is hardly radians{doubt}"
    if reach > DEGREES_MOST:
        raise InputError(
            f"Positions reach {reach:.5g}: neither rad nor deg. Are these ticks? Then say --position-unit ticks "
            "--ticks-per-turn 4096 --zero 2048, with the figures of your servo; else convert them."
        )
    doubt = "; if that is degrees, say --position-unit deg" if reach > TURN / 2.0 else ""
    return "rad", f"reaches {reach:.3g}; ROS has radians{doubt}"


def _whole(seen: Array, sent: Array) -> str:
    """A doubt where positions and targets are whole numbers throughout; "" else."""
    values = np.concatenate([seen, sent])
    if not np.array_equal(values, np.round(values)):
        return ""
    return "; whole numbers throughout: if these are ticks, say --position-unit ticks --ticks-per-turn N --zero Z"


def _normalised(recorded: str, seen: Array, sent: Array) -> str:
    """A doubt if values end at exactly 100 or -100, as LeRobot's do unless it is set to use degrees; "" otherwise."""
    if NORMALISED not in (float(np.abs(seen).max()), float(np.abs(sent).max())):
        return ""
    return (
        f"! {recorded} reaches exactly {NORMALISED:g}: is it LeRobot's normalised range, -100 to 100 or 0 to 100 of "
        "the joint's calibrated range? That is not an angle. Record with use_degrees, or state the scale: for a joint "
        "that turns by R deg from -100 to 100, --position-unit ticks --ticks-per-turn 72000/R."
    )
