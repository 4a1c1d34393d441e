# SPDX-License-Identifier: Apache-2.0
"""A position servo that sets a duty cycle in proportion to its error, with a DC motor behind it.

Two MuJoCo actuators do it natively: a position servo whose force range is the torque at full duty, and the back-EMF,
which the limit on the duty does not touch.
"""

import mujoco
import numpy as np

from labyrinth_sim.effect import Drive, Parameter, Values
from labyrinth_sim.live import Fields, Live
from labyrinth_sim.servo import GOAL_TICK, limit_torque, scale_torque, set_torque, target
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array


def spec(spec: mujoco.MjSpec, site: Site) -> None:
    axis = site.the_axis
    servo = spec.actuator(axis.actuator)
    servo.set_to_position(kp=1.0)
    limit_torque(servo)
    emf = spec.add_actuator(
        name=f"{axis.actuator}_emf", target=axis.joint, trntype=mujoco.mjtTrn.mjTRN_JOINT, group=site.group
    )
    emf.set_to_velocity(kv=1.0)
    emf.gainprm[0] = 0.0


def fields(fields: Fields, site: Site, values: Values) -> None:
    stall = values["torque_constant"] * values["voltage"] / values["resistance"]
    stiffness = stall * values["kp"] * values["duty_gain"]
    servo, emf = site.actuator, next(i for i in site.actuators if i != site.actuator)
    fields["actuator_gainprm"][:, servo, 0] = stiffness
    fields["actuator_biasprm"][:, servo, 1] = -stiffness
    set_torque(fields, site, stall)
    fields["actuator_biasprm"][:, emf, 2] = -(values["torque_constant"] ** 2) / values["resistance"]


def supply(live: Live, site: Site, factor: Array, speed: Array) -> None:
    """Less voltage; back-EMF is in the actuator already."""
    live["actuator_gainprm"][:, site.actuator, 0] *= factor
    live["actuator_biasprm"][:, site.actuator, 1] *= factor
    scale_torque(live, site, factor, np.zeros_like(speed))


DRIVE = Drive(
    name="pwm_servo",
    title="Position servo by duty cycle, with a DC motor",
    physics="The duty cycle is proportional to the error up to full duty; the motor's torque is what supply "
    "voltage less "
    "back-EMF drives through its resistance.",
    equation="duty = clip(k_p g (target - angle), -1, 1); torque = k_t (duty V - k_t speed) / R",
    parameters=(
        Parameter("kp", "1", 1.0, 4000.0, None, 200.0, "firmware's position gain, a register"),
        Parameter(
            "duty_gain", "1/rad", 1e-4, 0.1, None, 4096 / (2 * 3.141592653589793) / (256 * 885), "duty per rad and k_p"
        ),
        Parameter("voltage", "V", 3.0, 30.0, None, 7.4, "supplies of such servos"),
        Parameter("resistance", "ohm", 0.1, 50.0, None, 3.0, "windings of such motors"),
        Parameter(
            "torque_constant", "N m/A", 0.01, 10.0, None, 0.5, "behind the gear; stall torque over stall current"
        ),
        Parameter("delay", "s", 0.0, 0.05, None, 0.0, "bus and firmware"),
        GOAL_TICK,
    ),
    spec=spec,
    fields=fields,
    target=target,
    supply=supply,
    strength=("actuator_gainprm", "actuator_biasprm", "actuator_forcerange"),
    free=("resistance", "torque_constant", "joint.armature", "delay"),
)
