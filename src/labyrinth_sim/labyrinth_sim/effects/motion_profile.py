# SPDX-License-Identifier: Apache-2.0
"""Motion profile of the firmware: a setpoint with limited acceleration and speed."""

import numpy as np

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.filters import Profile
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array

FREE_ACCELERATION = 5000.0  # rad/s^2
FREE_SPEED = 200.0  # rad/s


def command(values: Values, site: Site, step: float, start: Array) -> Profile:
    acceleration = np.where(values["acceleration"] >= FREE_ACCELERATION, np.inf, values["acceleration"])
    speed = np.where(values["speed"] >= FREE_SPEED, np.inf, values["speed"])
    return Profile(acceleration, speed, step, start)


EFFECT = Effect(
    name="motion_profile",
    title="Motion profile of the firmware",
    physics="The servo's firmware moves its setpoint to the target with limited acceleration and speed.",
    equation="|d2u'/dt2| <= a, |du'/dt| <= v, in the shortest time without passing u",
    parameters=(
        Parameter(
            "acceleration",
            "rad/s^2",
            0.2,
            FREE_ACCELERATION,
            FREE_ACCELERATION,
            10.0,
            "one unit of Dynamixel's profile register (0.37), whose largest is 12000, to what hardly shows",
            fixed="bounds",
            span=500.0,
        ),
        Parameter(
            "speed",
            "rad/s",
            0.05,
            FREE_SPEED,
            FREE_SPEED,
            5.0,
            "crawling to what hardly shows: a step of 1 rad takes 5 ms",
            fixed="bounds",
            span=20.0,
        ),
    ),
    stage="command",
    mark="Steps become smooth S-shaped ramps: each starts and ends gently, and takes longer the larger it is.",
    shows="passing",
    confused_with=(
        "rate_limit",
        "torque_saturation",
        "command_delay",
        "supply_sag",
        "duty_cut_back",
        "viscous_friction",
    ),
    separated_by="Steps of several sizes and the effort: a profile makes the time grow with the root of the size and "
    "never drives the motor hard, a saturated motor pushes at its limit.",
    contains=(("speed", "rate_limit", "rate"),),
    order=12,
    command=command,
)
