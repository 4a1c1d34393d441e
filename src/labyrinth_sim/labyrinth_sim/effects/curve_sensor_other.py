# SPDX-License-Identifier: Apache-2.0
"""A free curve: a sensor's error over the angle of another axis, the first one that there is."""

from labyrinth_sim.curve import angle_share, bounds_of_range, curve, falling, knots
from labyrinth_sim.effect import Effect, Values
from labyrinth_sim.filters import Added
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array


def measure(values: Values, site: Site, step: float, start: Array) -> Added:
    return Added(lambda other: curve(values, angle_share(other, values)), site.other_seen)


EFFECT = Effect(
    name="curve_sensor_other",
    title="Free curve: sensor error over the other axis's angle",
    physics="A sensor is off by an amount that depends on where another axis stands; a table says how much, not why.",
    equation="angle' = angle + F(other angle), F through 10 values over centre +- half",
    parameters=(
        *knots("rad", -0.1, 0.1, falling(0.02), "a sensor off by 6 deg would be noticed by eye"),
        bounds_of_range("centre", "rad", -100.0, 100.0, 0.0),
        bounds_of_range("half", "rad", 0.001, 100.0, 0.06),
    ),
    stage="measurement",
    mark="One signal of this axis changes while only the other axis moves; its others do not.",
    shows="coupled",
    confused_with=("curve_other",),
    separated_by="Compare the sensors of one axis: an error that only one of them shows is its own.",
    where="signal",
    needs=("other_axis",),
    couples=True,
    order=20,
    nameless=True,
    measure=measure,
)
