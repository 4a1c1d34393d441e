# SPDX-License-Identifier: Apache-2.0
"""Backlash: belt slack, or play at the shaft where there is no belt."""

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.filters import Play
from labyrinth_sim.law import law, state
from labyrinth_sim.live import Fields
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array


def fields(fields: Fields, site: Site, values: Values) -> None:
    if site.tendon >= 0:
        slack = fields["tendon_lengthspring"]
        slack[:, site.tendon, 0] -= values["width"] / 2
        slack[:, site.tendon, 1] += values["width"] / 2


@law
def step(raw: int) -> None:
    """A slack belt neither pulls nor damps; MuJoCo's tendon would damp also within its spring's dead band."""
    s = state(raw)
    width, hold = s.values[0], s.values[1]
    if s.tendon < 0:
        return
    stretch = s.length[s.tendon] + s.step * s.rate[s.tendon]
    if abs(stretch) < width / 2:
        s.belt_damping[s.tendon] = 0.0
        s.frictionloss[s.load_dof] += hold


def measure(values: Values, site: Site, step: float, start: Array) -> Play | None:
    axis = site.the_axis
    behind = next((m for m in axis.measured if m.signal == site.signal), None)
    if axis.belt or behind is None or behind.quantity != "position" or not values["width"].any():
        return None
    return Play(values["width"])


EFFECT = Effect(
    name="backlash",
    title="Backlash (belt slack)",
    physics="Between driven and driving side lies a gap that must be crossed at every reversal before force "
    "is passed on.",
    equation="belt torque = k (s - clip(s, -w/2, w/2)) + d ds/dt where |s| > w/2, else 0, s = r motor - board; without "
    "a belt, angle' trails by at most w/2",
    parameters=(
        Parameter(
            "width", "rad", 0.0, 0.4, 0.0, 0.015, "0 to 23 deg; toy belts and worn gears show 0.5 to 2 deg", span=0.06
        ),
        Parameter("hold", "N m", 1e-4, 0.05, None, 0.005, "friction that holds the load while the belt is slack"),
    ),
    stage="mjcf",
    mark="After each reversal the load stands still for the width of the gap while the motor already turns; a loop of "
    "constant width when load is drawn over motor.",
    shows="loop",
    confused_with=(
        "coulomb_friction",
        "dead_band",
        "load_friction",
        "direction_friction",
        "sensor_quantisation",
        "lugre_friction",
        "belt_compliance",
        "stribeck_friction",
    ),
    separated_by="Slow triangles of two amplitudes with encoder and potentiometer: backlash widens the loop "
    "between the two, "
    "friction the one between command and encoder.",
    touches=("tendon_damping", "dof_frictionloss"),
    fields=fields,
    step=step,
    measure=measure,
)
