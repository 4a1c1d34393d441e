# SPDX-License-Identifier: Apache-2.0
"""The next experiment: a command, from a menu, after which the rivals would still differ.

Hunter and Reiner (Technometrics 7, 1965) choose the largest expected misfit between the rivals as fitted. But both are
fitted to the new recording too, so what counts is the misfit that is left when each has adapted as far as the old
recordings allow, to first order. A command with more jerk than any before also shows what the rest of the model lacks
there, which the old recordings could not show; it is chosen only if no gentler one decides. One that runs into a stop,
according to any of the rivals, shows the stop instead.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from eps_tunnel_analysis.diagnose.axis import AxisDiagnosis
from eps_tunnel_analysis.diagnose.axis_search import SETTLED, is_steady
from eps_tunnel_analysis.diagnose.evidence import Evidence
from eps_tunnel_analysis.diagnose.rank import NAMELESS, NONE, UNEXPLAINED, UNKNOWN
from eps_tunnel_analysis.diagnose.refits import Refit
from eps_tunnel_analysis.sequence import Chirp, Command, Hold, Ramp, Shape, Step, Triangle
from eps_tunnel_analysis.sequence_file import sequence_text
from labyrinth_sim.model import Model
from labyrinth_sim.prescribed import prescribed
from labyrinth_sim.simulate import simulate_batch
from labyrinth_sim.trials import Array

RATE = 100.0  # Hz
STEP = 0.0025  # s, MuJoCo's
TELLS_APART = 1.0  # times the noise floor: one more play that differs by this is worth some 8 in log-likelihood
STOP = 0.98  # of an axis's range, beyond which it is at its stop
WORTH = 0.35  # the same, for a command no harsher than those recorded, where the model leaves no more than before

SAME_COMMAND = 0.3  # of a command's root mean square, by which its recording may differ, as by a sample's delay, and
SAME_LENGTH = 0.5  # s; commands of the menu differ by more
SHARES = (0.25, 0.5, 0.9)  # of an axis's range: sizes of the menu's commands
RANGE = 0.1  # rad, if a rig states no limits


@dataclass(frozen=True)
class Experiment:
    """A sequence to play next.

    Attributes:
        name: of the sequence.
        command: what is played.
        rivals: the hypotheses that it separates.
        misfit: expected root mean square of what is left between the closest two after each was fitted to it, in
            units of the noise floor, or of what the best model leaves where that is unknown.
        reason: in words.
    """

    name: str
    command: Command
    rivals: tuple[str, ...]
    misfit: float
    reason: str

    def to_yaml(self, trials: int = 5) -> str:
        """A sequence file, ready to play."""
        return sequence_text(self.command, self.reason, trials)


@dataclass(frozen=True)
class Harsh:
    """How hard a command moves the joints: root mean square acceleration, rad/s^2; whether it jerks no harder than what
    was recorded; and whether it runs into a stop.
    """

    acceleration: float
    tested: bool
    stopped: bool = False


@dataclass(frozen=True)
class _Rival:
    """A hypothesis: (1 + k, K) values as fitted and with each fitted one moved a little, and (R, k) how the old
    residuals respond, each with weight 1 / R.
    """

    name: str
    points: Array
    old: Array


def menu(model: Model, axis: str) -> dict[str, Command]:
    """Commands for one axis, the others at rest or moving along, by name; all within the rig's limits."""
    channels = model.rig.command_channels
    chosen = next(i for i, a in enumerate(model.rig.axes) if a.name == axis)
    reaches = [min(map(abs, a.limits)) if a.limits else RANGE for a in model.rig.axes]
    commands = {}
    for share in SHARES:
        for name, shapes, others in _rows(share * reaches[chosen], share):
            label = f"{name}_{axis}_{round(math.degrees(share * reaches[chosen]) * 10):d}"
            lasts = math.fsum(s.lasts for s in shapes)
            rest = [[_scaled(s, reach) for s in others] if others else [Hold(lasts)] for reach in reaches]
            rows = tuple(tuple(shapes) if i == chosen else tuple(rest[i]) for i in range(len(channels)))
            if len(channels) > 1 or not others:
                commands[label] = Command(label, channels, (0.0,) * len(channels), rows)
    return commands


def _rows(size: float, share: float) -> Iterator[tuple[str, list[Shape], list[Shape]]]:
    """Name, shapes of the axis with angles up to `size` rad, and of the others, in shares of their range; none: at
    rest.
    """
    for name, shapes in _shapes(size).items():
        yield name, shapes, []
    # First alone, then together with the others: the difference shows what the axes share.
    jumps = (0.25, -0.25, 1.0, -1.0)
    alone = [Hold(0.5), *[Step(0.8, s * size) for s in (*jumps, *jumps, 0.0)]]
    along = [Hold(0.5 + 4 * 0.8), *[Step(0.8, s * share) for s in (*jumps, 0.0)]]
    yield "steps_together", alone, along


