# SPDX-License-Identifier: Apache-2.0
"""What hooks see of a running batch."""

import mujoco.batch
import numpy as np

from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array


class Fields:
    """Per-simulation fields of the compiled model: `fields["dof_damping"]` is (nsim, nv), writable."""

    def __init__(self, batch: mujoco.batch.Batch) -> None:
        self._batch = batch
        self.used: dict[str, Array] = {}
        self.torque: Array = np.zeros((batch.nsim, batch.model.nv))
        """(nsim, nv) N m that act on each degree of freedom at all times; add to it."""

    def __getitem__(self, name: str) -> Array:
        if name not in self.used:
            self.used[name] = self._batch.expand(name)
        return self.used[name]

    @property
    def model(self) -> mujoco.MjModel:
        """The model that all simulations share, for its base values."""
        return self._batch.model

    @property
    def changes_constants(self) -> bool:
        """Whether constants of the model follow from fields that are used."""
        return any(name in mujoco.MjModel._setconst_inputs for name in self.used)

    def derive(self) -> None:
        """Lets MuJoCo recompute the constants that follow from changed fields."""
        if self.changes_constants:
            self._batch.set_const()


class Live:
    """State of a running batch, as `step` hooks see it before each MuJoCo step.

    Attributes:
        qpos (nsim, nq), qvel (nsim, nv): now.
        applied (nsim, nv): N m, add to it; set back before every step.
        actuator, bias, passive (nsim, nv): N m on each degree of freedom as of the last step: of the drives; of inertia
            and gravity, on the other side of the equation; of springs and dampers.
        drives: place of each axis's drive.
        ctrl (nsim, nu): of the actuators, for this step.
        length, rate (nsim, ntendon): of the belts, rad, rad/s, as of the last step.
        base: values of the fields that step hooks write, before any hook.
        model: what all simulations share.
        step: s.
        memory: what a hook keeps from step to step, by a key of its own.
    """

    def __init__(
        self,
        batch: mujoco.batch.Batch,
        fields: Fields,
        touched: tuple[str, ...],
        drives: tuple[Site, ...],
        hooks: bool = True,
    ) -> None:
        self._fields = fields
        self.qpos: Array = batch.bind("qpos")
        self.qvel: Array = batch.bind("qvel")
        self.applied: Array = batch.bind("qfrc_applied")
        self.ctrl: Array = batch.bind("ctrl")
        self.actuator: Array = batch.bind("qfrc_actuator")
        if hooks:  # outputs are copied after every step, so they are bound only where they are read
            self.bias: Array = batch.bind("qfrc_bias")
            self.passive: Array = batch.bind("qfrc_passive")
            self.length: Array = batch.bind("ten_length")
            self.rate: Array = batch.bind("ten_velocity")
        self.model = batch.model
        self.step = float(batch.model.opt.timestep)
        self._torque = fields.torque
        self.applied[...] = fields.torque
        self.drives: tuple[Site, ...] = drives
        self.memory: dict[object, Array] = {}
        self.base: dict[str, Array] = {name: np.array(fields[name]) for name in touched}

    def __getitem__(self, name: str) -> Array:
        """A touched field, (nsim, ...), writable."""
        return self._fields[name]

    def restore(self) -> None:
        """Undoes what the hooks wrote for the last step."""
        self.applied[...] = self._torque
        for name, values in self.base.items():
            self._fields[name][...] = values
