# SPDX-License-Identifier: Apache-2.0
"""The one engine under batches and the live node: many simulations of one plan, and the laws that act on them."""

import copy
import logging
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import mujoco
import mujoco.batch
import numpy as np
from numpy.typing import NDArray

from labyrinth_sim.build import Placed, Plan, local_values
from labyrinth_sim.effect import Controller, Values
from labyrinth_sim.filters import Delay
from labyrinth_sim.first_state import place_ball
from labyrinth_sim.law import DATA, MEMORY, MODEL, MOST_VALUES, Addresses, Law, apply, roll, step_address
from labyrinth_sim.live import Fields, Live
from labyrinth_sim.model import Model
from labyrinth_sim.rig import BALL_SIGNALS, Measured
from labyrinth_sim.servo import back_emf_actuator
from labyrinth_sim.site import ball_site
from labyrinth_sim.trials import Array

# MuJoCo would otherwise write its warnings to a file in the working folder; `Engine.check` reports what they are about.
mujoco.set_mju_user_warning(logging.getLogger(__name__).debug)

Columns = slice | NDArray[np.intp]
LIMIT = 1e6  # rad, rad/s: beyond, a simulation has diverged
CHECK_EVERY = 50  # samples between checks for simulations that diverged
LEAD_TIME = 0.01  # s, over which a drive's law sees by how much its target changes; the paper's sample
SPREAD = 2  # samples over which a delay may spread a step of a command
FAR = 2.0  # times what saturates a drive, beyond which a step counts so, in full from this times that on
WHOLE_STEP = 20  # power of a step's share of a sample with which what goes beyond a saturated drive's reach counts
AT_ONCE = 1024  # MuJoCo steps of one uninterrupted stretch; bounds the memory of what is recorded
RECORDED = {"position": "qpos", "velocity": "qvel", "torque": "qfrc_actuator"}
BASE = ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange")
#: `Live` has them by these names.
NAMED = ("qpos", "qvel", "applied", "actuator", "bias", "passive", "ctrl", "length", "rate")


class Laws:
    """The laws of a batch, and what each simulation gives them.

    Args:
        errors: effects with an error that act.
        steps: those whose step has something to do; those of whole batches are left out.
        values: full parameter name -> (nsim,).

    Attributes:
        error: (nsim, u) rad, what drives see.
    """

    def __init__(
        self, plan: Plan, errors: Sequence[Placed], steps: Sequence[Placed], values: Values, nsim: int
    ) -> None:
        placed = [(p, p.effect.error, p.acts(values)) for p in errors]
        self._first = len(placed)
        placed += [(p, p.effect.step, p.steps(values)) for p in steps if isinstance(p.effect.step, Law)]
        self.codes = np.array([law.address for _, law, _ in placed if isinstance(law, Law)], dtype=np.int64)
        self.acts = np.array([acts for _, _, acts in placed], dtype=bool).reshape(len(placed), nsim)
        self.values = np.zeros((nsim, len(placed), MOST_VALUES))
        for k, (p, _, _) in enumerate(placed):
            own = [values[p.prefix + parameter.name] for parameter in p.effect.parameters]
            self.values[:, k, : len(own)] = np.column_stack(own)
        self.memory = np.zeros((nsim, len(placed), MEMORY))
        sites = [p.site for p, _, _ in placed]
        self.places = np.array(
            [[s.channel, s.actuator, s.dof, s.qpos, s.load_dof, s.tendon] for s in sites], dtype=np.int64
        ).reshape(len(sites), 6)
        self.touches = sorted({name for p, _, _ in placed for name in p.effect.touches})
        mj = plan.mj
        self.drives = np.array(
            [[s.actuator, s.dof, s.qpos, back_emf_actuator(s), drive.by_duty] for drive, _, s in plan.drives],
            dtype=np.int64,
        )
        self.sizes = np.array([mj.nq, mj.nv, mj.nu, mj.ntendon, len(plan.drives)], dtype=np.int64)
        self.step = np.zeros(1)
        self.error = np.zeros((nsim, len(plan.drives)))
        self._outside: tuple[Addresses, Addresses] | None = None  # tables and arguments for `apply_*`

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
        model = {name: fields[name][i] if name in self.touches else getattr(fields.model, name) for name in MODEL}
        base = [live.base[name][i] if name in live.base else getattr(fields.model, name) for name in BASE]
        arrays = [*(getattr(live, name)[i] for name in NAMED), *model.values(), *base, self.error[i]]
        return np.array([a.ctypes.data for a in arrays], dtype=np.int64)


