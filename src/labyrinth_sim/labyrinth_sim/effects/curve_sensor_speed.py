# SPDX-License-Identifier: Apache-2.0
"""A free curve: a sensor's error over the speed of what it measures."""

from labyrinth_sim.curve import bounds_of_range, curve, falling, knots, speed_share
from labyrinth_sim.effect import Effect, Values
from labyrinth_sim.filters import WithSpeed
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array


def measure(values: Values, site: Site, step: float, start: Array) -> WithSpeed:
    return WithSpeed(lambda angle, speed: angle + curve(values, speed_share(speed, values)), step, start)


EFFECT = Effect(
    name="curve_sensor_speed",
    title="Free curve: sensor error over speed",
    physics="A sensor is off by an amount that depends on how fast it moves and which way; a table says how much.",
    equation="angle' = angle + F(speed), F through 10 values over -most to most",
    parameters=(
        *knots("rad", -0.1, 0.1, falling(0.02), "a sensor off by 6 deg would be noticed by eye"),
        bounds_of_range("most", "rad/s", 0.001, 1000.0, 1.0),
    ),
    stage="measurement",
    mark="One signal is off while it moves, by an amount that depends on its speed alone; the others are not.",
    shows="late",
    confused_with=("curve_speed",),
    separated_by="Compare the sensors of one axis: a force moves both, its own error only one.",
    where="signal",
    order=20,
    nameless=True,
    measure=measure,
)
