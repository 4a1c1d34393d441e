# SPDX-License-Identifier: Apache-2.0
"""The laws that act between the steps of a batch, and what steps one of its simulations under them."""

import copy
from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from labyrinth_sim.build import Placed, Plan
from labyrinth_sim.drive_limit import END, PER_TORQUE, limit
from labyrinth_sim.effect import Values
from labyrinth_sim.law import (
    DATA,
    MEMORY,
    MODEL,
    MOST_VALUES,
    PLACE,
    TABLES,
    Addresses,
    Law,
    apply,
    roll,
    step_address,
)
from labyrinth_sim.live import Fields, Live
from labyrinth_sim.servo import back_emf_actuator
from labyrinth_sim.trials import Array

BASE = ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange")
#: `Live` has them by these names.
NAMED = ("qpos", "qvel", "applied", "actuator", "bias", "passive", "ctrl", "length", "rate")


class Laws:
    """The laws of a batch, and what each simulation gives them.

    Args:
        errors: effects with an error that act.
        steps: those whose step has something to do; those of whole batches are left out.
        values: full parameter name -> (nsim,).
        limits: also what drives give near their limits, in simulations that `near_limit` names; see `drive_limit`.

    Attributes:
        error: (nsim, u) rad, what drives see.
    """

    def __init__(
        self,
        plan: Plan,
        errors: Sequence[Placed],
        steps: Sequence[Placed],
        values: Values,
        nsim: int,
        limits: int | None,
    ) -> None:
        placed = [(p, p.effect.error, p.steps(values)) for p in errors]
        self._first = len(placed)
        placed += [(p, p.effect.step, p.steps(values)) for p in steps if isinstance(p.effect.step, Law)]
        self._limited = [] if limits is None else [site for _, _, site in plan.drives]
        self._end = limits == END
        laws = [law for _, law, _ in placed if isinstance(law, Law)] + [limit] * len(self._limited)
        self.codes = np.array([law.address for law in laws], dtype=np.int64)
        never = [np.zeros(nsim, dtype=bool)] * len(self._limited)
        self.acts = np.array([*(acts for _, _, acts in placed), *never], dtype=bool).reshape(len(laws), nsim)
        self.values = np.zeros((nsim, len(laws), MOST_VALUES))
        self._tables: list[Addresses] = []  # kept as long as laws may read them
        for k, (p, _, _) in enumerate(placed):
            own = [values[p.prefix + parameter.name] for parameter in p.effect.parameters]
            self.values[:, k, : len(own)] = np.column_stack(own)
            if p.effect.tables:
                self._tables.append(p.effect.tables.addresses())
                self.values[:, k, TABLES] = self._tables[-1].ctypes.data
        self.memory = np.zeros((nsim, len(laws), MEMORY))
        sites = [*(p.site for p, _, _ in placed), *self._limited]
        self.places = np.array([[getattr(s, name) for name in PLACE] for s in sites], dtype=np.int64).reshape(
            len(sites), len(PLACE)
        )
        self.touches = sorted({name for p, _, _ in placed for name in p.effect.touches})
        mj = plan.mj
        self.drives = np.array(
            [[s.actuator, s.dof, s.qpos, back_emf_actuator(s), drive.by_duty] for drive, _, s in plan.drives],
            dtype=np.int64,
        )
        self.sizes = np.array([mj.nq, mj.nv, mj.nu, mj.ntendon, len(plan.drives), mj.njnt], dtype=np.int64)
        self.step = np.zeros(1)
        self.error = np.zeros((nsim, len(plan.drives)))
        self._outside: tuple[Addresses, Addresses] | None = None  # tables and arguments for `apply_*`

    @property
    def limits(self) -> slice:
        """Which laws are those of the drives' limits, in the order of the drives."""
        return slice(len(self.codes) - len(self._limited), len(self.codes))

    def near_limit(self, which: NDArray[np.bool_]) -> None:
        """Says which drives of which simulations (nsim, u) may come near their limits."""
        self.acts[self.limits] = which.T

    def turn(self, simulation: int, model: mujoco.MjModel) -> None:
        """Tells the laws of a simulation's limits what a torque does where the model's joints are at 0."""
        own = [model.dof_invweight0[site.dof] if self._end else 0.0 for site in self._limited]
        self.values[simulation, self.limits, PER_TORQUE] = own

    def of(self, simulation: int) -> tuple[NDArray[np.intp], int]:
        """Which laws act on a simulation, and how many of those change errors."""
        which = np.flatnonzero(self.acts[:, simulation])
        return which, int((which < self._first).sum())

    def arguments(self, simulation: int, table: Addresses) -> Addresses:
        """(l, 7) what each law is called with: addresses."""
        raws = np.empty((len(self.codes), 7), dtype=np.int64)
        raws[:, 0], raws[:, 1] = table.ctypes.data, self.sizes.ctypes.data
        raws[:, 2] = self.places.ctypes.data + self.places.strides[0] * np.arange(len(raws))
        for column, array in ((3, self.values), (4, self.memory)):
            raws[:, column] = array[simulation].ctypes.data + array.strides[1] * np.arange(len(raws))
        raws[:, 5], raws[:, 6] = self.step.ctypes.data, self.drives.ctypes.data
        return raws

    def apply_errors(self, live: Live, fields: Fields) -> None:
        """Lets laws change `error` of a batch that is stepped from outside."""
        self._apply(live, fields, slice(0, self._first))

    def apply_forces(self, live: Live, fields: Fields) -> None:
        """Lets laws change the fields of a batch that is stepped from outside."""
        self._apply(live, fields, slice(self._first, None))

    def _apply(self, live: Live, fields: Fields, which: slice) -> None:
        if not len(self.codes[which]):
            return
        if self._outside is None:
            self.step[0] = live.step
            tables = np.array([self._table(live, fields, i) for i in range(len(self.error))])
            self._outside = tables, np.stack([self.arguments(i, tables[i]) for i in range(len(tables))])
        for i in range(len(self.error)):
            own = np.flatnonzero(self.acts[which, i])
            apply(self.codes[which][own], self._outside[1][i : i + 1, which][:, own])

    def _table(self, live: Live, fields: Fields, i: int) -> Addresses:
        own = {*self.touches, *fields.used}
        model = {name: fields[name][i] if name in own else getattr(fields.model, name) for name in MODEL}
        base = [live.base[name][i] if name in live.base else getattr(fields.model, name) for name in BASE]
        arrays = [*(getattr(live, name)[i] for name in NAMED), *model.values(), *base, self.error[i]]
        return np.array([a.ctypes.data for a in arrays], dtype=np.int64)


