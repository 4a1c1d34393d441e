# SPDX-License-Identifier: Apache-2.0
"""The fitting problem: free parameters with bounds, the residuals of one roll-out per command, a fitness for these.

The optimisers see no simulator. They work on normalised values z in [0, 1] (0 = lower bound, 1 = upper bound), as the
paper does, and ask for whole batches at once.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.simulated import compared_signals, rollouts
from eps_tunnel_analysis.tunnel import build_tunnel, smooth
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.model import Model
from labyrinth_sim.quantities import EFFORT
from labyrinth_sim.rig import Axis
from labyrinth_sim.trials import Array, locked

AT_BOUND = 1e-3  # normalised distance at which a value counts as at its bound
LEAST_MOTION = 1e-4
"""rad; an axis whose command spans less stands still in a play"""
#: Fitness of a roll-out that diverged: worse than any that did not, yet finite, so that an optimiser can rank it.
DIVERGED = 1e9

Copied = TypeVar("Copied")


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


def full_name(axis: Axis, name: str) -> str:
    """Full name of a value that a drive declares: its own, such as `d`, or its joint's, such as `joint.damping`."""
    owner, dot, quantity = name.partition(".")
    return f"{owner}.{axis.joint}.{quantity}" if dot else f"drive.{axis.name}.{name}"


def default_free(model: Model, signals: Iterable[str] = ()) -> tuple[str, ...]:
    """What each drive declares as free, every parameter of the model's effects, and open factors of compared efforts.

    Args:
        signals: those compared that are not positions.
    """
    names, compared = [], set(signals)
    for axis in model.rig.axes:
        kind = model.drives[axis.name].kind
        names += [full_name(axis, name) for name in kind.free or [p.name for p in kind.parameters]]
        if not any(m.quantity == "torque" and m.signal in compared for m in axis.measured):
            names += [full_name(axis, name) for name in kind.identified_by_effort]
    names += [f"{u.effect.name}.{u.place}.{p.name}" for u in model.effects
              for p in u.effect.parameters if p.fitted and not p.settled]  # fmt: skip
    names += [name for name in model.parameters() if name.startswith(f"{EFFORT}.") and name.split(".")[1] in compared]
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

    An axis without any signal in `signals` is fitted to all of them.
    """
    others = list(free)
    parts = []
    for axis in model.rig.axes:
        own = tuple(name for name in others if _belongs(name, axis))
        others = [name for name in others if name not in own]
        if not own:
            continue
        seen = [s for s in axis.positions if all(s in play.trials.signals for play in plays)]
        asked = [m.signal for m in axis.measured if m.signal in (signals or ())] if signals is not None else seen
        chosen = tuple(asked) or (tuple(signals) if signals is not None else None)
        moved = tuple(i for i, play in enumerate(plays) if _moves(play, axis.command))
        parts.append(Part(axis.name, own, chosen, moved or tuple(range(len(plays)))))
    if others:
        parts.append(Part("", tuple(others), tuple(signals) if signals is not None else None, tuple(range(len(plays)))))
    return parts


def _belongs(name: str, axis: Axis) -> bool:
    place = name.split(".", 1)[1].rpartition(".")[0]
    return place in (axis.name, axis.joint, axis.load, *(m.signal for m in axis.measured))


def _moves(play: Play, channel: str) -> bool:
    if channel not in play.trials.command_channels:
        return False
    commands = play.trials.commands[:, :, play.trials.command_channels.index(channel)]
    sent = commands[np.isfinite(commands)]
    return bool(len(sent) and np.ptp(sent) > LEAST_MOTION)


class Fitness(Protocol):
    """Smaller is better."""

    @property
    def name(self) -> str: ...

    def __call__(self, residuals: Array) -> Array:
        """(n, R) residuals to (n,) fitness."""
        ...

    def scaled(self, residuals: Array) -> Array:
        """(n, R) residuals weighted so that small sums of their size mean small fitness; for Gauss-Newton."""
        ...


@dataclass(frozen=True)
class CommandError:
    """F = sum over commands of E_C, E_C = 1/t_total * sum_k |phi_R - phi_S| dt (equations 10, 11).

    Attributes:
        weights: (R,) dt / t_total of the command and signal each residual belongs to.
    """

    weights: Array
    name: str = "error"

    def __post_init__(self) -> None:
        object.__setattr__(self, "weights", locked(self.weights))

    def __call__(self, residuals: Array) -> Array:
        errors = np.abs(residuals) @ self.weights
        return np.where(np.isfinite(errors), errors, DIVERGED)

    def scaled(self, residuals: Array) -> Array:
        # Every sample weighs alike within a command; commands of different length by their share.
        return residuals * (self.weights / self.weights.max())


@dataclass(frozen=True)
class Dissimilarity:
    """1 - alikeness over k (equation 13), made optimisable.

    The alikeness at one k is a step function: its slope is zero almost everywhere. A sample at distance d from the
    mean, in a tunnel of half-width delta, turns alike at k* = d / delta; the share of samples alike, averaged evenly
    over all k from 0 to `k_max`, is the mean of max(0, 1 - k*/k_max), which has a slope wherever a sample is inside at
    `k_max`. Outside it a slowly growing logarithm still points home.

    Attributes:
        lower, upper: (R,) half-widths of the measured tunnel, >= 0, in the residuals' units.
        k_max: the widest tunnel that counts.
        floor: least half-width, so that an exact recording does not divide by zero; the sensor's resolution.
    """

    lower: Array
    upper: Array
    k_max: float = 5.0
    floor: float = 1e-6
    name: str = "srg"

    def __post_init__(self) -> None:
        object.__setattr__(self, "lower", locked(np.maximum(self.lower, self.floor)))
        object.__setattr__(self, "upper", locked(np.maximum(self.upper, self.floor)))

    def scaled(self, residuals: Array) -> Array:
        """k* with the residual's sign, (n, R)."""
        return residuals / np.where(residuals >= 0.0, self.upper, self.lower)

    def __call__(self, residuals: Array) -> Array:
        k_star = np.abs(self.scaled(residuals)) / self.k_max
        cost = np.minimum(k_star, 1.0) + 0.05 * np.log1p(np.maximum(k_star - 1.0, 0.0))
        mean = cost.mean(axis=1)
        return np.where(np.isfinite(mean), mean, DIVERGED)


