# SPDX-License-Identifier: Apache-2.0
"""Evidence: what was measured, at its own stamps, how accurately, and what a model predicts at the same instants.

Nothing is resampled: commands act at their own stamps, and a model is rolled out on a grid as fine as it needs and read
where each sample was taken. So a verdict depends neither on an analysis grid nor on jittering stamps.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.diagnose.noise import SignalNoise, signal_noise
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.fit.cluster import Spread
from eps_tunnel_analysis.fit.problem import Residuals, copied
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.simulated import axes_at_rest, first_pose, known_values
from eps_tunnel_analysis.stamped import Readings, StampedTrial, aligned, readings, setpoints
from labyrinth_sim.model import Model
from labyrinth_sim.rig import BALL_SIGNALS
from labyrinth_sim.simulate import simulate_batch
from labyrinth_sim.trials import Array

LONGER = 0.05  # share by which a step may be longer than asked for
STILL = 0.5  # s after a command, from which on a rig counts as at rest
NARROWEST = 0.005  # s, of a bin; faster motion falls into one bin
PART = 6.25e-4  # s, about, of the parts of a step for which drives' efforts are computed, which jump with commands


@dataclass(frozen=True)
class PlayEvidence:
    """One play as it is compared: aligned trials, and for each signal the bins of its measurements.

    Attributes:
        play: as recorded.
        trials: its trials at their own stamps, aligned by their commands.
        seconds: length that all trials have.
        width: s, of the bins: the sensors' sample time, no less than `NARROWEST`.
        noise: for each signal.
    """

    play: Play
    trials: tuple[StampedTrial, ...]
    seconds: float
    width: float
    noise: tuple[SignalNoise, ...]


def play_evidence(model: Model, play: Play, signals: Sequence[str]) -> PlayEvidence:
    """The evidence of one play on these signals."""
    trials = aligned(play.at_stamps)
    seconds = min(trial.seconds for trial in trials)
    series = [trial.signals[name] for trial in trials for name in signals if len(trial.signals[name].time) > 1]
    apart = np.median(np.concatenate([np.diff(one.time) for one in series])) if series else play.trials.step
    width = max(float(apart), NARROWEST)
    resolution = {m.signal: m.resolution for m in model.rig.measured}
    noise = []
    for name in signals:
        bins = readings([t.signals[name] for t in trials], seconds, width, int(seconds / width) + 2, width)
        raw = [t.signals[name].values for t in trials]
        known = resolution.get(name, 0.0), SETTINGS.tolerance, SETTINGS.timing
        noise.append(signal_noise(bins, raw, width, *known, _still(trials[0], bins.time)))
    return PlayEvidence(play, trials, seconds, width, tuple(noise))


def _still(trial: StampedTrial, time: Array) -> NDArray[np.bool_]:
    """(b,) whether no command of a trial has changed for STILL before these times (b,) s."""
    still = time >= STILL
    for command in trial.commands.values():
        changed = command.time[1:][np.diff(command.values) != 0.0]  # from or to NaN, switched off, too
        last = np.concatenate([[-np.inf], changed])[np.searchsorted(changed, time, side="right")]
        still &= time - last >= STILL
    return np.asarray(still)


class Evidence:
    """Residuals of a model on recorded plays: simulated minus measured, at the instants of measurement.

    Args:
        model: its values hold where the free ones do not.
        free: k full names of free parameters.
        plays: as `play_evidence` gives them.
        signals: which are compared.
        step: s, at most, between the steps of a roll-out.
        nthread: 0 for one per CPU; the answer does not depend on it.
        spread: runs roll-outs elsewhere; None for this machine. The answer does not depend on it either.
        extrapolate: to steps of zero length, from roll-outs at `step` and at half of it.
        as_run: drives are limited as where the model runs step by step.

    Attributes:
        mean: (R,) what was measured, play by play, signal by signal, bin by bin.
        floor: (R,) by how much a perfect model would miss it: noise of the mean, ticks, drift, tolerance.
        time: (R,) s since the play's start.
        blocks: (R,) number of the play and signal.
    """

    def __init__(
        self,
        model: Model,
        free: Sequence[str],
        plays: Sequence[PlayEvidence],
        signals: Sequence[str],
        step: float,
        nthread: int = 0,
        spread: Spread | None = None,
        extrapolate: bool = False,
        as_run: bool = False,
    ) -> None:
        self.model, self.free, self.plays, self.signals = model, tuple(free), tuple(plays), tuple(signals)
        self.nthread, self.spread, self.extrapolate, self.as_run = nthread, spread, extrapolate, as_run
        self.missed: Array | float = 0.0
        self.known = known_values(model, [p.play for p in plays])
        self._steps = [_even(p.width, step) for p in plays]
        parts = [(p, s) for p in range(len(plays)) for s in range(len(signals))]
        noise = [plays[p].noise[s] for p, s in parts]
        self.mean = np.concatenate([n.mean for n in noise])
        self.floor = np.concatenate([n.floor for n in noise])
        self.time = np.concatenate([n.time for n in noise])
        self.blocks = np.repeat(np.arange(len(noise)), [len(n.time) for n in noise])

    def finer(self) -> "Evidence":
        """The same with steps half as long."""
        step = min(self._steps) / 2.0
        many = (self.nthread, self.spread, self.extrapolate, self.as_run)
        other = Evidence(self.model, self.free, self.plays, self.signals, step, *many)
        other.initial, other.missed = self.initial, self.missed
        return other

    def less(self, missed: Array) -> "Evidence":
        """The same, with residuals (R,) subtracted that need no explanation, in the signals' units."""
        other = self._again()
        other.missed = missed
        return other

    def of(
        self, model: Model, free: Sequence[str] | None = None, plays: Sequence[PlayEvidence] | None = None
    ) -> "Evidence":
        """The same for another model of the rig; with other free parameters, and plays that know other values of it, if
        any are given.
        """
        other = self._again()
        other.plays = self.plays if plays is None else tuple(plays)
        other.model, other.known = model, known_values(model, [p.play for p in other.plays])
        other.free = self.free if free is None else tuple(free)
        return other

    def started(self, shifts: Sequence[Mapping[str, float]]) -> "Evidence":
        """The same, with these signals shifted by so much at the start of each play, in their units."""
        other = self._again()
        other.initial = [
            {name: value + shift.get(name, 0.0) for name, value in pose.items()}
            for pose, shift in zip(self.initial, shifts, strict=True)
        ]
        return other

    def _again(self) -> "Evidence":
        """A copy to be changed, which shares what was read from the plays."""
        other = copied(self)
        other.__dict__.pop("_residuals", None)  # a spread one was sent elsewhere unchanged
        return other

    def start_noise(self, play: int, signal: str) -> float:
        """By how much the pose in which a play starts may be off: its first samples' noise, over all trials."""
        noise = self.plays[play].noise[self.signals.index(signal)]
        return float(np.sqrt((noise.single**2 + noise.tick**2 / 12.0) / len(self.plays[play].trials)))

    def count(self, play: int) -> int:
        """Points of a play's simulation grid."""
        return int(np.ceil(self.plays[play].seconds / self._steps[play] - 1e-9)) + 1

    def step(self, play: int) -> float:
        """s between the points of a play's simulation grid."""
        return self._steps[play]

    @property
    def shortest(self) -> float:
        """s, the shortest step of all plays."""
        return min(self._steps) / (2.0 if self.extrapolate else 1.0)

    def times(self, play: int) -> Array:
        """(K,) s, a play's simulation grid."""
        return np.asarray(self.step(play) * np.arange(self.count(play)), dtype=np.float64)

    def parts(self, play: int) -> int:
        """Of a step of a play's simulation grid, for which commands act and efforts are computed.

        Only of extrapolated ones: what steps get wrong of the motion would count against a target at its true time.
        """
        return max(2, 2 * round(self.step(play) / PART / 2.0)) if self.extrapolate else 1

    @cached_property
    def _readings(self) -> list[list[Readings]]:
        return [[self._reading(play, name) for name in self.signals] for play in range(len(self.plays))]

    def _reading(self, number: int, name: str) -> Readings:
        play, step, count, parts = self.plays[number], self.step(number), self.count(number), self.parts(number)
        series = [trial.signals[name] for trial in play.trials]
        # It jumps: read on straight lines from part to part.
        if parts > 1 and name in self.model.rig.efforts and not self._rolls:
            return readings(series, play.seconds, step / parts, count * parts, play.width, straight=True)
        return readings(series, play.seconds, step, count, play.width)

    @property
    def _rolls(self) -> bool:
        """Whether the ball is simulated."""
        return any(name in BALL_SIGNALS for pose in self.initial for name in pose)

    @cached_property
    def commands(self) -> list[Array]:
        """For each play (K, u) rad, the setpoint during each step of its grid; NaN where the drive is off."""
        return [self._setpoints(play, 1) for play in range(len(self.plays))]

    @cached_property
    def _within(self) -> list[Array]:
        """For each play (1, K * parts, u) rad, the same for each part of a step."""
        return [self._setpoints(play, self.parts(play))[None] for play in range(len(self.plays))]

    def _setpoints(self, play: int, parts: int) -> Array:
        """(K * parts, u) rad, the setpoint during each part of a step of a play's grid."""
        trials, step, count = self.plays[play].trials, self.step(play) / parts, self.count(play) * parts
        return np.column_stack([setpoints(trials, c, step, count) for c in self.model.rig.command_channels])

    @cached_property
    def initial(self) -> list[dict[str, Array]]:
        """For each play the initial position (1,) of each joint, the mean over its trials; the ball's if it
        is compared.
        """
        return [
            {
                name: np.array([v])
                for name, v in first_pose(self.model, play.trials).items()
                if name not in BALL_SIGNALS or name in self.signals
            }
            for play in self.plays
        ]

    @cached_property
    def resting(self) -> list[NDArray[np.bool_]]:
        """For each play (1, u) whether each axis rests under its first command as it begins."""
        return [axes_at_rest(self.model, play.trials)[None] for play in self.plays]

    def __call__(self, values: Array) -> Array:
        """(n, k) values in their units to (n, R) residuals in the signals' units; NaN where a roll-out diverged."""
        return self._residuals(np.atleast_2d(values)) - self.missed

    @cached_property
    def _residuals(self) -> Residuals:
        return self.spread(self.alone) if self.spread else self.alone

    def __getstate__(self) -> dict[str, Any]:
        # A worker elsewhere has its own number of cores, and does not distribute work itself.
        kept = {name: value for name, value in self.__dict__.items() if name != "_residuals"}
        return {**kept, "nthread": 0, "spread": None}

    def alone(self, table: Array) -> Array:
        """The same for a table (n, k), on this machine."""
        parts = []
        for number in range(len(self.plays)):
            result = simulate_batch(
                self.model, self.free, table, self.times(number), self._within[number],
                self.initial[number],
                per_command={name: given[[number]] for name, given in self.known.items()},
                resting=self.resting[number], signals=self.signals, timestep=self.step(number), nthread=self.nthread,
                extrapolate=self.extrapolate, parts=self.parts(number), as_run=self.as_run,
            )  # fmt: skip
            for column, bins in enumerate(self._readings[number]):
                name = self.signals[column]
                seen = result.efforts[name][:, 0] if name in result.efforts else result.values[:, 0, :, column]
                parts.append(np.asarray((bins.reading @ seen.T).T) - bins.mean)
        return np.concatenate(parts, axis=1)

    def fold(self, seconds: float) -> NDArray[np.int64]:
        """(R,) number of the stretch of time, about so long, that each residual belongs to; all signals of a play share
        theirs.
        """
        numbers = np.empty(len(self.time), dtype=np.int64)
        first = 0
        for number, play in enumerate(self.plays):
            here = self.blocks // len(self.signals) == number
            parts = max(1, round(play.seconds / seconds))
            numbers[here] = first + np.minimum((self.time[here] / play.seconds * parts).astype(np.int64), parts - 1)
            first += parts
        return numbers


def _even(width: float, step: float) -> float:
    """s: the longest step, hardly more than `step`, that divides a bin evenly.

    Bins are as wide as stamps are apart, and jitter alone must not halve the step.
    """
    return width / max(1, int(np.ceil(width / step * (1.0 - LONGER))))