class Runner:
    """One model and one state, filled with one simulation of a batch after the other."""

    def __init__(self, plan: Plan, fields: Fields) -> None:
        self._drives = plan.drives
        self._fields, self._derived = fields, fields.changes_constants
        self.model = copy.copy(plan.mj)
        self._disabled = int(plan.mj.opt.disableactuator)  # by the MJCF
        self.data = mujoco.MjData(self.model)

    def load(self, simulation: int, qpos: Array, qvel: Array) -> None:
        """Takes a simulation's fields and its first state."""
        for name, numbers in self._fields.used.items():
            owner, _, last = name.rpartition(".")
            holder = getattr(self.model, owner) if owner else self.model
            if np.ndim(getattr(holder, last)):
                getattr(holder, last)[...] = numbers[simulation]
            else:
                setattr(holder, last, numbers[simulation].reshape(-1)[0].item())
        if self._derived:
            mujoco.mj_setConst(self.model, self.data)
        self.model.opt.disableactuator = self._disabled
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = qpos, qvel
        self.data.qfrc_applied[:] = self._fields.torque[simulation]
        mujoco.mj_forward(self.model, self.data)
        self._sums = np.zeros(len(self._drives))
        self._torque = np.array(self._fields.torque[simulation])
        self._base = {name: np.array(getattr(self.model, name)) for name in MODEL}

    def switch(self, off: int) -> None:
        """Switches the actuator groups of these bits off, all others on."""
        self.model.opt.disableactuator = off

    def roll(
        self,
        laws: Laws,
        simulation: int,
        control: Array,
        targets: Array,
        gain: Array,
        ticks: Array,
        integral: Array,
        substeps: int,
        every: float,
        measured: Addresses,
        limit: float,
        jumps: Array,
        out: Array,
    ) -> int:
        """The sample at which the simulation diverged, or -1; see `labyrinth_sim.law.roll`."""
        m, d, error = self.model, self.data, laws.error[simulation]
        arrays = [getattr(d, name) for name in DATA] + [getattr(m, name) for name in MODEL]
        arrays += [self._base[name] for name in BASE] + [error]
        table = np.array([a.ctypes.data for a in arrays], dtype=np.int64)
        laws.step[0] = m.opt.timestep
        which, first_force = laws.of(simulation)
        pairs = [(self._torque, d.qfrc_applied), *((self._base[n], getattr(m, n)) for n in laws.touches)]
        restore = np.array([(a.ctypes.data, b.ctypes.data, a.size) for a, b in pairs], dtype=np.int64)
        at = np.array([d.qpos.ctypes.data, d.qvel.ctypes.data, d.qfrc_actuator.ctypes.data, d.ctrl.ctypes.data,
                       error.ctypes.data, m.nq, m.nv], dtype=np.int64)  # fmt: skip
        return int(roll(
            step_address(), m._address, d._address, laws.codes[which], first_force,
            laws.arguments(simulation, table)[which], restore, at, laws.drives, np.ascontiguousarray(control),
            np.ascontiguousarray(targets), np.ascontiguousarray(gain),
            np.ascontiguousarray(ticks), np.ascontiguousarray(integral), self._sums, substeps, every,
            measured, limit, jumps, laws.values[simulation, laws.limits], out,
        ))  # fmt: skip
