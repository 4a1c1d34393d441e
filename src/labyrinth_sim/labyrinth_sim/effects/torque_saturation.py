# SPDX-License-Identifier: Apache-2.0
"""Torque (duty) saturation: limits of MuJoCo where sharp, the servo's law rewritten before every step where not."""

import numba
import numpy as np

from labyrinth_sim.effect import Effect, Parameter, Values
from labyrinth_sim.law import law, state
from labyrinth_sim.live import Fields
from labyrinth_sim.servo import asked
from labyrinth_sim.site import Site


def fields(fields: Fields, site: Site, values: Values) -> None:
    current, duty = fields["jnt_actfrcrange"][:, site.joint], fields["actuator_forcerange"][:, site.actuator]
    share = values["share"][:, None]
    # Of a drive that knows no current the duty is limited, and back-EMF takes its part of what that leaves.
    knows = current[:, 1:] > 0.0
    least = np.where(current[:, 1:] < duty[:, 1:], current, duty)
    current[...] = np.where(knows & (share < 1.0), share * least, current)
    duty *= np.where(knows, 1.0, share)


@law
def step(raw: int) -> None:
    s = state(raw)
    bias, second = s.act_bias[s.drive], s.drives[s.channel, 3]
    most, own = s.limits[s.drive, 1], 0.0
    if s.joint_limits[s.joint, 1] > 0.0:  # its current is limited, which back-EMF is part of
        most, own = s.joint_limits[s.joint, 1], s.act_bias[second, 2] if second >= 0 else 0.0
    wanted = asked(s.gain[s.drive], bias, s.ctrl[s.drive], s.qpos[s.angle], s.qvel[s.dof], own)
    ratio = abs(wanted) / max(most, 1e-300)
    # Of the servo's law, so that MuJoCo still takes its damping at the coming speed.
    factor = given(ratio, s.values[1]) / ratio if ratio > 0.0 else 1.0
    s.gain[s.drive, 0] *= factor
    bias[0] *= factor
    bias[1] *= factor
    bias[2] = factor * (bias[2] + own) - own


@numba.njit  # type: ignore[untyped-decorator]
def given(ratio: float, softness: float) -> float:
    """What is given, as a share of the limit, where `ratio` times the limit is asked for, >= 0."""
    if ratio > 1.0:
        return float((1.0 + ratio ** (-1.0 / softness)) ** -softness)
    return float(ratio * (1.0 + ratio ** (1.0 / softness)) ** -softness)


EFFECT = Effect(
    name="torque_saturation",
    title="Torque (duty) saturation",
    physics="The drive's current, and with it its torque, is limited below what the motor could give; in a drive "
    "modelled without a current, the duty is limited. Near the limit it may give gradually less than is asked for.",
    equation="|torque| <= s torque_max; of a drive that knows no current, |duty| <= s; "
    "x / (1 + x^(1/r))^r of the limit where x of it is asked for, r > 0 being the softness",
    parameters=(
        Parameter("share", "1", 0.005, 1.0, 1.0, 0.02, "a hundredth to all of the full torque"),
        Parameter("softness", "1", 0.0, 1.0, None, 0.0, "0 is sharp; tanh has 0.4", settled=True, begin=(0.0,)),
    ),
    stage="mjcf",
    mark="Large steps accelerate and brake at a constant rate, small ones look undisturbed.",
    shows="passing",
    confused_with=(
        "rate_limit",
        "supply_sag",
        "viscous_friction",
        "motion_profile",
        "duty_cut_back",
    ),
    separated_by="Steps of several sizes: saturation gives them the same acceleration, a rate limit the same slope.",
    order=10,
    touches=("actuator_gainprm", "actuator_biasprm"),
    fields=fields,
    step=step,
    steps_with="softness",
)
