# SPDX-License-Identifier: Apache-2.0
"""Command delay."""

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.filters import Delay
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array


def command(values: Values, site: Site, step: float, start: Array) -> Delay | None:
    return Delay(values["delay"], step, start) if values["delay"].any() else None


EFFECT = Effect(
    name="command_delay",
    title="Command delay",
    physics="A command reaches the drive a fixed time after it was sent: bus, scheduler, firmware.",
    equation="u'(t) = u(t - T)",
    parameters=(
        Parameter(
            "delay", "s", 0.0, 0.15, 0.0, 0.03, "0 to three times the paper's 50 ms: serial bus plus a busy host"
        ),
    ),
    stage="command",
    mark="Everything measured starts late by the same time after every command, encoder and board alike.",
    shows="late",
    confused_with=(
        "sensor_delay",
        "sensor_lag",
        "rate_limit",
        "motion_profile",
        "camera_latency",
        "duty_cut_back",
    ),
    separated_by="Compare encoder and potentiometer: a late sensor is late alone, a late command makes both late.",
    order=30,
    exact=True,
    command=command,
)
