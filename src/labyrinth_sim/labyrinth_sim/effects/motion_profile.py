# SPDX-License-Identifier: Apache-2.0
"""Motion profile of the firmware: a setpoint with limited acceleration and speed."""

import numpy as np
from numpy.typing import NDArray

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array

FREE_ACCELERATION = 500.0  # rad/s^2
FREE_SPEED = 20.0  # rad/s


class Profile:
    """A setpoint that follows its input on trapezoids of speed, (nsim,) each; NaN passes and restarts it at rest.

    Each sample it takes the highest speed from which it can still stop at the target, as a sampled profile generator
    does. What comes out is held for a sample, so it is the mean over that sample.

    Args:
        acceleration, speed: limits, per s^2 and per s; infinite where there is none.
        step: s between samples.
        start: where the setpoint stands.
    """

    def __init__(self, acceleration: Array, speed: Array, step: float, start: Array) -> None:
        self.abrupt: NDArray[np.bool_] = np.isinf(acceleration)
        self.free = self.abrupt & np.isinf(speed)
        self.acceleration, self.speed = np.where(self.abrupt, 0.0, acceleration), speed
        self.step = step
        self.at, self.moving = np.array(start, float), np.zeros_like(start)

    def __call__(self, own: Array, every: Array) -> Array:
        out = np.empty_like(own)
        step, slowing = self.step, self.acceleration * self.step
        at, moving = self.at, self.moving
        for k in range(own.shape[1]):
            goal = own[:, k]
            free = self.free | np.isnan(at) | np.isnan(goal)
            ahead = goal - at - 0.5 * moving * step
            stoppable = np.sqrt((0.5 * slowing) ** 2 + 2.0 * self.acceleration * np.abs(ahead)) - 0.5 * slowing
            wanted = np.copysign(np.minimum(stoppable, self.speed), ahead)
            after = np.minimum(np.maximum(wanted, moving - slowing), moving + slowing)
            mean, way = (2.0 * moving + after) * step / 6.0, 0.5 * (moving + after) * step
            if self.abrupt.any():  # it moves at full speed until it is there, as `RateLimit` does
                most = self.speed * step
                straight = np.minimum(np.maximum(goal - at, -most), most)
                way = np.where(self.abrupt, straight, way)
                mean = np.where(self.abrupt, straight - 0.5 * straight * np.abs(straight) / most, mean)
            out[:, k] = np.where(free, goal, at + mean)
            at = np.where(free, goal, at + way)
            moving = np.where(free | self.abrupt, 0.0, after)
        self.at, self.moving = at, moving
        return out


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
            "one unit of Dynamixel's profile register (0.37) to beyond the largest of Feetech's (39)",
            fixed="bounds",
        ),
        Parameter(
            "speed",
            "rad/s",
            0.05,
            FREE_SPEED,
            FREE_SPEED,
            5.0,
            "crawling to faster than any servo of this class turns",
            fixed="bounds",
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
