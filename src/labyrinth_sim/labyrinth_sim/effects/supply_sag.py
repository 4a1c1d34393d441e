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
    servos, sag = live.servos, values["sag"][:, None]
    counts = np.minimum(sag / FULL, 1.0)
    speed = np.minimum(np.maximum(live.qvel[:, servos.dof] / NO_LOAD, -1.0), 1.0) * counts
    wanted = servos.torque(live) / servos.full
    along = np.where(wanted < 0.0, -speed, speed)
    torque = np.minimum(np.abs(wanted), 1.0)
    drawn = np.maximum((torque + along) * torque, 0.0)
    room = 1.0 - 4.0 * sag * drawn.sum(axis=1, keepdims=True)
    factor = 0.5 + 0.5 * np.sqrt(np.maximum(room, 0.0))
    if (torque + along > factor).any() or (room < 0.0).any():
        factor = _limited(sag, torque, along, drawn)
    drive, place = live.drives[site.channel]
    drive.supply(live, place, factor[:, 0], speed[:, site.channel])


def _limited(sag: Array, torque: Array, along: Array, drawn: Array) -> Array:
    """(nsim, 1) f where motors, (nsim, d), may run at full duty: those that want too much join until none does."""
    full = np.zeros(torque.shape, dtype=bool)
    for _ in range(torque.shape[1] + 1):
        slope = 1.0 + sag * full.sum(axis=1, keepdims=True)
        level = 1.0 + sag * np.where(full, along, 0.0).sum(axis=1, keepdims=True)
        room = level**2 - 4.0 * slope * sag * np.where(full, 0.0, drawn).sum(axis=1, keepdims=True)
        root = np.sqrt(np.maximum(room, 0.0))
        factor = np.minimum(np.maximum((level + root) / (2.0 * slope), 0.0), 1.0)
        more = ~full & (torque + along > factor)
        # A supply that cannot feed them all drives the hungriest at full duty.
        more |= ~full & (drawn >= np.where(full, 0.0, drawn).max(axis=1, keepdims=True)) & (room < 0.0)
        if not more.any():
            break
        full |= more
    return factor


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
    couples=True,
    touches=("actuator_gainprm", "actuator_biasprm", "actuator_forcerange"),
    step=step,
)
