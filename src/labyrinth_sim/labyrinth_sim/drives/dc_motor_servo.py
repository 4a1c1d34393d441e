# SPDX-License-Identifier: Apache-2.0
"""A position servo from data-sheet values: a PD law on the duty cycle, a DC motor, a gear, a limited current.

MuJoCo does all of it natively: the duty's limit is the servo's force range, back-EMF the second actuator, which that
limit does not touch, and the limit on the current that of the joint's actuator force.
"""

from collections.abc import Mapping

from labyrinth_sim.effect import Drive, Parameter, Values
from labyrinth_sim.live import Fields
from labyrinth_sim.servo import (
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
    per_ampere = values["efficiency"] * values["gear"] * values["torque_constant"]
    stall = per_ampere * values["voltage"] / values["resistance"]
    fields["actuator_gainprm"][:, site.actuator, 0] = stall * values["kp"]
    fields["actuator_biasprm"][:, site.actuator, 1] = -stall * values["kp"]
    fields["actuator_biasprm"][:, site.actuator, 2] = -stall * values["kd"]
    set_torque(fields, site, stall)
    set_back_emf(fields, site, per_ampere * values["gear"] * values["torque_constant"] / values["resistance"])
    set_current(fields, site, per_ampere * values["current_limit"])
    fields["dof_armature"][:, site.dof] += values["gear"] ** 2 * values["rotor_inertia"]


def full(values: Mapping[str, float]) -> float:
    current = min(values["voltage"] / values["resistance"], values["current_limit"])
    return values["efficiency"] * values["gear"] * values["torque_constant"] * current


DRIVE = Drive(
    name="dc_motor_servo",
    title="Position servo with a DC motor, gear and current limit",
    physics="A PD law sets the duty cycle up to full duty; supply voltage less back-EMF drives a current through the "
    "winding, up to a limit, and the gear turns the motor's torque into that of the joint.",
    equation="duty = clip(k_p (target - angle) - k_d speed, -1, 1); current = clip((duty V - k_t N speed) / R, -I, I); "
    "torque = eta N k_t current; armature + N^2 rotor inertia",
    parameters=(
        Parameter("kp", "1/rad", 0.01, 1000.0, None, 10.0, "full duty at 0.06 deg to hardly any"),
        Parameter("kd", "s/rad", 0.0, 20.0, None, 0.0, "full duty at 0.05 rad/s; many servos have none"),
        Parameter("voltage", "V", 3.0, 400.0, None, 12.0, "supplies from a toy's battery to a machine's"),
        Parameter("resistance", "ohm", 0.02, 100.0, None, 5.0, "windings of such motors"),
        Parameter(
            "torque_constant", "N m/A", 1e-4, 2.0, None, 0.005, "of the motor itself, without its gear", fixed="unit"
        ),
        Parameter("gear", "1", 1.0, 1e4, None, 200.0, "turns of the motor per turn of the joint; rad per m of a screw"),
        Parameter("efficiency", "1", 0.1, 1.0, None, 0.7, "of the gear, as it loses torque; friction comes on top"),
        Parameter("current_limit", "A", 0.01, 200.0, None, 200.0, "set in the firmware; the largest is none"),
        Parameter(
            "rotor_inertia", "kg m^2", 0.0, 0.01, None, 0.0, "of the motor; 0 where the armature has it", fixed="unit"
        ),
        Parameter("delay", "s", 0.0, 0.05, None, 0.0, "bus and firmware"),
        GOAL_TICK,
        FEEDBACK_TICK,
    ),
    spec=position_servo,
    fields=fields,
    target=target,
    by_duty=True,
    full=full,
    free=("kp", "resistance", "torque_constant", "joint.armature", "delay"),
    loose=("kp", "resistance", "torque_constant", "joint.armature"),
)
