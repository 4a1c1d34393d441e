# SPDX-License-Identifier: Apache-2.0
"""A servo whose current, and so its torque, follows a PD law on the angle; all of it MuJoCo's own actuators."""

from collections.abc import Mapping

from labyrinth_sim.effect import Drive, Parameter, Values
from labyrinth_sim.live import Fields
from labyrinth_sim.servo import (
    BACK_EMF,
    FEEDBACK_TICK,
    GOAL_TICK,
    position_servo,
    set_back_emf,
    set_current,
    set_torque,
    target,
)
from labyrinth_sim.site import Site


def fields(fields: Fields, site: Site, values: Values) -> None:
    fields["actuator_gainprm"][:, site.actuator, 0] = values["stiffness"]
    fields["actuator_biasprm"][:, site.actuator, 1] = -values["stiffness"]
    slope = values["torque"] * values["back_emf"]
    fields["actuator_biasprm"][:, site.actuator, 2] = slope - values["damping"]
    set_torque(fields, site, values["torque"])
    set_current(fields, site, values["torque"])
    set_back_emf(fields, site, slope)


def full(values: Mapping[str, float]) -> float:
    return values["torque"]


DRIVE = Drive(
    name="torque_pd",
    title="Torque servo under a PD law on the angle",
    physics="The motor's current, and so its torque, is proportional to the error less a share of the speed, up "
    "to a limit that falls with the speed as back-EMF takes its share of the supply.",
    equation="torque = clip(K (target - angle) - C speed, -M min(1, 1 + b speed), M min(1, 1 - b speed)), b = back_emf",
    parameters=(
        Parameter("stiffness", "N m/rad", 0.01, 500.0, None, 10.0, "from a toy servo to one of 10 N m at 1 deg"),
        Parameter("damping", "N m s/rad", 0.0, 20.0, None, 0.2, "up to more than critical for such servos"),
        Parameter("torque", "N m", 0.01, 20.0, None, 2.8, "stall torques of such servos"),
        BACK_EMF,
        Parameter("delay", "s", 0.0, 0.05, None, 0.0, "bus and firmware"),
        GOAL_TICK,
        FEEDBACK_TICK,
    ),
    spec=position_servo,
    fields=fields,
    target=target,
    full=full,
    free=("stiffness", "damping", "delay"),
    uncertain=("back_emf", "torque", "joint.armature"),
    loose=("stiffness", "damping"),
)