Residuals = Callable[[Array], Array]


@dataclass(frozen=True)
class Problem:
    """A least-error problem over k bounded parameters and R residual samples.

    Attributes:
        names: k full parameter names, e.g. "drive.x.p".
        units: k units.
        low, high: (k,) bounds in those units.
        start: (k,) the values to start from, within the bounds.
        residuals: maps values (n, k) in their units to simulated minus measured (n, R), in the signals' units; a row of
            NaN marks a roll-out that diverged.
        fitness: maps residuals (n, R) to one number each (n,), smaller is better.
        blocks: (R,) int, which unbroken run of samples (command and signal) each residual belongs to.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    low: Array
    high: Array
    start: Array
    residuals: Residuals
    fitness: Fitness
    blocks: Array

    def __post_init__(self) -> None:
        for name in ("low", "high", "start", "blocks"):
            object.__setattr__(self, name, locked(getattr(self, name)))
        k = len(self.names)
        complaints = []
        if k == 0:
            complaints.append("There is nothing to fit: no free parameter was named.")
        for name in ("low", "high", "start"):
            if getattr(self, name).shape != (k,):
                complaints.append(f"{name} must have shape ({k},), got {getattr(self, name).shape}.")
        if not complaints:
            for name, low, start, high in zip(self.names, self.low, self.start, self.high, strict=True):
                if not low < high:
                    complaints.append(f"{name}: the lower bound {low:g} must lie below the upper bound {high:g}.")
                elif not low <= start <= high:
                    complaints.append(f"{name}: the start {start:g} lies outside its bounds [{low:g}, {high:g}].")
        if complaints:
            raise InputError(complaints)

    @property
    def size(self) -> int:
        """k, the number of free parameters."""
        return len(self.names)

    def to_unit(self, values: Array) -> Array:
        """Values (..., k) in their units to z in [0, 1]."""
        return (np.asarray(values, dtype=np.float64) - self.low) / (self.high - self.low)

    def from_unit(self, z: Array) -> Array:
        """z (..., k) in [0, 1] to values in their units."""
        values = self.low + np.clip(z, 0.0, 1.0) * (self.high - self.low)
        return np.clip(values, self.low, self.high)  # rounding may lead out of the bounds by a last digit


class Objective:
    """Residuals of a model on recorded plays.

    Args:
        model: its values hold where the free ones do not.
        free: k full names of free parameters.
        plays: the recorded commands with their trials.
        signals: which to compare; by default every measured position of the rig that all plays have.
        timestep: MuJoCo's step, s; None for the rig's own.
        nthread: 0 for one per CPU; the answer does not depend on it.

    Attributes:
        mean: (R,) measured means of all seen samples, play by play, signal by signal.
        lower, upper: (R,) half-widths of the smoothed tunnel there (equation 12).
        blocks: (R,) number of the play and signal.
        samples: (R,) number of the sample on the play's grid.
        weights: (R,) one over the samples of the block; where signals of several units are compared, those of another
            unit than the first count as much for their spread as those of the first do.
    """

    def __init__(
        self,
        model: Model,
        free: Sequence[str],
        plays: Sequence[Play],
        signals: Iterable[str] | None = None,
        timestep: float | None = None,
        nthread: int = 0,
    ) -> None:
        known = model.parameters()
        complaints = [unknown_name("parameter", name, known) for name in free if name not in known]
        if not plays:
            complaints.append("There is nothing to fit to: no recorded play.")
        if complaints:
            raise InputError(complaints)
        self.model, self.free = model, tuple(free)
        self.signals = compared_signals(model, [play.trials for play in plays], signals)
        self.nthread = nthread
        self.rollouts = rollouts(model, plays, timestep)
        means, lowers, uppers, blocks, self._picks = [], [], [], [], []
        for number, play in enumerate(plays):
            tunnel = smooth(build_tunnel(play.trials.select(self.signals)))
            for column in range(len(self.signals)):
                seen = np.flatnonzero(~np.isnan(tunnel.mean[:, column]))
                means.append(tunnel.mean[seen, column])
                lowers.append(np.abs(tunnel.lower[seen, column]))
                uppers.append(tunnel.upper[seen, column])
                blocks.append(np.full(len(seen), number * len(self.signals) + column))
                self._picks.append((number, seen, column))
        self.mean, self.lower, self.upper = (locked(np.concatenate(part)) for part in (means, lowers, uppers))
        self.blocks = np.concatenate(blocks)
        self.samples = np.concatenate([seen for _, seen, _ in self._picks])
        counts = np.bincount(self.blocks)
        shares = self._shares(np.concatenate([np.full(len(seen), column) for _, seen, column in self._picks]))
        self.weights = locked(shares / counts[self.blocks])

    def _shares(self, columns: NDArray[np.int64]) -> Array:
        """(R,) what a residual of another unit counts in the first signal's unit."""
        units = dict(zip(self.model.rig.signals, self.model.rig.units, strict=True))
        own = np.array([units[self.signals[c]] for c in columns.tolist()])
        spread = {unit: float(np.std(self.mean[own == unit])) for unit in dict.fromkeys(own.tolist())}
        first = spread[str(own[0])] if len(own) else 0.0
        share = {unit: first / size if first > 0.0 and size > 0.0 else 1.0 for unit, size in spread.items()}
        return np.array([share[unit] for unit in own.tolist()])

    def __call__(self, values: Array) -> Array:
        """(n, k) values in their units to (n, R) residuals; a diverged roll-out is a row of NaN."""
        seen, _, _ = self.rollouts.simulate(self.model, self.free, values, self.signals, self.nthread)
        of = [np.flatnonzero(self.rollouts.play == play) for play, _, _ in self._picks]
        parts = [
            seen[:, runs[:, None], samples, column].mean(axis=1)
            for runs, (_, samples, column) in zip(of, self._picks, strict=True)
        ]
        residuals = np.concatenate(parts, axis=1) - self.mean
        residuals[~np.isfinite(residuals).all(axis=1)] = np.nan
        return residuals

    def __getstate__(self) -> dict[str, Any]:
        # A worker elsewhere has its own number of cores; a copy is no worker, see `copied`.
        return {**self.__dict__, "nthread": 0}


def copied(value: Copied) -> Copied:
    """A shallow copy that works where the value does.

    The standard one would be what a worker elsewhere gets, without the threads and the cluster of the value.
    """
    other = object.__new__(type(value))
    other.__dict__.update(value.__dict__)
    return other
