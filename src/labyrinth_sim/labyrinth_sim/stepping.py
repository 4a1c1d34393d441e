# SPDX-License-Identifier: Apache-2.0
"""Simulations a sample at a time: one, as the live node runs it, or many, whose controllers use what is measured."""

from collections.abc import Mapping

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from labyrinth_sim.build import compiled
from labyrinth_sim.engine import Engine
from labyrinth_sim.errors import InputError
from labyrinth_sim.first_state import first_state
from labyrinth_sim.model import Model
from labyrinth_sim.rig import BALL_SIGNALS
from labyrinth_sim.simulate import (
    command_filters,
    even_timestep,
    measure_filters,
    numbers_of,
    rest_targets,
    through,
    undone,
)
from labyrinth_sim.trials import Array


class BatchStepper:
    """`count` simulations of one model side by side, each under its own commands: the same engine as the roll-outs.

    Args:
        model: the model.
        count: how many simulations.
        step: s between samples; the rig's if None.
        with_ball: simulate the ball too; None for a rig that has one.
        timestep: s, MuJoCo's; None for the MJCF's.
        initial: as in `reset`.

    Attributes:
        signals: m names of what is measured, the ball's last.
        seen: (count, m) the present measurement; a simulation that diverged stays as it was.
        failed: (count,) which simulations diverged.
        time: s since the reset.
    """

    def __init__(
        self, model: Model, count: int, step: float | None = None, with_ball: bool | None = None,
        timestep: float | None = None, initial: Mapping[str, ArrayLike] | None = None,
    ) -> None:  # fmt: skip
        if count < 1:
            raise InputError(f"count must be at least 1, got {count}.")
        self.model, self.count, self.step = model, count, step or model.rig.sample_time
        ball = model.rig.ball is not None if with_ball is None else with_ball
        self._plan = compiled(model, ball, even_timestep(self.step, timestep, model, ball))
        self._numbers = numbers_of(model, count)
        self.signals = tuple(m.signal for m in model.rig.measured) + (BALL_SIGNALS if self._plan.with_ball else ())
        self.reset(initial)

    @property
    def failed(self) -> NDArray[np.bool_]:
        """(count,) which simulations diverged."""
        return self._engine.failed

    @property
    def time(self) -> float:
        """s since the reset."""
        return self._samples * self.step

    def index(self, *signals: str) -> list[int]:
        """Columns of signals in `seen`."""
        return [self.signals.index(name) for name in signals]

    def reset(self, initial: Mapping[str, ArrayLike] | None = None, first_command: Array | None = None) -> Array:
        """Starts again.

        Args:
            initial: signal -> value or (count,) values; 0 and the ball's start point where not given.
            first_command: (u,) or (count, u) rad; axes whose first command is NaN start switched off. All on if None.

        Returns:
            (count, m) the first measurement.
        """
        self._engine = Engine(self.model, self._plan, self._numbers, self.count, self.step, nthread=1)
        given = {name: np.broadcast_to(np.asarray(v, float), (self.count,)) for name, v in (initial or {}).items()}
        given = undone(self._plan, self._numbers, given)
        qpos, qvel = first_state(self.model, self._plan.mj, self._plan.with_ball, self.count, given)
        first = np.zeros(len(self.model.rig.axes)) if first_command is None else np.asarray(first_command, float)
        start = rest_targets(self._plan, qpos, np.broadcast_to(first, (self.count, len(self.model.rig.axes))))
        self._engine.start(qpos, qvel, start)
        self._commands, _ = command_filters(self._plan, self._numbers, self.step, start)
        raw = self._engine.measure()
        self._sensors = measure_filters(self.model, self._plan, self._numbers, self.step, raw)
        self._samples = 0
        self.seen = self._through_sensors(raw)
        return self.seen

    def advance(self, commands: Array) -> Array:
        """Holds commands (count, u) rad for one sample, NaN switching a drive off; returns `seen` after it."""
        target = through(self._commands, np.asarray(commands, float)[:, None, :])[:, 0]
        with np.errstate(over="ignore", invalid="ignore"):
            self._engine.advance(target)
            self._samples += 1
            self._engine.check(self.time)
            now = self._through_sensors(self._engine.measure())
        self.seen = np.where(self.failed[:, None], self.seen, now)
        return self.seen

    def ball(self) -> Array:
        """(count, 3) m, where each ball's centre is in the board's frame, whatever the camera sees."""
        return self._engine.ball()

    def _through_sensors(self, raw: Array) -> Array:
        return np.array(through(self._sensors, raw[:, None, :])[:, 0])


class Stepper:
    """A model that runs sample by sample, as the live node runs it: a batch of one.

    Args:
        model: the model.
        step: s between samples; the rig's if None.
        with_ball: simulate the ball too; None for a rig that has one.
        timestep: s, MuJoCo's; None for the MJCF's.
    """

    def __init__(
        self, model: Model, step: float | None = None, with_ball: bool | None = None, timestep: float | None = None
    ) -> None:
        self._batch = BatchStepper(model, 1, step, with_ball, timestep)
        self.model, self.step, self.signals = model, self._batch.step, self._batch.signals
        self.with_ball = model.rig.ball is not None if with_ball is None else with_ball

    @property
    def time(self) -> float:
        """s since the reset."""
        return self._batch.time

    def reset(self, initial: Mapping[str, float] | None = None, first_command: Array | None = None) -> Array:
        """Starts again.

        Args:
            initial: signal -> value; 0 and the ball's start point where not given.
            first_command: (u,) rad; axes whose first command is NaN start switched off. All on if None.

        Returns:
            (m,) the first measurement.
        """
        return np.array(self._batch.reset(initial, first_command)[0])

    def advance(self, command: Array) -> Array:
        """Holds a command (u,) rad for one sample, NaN switching a drive off; returns the measurement (m,) after it.

        Raises:
            InputError: the simulation diverged; `reset` starts it again.
        """
        seen = self._batch.advance(np.asarray(command, float)[None])
        if self._batch.failed[0]:
            raise InputError(f"The simulation of '{self.model.name}' {self._batch._engine.messages[0]}.")
        return np.array(seen[0])

    def ball(self) -> Array:
        """(3,) m, where the ball's centre is in the board's frame, whatever the camera sees."""
        return self._batch.ball()[0]

    def supply_ball(self) -> None:
        """Puts the ball, at rest, where the MJCF has it on the board."""
        if not self.with_ball:
            raise InputError(f"Rig '{self.model.rig.name}' has no ball.")
        self._batch._engine.place_ball({})

    @property
    def mj(self) -> mujoco.MjModel:
        """The compiled model, with this model's values."""
        return self._batch._engine.batch.get_model(0)

    @property
    def qpos(self) -> Array:
        """(nq,) now, for drawing."""
        return np.array(self._batch._engine.live.qpos[0])