class Runner:
    """One model and one state, filled with one simulation of a batch after the other."""

    def __init__(self, plan: Plan, fields: Fields) -> None:
        self._drives = plan.drives
        self._fields, self._derived = fields, any(name in mujoco.MjModel._setconst_inputs for name in fields.used)
        self.model = copy.copy(plan.mj)
        self._disabled = int(plan.mj.opt.disableactuator)  # by the MJCF
        self.data = mujoco.MjData(self.model)

    def load(self, simulation: int, qpos: Array, qvel: Array) -> None:
        """Takes a simulation's fields and its first state."""
        if self._derived:
            self.model = self._fields.model_of(simulation)
        else:
            for name, numbers in self._fields.used.items():
                owner, _, last = name.rpartition(".")
                holder = getattr(self.model, owner) if owner else self.model
                if np.ndim(getattr(holder, last)):
                    getattr(holder, last)[...] = numbers[simulation]
                else:
                    setattr(holder, last, numbers[simulation].reshape(-1)[0].item())
        self.model.opt.disableactuator = self._disabled
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = qpos, qvel
        self.data.qfrc_applied[:] = self._fields.torque[simulation]
        mujoco.mj_forward(self.model, self.data)
        self._sums = np.zeros(len(self._drives))
        self._torque = np.ascontiguousarray(self._fields.torque[simulation])
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
            measured, limit, out,
        ))  # fmt: skip


