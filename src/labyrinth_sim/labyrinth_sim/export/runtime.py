# SPDX-License-Identifier: Apache-2.0
# mypy: ignore-errors
"""Steps an exported model: targets in, MuJoCo's steps with what the MJCF cannot express, measurements out.

    model = mujoco.MjModel.from_xml_path("...xml")
    data = mujoco.MjData(model)
    sim = Simulation(model, data)
    sim.reset()                      # from the state that data is in
    sim.step(target)                 # one sample: SAMPLE_TIME s with these targets held, NaN switches a drive off
    seen = sim.measure()             # signals by name, with what the sensors do to them

One Simulation belongs to one MjModel, some of whose fields it writes while stepping.
"""

import math
from types import SimpleNamespace

import mujoco
import numpy as np

LEAD_TIME = 0.01  # s, over which a drive's law sees by how much its target changes

# What was exported; a generated module has its own below.
SAMPLE_TIME = 0.01
AXES: list = []
DRIVES: list = []
EFFECTS: list = []
SCALES: dict = {}
TORQUE: dict = {}
DELAY = None  # class of a delay


def ndtr(x):
    """Gaussian distribution function."""
    return 0.5 * (1.0 + np.vectorize(math.erf)(np.asarray(x) / math.sqrt(2.0)))


def state(raw):
    """What a law sees is what it is given."""
    return raw


class ExportedState:
    """One simulation before each step, as laws see it, and what undoes what they wrote."""

    def __init__(self, model, data, touched, sites, drives, torque):
        self.torque = torque
        self.base = {name: np.array(getattr(model, name)) for name in touched}
        bases = [np.array(getattr(model, f"actuator_{n}")) for n in ("gainprm", "biasprm", "forcerange")]
        second = [next((a for a in site.actuators if a != site.actuator), -1) for site in sites]
        self.shared = {
            "qpos": data.qpos, "qvel": data.qvel, "applied": data.qfrc_applied, "actuator": data.qfrc_actuator,
            "bias": data.qfrc_bias, "passive": data.qfrc_passive, "ctrl": data.ctrl, "length": data.ten_length,
            "rate": data.ten_velocity, "damping": model.dof_damping, "frictionloss": model.dof_frictionloss,
            "belt_damping": model.tendon_damping, "gain": model.actuator_gainprm, "act_bias": model.actuator_biasprm,
            "limits": model.actuator_forcerange, "joint_limits": model.jnt_actfrcrange,
            "base_gain": bases[0], "base_bias": bases[1], "base_limits": bases[2],
            "error": np.zeros(len(sites)), "step": float(model.opt.timestep),
            "drives": np.array(
                [[s.actuator, s.dof, s.qpos, a, int(d.by_duty)] for s, a, d in zip(sites, second, drives, strict=True)]
            ),
        }  # fmt: skip
        self.model, self.data = model, data

    def of(self, site, values):
        """What one effect's law is given."""
        return SimpleNamespace(
            **self.shared, channel=site.channel, drive=site.actuator, dof=site.dof, angle=site.qpos,
            load_dof=site.load_dof, tendon=site.tendon, joint=site.joint,
            values=np.array([v[0] for v in values.values()]), memory=np.zeros(8),
        )  # fmt: skip

    def restore(self):
        """Undoes what laws wrote for the last step."""
        self.data.qfrc_applied[:] = self.torque
        for name, values in self.base.items():
            getattr(self.model, name)[...] = values