def _shapes(size: float) -> dict[str, list[Shape]]:
    return {
        "slow_triangles": [Hold(0.5), Triangle(5.0, size / 4, 0.4), Triangle(6.0, size, 1 / 3), Hold(0.5)],
        "fast_triangles": [Hold(0.5), Triangle(4.0, size / 2, 1.5), Triangle(4.0, size / 4, 3.0), Hold(0.5)],
        "steps": [Hold(0.5), *[Step(1.0, s * size) for s in (0.25, -0.25, 0.5, -0.5, 1.0, -1.0, 0.1, 0.0)]],
        "quick_steps": [Hold(0.5), *[Step(0.25, s * size) for s in (1.0, -1.0, 0.5, -0.5) * 8], Step(0.5, 0.0)],
        "staircase": [Hold(0.3), *[Step(0.6, size * i / 5) for i in (1, 2, 3, 4, 5, 4, 3, 2, 1, 0, -1, -3, -5, -3, 0)]],
        "ramps": [Hold(0.3), Ramp(2.5, size), Ramp(1.5, -size), Ramp(0.8, size), Ramp(0.4, 0.0), Ramp(4.0, -size),
                  Hold(0.5)],
        "chirp": [Hold(0.3), Chirp(8.0, size / 2, 0.3, 5.0), Hold(0.5)],
    }  # fmt: skip


def _scaled(shape: Shape, reach: float) -> Shape:
    return Step(shape.lasts, shape.to * reach) if isinstance(shape, Step) else shape


def next_experiment(
    axes: Sequence[AxisDiagnosis], model: Model, stated: Sequence[str], floor: bool = True
) -> Experiment | None:
    """The command after which the rivals of the stated set would still differ.

    Among the commands that avoid the stops and have no more jerk than was recorded: the gentlest for which the rivals
    differ enough, else the one for which they differ most, if that is worth a play. Otherwise, among all commands, the
    gentlest for which they differ enough, else the one for which they differ most.

    If the only rival of an effect is something unknown, the command that shows most of the effect; None if there is
    neither. A command that was already played is not proposed again: it would leave the rivals undecided again.

    Args:
        floor: whether the noise floor is known; if not, what the best model leaves is the unit.
    """
    named = "the noise floor" if floor else "what is left"
    rivals_of = [(axis, _rivals(axis, stated)) for axis in axes]
    alone = all(len(rivals) < 2 for _, rivals in rivals_of) and UNKNOWN in stated
    offers: list[tuple[Experiment, Harsh]] = []
    for axis, refits in rivals_of:
        if alone and refits and refits[0].effects:
            refits = [refits[0], axis.base]
        if len(refits) < 2:
            continue
        rivals = [_rival(axis, refit) for refit in refits]
        names = " and ".join(sorted(r.name for r in rivals))
        known = _harshest(axis, rivals[0].points[0])
        start = f"Tests {rivals[0].name}, which differs" if alone else f"Decides between {names}, which differ"
        offered = [(own, item) for own in axis.part.axes for item in menu(model, own).items()]
        for own, (name, command) in offered:
            if was_played(axis.search.evidence, command):
                continue
            answers, harsh = _answers(axis, own, rivals, command, 1.0 if floor else math.sqrt(axis.best.cost), known)
            # The two that stay closest count: a difference of both from a third rival decides nothing.
            size = math.sqrt(
                min(
                    left_after_fit(answers[i][0], answers[j], rivals[j].old)
                    for i, j in permutations(range(len(rivals)), 2)
                )
            )
            reason = f"{start} by {size:.1f} times {named} here, once each is fitted to it."
            offer = Experiment(name, command, tuple(r.name for r in rivals), size, reason)
            offers.append((offer, harsh))
    return chosen(offers)


def chosen(offers: Sequence[tuple[Experiment, Harsh]]) -> Experiment | None:
    """The offer that `next_experiment` takes."""
    offers = [(o, harsh) for o, harsh in offers if not harsh.stopped] or offers
    deciding = [(o, harsh) for o, harsh in offers if o.misfit >= TELLS_APART]
    tested = [(o, harsh) for o, harsh in offers if harsh.tested and o.misfit >= WORTH]
    gentle = [(o, harsh) for o, harsh in tested if o.misfit >= TELLS_APART]
    if gentle or (deciding and not tested):
        return min(gentle or deciding, key=lambda offer: offer[1].acceleration)[0]
    return max((o for o, _ in tested or offers), key=lambda o: o.misfit, default=None)


def was_played(evidence: Evidence, command: Command) -> bool:
    """Whether one of the recordings is of this command, on the axes that are not prescribed."""
    at, asked = command.sample(RATE)
    own = [i for i, axis in enumerate(evidence.model.rig.axes) if axis.name not in prescribed(evidence.model)]
    asked = asked[:, own]
    for number, recorded in enumerate(commands[:, own] for commands in evidence.commands):
        time = evidence.times(number)
        if abs(time[-1] - command.duration) < SAME_LENGTH:
            apart = recorded - asked[np.searchsorted(at, time + 1e-9, side="right") - 1]
            if np.nanmean(apart**2) < SAME_COMMAND**2 * np.mean(asked**2):
                return True
    return False


