# SPDX-License-Identifier: Apache-2.0
"""Supply sag."""

import math

import numba
import numpy as np

from labyrinth_sim.effect import Effect, Parameter
from labyrinth_sim.law import law, state
from labyrinth_sim.servo import asked
from labyrinth_sim.trials import Array

NO_LOAD = 6.5  # rad/s at which back-EMF takes the whole voltage, where the drive does not say: MX-106 4.7, MX-64 6.6
FULL = 0.2  # sag from which back-EMF counts in full; below it fades, so that no sag is no effect


@law
def step(raw: int) -> None:
    """Solves f = 1 - s sum_i duty_i t_i, f being V'/V, t_i the torque and n_i back-EMF in its direction, as shares.

    A drive by duty cycle gives duty f - n. One that regulates its torque gives the share t at the duty (t + n) / f; if
    it wants more than f - n, or more than the supply can feed, it runs at full duty.
    """
    s = state(raw)
    sag, count = s.values[0], s.drives.shape[0]
    along, duty, torque, here, own_here = np.empty(count), np.empty(count), np.empty(count), 0.0, False
    for i in range(count):
        act, dof, angle, second, by_duty = (
            s.drives[i, 0],
            s.drives[i, 1],
            s.drives[i, 2],
            s.drives[i, 3],
            s.drives[i, 4],
        )
        full, bias = s.base_limits[act, 1], s.base_bias[act]
        slope = -s.base_bias[second, 2] / full if second >= 0 else 0.0
        own = slope > 0.0
        emf = (slope if own else min(sag / FULL, 1.0) / NO_LOAD) * s.qvel[dof]
        wanted = asked(s.base_gain[act], bias, s.ctrl[act], s.qpos[angle], s.qvel[dof], 0.0) / full
        wanted -= emf if own and by_duty == 0 else 0.0  # of a drive with back-EMF of its own a voltage
        along[i] = -emf if wanted < 0.0 else emf
        size = min(abs(wanted), 1.0 + abs(emf))  # more is full duty in any case
        duty[i] = min(size, 1.0) if by_duty else 0.0
        torque[i] = 0.0 if by_duty else size
        if i == s.channel:
            here, own_here = emf, own
    factor = solved(sag, duty, along, torque)
    act, by_duty = s.drives[s.channel, 0], s.drives[s.channel, 4]
    if by_duty:  # less voltage at the same duty; back-EMF is in the actuators already
        s.gain[act, 0] *= factor
        for k in range(3):
            s.act_bias[act, k] *= factor
    emf = 0.0 if own_here or by_duty else here
    s.limits[act, 0] *= max(factor + emf, 0.0)
    s.limits[act, 1] *= max(factor - emf, 0.0)


@numba.njit  # type: ignore[untyped-decorator]
def solved(sag: float, duty: Array, along: Array, torque: Array) -> float:
    """f, where each motor (d,) has a duty of its own or, 0, regulates its torque up to full duty."""
    factor = 1.0
    for _ in range(len(torque) + 1):
        slope, level, drawn, most = 1.0, 1.0, 0.0, 0.0
        for i in range(len(torque)):
            slope += sag * duty[i] ** 2
            level += sag * duty[i] * along[i]
            if duty[i] == 0.0:
                own = max((torque[i] + along[i]) * torque[i], 0.0)
                drawn += own
                most = max(most, own)
        room = level**2 - 4.0 * slope * sag * drawn
        factor = min(max((level + math.sqrt(max(room, 0.0))) / (2.0 * slope), 0.0), 1.0)
        more = False
        for i in range(len(torque)):
            own = max((torque[i] + along[i]) * torque[i], 0.0)
            # A supply that cannot feed them all drives the hungriest at full duty.
            starves = room < 0.0 and own > 0.0 and own >= most
            if duty[i] == 0.0 and ((torque[i] > 0.0 and torque[i] + along[i] > factor) or starves):
                duty[i], more = 1.0, True
        if not more:
            break
    return factor


EFFECT = Effect(
    name="supply_sag",
    title="Supply sag",
    physics="The supply's voltage falls with the current that all motors draw, and with it the torque they can give: "
    "back-EMF takes a larger share of what is left.",
    equation="V' = V - s V sum_i duty_i |torque_i| / torque_max,i; |torque_i| <= torque_max,i (V' / V - b_i speed_i), "
    "b_i = 1 / 6.5 s/rad where the drive has no back-EMF of its own",
    parameters=(Parameter("sag", "1", 0.0, 20.0, 0.0, 2.0, "0 to a supply that leaves a stalled motor a twentieth"),),
    stage="force",
    mark="Both axes moving at once are slower than either alone; large steps lose their top speed.",
    shows="passing",
    confused_with=(
        "torque_saturation",
        "rate_limit",
        "viscous_friction",
        "motion_profile",
        "duty_cut_back",
        "direction_viscous_friction",
    ),
    separated_by="Step one axis alone, then both together: only sag makes the first slower because of the second.",
    couples=True,
    everywhere=True,
    touches=("actuator_gainprm", "actuator_biasprm", "actuator_forcerange"),
    step=step,
)