class Simulation:
    """An exported model that runs sample by sample.

    Args:
        model, data: MuJoCo's, of the exported MJCF or of one that holds it.
        sample_time: s between targets.
    """

    def __init__(self, model, data, sample_time=None):
        self.model, self.data = model, data
        self.sample_time = sample_time or SAMPLE_TIME
        self.substeps = max(1, math.ceil(self.sample_time / model.opt.timestep - 1e-6))
        model.opt.timestep = self.sample_time / self.substeps
        rig = SimpleNamespace(axes=[SimpleNamespace(**{**axis, "measured": _measured(axis)}) for axis in AXES])
        self._sites = [_site(model, rig, channel) for channel in range(len(AXES))]
        self._drives = [(SimpleNamespace(**{**drive, "values": _arrays(drive["values"])})) for drive in DRIVES]
        self._effects = [
            SimpleNamespace(**{**effect, "values": _arrays(effect["values"]), "site": self._place(effect)})
            for effect in EFFECTS
        ]
        self._signals = [m for axis in rig.axes for m in axis.measured]
        self._window = max(LEAD_TIME, self.sample_time)

    def _place(self, effect):
        site = self._sites[effect["channel"]]
        return SimpleNamespace(**{**site.__dict__, "signal": effect["signal"]})

    def reset(self, target=None):
        """Starts from the state that `data` is in; targets were where the axes stand until now.

        Args:
            target: (u,) the first; NaN where a drive starts switched off.
        """
        model, data = self.model, self.data
        touched = sorted({name for e in self._effects if e.step or e.error for name in e.touches})
        torque = np.zeros(model.nv)
        for joint, value in TORQUE.items():
            torque[int(model.joint(joint).dofadr[0])] = value
        self.state = ExportedState(model, data, touched, self._sites, self._drives, torque)
        self.state.restore()
        laws = [(e, self.state.of(e.site, e.values)) for e in self._effects]
        self._errors = [(e.error, given) for e, given in laws if e.error]
        self._forces = [(e.step, given) for e, given in laws if e.step]
        self._ticks = np.array([float(d.values.get("feedback_tick", np.zeros(1))[0]) for d in self._drives])
        first = np.zeros(len(AXES)) if target is None else np.asarray(target, float)
        start = np.array([data.qpos[site.qpos] for site in self._sites])
        start = np.where(np.isnan(first), np.nan, start)[None]
        self._commands = []
        for i, drive in enumerate(self._drives):
            chain = [
                e.command(e.values, e.site, self.sample_time, start[:, i])
                for e in self._effects
                if e.command and e.channel == i
            ]
            own = drive.values, self._sites[i], self.sample_time, start[:, i]
            chain.append(drive.target(*own) if drive.target else None)
            self._commands.append([f for f in chain if f is not None])
        self._gain = [d.gain(d.values) if d.gain else np.ones(1) for d in self._drives]
        self._lead = [d.lead(d.values) if d.lead else None for d in self._drives]
        self._controllers = [d.controller(d.values, self.sample_time) if d.controller else None for d in self._drives]
        self._earlier = [DELAY(np.array([self._window]), self.sample_time, start[:, i]) for i in range(len(AXES))]
        mujoco.mj_forward(model, data)
        self._efforts = data.qfrc_actuator.copy()
        raw = self._raw()
        self._sensors = []
        for column, measured in enumerate(self._signals):
            chain = [_over(SCALES[measured.signal])] if measured.signal in SCALES else []
            for e in self._effects:
                sees = e.measure and (
                    e.site.signal == measured.signal if e.signal
                    else any(m.signal == measured.signal for m in e.site.the_axis.measured)
                )  # fmt: skip
                if sees:
                    site = SimpleNamespace(**{**e.site.__dict__, "signal": measured.signal})
                    made = e.measure(e.values, site, self.sample_time, raw[:, column])
                    chain += [made] if made is not None else []
            self._sensors.append(chain)

    def step(self, target):
        """One sample with targets (u,) held, rad or m; NaN switches that axis's drive off."""
        every = np.asarray(target, float)[None, None, :]
        goals = every.copy()
        for i, chain in enumerate(self._commands):
            for f in chain:
                goals[:, :, i] = f(goals[:, :, i], every)
        goal = goals[0, 0]
        off = np.isnan(goal)
        bits = int(self.model.opt.disableactuator)
        for i, site in enumerate(self._sites):
            bits = bits | (1 << site.group) if off[i] else bits & ~(1 << site.group)
        self.model.opt.disableactuator = bits
        self.state.restore()
        errors = self._seen_errors(goal)
        base = []
        for i, site in enumerate(self._sites):
            control = self._gain[i] * goal[i]
            lead = self._lead[i]
            if lead is not None and lead.any():
                own = goals[:, :, i]
                change = np.nan_to_num(own - self._earlier[i](own, own))[:, 0]
                control = control + (LEAD_TIME / self._window) * lead * change
            if self._controllers[i]:
                error = np.array([0.0 if off[i] else errors[i]])
                control = control + self._controllers[i].sample(error)
                self._controllers[i].restart(np.array([off[i]]))
            base.append(np.atleast_1d(control))
            self.data.ctrl[site.actuator] = 0.0 if off[i] else control[0]
        for k in range(self.substeps):
            self.state.restore()
            if self._errors or self._ticks.any():
                errors = self._seen_errors(goal)
                for i, site in enumerate(self._sites):
                    if not off[i]:
                        shift = errors[i] - (goal[i] - self.data.qpos[site.qpos])
                        self.data.ctrl[site.actuator] = (base[i] + self._gain[i] * shift)[0]
            else:
                self.state.shared["error"][:] = goal - self._angles()
            for law, given in self._forces:
                law(given)
            mujoco.mj_step(self.model, self.data)
            if k == 0:
                self._efforts = self.data.qfrc_actuator.copy()

    def _angles(self):
        """(u,) as the drives see them."""
        seen = np.array([self.data.qpos[site.qpos] for site in self._sites])
        safe = np.where(self._ticks > 0.0, self._ticks, 1.0)
        return np.where(self._ticks > 0.0, safe * np.floor(seen / safe + 0.5), seen)

    def _seen_errors(self, goal):
        """(u,) rad by which each drive sees its target before its angle."""
        error = self.state.shared["error"]
        error[:] = goal - self._angles()
        for law, given in self._errors:
            law(given)
        return error.copy()

    def _raw(self):
        """(1, m) signals now, before any sensor's effects; efforts are those that the last sample began with."""
        sources = {"position": self.data.qpos, "velocity": self.data.qvel, "torque": self._efforts}
        found = []
        for m in self._signals:
            joint = self.model.joint(m.joint)
            found.append(sources[m.quantity][int((joint.qposadr if m.quantity == "position" else joint.dofadr)[0])])
        return np.array(found)[None]

    def measure(self):
        """Signal -> value in SI, with what the sensors do to it; call it once a sample, after `reset` or `step`."""
        raw = self._raw()[:, None, :]
        seen = raw.copy()
        for column, chain in enumerate(self._sensors):
            for f in chain:
                seen[:, :, column] = f(seen[:, :, column], raw)
        return {m.signal: float(v) for m, v in zip(self._signals, seen[0, 0], strict=True)}