class Engine:
    """nsim simulations.

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
        self._set_fields(values)
        self.nthread = nthread
        acting = plan.acting(values)
        errors, steps = [p for p in acting if p.effect.error], [p for p in acting if p.steps(values).any()]
        self._hooks = [(p, local_values(values, p.prefix)) for p in steps if not isinstance(p.effect.step, Law)]
        self._errors = bool(errors)
        none = np.zeros(nsim)
        self._ticks = np.column_stack([values.get(f"{p}feedback_tick", none) for _, p, _ in plan.drives])
        self._errors |= bool(self._ticks.any())
        self._every_step = bool(steps) or self._errors
        touched = {name for p in steps for name in p.effect.touches}
        sites = tuple(site for _, _, site in plan.drives)
        self.live = Live(self.batch, self.fields, tuple(sorted(touched)), sites, self._every_step)
        own = [(kind, local_values(values, prefix)) for kind, prefix, _ in plan.drives]
        self._gain = [kind.gain(v) if kind.gain else np.ones(nsim) for kind, v in own]
        self._reach = [kind.reach(v) if kind.reach else None for kind, v in own]
        self._window = max(LEAD_TIME, step)
        self._lead = [kind.lead(v) if kind.lead else None for kind, v in own]
        self._controllers: list[Controller | None] = [
            kind.controller(v, step) if kind.controller else None for kind, v in own
        ]
        integrals = [c.integral if c else none for c in self._controllers]
        self._whole = not (self._hooks or plan.with_ball or any(i is None for i in integrals))
        self._integral = np.column_stack([none if i is None else i for i in integrals])
        between = self._every_step or bool(self._integral.any())
        self._laws = Laws(plan, errors, steps, values, nsim) if between else None
        self._off, self._any_off = np.zeros((nsim, len(plan.drives)), dtype=bool), False
        self._earlier: list[Delay] = []
        self._addresses = [_address(plan.mj, m) for m in model.rig.measured]
        self._measured = self._columns(self._addresses)
        self._signals = len(model.rig.measured) + (len(BALL_SIGNALS) if plan.with_ball else 0)
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
                factor = numbers if quantity == "inertia" else numbers / self.plan.mj.body_mass[body]
                self.fields["body_inertia"][:, body] *= factor[:, None]
                if quantity == "mass":
                    self.fields["body_mass"][:, body] = numbers
            elif kind == "belt":
                self.fields[f"tendon_{quantity}"][:, self.plan.mj.tendon(owner).id] = numbers
        for drive, prefix, site in self.plan.drives:
            drive.fields(self.fields, site, local_values(values, prefix))
        for placed in self.plan.effects:
            if placed.effect.fields:
                placed.effect.fields(self.fields, placed.site, local_values(values, placed.prefix))
        self.fields.derive()

    def start(self, qpos: Array, qvel: Array, target: Array) -> None:
        """Puts the simulations into their first state, (nsim, nq) and (nsim, nv); their targets (nsim, u) were these
        until now.
        """
        self.batch.bind("qpos")[...] = qpos
        self.batch.bind("qvel")[...] = qvel
        window = np.full(self.nsim, self._window)
        self._earlier = [Delay(window, self.step, target[:, i]) for i in range(len(self.plan.drives))]
        if (self._every_step or self.plan.with_ball) and not (self._laws and self._whole):
            self._run(lambda ids: self.batch.forward(ids))

    def roll(self, targets: Array, means: bool = False) -> Array:
        """Rolls out all targets (nsim, T, u) rad, each held for a sample; NaN switches that axis's drive off.

        Args:
            means: they are means over each sample, of commands that may change within it.

        Returns:
            (nsim, T, m) signals at the start of each sample, before any sensor's effects; the ball's last. Efforts are
            those that act from then on.
        """
        if means:
            targets = self._within_reach(targets)
        if not self._whole:
            return self._stepped(targets)
        if self._laws is not None:
            return self._with_laws(self._laws, targets)
        return self._uninterrupted(targets)

    def _within_reach(self, targets: Array) -> Array:
        """Targets (nsim, T, u) that give a drive which saturates the torque that it has in the mean over a sample.

        Where a command steps within a sample, the target is what was asked for in the mean. A small part of a large
        step already asks for all that the drive gives, and would have it for the whole sample: so there the step counts
        no further than the error at which the drive gives its most. Samples that hold all of the step stay as they are,
        and so do small steps, by which a drive is soon up to speed, and ramps, which go on as they came.
        """
        found = targets
        for i, reach in enumerate(self._reach):
            own = targets[:, :, i]
            if reach is None or own.shape[1] <= 2 * SPREAD:
                continue
            before, after = own[:, : -2 * SPREAD], own[:, 2 * SPREAD :]
            change, middle = after - before, own[:, SPREAD:-SPREAD]
            least = FAR * reach[:, None]
            with np.errstate(invalid="ignore"):
                if not (np.abs(change) > least).any():
                    continue  # before ramps are looked for, which takes longer
                step = (np.abs(change) - _of_a_ramp(own, np.sign(change))) / least
                far = step > 1.0
            found = targets.copy() if found is targets else found
            share = (middle - before)[far] / change[far]
            most = (np.sign(change) * reach[:, None])[far]
            kept = before[far] + share * most + share**WHOLE_STEP * (change[far] - most)
            how_far = np.minimum(np.log(step[far]) / np.log(FAR), 1.0)
            partly = np.where((share >= 0.0) & (share <= 1.0), how_far, 0.0)
            found[:, SPREAD:-SPREAD, i][far] += partly * (kept - middle[far])
        return found

    def _stepped(self, targets: Array) -> Array:
        samples = targets.shape[1]
        raw = np.empty((self.nsim, samples, self._signals))
        with np.errstate(over="ignore", invalid="ignore"):
            for k in range(samples):
                raw[:, k] = self.measure()
                self.advance(targets[:, k], raw[:, k])
                if k % CHECK_EVERY == 0 or k == samples - 1:
                    self.check(k * self.step)
        return raw

    def _uninterrupted(self, targets: Array) -> Array:
        """Controls that are known beforehand: MuJoCo steps from one change of what is switched on to the next."""
        samples = targets.shape[1]
        raw = np.empty((self.nsim, samples, self._signals))
        for source, addresses, columns in self._measured:
            raw[:, 0, columns] = source[:, addresses]
        off = np.isnan(targets)
        control = self._controls(targets, off)
        most = max(1, AT_ONCE // self.substeps)
        for low, high in _stretches(off, most):
            if (off[:, low] != self._off).any():
                self._switch(off[:, low])
            self._record(control[:, low:high], raw, low)
            self.check(high * self.step)
        return raw

    def _controls(self, targets: Array, off: NDArray[np.bool_]) -> Array:
        """(nsim, T, nu) of all actuators, as far as the targets alone tell."""
        control = np.zeros((self.nsim, targets.shape[1], self.plan.mj.nu))
        for i, (_, _, site) in enumerate(self.plan.drives):
            control[:, :, site.actuator] = np.where(off[:, :, i], 0.0, self._law(i, targets[:, :, i]))
        return control

    def _with_laws(self, laws: Laws, targets: Array) -> Array:
        """Simulations with laws between their steps, each by itself, in one compiled loop."""
        raw = np.zeros((self.nsim, targets.shape[1], self._signals))
        off = np.isnan(targets)
        controls = self._controls(targets, off)
        stretches = _stretches(off)
        disabled = self._disabled(off)
        measured = np.array([(list(RECORDED).index(q), address) for q, address in self._addresses], dtype=np.int64)
        qpos, qvel, gain = self.live.qpos, self.live.qvel, np.column_stack(self._gain)

        def rows(own: Sequence[int]) -> list[tuple[int, int]]:
            """Those that diverged, and the sample at which they did."""
            runner, failed = Runner(self.plan, self.fields), []
            for i in own:
                runner.load(i, qpos[i], qvel[i])
                for low, high in stretches:
                    runner.switch(int(disabled[i, low]))
                    at = runner.roll(laws, i, controls[i, low:high], targets[i, low:high], gain[i],
                                     self._ticks[i], self._integral[i], self.substeps, self.step,
                                     measured, LIMIT, raw[i, low:high])  # fmt: skip
                    if at >= 0:
                        failed.append((i, low + at))
                        break
            return failed

        count = min(self.nthread or os.cpu_count() or 1, self.nsim)
        shares = [range(first, self.nsim, count) for first in range(count)]
        if count == 1:
            found = [rows(shares[0])]
        else:
            with ThreadPoolExecutor(count) as pool:
                found = list(pool.map(rows, shares))
        for i, at in (row for part in found for row in part):
            self._fail(i, _diverged(at * self.step))
        return raw

    def _record(self, control: Array, raw: Array, low: int) -> None:
        """Steps through controls (nsim, K, nu) and writes signals into raw (nsim, T, m), from sample `low` on."""
        ids = np.flatnonzero(~self.failed).astype(np.int32) if self.messages else None
        if ids is not None and ids.size == 0:
            return
        rows = slice(None) if ids is None else ids
        held = control[rows]
        if self.substeps > 1:
            held = np.repeat(held, self.substeps, axis=1)
        needed = [RECORDED[q] for q in RECORDED if any(q == own for own, _ in self._addresses)]
        try:
            seen = self.batch.rollout(held.shape[1], held, int(mujoco.mjtState.mjSTATE_CTRL), record=needed, ids=ids)
        except mujoco.batch.SimulationError as error:
            for i in error.ids:
                self._fail(int(i), self.batch.error(int(i)))
            return
        high = low + control.shape[1]
        for column, (quantity, address) in enumerate(self._addresses):
            found = seen[RECORDED[quantity]][:, :, address]
            if quantity == "torque":  # what acted during a step is recorded with it
                raw[rows, low:high, column] = found[:, :: self.substeps]
            else:
                after = found[:, self.substeps - 1 :: self.substeps]
                last = min(high + 1, raw.shape[1])
                raw[rows, low + 1 : last, column] = after[:, : last - low - 1]

    def _law(self, channel: int, targets: Array) -> Array:
        """(nsim, K) controls of a drive for its next targets (nsim, K), without what depends on the angle."""
        control = self._gain[channel][:, None] * targets
        lead = self._lead[channel]
        if lead is None or not lead.any():
            return control
        change = np.nan_to_num(targets - self._earlier[channel](targets, targets))
        return control + (LEAD_TIME / self._window) * lead[:, None] * change

    def advance(self, target: Array, seen: Array | None = None) -> None:
        """One sample with these targets (nsim, u) rad held; NaN switches that axis's drive off.

        Args:
            seen: (nsim, m) signals; their efforts become those that acted at first.
        """
        off = np.isnan(target)
        if (off != self._off).any():
            self._switch(off)
        base = []
        errors = self._seen_errors(target)
        for i, controller in enumerate(self._controllers):
            control = self._law(i, target[:, i : i + 1])[:, 0]
            if controller:
                error = errors[:, i]
                control = control + controller.sample(np.where(off[:, i], 0.0, error) if self._any_off else error)
                if self._any_off:
                    controller.restart(off[:, i])
            base.append(control)
            self._control(i, control, off[:, i])
        if not self._every_step:
            self._first(seen, partial(self.batch.step, nstep=1, stage=self._stage if self.substeps == 1 else 0))
            if self.substeps > 1:
                self._run(partial(self.batch.step, nstep=self.substeps - 1, stage=self._stage))
            return
        for k in range(self.substeps):
            self._before_step(target, base, off)
            stage = self._stage if k == self.substeps - 1 else 0
            self._first(seen if k == 0 else None, partial(self.batch.step, nstep=1, stage=stage))

    def _first(self, seen: Array | None, call: Callable[[NDArray[np.int32] | None], None]) -> None:
        self._run(call)
        if seen is not None:
            for column, (quantity, address) in enumerate(self._addresses):
                if quantity == "torque":
                    seen[:, column] = self.live.actuator[:, address]

    def _control(self, channel: int, control: Array, off: NDArray[np.bool_]) -> None:
        actuator = self.plan.drives[channel][2].actuator
        self.live.ctrl[:, actuator] = np.where(off, 0.0, control) if self._any_off else control

    def _before_step(self, target: Array, base: Sequence[Array], off: NDArray[np.bool_]) -> None:
        self.live.restore()
        errors = self._seen_errors(target)
        for i, (_, _, site) in enumerate(self.plan.drives):
            if self._errors:
                shift = errors[:, i] - (target[:, i] - self.live.qpos[:, site.qpos])
                self._control(i, base[i] + self._gain[i] * np.where(off[:, i], 0.0, shift), off[:, i])
        for placed, values in self._hooks:
            assert callable(placed.effect.step)
            placed.effect.step(self.live, placed.site, values)
        if self._laws:
            self._laws.apply_forces(self.live, self.fields)

    def _seen_errors(self, target: Array) -> Array:
        """(nsim, u) rad by which each drive sees its target before its angle; NaN where it is off."""
        seen = self.live.qpos[:, [site.qpos for _, _, site in self.plan.drives]]
        errors = target - np.where(self._ticks > 0.0, _whole(seen, self._ticks), seen)
        if self._laws is None:
            return errors
        self._laws.error[...] = errors
        self._laws.apply_errors(self.live, self.fields)
        return np.where(np.isnan(target), np.nan, self._laws.error)

    def _switch(self, off: NDArray[np.bool_]) -> None:
        self.fields["opt.disableactuator"][...] = self._disabled(off)
        self._off, self._any_off = off, bool(off.any())

    def _disabled(self, off: NDArray[np.bool_]) -> NDArray[np.int32]:
        """(...) bits of the actuator groups of drives that are off (..., u), and of those that the MJCF disables."""
        bits = np.full(off.shape[:-1], self.plan.mj.opt.disableactuator, dtype=np.int32)
        for i, (_, _, site) in enumerate(self.plan.drives):
            bits |= np.where(off[..., i], 1 << site.group, 0).astype(np.int32)
        return bits

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
            self._fail(int(sim), _diverged(time))

    def measure(self) -> Array:
        """(nsim, m) signals now, before any sensor's effects; the ball's last. Efforts are those of the last step."""
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


def _stretches(off: NDArray[np.bool_], most: int | None = None) -> list[tuple[int, int]]:
    """Samples [low, high), `most` at once, during which no drive is switched on or off (nsim, T, u)."""
    edges = np.flatnonzero((off[:, 1:] != off[:, :-1]).any(axis=(0, 2))) + 1
    parts = zip([0, *map(int, edges)], [*map(int, edges), off.shape[1]], strict=True)
    return [(low, min(low + (most or last), last)) for first, last in parts for low in range(first, last, most or last)]


def _of_a_ramp(targets: Array, sign: Array) -> Array:
    """(nsim, T - 2 SPREAD) how far targets (nsim, T) move that way in the 2 SPREAD samples before or after those."""
    width = 2 * SPREAD
    held = np.pad(targets, ((0, 0), (width, width)), mode="edge")
    moved = np.nan_to_num(held[:, width:] - held[:, :-width])
    return np.maximum(np.maximum(sign * moved[:, : -2 * width], sign * moved[:, 2 * width :]), 0.0)


def _whole(angle: Array, tick: Array) -> Array:
    """Angles in whole ticks, halves upwards."""
    return tick * np.floor(angle / np.where(tick > 0.0, tick, 1.0) + 0.5)


def _diverged(time: float) -> str:
    return f"diverged by {time:.3f} s: a speed beyond {LIMIT:g} rad/s or not a number"


def _run_of(columns: list[int]) -> Columns:
    """The columns as a slice where they are evenly spaced, for that copies nothing twice."""
    apart = columns[1] - columns[0] if len(columns) > 1 else 1
    if apart > 0 and columns == list(range(columns[0], columns[-1] + 1, apart)):
        return slice(columns[0], columns[-1] + 1, apart)
    return np.array(columns)


def _address(mj: mujoco.MjModel, measured: Measured) -> tuple[str, int]:
    joint = mj.joint(measured.joint)
    return measured.quantity, int(joint.qposadr[0] if measured.quantity == "position" else joint.dofadr[0])
