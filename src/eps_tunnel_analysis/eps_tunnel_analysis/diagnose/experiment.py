# SPDX-License-Identifier: Apache-2.0
"""The next experiment: the command, from a menu, on which the fitted rivals differ most.

Hunter and Reiner (Technometrics 7, 1965): run what has the largest expected misfit between the rivals.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import combinations

import numpy as np
import yaml

from eps_tunnel_analysis.diagnose.axis_diagnosis import AxisDiagnosis
from eps_tunnel_analysis.diagnose.rank import NONE, UNKNOWN
from eps_tunnel_analysis.sequence import Command
from eps_tunnel_analysis.sequence_file import SUFFIXES
from eps_tunnel_analysis.sequence_shapes import Chirp, Hold, Ramp, Shape, Step, Triangle
from labyrinth_sim.model import Model
from labyrinth_sim.simulate import simulate_batch

SHARES = (0.25, 0.5, 0.9)  # of an axis's range
RANGE = 0.1  # rad, where a rig states no limits
RATE = 100.0  # Hz


@dataclass(frozen=True)
class Experiment:
    """A sequence to play next.

    Attributes:
        name: of the sequence.
        command: what is played.
        rivals: the hypotheses that it separates.
        misfit: expected root mean square difference between them, in units of the noise floor, or of what the best
            model leaves where that is unknown.
        reason: in words.
    """

    name: str
    command: Command
    rivals: tuple[str, ...]
    misfit: float
    reason: str

    def to_yaml(self, trials: int = 5) -> str:
        """A sequence file, ready to play."""
        body = {
            "description": self.reason,
            "initial_deg": {
                c: math.degrees(v) for c, v in zip(self.command.channels, self.command.initial, strict=True)
            },
            "trials": trials,
            "command": {
                c: [_entry(shape) for shape in row]
                for c, row in zip(self.command.channels, self.command.shapes, strict=True)
            },
        }
        return "# SPDX-License-Identifier: Apache-2.0\n" + yaml.safe_dump(body, sort_keys=False, allow_unicode=True)


def _entry(shape: Shape) -> dict[str, dict[str, float]]:
    body = {}
    for item in fields(shape):
        value = getattr(shape, item.name)
        unit = item.metadata["unit"]
        body[item.name + SUFFIXES[unit]] = round(math.degrees(value), 6) if unit == "rad" else value
    return {shape.word: body}


def menu(model: Model, axis: str) -> dict[str, Command]:
    """Commands for one axis, the others at rest, by name."""
    channels = model.rig.command_channels
    chosen = next(i for i, a in enumerate(model.rig.axes) if a.name == axis)
    limits = model.rig.axes[chosen].limits
    reach = min(abs(limits[0]), abs(limits[1])) if limits else RANGE
    found = {}
    for share in SHARES:
        size = share * reach
        for name, shapes in _shapes(size).items():
            label = f"{name}_{axis}_{round(math.degrees(size) * 10):d}"
            lasts = math.fsum(s.lasts for s in shapes)
            rows = tuple(tuple(shapes) if i == chosen else (Hold(lasts),) for i in range(len(channels)))
            found[label] = Command(label, channels, (0.0,) * len(channels), rows)
    return found


def _shapes(size: float) -> dict[str, list[Shape]]:
    return {
        "slow_triangles": [Hold(0.5), Triangle(5.0, size / 4, 0.4), Triangle(6.0, size, 1 / 3), Hold(0.5)],
        "fast_triangles": [Hold(0.5), Triangle(4.0, size / 2, 1.5), Triangle(4.0, size / 4, 3.0), Hold(0.5)],
        "steps": [Hold(0.5), *[Step(1.0, s * size) for s in (0.25, -0.25, 0.5, -0.5, 1.0, -1.0, 0.1, 0.0)]],
        "staircase": [Hold(0.3), *[Step(0.6, size * i / 5) for i in (1, 2, 3, 4, 5, 4, 3, 2, 1, 0, -1, -3, -5, -3, 0)]],
        "ramps": [Hold(0.3), Ramp(2.5, size), Ramp(1.5, -size), Ramp(0.8, size), Ramp(0.4, 0.0), Ramp(4.0, -size),
                  Hold(0.5)],
        "chirp": [Hold(0.3), Chirp(8.0, size / 2, 0.3, 5.0), Hold(0.5)],
    }  # fmt: skip


def next_experiment(
    axes: Sequence[AxisDiagnosis], model: Model, stated: Sequence[str], floor: bool = True
) -> Experiment | None:
    """The command on which the rivals of the stated set differ most, on the axis where they do; None without rivals.

    Args:
        floor: whether the noise floor is known; if not, what the best model leaves is the unit.
    """
    best: Experiment | None = None
    for axis in axes:
        names = {c.name for c in axis.search.library.candidates}
        mine: dict[frozenset[str], str] = {}
        for name in stated:
            if name != UNKNOWN:
                mine.setdefault(frozenset(set(name.split(" + ")) & names if name != NONE else ()), name)
        refits = {e: next((r for r in (axis.base, *axis.refits) if set(r.effects) == e), None) for e in mine}
        rivals = {e: r for e, r in refits.items() if r is not None}
        if len(rivals) < 2:
            continue
        commands = menu(model, axis.part.axis)
        unit = 1.0 if floor else math.sqrt(axis.best.overall)
        floors = {
            s: unit * float(np.median(axis.search.scale[axis.search.signal == i]))
            for i, s in enumerate(axis.part.signals)
        }
        table = np.array([r.values for r in rivals.values()])
        probabilities = np.array([axis.probabilities.get(" + ".join(sorted(e)) or NONE, 0.0) for e in rivals])
        for name, command in commands.items():
            time, targets = command.sample(RATE)
            result = simulate_batch(
                axis.search.library.model, axis.search.library.names, table, time, targets[None], {}, timestep=0.005
            )
            positions = [s for s in axis.part.signals if result.units[result.signals.index(s)] != "N m"]
            scaled = np.stack([result.values[:, 0, :, result.signals.index(s)] / floors[s] for s in positions], axis=-1)
            misfit = 0.0
            for i, j in combinations(range(len(table)), 2):
                weight = probabilities[i] * probabilities[j]
                misfit += weight * float(np.nanmean((scaled[i] - scaled[j]) ** 2))
            total = sum(probabilities[i] * probabilities[j] for i, j in combinations(range(len(table)), 2))
            size = math.sqrt(misfit / total) if total > 0 else 0.0
            if best is None or size > best.misfit:
                named = "the noise floor" if floor else "what is left"
                told = " and ".join(sorted(" + ".join(sorted(e)) or NONE for e in rivals))
                reason = f"Decides between {told}: they differ by {size:.1f} times {named} here."
                best = Experiment(name, command, tuple(mine.values()), size, reason)
    return best
