# SPDX-License-Identifier: Apache-2.0
"""One simulation, a sample at a time, as the live node runs it: the same engine as the batch."""

from collections.abc import Mapping

import mujoco
import numpy as np

from labyrinth_sim.build import compiled
from labyrinth_sim.chains import command_filters, measure_filters, through, undone
from labyrinth_sim.engine import Engine
from labyrinth_sim.errors import InputError
from labyrinth_sim.first_state import first_state
from labyrinth_sim.model import Model
from labyrinth_sim.rig import BALL_SIGNALS
from labyrinth_sim.simulate import even_timestep, numbers_of, rest_targets
from labyrinth_sim.trials import Array


class Stepper:
    """A model that runs sample by sample.

    Args:
        model: the model.
        step: s between samples; the rig's if None.
        with_ball: simulate the ball too; None for a rig that has one.
        timestep: s, MuJoCo's; None for the MJCF's.
    """

    def __init__(
        self, model: Model, step: float | None = None, with_ball: bool | None = None, timestep: float | None = None
    ) -> None:
        self.model = model
        self.step = step or model.rig.sample_time
        self.with_ball = model.rig.ball is not None if with_ball is None else with_ball
        self._plan = compiled(model, self.with_ball, even_timestep(self.step, timestep, model, self.with_ball))
        self._numbers = numbers_of(model, 1)
        self.signals = tuple(m.signal for m in model.rig.measured) + (BALL_SIGNALS if self.with_ball else ())
        self.reset()

    @property
    def time(self) -> float:
        """s since the reset."""
        return self._samples * self.step

    def reset(self, initial: Mapping[str, float] | None = None, first_command: Array | None = None) -> Array:
        """Starts anew.

        Args:
            initial: signal -> value; 0 and the ball's start point where not given.
            first_command: (u,) rad; axes whose first command is NaN start switched off. All on if None.

        Returns:
            (m,) the first measurement.
        """
        self._engine = Engine(self.model, self._plan, self._numbers, 1, self.step, nthread=1)
        given = {name: np.array([value]) for name, value in (initial or {}).items()}
        given = undone(self._plan, self._numbers, given)
        qpos, qvel = first_state(self.model, self._plan.mj, self.with_ball, 1, given)
        first = np.zeros(len(self.model.rig.axes)) if first_command is None else np.asarray(first_command, float)
        start = rest_targets(self._plan, qpos, first[None])
        self._engine.start(qpos, qvel, start)
        self._commands = command_filters(self._plan, self._numbers, self.step, start)
        raw = self._engine.measure()
        self._sensors = measure_filters(self.model, self._plan, self._numbers, self.step, raw)
        self._samples = 0
        return self._seen(raw)

    def advance(self, command: Array) -> Array:
        """Holds a command (u,) rad for one sample, NaN switching a drive off; returns the measurement (m,) after it.

        Raises:
            InputError: the simulation diverged; `reset` starts anew.
        """
        target = through(self._commands, np.asarray(command, float)[None, None, :])[:, 0]
        self._engine.advance(target)
        self._samples += 1
        self._engine.check(self.time)
        if self._engine.failed[0]:
            raise InputError(f"The simulation of '{self.model.name}' {self._engine.messages[0]}.")
        return self._seen(self._engine.measure())

    def _seen(self, raw: Array) -> Array:
        return through(self._sensors, raw[:, None, :])[0, 0]

    def ball(self) -> Array:
        """(3,) m, where the ball's centre is in the board's frame, whatever the camera sees."""
        return self._engine.ball()[0]

    def supply_ball(self) -> None:
        """Puts the ball, at rest, where the MJCF has it on the board."""
        if not self.with_ball:
            raise InputError(f"Rig '{self.model.rig.name}' has no ball.")
        self._engine.place_ball({})

    @property
    def mj(self) -> mujoco.MjModel:
        """The compiled model, with this model's values."""
        return self._engine.batch.get_model(0)

    @property
    def qpos(self) -> Array:
        """(nq,) now, for drawing."""
        return np.array(self._engine.live.qpos[0])
