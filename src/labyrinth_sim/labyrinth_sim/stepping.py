# SPDX-License-Identifier: Apache-2.0
"""Many simulations of one model, a sample at a time: for controllers whose commands depend on what is measured."""

from collections.abc import Mapping

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
    """`count` simulations of one model side by side, each under its own commands; see `simulate.Stepper` for one.

    Args:
        model: the model.
        count: how many simulations.
        step: s between samples; the rig's if None.
        with_ball: simulate the ball too; None for a rig that has one.
        timestep: s, MuJoCo's; None for the MJCF's.
        initial: signal -> value or (count,) values at the first sample; 0 and the ball's start point where not given.

    Attributes:
        signals: m names of what is measured, the ball's last.
        seen: (count, m) the present measurement; a simulation that diverged stays as it was.
        failed: (count,) which simulations diverged.
    """

    def __init__(
        self, model: Model, count: int, step: float | None = None, with_ball: bool | None = None,
        timestep: float | None = None, initial: Mapping[str, ArrayLike] | None = None,
    ) -> None:  # fmt: skip
        if count < 1:
            raise InputError(f"count must be at least 1, got {count}.")
        self.count, self.step = count, step or model.rig.sample_time
        ball = model.rig.ball is not None if with_ball is None else with_ball
        plan = compiled(model, ball, even_timestep(self.step, timestep, model, ball))
        numbers = numbers_of(model, count)
        self.signals = tuple(m.signal for m in model.rig.measured) + (BALL_SIGNALS if plan.with_ball else ())
        given = {name: np.broadcast_to(np.asarray(v, float), (count,)) for name, v in (initial or {}).items()}
        qpos, qvel = first_state(model, plan.mj, plan.with_ball, count, undone(plan, numbers, given))
        start = rest_targets(plan, qpos, np.zeros((count, len(model.rig.axes))))
        self._engine = Engine(model, plan, numbers, count, self.step, nthread=1)
        self._engine.start(qpos, qvel, start)
        self._commands = command_filters(plan, numbers, self.step, start)
        raw = self._engine.measure()
        self._sensors = measure_filters(model, plan, numbers, self.step, raw)
        self._samples = 0
        self.seen = self._through_sensors(raw)

    @property
    def failed(self) -> NDArray[np.bool_]:
        """(count,) which simulations diverged."""
        return self._engine.failed

    def index(self, *signals: str) -> list[int]:
        """Columns of signals in `seen`."""
        return [self.signals.index(name) for name in signals]

    def advance(self, commands: Array) -> Array:
        """Holds commands (count, u) rad for one sample, NaN switching a drive off; returns `seen` after it."""
        target = through(self._commands, np.asarray(commands, float)[:, None, :])[:, 0]
        with np.errstate(over="ignore", invalid="ignore"):
            self._engine.advance(target)
            self._samples += 1
            self._engine.check(self._samples * self.step)
            now = self._through_sensors(self._engine.measure())
        self.seen = np.where(self.failed[:, None], self.seen, now)
        return self.seen

    def ball(self) -> Array:
        """(count, 3) m, where each ball's centre is in the board's frame, whatever the camera sees."""
        return self._engine.ball()

    def _through_sensors(self, raw: Array) -> Array:
        return np.array(through(self._sensors, raw[:, None, :])[:, 0])