def _arrays(values):
    return {name: np.array([value]) for name, value in values.items()}


def _measured(axis):
    return [SimpleNamespace(**m) for m in axis["measured"]]


def _over(scale):
    return lambda own, every: own / scale


def _site(model, rig, channel):
    axis = rig.axes[channel]
    joint, load = model.joint(axis.joint), model.joint(axis.load)
    group, others = channel + 1, tuple(i for i in range(len(rig.axes)) if i != channel)
    signals = [m.signal for each in rig.axes for m in each.measured]
    seen = [m.signal for i in others[:1] for m in rig.axes[i].measured if m.quantity == "position"]
    return SimpleNamespace(
        rig=rig,
        axis=axis,
        the_axis=axis,
        signal=None,
        group=group,
        channel=channel,
        others=others,
        other_seen=tuple(signals.index(s) for s in seen[:1]),
        actuator=model.actuator(axis.actuator).id,
        actuators=tuple(i for i in range(model.nu) if model.actuator_group[i] == group),
        joint=joint.id,
        dof=int(joint.dofadr[0]),
        qpos=int(joint.qposadr[0]),
        load_joint=load.id,
        load_dof=int(load.dofadr[0]),
        load_body=int(load.bodyid[0]),
        tendon=model.tendon(axis.belt).id if axis.belt else -1,
        centre={},
    )
