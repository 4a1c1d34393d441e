# SPDX-License-Identifier: Apache-2.0
"""Camera latency."""

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.filters import Delay
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array


def measure(values: Values, site: Site, step: float, start: Array) -> Delay | None:
    return Delay(values["delay"], step, start, smooth=True) if values["delay"].any() else None


EFFECT = Effect(
    name="camera_latency",
    title="Camera latency",
    physics="Exposure, transfer and image processing make the ball's position older than its stamp.",
    equation="ball'(t) = ball(t - T)",
    parameters=(Parameter("delay", "s", 0.0, 0.2, 0.0, 0.05, "0 to six frames at 30 frames per second"),),
    stage="measurement",
    mark="The ball trails its true position by speed times latency, while the motors are on time.",
    shows="late",
    confused_with=(
        "command_delay",
        "rolling_friction",
        "camera_scale",
    ),
    separated_by="A step of the board: with latency the encoder moves on time and the ball late.",
    where="ball",
    order=10,
    measure=measure,
)
