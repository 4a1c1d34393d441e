# SPDX-License-Identifier: Apache-2.0
"""What the drives have in common: a torque limit that follows the supply; targets in whole ticks that come late."""

import mujoco
import numpy as np

from labyrinth_sim.effect import Parameter, Values
from labyrinth_sim.filters import Delay, rounded
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


GOAL_TICK = Parameter("goal_tick", "rad", 0.0, 0.05, None, 0.0, "the goal register's, from its data sheet; 0 is none")


class Target:
    """The filter of a target that a servo takes in whole ticks, (nsim,) rad, and late."""

    def __init__(self, tick: Array, delay: Delay | None) -> None:
        self.tick, self.delay = tick, delay

    def __call__(self, own: Array, every: Array) -> Array:
        goal = rounded(own, self.tick)
        return self.delay(goal, every) if self.delay else goal


def target(values: Values, site: Site, step: float, start: Array) -> Target | None:
    """The filter by the parameters `goal_tick`, rad, and `delay`, s; None where both are 0."""
    late = Delay(values["delay"], step, start) if values["delay"].any() else None
    return Target(values["goal_tick"], late) if late or values["goal_tick"].any() else None
