# SPDX-License-Identifier: Apache-2.0
"""The one engine under batches and the live node: many simulations of one plan."""

import itertools
import logging
import os
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property, partial

import mujoco
import mujoco.batch
import numpy as np
from numpy.typing import NDArray

from labyrinth_sim.build import Plan, local_values
from labyrinth_sim.command_steps import CommandSteps, command_steps, may_saturate
from labyrinth_sim.drive_torques import DriveTorques
from labyrinth_sim.effect import Controller, Values
from labyrinth_sim.filters import Delay
from labyrinth_sim.first_state import place_ball
from labyrinth_sim.law import Law
from labyrinth_sim.live import Fields, Live
from labyrinth_sim.model import Model
from labyrinth_sim.rig import BALL_SIGNALS, Measured
from labyrinth_sim.runner import Laws, Runner
from labyrinth_sim.site import ball_site
from labyrinth_sim.trials import Array

# MuJoCo would otherwise write its warnings to a file in the working folder; `Engine.check` reports what they are about.
mujoco.set_mju_user_warning(logging.getLogger(__name__).debug)

Columns = slice | NDArray[np.intp]
LIMIT = 1e6  # rad, rad/s: beyond, a simulation has diverged
CHECK_EVERY = 50  # samples between checks for simulations that diverged
LEAD_TIME = 0.01  # s, over which a drive's law sees by how much its target changes; the paper's sample
AT_ONCE = 1024  # MuJoCo steps of one uninterrupted stretch; bounds the memory of what is recorded
LIMIT_FIELDS = {"actuator_forcerange", "jnt_actfrcrange"}
LOWERED = 0.05  # to which share of a drive's limits an effect that rewrites them may well lower them
RECORDED = {"position": "qpos", "velocity": "qvel", "torque": "qfrc_actuator"}


