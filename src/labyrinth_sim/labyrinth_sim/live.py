# SPDX-License-Identifier: Apache-2.0
"""What hooks see of a running batch."""

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import mujoco.batch
import numpy as np

from labyrinth_sim.trials import Array

if TYPE_CHECKING:
    from labyrinth_sim.effect import Drive
    from labyrinth_sim.site import Site


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

    def derive(self) -> None:
        """Lets MuJoCo recompute the constants that follow from changed fields."""
        if any(name in mujoco.MjModel._setconst_inputs for name in self.used):
            self._batch.set_const()


class Servos:
    """The drives' position servos, linear in angle and speed as MuJoCo's are, before any hook.

    Attributes:
        dof: (d,) degree of freedom of each drive, in the order of the axes.
        full: (nsim, d) N m, the largest torque.
    """

    def __init__(self, base: dict[str, Array], sites: "Sequence[Site]") -> None:
        self._actuator = np.array([site.actuator for site in sites])
        self._angle = np.array([site.qpos for site in sites])
        self.dof = np.array([site.dof for site in sites])
        self._gain = base["actuator_gainprm"][:, self._actuator, 0]
        self._bias = [base["actuator_biasprm"][:, self._actuator, k] for k in range(3)]
        self.full = base["actuator_forcerange"][:, self._actuator, 1]

    def torque(self, live: "Live") -> Array:
        """(nsim, d) N m that they would give without a limit."""
        constant, stiffness, damping = self._bias
        angle, speed = live.qpos[:, self._angle], live.qvel[:, self.dof]
        return self._gain * live.ctrl[:, self._actuator] + constant + stiffness * angle + damping * speed


class Live:
    """State of a running batch, as `step` hooks see it before each MuJoCo step.

    Attributes:
        qpos (nsim, nq), qvel (nsim, nv): now.
        applied (nsim, nv): N m, add to it; set back before every step.
        actuator, bias, passive (nsim, nv): N m on each degree of freedom as of the last step: of the drives; of inertia
            and gravity, on the other side of the equation; of springs and dampers.
        drives: kind and place of each axis's drive.
        ctrl (nsim, nu): of the actuators, for this step.
        length, rate (nsim, ntendon): of the belts, rad, rad/s, as of the last step.
        base: values of the fields that step hooks write, before any hook.
        model: what all simulations share.
        step: s.
    """

    def __init__(
        self,
        batch: mujoco.batch.Batch,
        fields: Fields,
        touched: tuple[str, ...],
        drives: "tuple[tuple[Drive, Site], ...]",
    ) -> None:
        self._fields = fields
        self.qpos: Array = batch.bind("qpos")
        self.qvel: Array = batch.bind("qvel")
        self.applied: Array = batch.bind("qfrc_applied")
        self.actuator: Array = batch.bind("qfrc_actuator")
        self.bias: Array = batch.bind("qfrc_bias")
        self.passive: Array = batch.bind("qfrc_passive")
        self.ctrl: Array = batch.bind("ctrl")
        self.length: Array = batch.bind("ten_length")
        self.rate: Array = batch.bind("ten_velocity")
        self.model = batch.model
        self.step = float(batch.model.opt.timestep)
        self._torque = fields.torque
        self.applied[...] = fields.torque
        self.drives: tuple[tuple[Drive, Site], ...] = drives
        self.base: dict[str, Array] = {name: np.array(fields[name]) for name in touched}

    @cached_property
    def servos(self) -> Servos:
        """The drives' servos, for hooks that touch all that actuators are made of."""
        return Servos(self.base, [site for _, site in self.drives])

    def __getitem__(self, name: str) -> Array:
        """A touched field, (nsim, ...), writable."""
        return self._fields[name]

    def restore(self) -> None:
        """Undoes what the hooks wrote for the last step."""
        self.applied[...] = self._torque
        for name, values in self.base.items():
            self._fields[name][...] = values
