# SPDX-License-Identifier: Apache-2.0
"""Supply sag."""

import numpy as np

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.live import Live
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array

NO_LOAD = 6.5  # rad/s at which back-EMF takes the whole voltage; data sheets: MX-106 4.7, XL330 6.4, MX-64 6.6
FULL = 0.2  # sag from which back-EMF counts in full; below it fades, so that no sag is no effect


def step(live: Live, site: Site, values: Values) -> None:
    """Solves f = 1 - s sum_i duty_i t_i, f being V'/V, t_i the torque and n_i the speed in its direction, as shares.

    A driver that gives the share t at duty (t + n) / f draws that duty's part of the motor's current. Motors that want
    more than f - n, or more than the supply can feed, run at full duty, give f - n and draw that.
    """
    wanted = np.stack([_wanted(live, other) for _, other in live.drives])
    sag = values["sag"]
    counts = np.minimum(sag / FULL, 1.0)
    speed = np.stack([np.clip(live.qvel[:, other.dof] / NO_LOAD, -1.0, 1.0) for _, other in live.drives]) * counts
    along = np.where(wanted < 0.0, -speed, speed)
    torque = np.abs(wanted)
    drawn = np.maximum((torque + along) * torque, 0.0)
    full = np.zeros(torque.shape, dtype=bool)
    factor = np.ones_like(sag)
    for _ in range(len(torque) + 1):
        slope = 1.0 + sag * full.sum(axis=0)
        level = 1.0 + sag * np.where(full, along, 0.0).sum(axis=0)
        room = level**2 - 4.0 * slope * sag * np.where(full, 0.0, drawn).sum(axis=0)
        factor = np.clip((level + np.sqrt(np.maximum(room, 0.0))) / (2.0 * slope), 0.0, 1.0)
        short = room < 0.0
        more = ~full & (torque + along > factor)
        if short.any():
            more |= ~full & (drawn >= np.where(full, 0.0, drawn).max(axis=0)) & short
        if not more.any():
            break
        full |= more
    drive, place = live.drives[site.channel]
    drive.supply(live, place, factor, speed[site.channel])


def _wanted(live: Live, site: Site) -> Array:
    """(nsim,) share of its full torque that an axis's servo, linear in angle and speed as MuJoCo's are, would give."""
    i = site.actuator
    gain, bias = live.base["actuator_gainprm"][:, i], live.base["actuator_biasprm"][:, i]
    torque = gain[:, 0] * live.ctrl[:, i] + bias[:, 0]
    torque = torque + bias[:, 1] * live.qpos[:, site.qpos] + bias[:, 2] * live.qvel[:, site.dof]
    return np.clip(torque / live.base["actuator_forcerange"][:, i, 1], -1.0, 1.0)


EFFECT = Effect(
    name="supply_sag",
    title="Supply sag",
    physics="The supply's voltage falls with the current that all motors draw, and with it the torque they can give: "
    "back-EMF takes a larger share of what is left.",
    equation="V' = V - s V sum_i duty_i |torque_i| / torque_max,i; |torque_i| <= torque_max,i (V' / V - speed_i / 6.5)",
    parameters=(Parameter("sag", "1", 0.0, 20.0, 0.0, 2.0, "0 to a supply that leaves a stalled motor a twentieth"),),
    stage="force",
    mark="Both axes moving at once are slower than either alone; large steps lose their top speed.",
    shows="passing",
    confused_with=("torque_saturation", "rate_limit", "viscous_friction"),
    separated_by="Step one axis alone, then both together: only sag makes the first slower because of the second.",
    touches=("actuator_gainprm", "actuator_biasprm", "actuator_forcerange"),
    step=step,
)
