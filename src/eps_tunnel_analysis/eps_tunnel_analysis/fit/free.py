# SPDX-License-Identifier: Apache-2.0
"""Which of a model's numbers a calibration may move, and which axis each belongs to."""

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

from eps_tunnel_analysis.plays import Play
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.model import Model
from labyrinth_sim.rig import Axis

MOVES = 1e-4
"""rad; an axis whose command spans less stands still in a play"""


def free_parameters(model: Model, patterns: Sequence[str]) -> tuple[str, ...]:
    """Full names that match, in the model's order; `drive.x.*` matches all of that drive.

    Raises:
        InputError: a pattern that matches nothing; lists the names.
    """
    known = model.parameters()
    complaints = [
        unknown_name("parameter", pattern, known)
        for pattern in patterns
        if not any(fnmatchcase(name, pattern) for name in known)
    ]
    if complaints:
        raise InputError(complaints)
    return tuple(name for name in known if any(fnmatchcase(name, pattern) for pattern in patterns))


def default_free(model: Model) -> tuple[str, ...]:
    """What each drive declares as free, and every parameter of the model's effects."""
    names = []
    for axis in model.rig.axes:
        kind = model.drives[axis.name].kind
        for name in kind.free or [p.name for p in kind.parameters]:
            owner, dot, quantity = name.partition(".")
            names.append(f"{owner}.{axis.joint}.{quantity}" if dot else f"drive.{axis.name}.{name}")
    names += [f"{u.effect.name}.{u.place}.{p.name}" for u in model.effects for p in u.effect.parameters]
    return tuple(names)


@dataclass(frozen=True)
class Part:
    """What one run of an optimiser fits.

    Attributes:
        axis: its name, "" for what belongs to no axis or to all.
        free: full parameter names.
        signals: compared; None for all.
        plays: numbers of the plays that say something about it.
    """

    axis: str
    free: tuple[str, ...]
    signals: tuple[str, ...] | None
    plays: tuple[int, ...]


def by_axis(model: Model, free: Sequence[str], plays: Sequence[Play], signals: Sequence[str] | None) -> list[Part]:
    """One part for each axis, as the paper fits its servos, with that axis's signals and the plays that move it; last
    what belongs to no axis.

    An axis of which `signals` names none is fitted to all of them.
    """
    left = list(free)
    parts = []
    for axis in model.rig.axes:
        mine = tuple(name for name in left if _belongs(name, axis))
        left = [name for name in left if name not in mine]
        if not mine:
            continue
        own = [m.signal for m in axis.measured if m.quantity == "position"]
        seen = [s for s in own if all(s in play.trials.signals for play in plays)]
        asked = [m.signal for m in axis.measured if m.signal in (signals or ())] if signals is not None else seen
        chosen = tuple(asked) or (tuple(signals) if signals is not None else None)
        moved = tuple(i for i, play in enumerate(plays) if _moves(play, axis.command))
        parts.append(Part(axis.name, mine, chosen, moved or tuple(range(len(plays)))))
    if left:
        parts.append(Part("", tuple(left), tuple(signals) if signals is not None else None, tuple(range(len(plays)))))
    return parts


def _belongs(name: str, axis: Axis) -> bool:
    place = name.split(".", 1)[1].rpartition(".")[0]
    return place in (axis.name, axis.joint, axis.load, *(m.signal for m in axis.measured))


def _moves(play: Play, channel: str) -> bool:
    if channel not in play.trials.command_channels:
        return False
    commands = play.trials.commands[:, :, play.trials.command_channels.index(channel)]
    sent = commands[np.isfinite(commands)]
    return bool(len(sent) and np.ptp(sent) > MOVES)