class Engine:
    """nsim simulations.

    Args:
        model: the model.
        plan: its compiled structure.
        values: full parameter name -> (nsim,); every parameter of the model that is not at the MJCF's own value.
        nsim: how many.
        step: s between samples.
        nthread: 0 for one per CPU. The result does not depend on it.
        driven: after what the rig measures, signals have the position and the speed of each drive's joint as well; for
            `efforts_between`.
        limits: when in a step drives ask for what limits them, END or BEGINNING, see `drive_limit`; targets are then
            means over each sample, and may step within it. None for targets that are held, and MuJoCo's own limits.
    """

    def __init__(
        self, model: Model, plan: Plan, values: Values, nsim: int, step: float, nthread: int = 0,
        driven: bool = False, limits: int | None = None,
    ) -> None:  # fmt: skip
        self.plan, self.nsim, self.step = plan, nsim, step
        self.substeps = max(1, round(step / plan.mj.opt.timestep))
        self.batch = mujoco.batch.Batch(plan.mj, nsim, nthread)
        self.fields = Fields(self.batch)
        self.fields["opt.timestep"][...] = step / self.substeps
        self._set_fields(values)
        self.nthread = nthread
        acting = plan.acting(values)
        busy = [p for p in acting if p.steps(values).any()]
        errors, steps = [p for p in busy if p.effect.error], [p for p in busy if p.effect.step]
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
        self._window = max(LEAD_TIME, step)
        self._lead = [kind.lead(v) if kind.lead else None for kind, v in own]
        self._controllers: list[Controller | None] = [
            kind.controller(v, step) if kind.controller else None for kind, v in own
        ]
        integrals = [c.integral if c else none for c in self._controllers]
        self._whole = not (self._hooks or plan.with_ball or any(i is None for i in integrals))
        self._integral = np.column_stack([none if i is None else i for i in integrals])
        self._between = self._every_step or bool(self._integral.any())
        self._limits = limits if self._whole else None
        self._lowered = np.ones((nsim, len(plan.drives)))
        for p in steps:
            if LIMIT_FIELDS & set(p.effect.touches):
                channels = slice(None) if p.effect.couples else p.site.channel
                self._lowered[p.steps(values), channels] = LOWERED
        limited = self._limits is not None
        self._laws = Laws(plan, errors, steps, values, nsim, self._limits) if self._between or limited else None
        self._off, self._any_off = np.zeros((nsim, len(plan.drives)), dtype=bool), False
        self._earlier: list[Delay] = []
        self._addresses = [_address(plan.mj, m) for m in model.rig.measured]
        if driven:
            self._addresses += [pair for s in sites for pair in (("position", s.qpos), ("velocity", s.dof))]
        self._measured = self._columns(self._addresses)
        self._signals = len(self._addresses) + (len(BALL_SIGNALS) if plan.with_ball else 0)
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
        self._earlier = [self._before(own, self.step) for own in target.T]
        if (self._every_step or self.plan.with_ball) and not (self._laws and self._whole):
            self._run(lambda ids: self.batch.forward(ids))

    def roll(self, targets: Array) -> Array:
        """Rolls out all targets (nsim, T, u) rad, each held for a sample; NaN switches that axis's drive off.

        Returns:
            (nsim, T, m) signals at the start of each sample, before any sensor's effects; the ball's last. Efforts are
            those that act from then on, of a control that steps within the sample those that act after it.
        """
        _ = self.torques  # reads the drives' fields before any law changes them
        if not self._whole:
            return self._stepped(targets)
        laws = [self._law(i, targets[:, :, i], earlier) for i, earlier in enumerate(self._earlier)]
        controls, steps, near = np.stack(laws, axis=2), None, False
        if self._laws is not None and self._limits is not None:
            may = may_saturate(controls, self._most)
            self._laws.near_limit(may)
            near = bool(may.any())
            if near:
                controls, steps = command_steps(controls, self._most, self._limits, may)
        if self._laws is not None and (self._between or near):
            return self._with_laws(self._laws, targets, controls, steps)
        return self._uninterrupted(controls)

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

    def _uninterrupted(self, controls: Array) -> Array:
        """Controls that are known beforehand: MuJoCo steps from one change of what is switched on to the next."""
        samples = controls.shape[1]
        raw = np.empty((self.nsim, samples, self._signals))
        for source, addresses, columns in self._measured:
            raw[:, 0, columns] = source[:, addresses]
        off = np.isnan(controls)
        control = self._of_actuators(controls)
        most = max(1, AT_ONCE // self.substeps)
        for low, high in _stretches(_switched(off), off.shape[1], most):
            if (off[:, low] != self._off).any():
                self._switch(off[:, low])
            self._record(control[:, low:high], raw, low)
            self.check(high * self.step)
        return raw

    @cached_property
    def torques(self) -> DriveTorques:
        """What the drives give."""
        return DriveTorques(self.plan, self.fields)

    @cached_property
    def _most(self) -> Array:
        """(nsim, u) the control at which each drive may give its most."""
        return self.torques.most * self._lowered

    def _of_actuators(self, controls: Array) -> Array:
        """(nsim, T, nu) of all actuators, from those of the drives (nsim, T, u), NaN where these are off."""
        control = np.zeros((*controls.shape[:2], self.plan.mj.nu))
        control[:, :, [site.actuator for _, _, site in self.plan.drives]] = np.where(np.isnan(controls), 0.0, controls)
        return control

    def asked(self, drive: int, targets: Array, start: Array, step: float | None = None) -> Array:
        """(nsim, K) controls of a drive for its targets (nsim, K) rad, NaN where it is off, without what depends on the
        angle.

        Args:
            start: (nsim,) rad, the target until then.
            step: s between the targets, each of which is what the drive sees at its time; None for the means over this
                engine's samples, as `roll` takes them.
        """
        controls = self._law(drive, targets, self._before(start, step or self.step))
        if step is not None or self._limits is None:
            return controls
        return command_steps(controls[:, :, None], self._most[:, drive : drive + 1], self._limits)[0][:, :, 0]

    def _before(self, target: Array, step: float) -> Delay:
        """The filter that gives a drive's target of a while ago, (nsim,) rad until now."""
        return Delay(np.full(self.nsim, self._window), step, target)

    def _with_laws(self, laws: Laws, targets: Array, controls: Array, steps: CommandSteps | None) -> Array:
        """Simulations with laws between their steps, each by itself, in one compiled loop."""
        raw = np.zeros((self.nsim, targets.shape[1], self._signals))
        off = np.isnan(targets)
        controls = self._of_actuators(controls)
        disabled = self._disabled(off)
        measured = np.array([(list(RECORDED).index(q), address) for q, address in self._addresses], dtype=np.int64)
        qpos, qvel, gain = self.live.qpos, self.live.qvel, np.column_stack(self._gain)
        edges = _switched(off)

        def rows(own: Sequence[int]) -> list[tuple[int, int]]:
            """Those that diverged, and the sample at which they did."""
            runner, failed = Runner(self.plan, self.fields), []
            for i in own:
                runner.load(i, qpos[i], qvel[i])
                laws.turn(i, runner.model)
                jumps = steps.jumps(i) if steps else np.empty((0, 2))
                for low, high in _stretches(edges, off.shape[1]):
                    runner.switch(int(disabled[i, low]))
                    here = jumps[slice(*np.searchsorted(jumps[:, 0], [low, high]))].copy()
                    here[:, 0] -= low
                    at = runner.roll(laws, i, controls[i, low:high], targets[i, low:high], gain[i],
                                     self._ticks[i], self._integral[i], self.substeps, self.step,
                                     measured, LIMIT, here, raw[i, low:high])  # fmt: skip
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

    def _law(self, channel: int, targets: Array, earlier: Delay) -> Array:
        """(nsim, K) controls of a drive for its next targets (nsim, K), without what depends on the angle."""
        control = self._gain[channel][:, None] * targets
        lead = self._lead[channel]
        if lead is None or not lead.any():
            return control
        change = np.nan_to_num(targets - earlier(targets, targets))
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
            control = self._law(i, target[:, i : i + 1], self._earlier[i])[:, 0]
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
        for k in range(self.substeps if self._every_step else 0):
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


def _switched(off: NDArray[np.bool_]) -> set[int]:
    """Samples at which any drive is switched on or off (nsim, T, u)."""
    return {int(k) + 1 for k in np.flatnonzero((off[:, 1:] != off[:, :-1]).any(axis=(0, 2)))}


def _stretches(edges: Collection[int], samples: int, most: int | None = None) -> list[tuple[int, int]]:
    """Samples [low, high), `most` at once, up to the next of the edges."""
    parts = itertools.pairwise(sorted({0, samples, *edges}))
    return [(low, min(low + (most or last), last)) for first, last in parts for low in range(first, last, most or last)]


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
