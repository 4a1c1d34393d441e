# SPDX-License-Identifier: Apache-2.0
"""Sensor lag."""

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.filters import Blend, Lag, Mean
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array


def measure(values: Values, site: Site, step: float, start: Array) -> Lag | Blend:
    late, share = values["time_constant"], values["averaged"]
    lag = Lag(late, step)
    return Blend(lag, Mean(2.0 * late, step, start), share) if share.any() else lag


EFFECT = Effect(
    name="sensor_lag",
    title="Sensor lag",
    physics="A filter smooths the sensor's signal: a low-pass, a moving average, or the exposure of a camera.",
    equation="tau d(angle')/dt + angle' = angle; in place of the share m of it the mean of angle over the last 2 tau",
    parameters=(
        Parameter("time_constant", "s", 0.0, 0.15, 0.0, 0.03, "0 to a filter at 1 Hz; half of what is averaged over"),
        Parameter(
            "averaged",
            "1",
            0.0,
            1.0,
            None,
            0.0,
            "0 is a low-pass of first order, 1 a moving average",
            settled=True,
            choices=(0.0, 1.0),
        ),
    ),
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
