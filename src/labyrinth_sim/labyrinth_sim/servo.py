# SPDX-License-Identifier: Apache-2.0
"""What the drives have in common: a torque up to a limit that follows the supply, and a target that comes late."""

import mujoco
import numpy as np

from labyrinth_sim.effect import Values
from labyrinth_sim.filters import Delay
from labyrinth_sim.live import Fields, Live
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array


def limit_torque(servo: mujoco.MjsActuator) -> None:
    """Lets an actuator take any target and limits its torque; `set_torque` tells to what."""
    servo.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
    servo.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
    servo.forcerange = [-1.0, 1.0]


def set_torque(fields: Fields, site: Site, torque: Array) -> None:
    """Sets the largest torque, (nsim,) N m, in either direction."""
    fields["actuator_forcerange"][:, site.actuator, 0] = -torque
    fields["actuator_forcerange"][:, site.actuator, 1] = torque


def scale_torque(live: Live, site: Site, factor: Array, speed: Array) -> None:
    """Scales the largest torque as a supply that sags does.

    Args:
        factor: (nsim,) of the full voltage.
        speed: (nsim,) signed share of it that back-EMF takes.
    """
    limits = live["actuator_forcerange"][:, site.actuator]
    limits[:, 0] *= np.maximum(factor + speed, 0.0)
    limits[:, 1] *= np.maximum(factor - speed, 0.0)


def delay(values: Values, site: Site, step: float, start: Array) -> Delay | None:
    """The filter of a target that comes late by the parameter `delay`, s; None where it never does."""
    return Delay(values["delay"], step, start) if values["delay"].any() else None
