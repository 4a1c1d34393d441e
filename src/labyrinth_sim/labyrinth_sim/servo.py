# SPDX-License-Identifier: Apache-2.0
"""What the drives have in common: a torque-speed line that follows the supply; targets in whole ticks that come late.

MuJoCo does the line natively, by two actuators on the joint. The servo's force range is the torque at rest, S. The
second one is the back-EMF, -B speed with B = S / no-load speed, which that range does not touch; a servo that is to
follow its law until it reaches the line is given B speed on top of it: `clip(law + B speed, -S, S) - B speed`.
"""

import mujoco
import numba

from labyrinth_sim.effect import Parameter, Values
from labyrinth_sim.filters import Delay, rounded
from labyrinth_sim.live import Fields
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array


def position_servo(spec: mujoco.MjSpec, site: Site) -> None:
    """Makes the axis's actuator a servo on angle and speed, with a torque-speed line, limited torque and current."""
    servo = spec.actuator(site.the_axis.actuator)
    servo.set_to_position(kp=1.0, kv=1.0)
    limit_torque(servo)
    add_back_emf(spec, site)
    limit_current(spec, site)


def limit_torque(servo: mujoco.MjsActuator) -> None:
    """Lets an actuator take any target and limits its torque; `set_torque` sets the limit."""
    servo.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
    servo.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
    servo.forcerange = [-1.0, 1.0]


def set_torque(fields: Fields, site: Site, torque: Array) -> None:
    """Sets the largest torque at rest, (nsim,) N m, in either direction."""
    fields["actuator_forcerange"][:, site.actuator, 0] = -torque
    fields["actuator_forcerange"][:, site.actuator, 1] = torque


def limit_current(spec: mujoco.MjSpec, site: Site) -> None:
    """Limits what both of the axis's actuators give together, as a limited current does; `set_current` sets the limit.

    A motor that brakes has back-EMF on its side, and would give more than at rest.
    """
    joint = spec.joint(site.the_axis.joint)
    joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
    joint.actfrcrange = [-1.0, 1.0]


def set_current(fields: Fields, site: Site, torque: Array) -> None:
    """Sets the torque at the largest current, (nsim,) N m, in either direction."""
    fields["jnt_actfrcrange"][:, site.joint, 0] = -torque
    fields["jnt_actfrcrange"][:, site.joint, 1] = torque


@numba.njit  # type: ignore[untyped-decorator]
def asked(gain: Array, bias: Array, control: float, angle: float, speed: float, emf: float) -> float:
    """N m that a servo's law asks for, its range aside; for laws of effects.

    Args:
        gain, bias: (10,) of its actuator.
        emf: N m s/rad of back-EMF (negative) where that counts, too.
    """
    return float(gain[0] * control + bias[0] + bias[1] * angle + (bias[2] + emf) * speed)


BACK_EMF = Parameter(
    "back_emf",
    "s/rad",
    0.0,
    1.0,
    0.0,
    0.0,
    "share of the torque that each rad/s takes, 1 over the no-load speed; 0 is none, small servos have 0.1 to 0.3",
)


def add_back_emf(spec: mujoco.MjSpec, site: Site) -> None:
    """Gives the axis its second actuator; `set_back_emf` sets its strength."""
    axis = site.the_axis
    emf = spec.add_actuator(
        name=f"{axis.actuator}_emf", target=axis.joint, trntype=mujoco.mjtTrn.mjTRN_JOINT, group=site.group
    )
    emf.set_to_velocity(kv=1.0)
    emf.gainprm[0] = 0.0


def back_emf_actuator(site: Site) -> int:
    """Index of the axis's second actuator, -1 for a drive that has none."""
    return next((i for i in site.actuators if i != site.actuator), -1)


def set_back_emf(fields: Fields, site: Site, slope: Array) -> None:
    """Sets what back-EMF takes of the torque, (nsim,) N m s/rad."""
    fields["actuator_biasprm"][:, back_emf_actuator(site), 2] = -slope


GOAL_TICK = Parameter("goal_tick", "rad", 0.0, 0.05, None, 0.0, "the goal register's, from its data sheet; 0 is none")

FEEDBACK_TICK = Parameter(
    "feedback_tick",
    "rad",
    0.0,
    0.05,
    None,
    0.0,
    "of the servo's own encoder, from its data sheet: the law sees whole ticks of the angle; 0 is none",
)


class Target:
    """The filter of a target that a servo takes in whole ticks, (nsim,) rad, and late."""

    def __init__(self, tick: Array, delay: Delay | None) -> None:
        self.tick, self.delay = tick, delay

    def __call__(self, own: Array, every: Array) -> Array:
        goal = rounded(own, self.tick)
        return self.delay(goal, every) if self.delay else goal


def target(values: Values, site: Site, step: float, start: Array) -> Target | None:
    """The filter by the parameters `goal_tick`, rad, and `delay`, s; None where both are 0."""
    late = Delay(values["delay"], step, start) if values["delay"].any() else None
    return Target(values["goal_tick"], late) if late or values["goal_tick"].any() else None
