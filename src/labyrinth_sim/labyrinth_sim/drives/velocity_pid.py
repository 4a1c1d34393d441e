# SPDX-License-Identifier: Apache-2.0
"""The paper's simulated servo, equation 8: a PID law on the angle commands a speed."""

from collections.abc import Mapping

import mujoco
import numpy as np

from labyrinth_sim.effect import Drive, Parameter, Values
from labyrinth_sim.law import MOST_SUM
from labyrinth_sim.live import Fields
from labyrinth_sim.servo import (
    BACK_EMF,
    FEEDBACK_TICK,
    GOAL_TICK,
    add_back_emf,
    limit_current,
    limit_torque,
    set_back_emf,
    set_current,
    set_torque,
    target,
)
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array

REFERENCE_STEP = 0.01  # s; the paper samples at 100 Hz


class Integral:
    """The I part of equation 8, a sum over the samples; P and D are MuJoCo's own."""

    def __init__(self, values: Values, step: float) -> None:
        self.i, self.step = values["i"], step
        self.sum = np.zeros_like(self.i)

    def sample(self, error: Array) -> Array:
        self.sum = self.sum + error * self.step
        speed: Array = np.clip(self.i * self.sum, -MOST_SUM, MOST_SUM)
        return speed

    @property
    def integral(self) -> Array:
        return self.i

    def restart(self, which: Array) -> None:
        self.sum = np.where(which, 0.0, self.sum)


def integral(values: Values, step: float) -> Integral | None:
    return Integral(values, step) if values["i"].any() else None


def gain(values: Values) -> Array:
    return values["p"]


def lead(values: Values) -> Array:
    """D (e_n - e_{n-1}), of samples 10 ms apart: of the target its change within them, of the angle 10 ms times its
    speed, which MuJoCo takes off implicitly.
    """
    return values["d"]


def spec(spec: mujoco.MjSpec, site: Site) -> None:
    actuator = spec.actuator(site.the_axis.actuator)
    actuator.set_to_velocity(kv=1.0)
    limit_torque(actuator)
    add_back_emf(spec, site)
    limit_current(spec, site)


def fields(fields: Fields, site: Site, values: Values) -> None:
    fields["actuator_gainprm"][:, site.actuator, 0] = values["speed_gain"]
    fields["actuator_biasprm"][:, site.actuator, 1] = -values["speed_gain"] * values["p"]
    slope = values["torque"] * values["back_emf"]
    fields["actuator_biasprm"][:, site.actuator, 2] = slope - values["speed_gain"] * (
        1.0 + REFERENCE_STEP * values["d"]
    )
    set_torque(fields, site, values["torque"])
    set_current(fields, site, values["torque"])
    set_back_emf(fields, site, slope)


def full(values: Mapping[str, float]) -> float:
    return values["torque"]


DRIVE = Drive(
    name="velocity_pid",
    title="Speed servo under a PID law on the angle",
    physics="The servo turns at the speed set by a PID law on the angle's error, as far as its torque suffices; "
    "back-EMF takes a share of the torque that grows with the speed.",
    equation="v = P e + I sum(e_k dt_k) + D (e - e 10 ms before); "
    "torque = clip(G (v - speed), -M min(1, 1 + b speed), M min(1, 1 - b speed)), b = back_emf",
    parameters=(
        Parameter("p", "1/s", -25.0, 25.0, None, 1.0, "the paper's search range"),
        Parameter("i", "1/s^2", -20.0, 20.0, None, 0.0, "the paper's search range"),
        Parameter("d", "1/s", -20.0, 20.0, None, 0.0, "the paper's search range; at 10 ms a sample"),
        Parameter("delay", "s", 0.0, 0.05, None, 0.0, "the paper's search range"),
        GOAL_TICK,
        FEEDBACK_TICK,
        Parameter(
            "speed_gain", "N m s/rad", 0.05, 20.0, None, 2.0, "from compliant to stiff for 0.01 kg m^2 of armature"
        ),
        Parameter("torque", "N m", 0.01, 10.0, None, 2.8, "hobby servo to MX-106 (8.4 N m)"),
        BACK_EMF,
    ),
    spec=spec,
    fields=fields,
    target=target,
    gain=gain,
    lead=lead,
    controller=integral,
    full=full,
    free=("p", "i", "d", "delay"),
    uncertain=("back_emf", "speed_gain", "torque", "joint.armature"),
)
