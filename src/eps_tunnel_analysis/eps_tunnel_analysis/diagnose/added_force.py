# SPDX-License-Identifier: Apache-2.0
"""The motion of one axis while recorded commands are played on a model, with forces, or offsets of its setpoint, over
time added.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from eps_tunnel_analysis.diagnose.evidence import Evidence, play_evidence
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.filters import Map
from labyrinth_sim.law import Tables, law, row_of, state
from labyrinth_sim.live import Live
from labyrinth_sim.model import Model
from labyrinth_sim.simulate import simulate_batch
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array, locked

STEP = 0.0025  # s, at most, between the steps of a roll-out
STANDSTILL = 1e-3  # rad/s, m/s; below it a joint keeps its direction
COVERED = 1.02  # times the visited range that a curve covers
LAST_ROW = 1e6


@dataclass(frozen=True)
class Motion:
    """One axis in the roll-out of one play, K steps. Of the driven joint, in rad and N m (m and N where it slides).

    Attributes:
        time: (K,) s since the start.
        angle, speed: (K,).
        direction: (K,) sign of the last speed above STANDSTILL, 0 before the first.
        since: (K,) s since the direction last changed.
        load: (K,) absolute torque that the gear carries, motor against load.
        drive: (K,) of the motor, signed.
        command: (K,) target during each step, NaN where the drive is off.
        other: (K,) angle of the first other axis; empty if there is none.
        other_command: (K,) its target, 0 where its drive is off; empty likewise.
    """

    time: Array
    angle: Array
    speed: Array
    direction: Array
    since: Array
    load: Array
    drive: Array
    command: Array
    other: Array
    other_command: Array

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            object.__setattr__(self, name, locked(getattr(self, name)))


def unlisted(name: str, title: str, physics: str, equation: str, *parameters: Parameter) -> Effect:
    """An effect that only an analysis adds, after all others; its hooks are added to it."""
    return Effect(
        name=name,
        title=title,
        physics=physics,
        equation=equation,
        parameters=parameters,
        stage="force",
        mark="",
        shows="offset",
        confused_with=(),
        separated_by="",
        order=1000,
    )


ROW = Parameter("row", "1", 0.0, LAST_ROW, 0.0, 1.0, "number of a row, from 1; 0 adds nothing")


class Rows:
    """An effect that adds the rows of a table over time to one axis, a row for each simulation.

    Attributes:
        name: of the parameter that says which row acts.
    """

    def __init__(self, effect: Effect, axis: str) -> None:
        self.effect, self._axis = effect, axis
        self.name = f"{effect.name}.{axis}.{ROW.name}"

    def into(self, model: Model) -> Model:
        """The model with this effect, which adds nothing until asked."""
        return model.with_effect(self.effect, self._axis, self.effect.off)


class Forces(Rows):
    """Tables of force over time (N m).

    Args:
        axis: short name.
        at_load: whether they act on the load's joint.

    Attributes:
        tables: the rows, each (K,) of the steps of a roll-out.
    """

    def __init__(self, axis: str, at_load: bool = False) -> None:
        self.tables = Tables()
        load = Parameter("at_load", "1", 0.0, 1.0, None, float(at_load), "1 for the load's joint")
        made = unlisted("added_force", "Added force", "A force over time, as a table.", "torque = table", ROW, load)
        super().__init__(replace(made, step=_add, tables=self.tables, steps_with=ROW.name), axis)


@law
def _add(raw):  # type: ignore[no-untyped-def]
    s = state(raw)
    row = row_of(s, int(s.values[0]))
    dof = s.load_dof if s.values[1] > 0.0 else s.dof
    s.applied[dof] += row[min(int(s.memory[0]), row.size - 1)]
    s.memory[0] += 1.0


class Tracer:
    """Records what one simulation goes through, step by step."""

    def __init__(self, axis: str) -> None:
        on = Parameter("on", "1", 0.0, 1.0, 0.0, 1.0, "1 to record")
        self.effect = replace(unlisted("tracer", "Tracer", "Nothing.", "none", on), step=self._step, order=1001)
        self._axis = axis
        self._seen: list[list[float]] = []

    def into(self, model: Model) -> Model:
        """The model with this effect."""
        return model.with_effect(self.effect, self._axis)

    def _step(self, live: Live, site: Site, values: Values) -> None:
        other = live.drives[site.others[0]].qpos if site.others else -1
        carried = live.actuator[0, site.dof] - live.passive[0, site.dof] + live.bias[0, site.dof]
        self._seen.append(
            [
                live.qpos[0, site.qpos],
                live.qvel[0, site.dof],
                carried,
                live.actuator[0, site.dof],
                live.qpos[0, other],
            ]
        )

    def taken(self) -> Array:
        """(K, 5) angle, speed, load, drive's torque and other angle at the start of each step; then it begins anew."""
        table, self._seen = np.array(self._seen), []
        return table


class Setpoints(Rows):
    """Tables of offsets of the command over time (rad)."""

    def __init__(self, axis: str) -> None:
        self.table: Array = np.zeros((1, 1))  # (rows, K)
        about = "An offset over time, as a table."
        made = unlisted("added_setpoint", "Added setpoint", about, "u' = u + table", ROW)
        # Before any delay: what is added is an error of the command as it was sent.
        super().__init__(replace(made, stage="command", order=0, command=self._command), axis)

    def _command(self, values: Values, site: Site, step: float, start: Array) -> Map:
        rows = values[ROW.name].astype(np.int64)
        offsets = np.where(rows[:, None] > 0, self.table[np.maximum(rows - 1, 0)], 0.0)
        return Map(lambda target: target + offsets[:, : target.shape[1]])


