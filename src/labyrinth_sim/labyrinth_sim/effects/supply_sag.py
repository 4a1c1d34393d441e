# SPDX-License-Identifier: Apache-2.0
"""Supply sag."""

import numpy as np

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.live import Live
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array


def step(live: Live, site: Site, values: Values) -> None:
    """Solves f = 1 - s sum_i t_i^2 / f, f being V'/V and t_i = min(wanted_i, f) shares of the torque at full voltage.

    A driver that gives the share t at duty t / f draws that duty's part of the motor's current. Motors that want more
    than f, or more than the supply can feed, run at full duty and draw f.
    """
    wanted = np.stack([_wanted(live, other) for _, other in live.drives])
    sag = values["sag"]
    full = np.zeros(wanted.shape, dtype=bool)
    factor = np.ones_like(sag)
    for _ in range(len(wanted) + 1):
        slope = 1.0 + sag * full.sum(axis=0)
        room = 1.0 - 4.0 * slope * sag * np.where(full, 0.0, wanted**2).sum(axis=0)
        factor = (1.0 + np.sqrt(np.maximum(room, 0.0))) / (2.0 * slope)
        short = room < 0.0
        more = ~full & (wanted > factor)
        if short.any():
            more |= ~full & (wanted >= np.where(full, 0.0, wanted).max(axis=0)) & short
        if not more.any():
            break
        full |= more
    drive, place = live.drives[site.channel]
    drive.supply(live, place, factor)


def _wanted(live: Live, site: Site) -> Array:
    """(nsim,) share of its full torque that an axis's servo, linear in angle and speed as MuJoCo's are, would give."""
    i = site.actuator
    gain, bias = live.base["actuator_gainprm"][:, i], live.base["actuator_biasprm"][:, i]
    torque = gain[:, 0] * live.ctrl[:, i] + bias[:, 0]
    torque = torque + bias[:, 1] * live.qpos[:, site.qpos] + bias[:, 2] * live.qvel[:, site.dof]
    return np.minimum(np.abs(torque) / live.base["actuator_forcerange"][:, i, 1], 1.0)


EFFECT = Effect(
    name="supply_sag",
    title="Supply sag",
    physics="The supply's voltage falls with the current that all motors draw, and with it the torque they can give.",
    equation="V' = V - s V sum_i duty_i |torque_i| / torque_max,i",
    parameters=(Parameter("sag", "1", 0.0, 20.0, 0.0, 2.0, "0 to a supply that leaves a stalled motor a twentieth"),),
    stage="force",
    mark="Both axes moving at once are slower than either alone; large steps lose their top speed.",
    shows="passing",
    confused_with=("torque_saturation", "rate_limit", "viscous_friction"),
    separated_by="Step one axis alone, then both together: only sag makes the first slower because of the second.",
    touches=("actuator_gainprm", "actuator_biasprm", "actuator_forcerange"),
    step=step,
)
