# SPDX-License-Identifier: Apache-2.0
"""A free curve: a sensor's error over what it measures."""

from labyrinth_sim.curve import angle_share, bounds_of_range, curve, falling, knots
from labyrinth_sim.effect import Effect, Values
from labyrinth_sim.filters import Map
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array

ROUNDS = 8  # in which the angle behind a reading is found; each leaves as much as the error is steep


def measure(values: Values, site: Site, step: float, start: Array) -> Map:
    return Map(lambda angle: angle + curve(values, angle_share(angle, values)))


def undo(values: Values, site: Site, seen: Array) -> Array:
    angle = seen
    for _ in range(ROUNDS):
        angle = seen - curve(values, angle_share(angle[:, None], values))[:, 0]
    return angle


EFFECT = Effect(
    name="curve_sensor",
    title="Free curve: sensor error over angle",
    physics="A sensor is off by an amount that depends on the angle; a table says how much, not why.",
    equation="angle' = angle + F(angle), F through 10 values over centre +- half",
    parameters=(
        *knots("rad", -0.1, 0.1, falling(0.02), "a sensor off by 6 deg would be noticed by eye"),
        bounds_of_range("centre", "rad", -100.0, 100.0, 0.0),
        bounds_of_range("half", "rad", 0.001, 100.0, 0.06),
    ),
    stage="measurement",
    mark="One signal is off by an amount that depends on its value alone; the others are not.",
    shows="by_angle",
    confused_with=("curve_angle",),
    separated_by="Compare the sensors of one axis: an error that only one of them shows is its own.",
    where="signal",
    order=20,
    nameless=True,
    measure=measure,
    undo=undo,
)