class Playing:
    """A model under recorded commands, with forces over time added to one axis, or offsets to its command.

    Args:
        model: refitted.
        plays: recorded.
        axis: short name.
        signals: compared.
        free: full names of values that may also move.
        at_load: whether forces act on the load's joint.
    """

    def __init__(
        self,
        model: Model,
        plays: Sequence[Play],
        axis: str,
        signals: Sequence[str],
        free: Sequence[str] = (),
        at_load: bool = False,
        nthread: int = 0,
    ) -> None:
        self.axis, self.signals, self.free = axis, tuple(signals), tuple(free)
        self._forces, self._setpoints, self._tracer = Forces(axis, at_load), Setpoints(axis), Tracer(axis)
        self.model = self._setpoints.into(self._forces.into(model))
        self.plays = tuple(play_evidence(self.model, play, signals) for play in plays)
        free = (*self.free, self._forces.name, self._setpoints.name)
        self.evidence = tuple(Evidence(self.model, free, [p], signals, STEP, nthread) for p in self.plays)
        self.values = np.array([self.model.values()[name] for name in self.free])
        self.nthread = nthread
        self._channel = next(i for i, a in enumerate(model.rig.axes) if a.name == axis)

    def count(self, play: int) -> int:
        """K, steps of a play's roll-out."""
        return self.evidence[play].count(0)

    def residuals(self, play: int, table: Array, values: Array | None = None) -> Array:
        """(n, R) simulated minus measured of one play, under force tables (n, K) N m.

        Args:
            values: (n, k) of the free values, those of the model by default.
        """
        self._forces.tables.rows = list(np.ascontiguousarray(table, dtype=np.float64))
        numbers = _numbers(table)
        return self.evidence[play](self._rows(numbers, np.zeros_like(numbers), values))

    def residuals_commanded(self, play: int, table: Array) -> Array:
        """(n, R) the same under offsets (n, K) rad of the axis's command, without a force."""
        self._setpoints.table = table
        numbers = _numbers(table)
        return self.evidence[play](self._rows(np.zeros_like(numbers), numbers))

    def _rows(self, forces: Array, setpoints: Array, values: Array | None = None) -> Array:
        """(n, k + 2) of all free parameters, from the rows (n,) of forces and of offsets."""
        free = np.broadcast_to(self.values if values is None else values, (len(forces), len(self.free)))
        return np.column_stack([free, forces, setpoints])

    def motion(self, play: int, force: Array | None = None) -> Motion:
        """The axis's motion under a force over time (K,) N m, none by default."""
        evidence = self.evidence[play]
        count = evidence.count(0)
        self._forces.tables.rows = [np.zeros(count) if force is None else np.ascontiguousarray(force, np.float64)]
        self._tracer.taken()
        simulate_batch(
            self._tracer.into(self.model), (*self.free, self._forces.name), np.append(self.values, 1.0)[None],
            evidence.times(0), evidence.commands[0][None], evidence.initial[0],
            per_command=evidence.known, resting=evidence.resting[0],
            signals=self.signals, timestep=evidence.step(0), nthread=1, parts=1,
        )  # fmt: skip
        seen = self._tracer.taken()[:count]
        angle, speed, load, drive, other = seen.T
        step, others = evidence.step(0), len(self.model.rig.axes) > 1
        targets = np.nan_to_num(evidence.commands[0][: len(seen)])
        direction, since = _reversals(speed, step)
        return Motion(
            evidence.times(0)[: len(seen)], angle, speed, direction, since, np.abs(load), drive,
            evidence.commands[0][: len(seen), self._channel],
            *((other, targets[:, 0 if self._channel else 1]) if others else (np.empty(0), np.empty(0))),
        )  # fmt: skip


def _numbers(table: Array) -> Array:
    """(n,) of a table's rows (n, K), from 1."""
    return np.arange(1, len(table) + 1, dtype=float)


def _reversals(speed: Array, step: float) -> tuple[Array, Array]:
    """(K,) direction of the last motion and s since it changed."""
    sign = np.where(np.abs(speed) > STANDSTILL, np.sign(speed), 0.0)
    last = np.maximum.accumulate(np.where(sign != 0.0, np.arange(len(sign)), 0))
    direction = sign[last]
    changed = np.flatnonzero(np.diff(direction, prepend=0.0) != 0.0)
    start = np.zeros(len(sign), dtype=np.int64)
    start[changed] = changed
    since = step * (np.arange(len(sign)) - np.maximum.accumulate(start))
    return np.asarray(direction, dtype=np.float64), np.asarray(since, dtype=np.float64)


def beside_another(motions: Sequence[Motion]) -> bool:
    """Whether the axis has another one beside it."""
    return all(m.other.size for m in motions)


def visited(motions: Sequence[Motion]) -> dict[str, dict[str, float]]:
    """Free curve -> short name of each number of its range, so that it covers what these motions visit."""
    angle = _middle([m.angle for m in motions])
    spans = {
        "curve_angle": angle,
        "curve_angle_friction": angle,
        "curve_speed": {"most": COVERED * max(float(np.abs(m.speed).max()) for m in motions)},
        "curve_load_friction": {"most": COVERED * max(float(m.load.max()) for m in motions)},
        "curve_reversal": {"end": max(float(np.quantile(m.since, 0.98)) for m in motions)},
        "curve_time": {"end": max(float(m.time[-1]) for m in motions)},
        "curve_time_friction": {"end": max(float(m.time[-1]) for m in motions)},
    }
    if beside_another(motions):
        other = _middle([m.other for m in motions])
        spans |= {"curve_other": other, "curve_other_friction": other}
    return spans


def _middle(values: Sequence[Array]) -> dict[str, float]:
    low, high = min(float(v.min()) for v in values), max(float(v.max()) for v in values)
    return {"centre": 0.5 * (low + high), "half": max(0.5 * COVERED * (high - low), 1e-3)}
