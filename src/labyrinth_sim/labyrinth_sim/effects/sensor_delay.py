# SPDX-License-Identifier: Apache-2.0
"""Sensor delay."""

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.filters import Delay
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array


def measure(values: Values, site: Site, step: float, start: Array) -> Delay | None:
    return Delay(values["delay"], step, start, smooth=True) if values["delay"].any() else None


EFFECT = Effect(
    name="sensor_delay",
    title="Sensor delay",
    physics="The sensor's value is older than its stamp: bus, converter, filter of a camera.",
    equation="angle'(t) = angle(t - T)",
    parameters=(Parameter("delay", "s", 0.0, 0.15, 0.0, 0.03, "0 to four frames of a slow camera"),),
    stage="measurement",
    mark="One signal is late by the same time throughout; the others are not.",
    shows="late",
    confused_with=("sensor_lag", "command_delay"),
    separated_by="Compare the sensors of one axis: a late command makes both late, a late sensor only one.",
    where="signal",
    order=10,
    exact=True,
    measure=measure,
)
