# SPDX-License-Identifier: Apache-2.0
"""Sensor lag."""

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.filters import Lag
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array


def measure(values: Values, site: Site, step: float, start: Array) -> Lag:
    return Lag(values["time_constant"], step)


EFFECT = Effect(
    name="sensor_lag",
    title="Sensor lag",
    physics="A low-pass filter smooths the sensor's signal.",
    equation="tau d(angle')/dt + angle' = angle",
    parameters=(Parameter("time_constant", "s", 0.0, 0.15, 0.0, 0.03, "0 to a filter at 1 Hz"),),
    stage="measurement",
    mark="One signal rounds off every corner and trails more the faster it changes; it starts on time.",
    shows="late",
    confused_with=(
        "sensor_delay",
        "command_delay",
        "viscous_friction",
        "belt_compliance",
    ),
    separated_by="Fast sines: a lag makes them smaller, a delay does not; compare the sensors of one axis for "
    "motor and "
    "load.",
    where="signal",
    order=15,
    measure=measure,
)
