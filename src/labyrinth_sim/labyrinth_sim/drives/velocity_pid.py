# SPDX-License-Identifier: Apache-2.0
"""The paper's simulated servo, equation 8: a PID law on the angle commands a speed."""

import mujoco
import numpy as np

from labyrinth_sim.effect import Drive, Parameter, Values
from labyrinth_sim.live import Fields
from labyrinth_sim.servo import GOAL_TICK, limit_torque, scale_torque, set_torque, target
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array

REFERENCE_STEP = 0.01  # s; the paper samples at 100 Hz
FASTEST = 1e4  # rad/s; far beyond, the torque is saturated anyway, and MuJoCo takes huge controls for errors


class VelocityPid:
    """Equation 8, `v_n = P e_n + I sum(e_k dt_k) + D (e_n - e_{n-1})`: I and D at each sample, P at each MuJoCo step.

    P is MuJoCo's own, for a servo's loop is ten times faster than commands come. D is meant for 10 ms; at another
    sample the difference is scaled, so that the damping stays the same.
    """

    def __init__(self, values: Values, step: float) -> None:
        self.p, self.i = values["p"], values["i"]
        self.d = values["d"] * (REFERENCE_STEP / step)
        self.step = step
        self.sum = np.zeros_like(self.p)
        self.last = np.zeros_like(self.p)
        self.sampled = np.zeros_like(self.p)

    def sample(self, error: Array) -> None:
        self.sum = self.sum + error * self.step
        speed = self.i * self.sum + self.d * (error - self.last)
        self.sampled = np.maximum(np.minimum(speed, FASTEST), -FASTEST)
        self.last = error

    def __call__(self, target: Array) -> Array:
        return self.p * target + self.sampled

    def restart(self, which: Array) -> None:
        self.sum = np.where(which, 0.0, self.sum)
        self.last = np.where(which, 0.0, self.last)


def spec(spec: mujoco.MjSpec, site: Site) -> None:
    actuator = spec.actuator(site.the_axis.actuator)
    actuator.set_to_velocity(kv=1.0)
    limit_torque(actuator)


def fields(fields: Fields, site: Site, values: Values) -> None:
    fields["actuator_gainprm"][:, site.actuator, 0] = values["speed_gain"]
    fields["actuator_biasprm"][:, site.actuator, 1] = -values["speed_gain"] * values["p"]
    fields["actuator_biasprm"][:, site.actuator, 2] = -values["speed_gain"]
    set_torque(fields, site, values["torque"])


DRIVE = Drive(
    name="velocity_pid",
    title="Speed servo under a PID law on the angle",
    physics="The servo turns at the speed that a PID law on the angle's error asks for, as far as its torque suffices.",
    equation="v = P e + I sum(e_k dt_k) + D (e_n - e_{n-1}), sum and difference of samples; "
    "torque = clip(G (v - speed), -M, M)",
    parameters=(
        Parameter("p", "1/s", -25.0, 25.0, None, 1.0, "the paper's search range"),
        Parameter("i", "1/s^2", -20.0, 20.0, None, 0.0, "the paper's search range"),
        Parameter("d", "1/s", -20.0, 20.0, None, 0.0, "the paper's search range; at 10 ms a sample"),
        Parameter("delay", "s", 0.0, 0.05, None, 0.0, "the paper's search range"),
        GOAL_TICK,
        Parameter(
            "speed_gain", "N m s/rad", 0.05, 20.0, None, 2.0, "from compliant to stiff beside 0.01 kg m^2 of armature"
        ),
        Parameter("torque", "N m", 0.01, 10.0, None, 2.8, "hobby servo to MX-106 (8.4 N m)"),
    ),
    spec=spec,
    fields=fields,
    target=target,
    controller=VelocityPid,
    supply=scale_torque,
    free=("p", "i", "d", "delay"),
)
