# SPDX-License-Identifier: Apache-2.0
"""Where a simulation begins: joints and ball as they were measured."""

from collections.abc import Mapping

import mujoco
import numpy as np

from labyrinth_sim.model import Model
from labyrinth_sim.rig import BALL_SIGNALS
from labyrinth_sim.site import Site, ball_site
from labyrinth_sim.trials import Array


def first_state(
    model: Model, mj: mujoco.MjModel, with_ball: bool, nsim: int, initial: Mapping[str, Array] | None
) -> tuple[Array, Array]:
    """qpos (nsim, nq) and qvel (nsim, nv) from measured signals, each (nsim,); NaN and absent ones are 0.

    Of several sensors on a joint the finest says where it begins. Where only one side of a belt is given the other
    follows without slip.
    """
    qpos = np.tile(mj.qpos0, (nsim, 1))
    qvel = np.zeros((nsim, mj.nv))
    given = dict(initial or {})
    for axis in model.rig.axes:
        for quantity, array, address in (("position", qpos, "qposadr"), ("velocity", qvel, "dofadr")):
            known: dict[str, Array] = {}
            for m in axis.finest_first:
                if m.quantity == quantity and m.signal in given:
                    coarser = np.broadcast_to(np.asarray(given[m.signal], float), (nsim,))
                    finer = known.get(m.joint, coarser)
                    known[m.joint] = np.where(np.isnan(finer), coarser, finer)
            ratio = _ratio(mj, axis.belt) if axis.belt else 1.0
            shaft = known.get(axis.joint, np.full(nsim, np.nan))
            load = known.get(axis.load, np.full(nsim, np.nan))
            rest = np.where(np.isnan(load), 0.0, load / ratio)
            shaft = np.where(np.isnan(shaft), rest, shaft)
            load = np.where(np.isnan(load), shaft * ratio, load)
            for name, numbers in ((axis.joint, shaft), (axis.load, load)):
                array[:, int(getattr(mj.joint(name), address)[0])] = numbers
    if with_ball and model.rig.ball:
        place_ball(ball_site(model.rig, mj), mj, qpos, given)
    return qpos, qvel


def _ratio(mj: mujoco.MjModel, belt: str) -> float:
    first = int(mj.tendon_adr[mj.tendon(belt).id])
    return float(-mj.wrap_prm[first] / mj.wrap_prm[first + 1])


def place_ball(site: Site, mj: mujoco.MjModel, qpos: Array, given: Mapping[str, Array]) -> None:
    """Writes the ball into qpos (nsim, nq), at ball_x, ball_y in its frame, or where the MJCF has it."""
    data = mujoco.MjData(mj)
    mujoco.mj_forward(mj, data)
    rest = data.site_xmat[site.ball_site].reshape(3, 3).T @ (data.xpos[site.ball_body] - data.site_xpos[site.ball_site])
    for sim in range(len(qpos)):
        place = rest.copy()
        for axis, signal in enumerate(BALL_SIGNALS):
            number = np.broadcast_to(given.get(signal, np.nan), (len(qpos),))[sim]
            place[axis] = rest[axis] if np.isnan(number) else number
        data.qpos[:] = qpos[sim]
        mujoco.mj_kinematics(mj, data)
        world = data.site_xpos[site.ball_site] + data.site_xmat[site.ball_site].reshape(3, 3) @ place
        qpos[sim, site.ball_qpos : site.ball_qpos + 3] = world
