# SPDX-License-Identifier: Apache-2.0
"""What hooks see of a running batch."""

import mujoco.batch
import numpy as np

from labyrinth_sim.trials import Array


class Fields:
    """Per-simulation fields of the compiled model: `fields["dof_damping"]` is (nsim, nv), writable."""

    def __init__(self, batch: mujoco.batch.Batch) -> None:
        self._batch = batch
        self.used: dict[str, Array] = {}

    def __getitem__(self, name: str) -> Array:
        if name not in self.used:
            self.used[name] = self._batch.expand(name)
        return self.used[name]

    @property
    def model(self) -> mujoco.MjModel:
        """The model that all simulations share, for its base values."""
        return self._batch.model

    def derive(self) -> None:
        """Lets MuJoCo recompute the constants that follow from changed fields."""
        if any(name in mujoco.MjModel._setconst_inputs for name in self.used):
            self._batch.set_const()


class Live:
    """State of a running batch, as `step` hooks see it before each MuJoCo step.

    Attributes:
        qpos (nsim, nq), qvel (nsim, nv): now.
        applied (nsim, nv): N m, add to it; zeroed before every step.
        actuator, bias, passive (nsim, nv): N m on each degree of freedom as of the last step: of the drives; of inertia and
            gravity, on the other side of the equation; of springs and dampers.
        base: values of the fields that step hooks write, before any hook.
        step: s.
    """

    def __init__(self, batch: mujoco.batch.Batch, fields: Fields, touched: tuple[str, ...]) -> None:
        self._fields = fields
        self.qpos: Array = batch.bind("qpos")
        self.qvel: Array = batch.bind("qvel")
        self.applied: Array = batch.bind("qfrc_applied")
        self.actuator: Array = batch.bind("qfrc_actuator")
        self.bias: Array = batch.bind("qfrc_bias")
        self.passive: Array = batch.bind("qfrc_passive")
        self.force: Array = batch.bind("actuator_force")
        self.step = float(batch.model.opt.timestep)
        self.base: dict[str, Array] = {name: np.array(fields[name]) for name in touched}

    def __getitem__(self, name: str) -> Array:
        """A touched field, (nsim, ...), writable."""
        return self._fields[name]

    def restore(self) -> None:
        """Undoes what the hooks wrote for the last step."""
        self.applied[...] = 0.0
        for name, values in self.base.items():
            self._fields[name][...] = values
