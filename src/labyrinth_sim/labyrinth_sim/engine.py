# SPDX-License-Identifier: Apache-2.0
"""The one engine under batches and the live node: many simulations of one plan, a sample at a time."""

import logging
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import mujoco
import mujoco.batch
import numpy as np
from numpy.typing import NDArray

from labyrinth_sim.build import Plan, local_values
from labyrinth_sim.effect import Controller, Values
from labyrinth_sim.first_state import place_ball
from labyrinth_sim.live import Fields, Live
from labyrinth_sim.model import Model
from labyrinth_sim.rig import BALL_SIGNALS, Measured
from labyrinth_sim.site import ball_site
from labyrinth_sim.trials import Array

# MuJoCo would otherwise write its warnings to a file in the working folder; `Engine.check` reports what they are about.
mujoco.set_mju_user_warning(logging.getLogger(__name__).debug)

Columns = slice | NDArray[np.intp]
LIMIT = 1e6  # rad, rad/s: beyond, a simulation has diverged


class Engine:
    """nsim simulations, advanced sample by sample.

    Args:
        model: the model.
        plan: its compiled structure.
        values: full parameter name -> (nsim,); every parameter of the model that is not at the MJCF's own value.
        nsim: how many.
        step: s between samples.
        nthread: 0 for one per CPU. The result does not depend on it.
    """

    def __init__(self, model: Model, plan: Plan, values: Values, nsim: int, step: float, nthread: int = 0) -> None:
        self.plan, self.nsim, self.step = plan, nsim, step
        self.substeps = max(1, round(step / plan.mj.opt.timestep))
        self.batch = mujoco.batch.Batch(plan.mj, nsim, nthread)
        self.fields = Fields(self.batch)
        self.fields["opt.timestep"][...] = step / self.substeps
        self._values = values
        self._set_fields(values)
        acting = plan.acting(values)
        self._hooks = [(p, local_values(values, p.prefix)) for p in acting if p.effect.step]
        self._errors = [[(p, local_values(values, p.prefix)) for p in acting if p.effect.error and p.site.channel == i]
                        for i in range(len(plan.drives))]  # fmt: skip
        touched = {name for p, _ in self._hooks for name in p.effect.touches}
        self.live = Live(self.batch, self.fields, tuple(sorted(touched)), tuple((d, s) for d, _, s in plan.drives))
        self.live_step = step / self.substeps
        self._controllers: list[Controller | None] = [
            kind.controller(local_values(values, prefix), step) if kind.controller else None
            for kind, prefix, _ in plan.drives
        ]
        self._every_step = bool(self._hooks) or any(self._errors)
        self._off, self._any_off = np.zeros((nsim, len(plan.drives)), dtype=bool), False
        self._measured = self._columns([_address(plan.mj, m) for m in model.rig.measured])
        self._signals = len(model.rig.measured) + (len(BALL_SIGNALS) if plan.with_ball else 0)
        self._ctrl = self.batch.bind("ctrl")
        self._stage = int(mujoco.mjtStage.mjSTAGE_POS if plan.with_ball else mujoco.mjtStage.mjSTAGE_NONE)
        self.failed: NDArray[np.bool_] = np.zeros(nsim, dtype=bool)
        self.messages: dict[int, str] = {}
        if plan.with_ball:
            self._ball = ball_site(model.rig, plan.mj)
            self._xpos, self._site_pos = self.batch.bind("xpos"), self.batch.bind("site_xpos")
            self._site_mat = self.batch.bind("site_xmat").reshape(nsim, -1, 3, 3)

    def _set_fields(self, values: Values) -> None:
        for name, numbers in values.items():
            kind, owner, _, quantity = (*name.split(".", 1)[:1], *name[len(name.split(".")[0]) + 1 :].rpartition("."))
            if kind == "joint":
                self.fields[f"dof_{quantity}"][:, int(self.plan.mj.joint(owner).dofadr[0])] = numbers
            elif kind == "body":
                body = self.plan.mj.body(owner).id
                self.fields["body_inertia"][:, body] *= (numbers / self.plan.mj.body_mass[body])[:, None]
                self.fields["body_mass"][:, body] = numbers
        for drive, prefix, site in self.plan.drives:
            drive.fields(self.fields, site, local_values(values, prefix))
        for placed in self.plan.effects:
            if placed.effect.fields:
                placed.effect.fields(self.fields, placed.site, local_values(values, placed.prefix))
        self.fields.derive()

    def start(self, qpos: Array, qvel: Array) -> None:
        """Puts the simulations into their first state, (nsim, nq) and (nsim, nv)."""
        self.batch.bind("qpos")[...] = qpos
        self.batch.bind("qvel")[...] = qvel
        if self._hooks or self.plan.with_ball:
            self._run(lambda ids: self.batch.forward(ids))

    def advance(self, target: Array) -> None:
        """One sample with these targets (nsim, u) rad held; NaN switches that axis's drive off."""
        off = np.isnan(target)
        if (off != self._off).any():
            self._switch(off)
        for i, controller in enumerate(self._controllers):
            if controller:
                error = self._error(i, target[:, i])
                controller.sample(np.where(off[:, i], 0.0, error) if self._any_off else error)
                if self._any_off:
                    controller.restart(off[:, i])
            if not self._errors[i]:
                self._control(i, target[:, i], off[:, i])
        if not self._every_step:
            self._run(lambda ids: self.batch.step(ids, self.substeps, self._stage))
            return
        for k in range(self.substeps):
            self._before_step(target, off)
            stage = self._stage if k == self.substeps - 1 else 0
            self._run(partial(self.batch.step, nstep=1, stage=stage))

    def _control(self, channel: int, target: Array, off: NDArray[np.bool_]) -> None:
        controller = self._controllers[channel]
        control = controller(target) if controller else target
        self._ctrl[:, self.plan.drives[channel][2].actuator] = np.where(off, 0.0, control) if self._any_off else control

    def _before_step(self, target: Array, off: NDArray[np.bool_]) -> None:
        for i, (_, _, site) in enumerate(self.plan.drives):
            if self._errors[i]:
                error = target[:, i] - self.live.qpos[:, site.qpos]
                self._control(i, target[:, i] + (self._error(i, target[:, i]) - error), off[:, i])
        if self._hooks:
            self.live.restore()
            for placed, values in self._hooks:
                assert placed.effect.step is not None
                placed.effect.step(self.live, placed.site, values)

    def _error(self, channel: int, target: Array) -> Array:
        error = target - self.live.qpos[:, self.plan.drives[channel][2].qpos]
        for placed, values in self._errors[channel]:
            assert placed.effect.error is not None
            error = placed.effect.error(values, error)
        return error

    def _switch(self, off: NDArray[np.bool_]) -> None:
        bits = np.zeros(self.nsim, dtype=np.int32)
        for i, (_, _, site) in enumerate(self.plan.drives):
            bits |= np.where(off[:, i], 1 << site.group, 0).astype(np.int32)
        self.fields["opt.disableactuator"][...] = bits
        self._off, self._any_off = off, bool(off.any())

    def _run(self, call: Callable[[NDArray[np.int32] | None], None]) -> None:
        ids = np.flatnonzero(~self.failed).astype(np.int32) if self.messages else None
        if ids is not None and ids.size == 0:
            return
        try:
            call(ids)
        except mujoco.batch.SimulationError as error:
            for i in error.ids:
                self._fail(int(i), self.batch.error(int(i)))

    def _fail(self, sim: int, message: str) -> None:
        if not self.failed[sim]:
            self.failed[sim] = True
            self.messages[sim] = message

    def check(self, time: float) -> None:
        """Marks simulations that diverged by `time` s; they are not stepped any more."""
        speed = np.abs(self.live.qvel).max(axis=1)
        for sim in np.flatnonzero(~(speed < LIMIT) & ~self.failed):
            self._fail(int(sim), f"diverged by {time:.3f} s: a speed beyond {LIMIT:g} rad/s or not a number")

    def measure(self) -> Array:
        """(nsim, m) signals now, before any sensor's effects; the ball's last."""
        seen = np.empty((self.nsim, self._signals))
        for source, addresses, columns in self._measured:
            seen[:, columns] = source[:, addresses]
        if self.plan.with_ball:
            seen[:, -2:] = self.ball()[:, :2]
        return seen

    def _columns(self, measured: Sequence[tuple[str, int]]) -> list[tuple[Array, Columns, Columns]]:
        """What is measured, gathered from each array at once: the array, its columns, and theirs among the signals."""
        sources = {"position": self.live.qpos, "velocity": self.live.qvel, "torque": self.live.actuator}
        found = []
        for quantity, source in sources.items():
            columns = [i for i, (q, _) in enumerate(measured) if q == quantity]
            if columns:
                found.append((source, _run_of([measured[i][1] for i in columns]), _run_of(columns)))
        return found

    def ball(self) -> Array:
        """(nsim, 3) m, the ball's centre in its site's frame."""
        offset = self._xpos[:, self._ball.ball_body] - self._site_pos[:, self._ball.ball_site]
        mat = self._site_mat[:, self._ball.ball_site]
        # Written out, so that the sum has one order at any batch size.
        return mat[:, 0] * offset[:, :1] + mat[:, 1] * offset[:, 1:2] + mat[:, 2] * offset[:, 2:]

    def place_ball(self, given: Mapping[str, Array]) -> None:
        """Puts the balls, at rest, at `ball_x`, `ball_y` (nsim,) m, or where the MJCF has them."""
        place_ball(self._ball, self.plan.mj, self.live.qpos, given)
        self.live.qvel[:, self._ball.ball_dof : self._ball.ball_dof + 6] = 0.0


def _run_of(columns: list[int]) -> Columns:
    """The columns as a slice where they are evenly spaced, for that copies nothing twice."""
    apart = columns[1] - columns[0] if len(columns) > 1 else 1
    if apart > 0 and columns == list(range(columns[0], columns[-1] + 1, apart)):
        return slice(columns[0], columns[-1] + 1, apart)
    return np.array(columns)


def _address(mj: mujoco.MjModel, measured: Measured) -> tuple[str, int]:
    joint = mj.joint(measured.joint)
    return measured.quantity, int(joint.qposadr[0] if measured.quantity == "position" else joint.dofadr[0])
