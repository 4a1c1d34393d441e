# SPDX-License-Identifier: Apache-2.0
"""A position servo that sets a duty cycle in proportion to its error, with a DC motor behind it.

Two MuJoCo actuators do it natively: a position servo whose force range is the torque at full duty, and the back-EMF,
which the limit on the duty does not touch.
"""

from collections.abc import Mapping

import mujoco

from labyrinth_sim.effect import Drive, Parameter, Values
from labyrinth_sim.live import Fields
from labyrinth_sim.servo import FEEDBACK_TICK, GOAL_TICK, add_back_emf, limit_torque, set_back_emf, set_torque, target
from labyrinth_sim.site import Site


def spec(spec: mujoco.MjSpec, site: Site) -> None:
    servo = spec.actuator(site.the_axis.actuator)
    servo.set_to_position(kp=1.0)
    limit_torque(servo)
    add_back_emf(spec, site)


def fields(fields: Fields, site: Site, values: Values) -> None:
    stall = values["torque_constant"] * values["voltage"] / values["resistance"]
    stiffness = stall * values["kp"] * values["duty_gain"]
    fields["actuator_gainprm"][:, site.actuator, 0] = stiffness
    fields["actuator_biasprm"][:, site.actuator, 1] = -stiffness
    fields["actuator_biasprm"][:, site.actuator, 2] = stiffness * values["feedback_delay"]
    set_torque(fields, site, stall)
    set_back_emf(fields, site, values["torque_constant"] ** 2 / values["resistance"])


def full(values: Mapping[str, float]) -> float:
    return values["torque_constant"] * values["voltage"] / values["resistance"]


DRIVE = Drive(
    name="pwm_servo",
    title="Position servo by duty cycle, with a DC motor",
    physics="The duty cycle is proportional to the error up to full duty; the motor's torque is what supply "
    "voltage less "
    "back-EMF drives through its resistance. The firmware uses an angle that is on average half a loop period "
    "old.",
    equation="duty = clip(k_p g (target - angle + T speed), -1, 1); torque = k_t (duty V - k_t speed) / R, "
    "T = feedback_delay",
    parameters=(
        Parameter("kp", "1", 1.0, 4000.0, None, 200.0, "firmware's position gain, a register"),
        Parameter(
            "duty_gain",
            "1/rad",
            1e-4,
            1.0,
            None,
            4096 / (2 * 3.141592653589793) / (256 * 885),
            "duty per rad and k_p: 0.0029 in an XL330, 0.165 in an STS3215",
        ),
        Parameter("voltage", "V", 3.0, 30.0, None, 7.4, "supplies of such servos"),
        Parameter("resistance", "ohm", 0.1, 50.0, None, 3.0, "windings of such motors"),
        Parameter(
            "torque_constant", "N m/A", 0.01, 10.0, None, 0.5, "behind the gear; stall torque over stall current"
        ),
        Parameter("delay", "s", 0.0, 0.05, None, 0.0, "bus and firmware"),
        Parameter(
            "feedback_delay", "s", 0.0, 0.005, None, 0.0, "half a period of the firmware's loop: 0.5 ms at 1 kHz"
        ),
        GOAL_TICK,
        FEEDBACK_TICK,
    ),
    spec=spec,
    fields=fields,
    target=target,
    by_duty=True,
    full=full,
    free=("resistance", "torque_constant", "joint.armature", "delay"),
    identified_by_effort=("duty_gain",),
    uncertain=("feedback_delay",),
    loose=("resistance", "torque_constant", "joint.armature", "duty_gain"),
)