def _harshest(axis: AxisDiagnosis, values: Array) -> float:
    """Root mean square jerk of the harshest play so far, rad/s^3, as simulated with these values (K,)."""
    evidence, jerks = axis.search.evidence, [0.0]
    for number in range(len(evidence.plays)):
        time = evidence.times(number)
        played = simulate_batch(
            evidence.model, evidence.free, values[None], time, evidence.commands[number][None], {},
            per_command={name: given[[number]] for name, given in evidence.known.items()},
            signals=evidence.model.rig.positions, timestep=STEP, nthread=evidence.nthread,
        )  # fmt: skip
        jerks.append(harshness(played.values[0, 0], time, 3))
    return max(jerks)


def harshness(angles: Array, time: Array, order: int) -> float:
    """Root mean square of a derivative of angles (T, m) rad: 2 for the acceleration, 3 for the jerk.

    From differences at RATE, because those of a step grow with the rate.
    """
    every = max(1, round(1.0 / (RATE * (time[1] - time[0]))))
    step = every * float(time[1] - time[0])
    return float(np.sqrt(np.nanmean(np.diff(angles[::every], order, axis=0) ** 2))) / step**order


def _rivals(axis: AxisDiagnosis, stated: Sequence[str]) -> list[Refit]:
    """The refits of stated hypotheses that differ on this axis."""
    names = {c.name for c in axis.search.library.candidates}
    chosen: dict[frozenset[str], Refit] = {}
    for name in stated:
        here = frozenset(() if name in NAMELESS else names & set(name.split(" + ")))
        refit = next((r for r in (axis.base, *axis.refits) if set(r.effects) == here), None)
        if name not in UNEXPLAINED and refit is not None:
            chosen.setdefault(here, refit)
    return list(chosen.values())


def _rival(axis: AxisDiagnosis, refit: Refit) -> _Rival:
    name = " + ".join(sorted(refit.effects)) or NONE
    points = np.vstack([refit.values, axis.search.moved(refit)])
    old = axis.search.residuals(points)
    slopes = np.nan_to_num(old[1:] - old[0]).T / math.sqrt(old.shape[1])
    return _Rival(name, points, slopes)


def _answers(
    axis: AxisDiagnosis, name: str, rivals: Sequence[_Rival], command: Command, unit: float, known: float
) -> tuple[list[Array], Harsh]:
    """(1 + k, n) for each rival: the compared samples of its roll-outs, in units of the floor, each of weight 1 / n.

    Also how harsh the command is, which moves the axis `name`; `known` is the largest jerk recorded, rad/s^3.
    """
    search, signals = axis.search, axis.part.signals
    floors = [unit * float(np.median(search.scale[search.signal == i])) for i in range(len(signals))]
    time, targets = command.sample(RATE)
    table = np.vstack([r.points for r in rivals])
    model = search.library.model
    positions = model.rig.positions
    every = (*signals, *(name for name in positions if name not in signals))
    result = simulate_batch(
        model, search.library.names, table, time, targets[None], {}, signals=every, timestep=STEP,
        nthread=search.evidence.nthread,
    )  # fmt: skip
    angles = result.values[0, 0][:, [every.index(name) for name in positions]]
    moved_axis = model.rig.axis(name)
    moved = result.values[:, 0][:, :, [every.index(signal) for signal in moved_axis.positions]]
    low, high = (STOP * limit for limit in moved_axis.limits)
    stopped = bool(np.nanmin(moved) < low or np.nanmax(moved) > high)
    harsh = Harsh(harshness(angles, time, 2), harshness(angles, time, 3) <= known, stopped)
    late = time - time[0] >= SETTLED
    channel = model.rig.command_channels.index(moved_axis.command)
    calm = late & is_steady(targets[:, channel], time[1] - time[0])
    parts = [
        result.values[:, 0, late if result.units[i] in ("rad", "m") else calm, i] / floors[i]
        for i in range(len(signals))
    ]
    seen = np.nan_to_num(np.concatenate(parts, axis=1))
    ends = np.cumsum([len(r.points) for r in rivals])[:-1]
    return [part / math.sqrt(seen.shape[1]) for part in np.split(seen, ends)], harsh


def left_after_fit(truth: Array, rival: Array, old: Array) -> float:
    """Mean square that a rival (1 + k, n) leaves of a truth (n,) as it adapts, at the cost of old residuals (R, k)."""
    wanted = np.concatenate([truth - rival[0], np.zeros(len(old))])
    slopes = np.vstack([(rival[1:] - rival[0]).T, old])
    change = np.linalg.lstsq(slopes, wanted, rcond=None)[0]
    return float(np.sum((wanted - slopes @ change) ** 2))
