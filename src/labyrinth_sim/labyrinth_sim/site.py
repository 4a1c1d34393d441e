# SPDX-License-Identifier: Apache-2.0
"""Where an effect acts: names of the rig resolved to indices of a compiled model."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import mujoco
import numpy as np

from labyrinth_sim.rig import BALL_SIGNALS, Axis, Ball, Rig


@dataclass(frozen=True)
class Site:
    """A place of a rig. Indices are -1 before the model is compiled and where there is no such thing.

    Attributes:
        rig: whole rig.
        axis: of the axis or the signal; None for the ball.
        signal: name of the measured position, or None.
        group: actuator group of the axis, by which the drive is switched off.
        channel: index of the axis and its command.
        others: indices of the other axes.
        actuator, actuators: of the axis; all that share its group.
        joint, dof, qpos: of the driven joint.
        load_joint, load_dof, load_body: of the joint that carries the load, the driven one without a belt.
        tendon: the belt.
        ball_dof, ball_geom, ball_body, ball_qpos, ball_site: of the ball.
        centre: m, signal of the ball -> the point about which the board turns, in the frame of its positions.
    """

    rig: Rig
    axis: Axis | None = None
    signal: str | None = None
    group: int = -1
    channel: int = -1
    others: tuple[int, ...] = ()
    actuator: int = -1
    actuators: tuple[int, ...] = ()
    joint: int = -1
    dof: int = -1
    qpos: int = -1
    load_joint: int = -1
    load_dof: int = -1
    load_body: int = -1
    tendon: int = -1
    ball: Ball | None = field(default=None)
    ball_dof: int = -1
    ball_geom: int = -1
    ball_body: int = -1
    ball_qpos: int = -1
    ball_site: int = -1
    centre: Mapping[str, float] = field(default_factory=dict)

    @property
    def the_axis(self) -> Axis:
        """The axis, where there must be one."""
        assert self.axis is not None
        return self.axis

    @property
    def other_seen(self) -> tuple[int, ...]:
        """The column of the first other axis's first position among the rig's signals; empty where there is none."""
        positions = [p for other in self.others[:1] for p in self.rig.axes[other].positions[:1]]
        return tuple(self.rig.signals.index(p) for p in positions)


def axis_site(rig: Rig, channel: int, model: mujoco.MjModel | None = None, signal: str | None = None) -> Site:
    """The place of an axis; indices are filled in from `model`."""
    axis = rig.axes[channel]
    others = tuple(i for i in range(len(rig.axes)) if i != channel)
    group = channel + 1
    if model is None:
        return Site(rig, axis, signal, group, channel, others)
    joint, load = model.joint(axis.joint), model.joint(axis.load)
    return Site(
        rig,
        axis,
        signal,
        group,
        channel,
        others,
        actuator=model.actuator(axis.actuator).id,
        actuators=tuple(i for i in range(model.nu) if model.actuator_group[i] == group),
        joint=joint.id,
        dof=int(joint.dofadr[0]),
        qpos=int(joint.qposadr[0]),
        load_joint=load.id,
        load_dof=int(load.dofadr[0]),
        load_body=int(load.bodyid[0]),
        tendon=model.tendon(axis.belt).id if axis.belt else -1,
    )


def ball_site(rig: Rig, model: mujoco.MjModel | None = None) -> Site:
    """The place of the ball; indices are filled in from `model`."""
    ball = rig.ball
    if model is None or ball is None:
        return Site(rig, ball=ball)
    joint = model.joint(ball.joint)
    body = int(joint.bodyid[0])
    site = model.site(ball.site)
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, site.quat)
    centre = turn.reshape(3, 3).T @ -site.pos
    return Site(
        rig,
        ball=ball,
        ball_dof=int(joint.dofadr[0]),
        ball_qpos=int(joint.qposadr[0]),
        ball_geom=int(model.body(body).geomadr[0]),
        ball_body=body,
        ball_site=site.id,
        centre={signal: float(v) for signal, v in zip(BALL_SIGNALS, centre, strict=False)},
    )
