# SPDX-License-Identifier: Apache-2.0
"""The position servo that a robot's model has at a joint: its gains, and how well it moves as was recorded."""

import copy
from dataclasses import dataclass

import mujoco
import numpy as np

from eps_tunnel_analysis.new_rig.joints import Robot, Sampled
from labyrinth_sim.trials import Array

FROZEN = 1e6  # kg m^2 or kg, with which the other joints stay where they are


@dataclass(frozen=True)
class OwnServo:
    """A `position` actuator, seen from the joint.

    Attributes:
        stiffness: N m/rad (N/m); `damping`: N m s/rad (N s/m).
        gear: radians (m) of its target for one of the joint.
    """

    stiffness: float
    damping: float
    gear: float


def own_servo(robot: Robot, joint: str) -> OwnServo | None:
    """The model's position servo at a joint; None where it has none."""
    name, mj = robot.actuators.get(joint), robot.mj
    if name is None:
        return None
    number = mj.actuator(name).id
    kinds = int(mj.actuator_gaintype[number]), int(mj.actuator_biastype[number])
    kp, gear = float(mj.actuator_gainprm[number, 0]), float(mj.actuator_gear[number, 0])
    _, own, speed = (float(v) for v in mj.actuator_biasprm[number, :3])
    linear = (int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtBias.mjBIAS_AFFINE))
    prompt = int(mj.actuator_dyntype[number]) == int(mujoco.mjtDyn.mjDYN_NONE)
    if not prompt or kinds != linear or kp <= 0.0 or not np.isclose(own, -kp) or speed > 0.0 or gear == 0.0:
        return None
    return OwnServo(kp * gear**2, -speed * gear**2, gear)


def misses(robot: Robot, joint: str, servo: OwnServo, s: Sampled, scale: float, zero: float) -> float:
    """Standard deviation of what a model with its own servo misses of a recording, the other joints held, as a share of
    how far the target moves; infinite where it diverges or nothing was commanded.

    Args:
        scale, zero: rad or m per recorded unit of position, and the recorded zero.
    """
    target, position = (scale * (x - zero) for x in (s.target, s.position))
    good = np.isfinite(target) & np.isfinite(position)
    moved = float(np.std(target[good])) if good.any() else 0.0
    if moved == 0.0:
        return float("inf")
    simulated = _moved(robot, joint, servo.gear * np.interp(s.time, s.time[good], target[good]), position[good][0], s)
    off = simulated[good] - position[good]
    return float(np.std(off)) / moved if np.isfinite(off).all() else float("inf")


def _moved(robot: Robot, joint: str, targets: Array, start: float, s: Sampled) -> Array:
    """(T,) position of a joint under an actuator's targets (T,), each held for a sample."""
    mj = copy.copy(robot.mj)
    at, number = mj.joint(joint), mj.actuator(robot.actuators[joint]).id
    others = np.arange(mj.nv) != int(at.dofadr[0])
    mj.dof_armature[others] = FROZEN
    mj.actuator_ctrllimited[:] = 0
    mj.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    step = float(s.time[1] - s.time[0])
    each = max(1, round(step / mj.opt.timestep))
    mj.opt.timestep = step / each
    data = mujoco.MjData(mj)
    data.qpos[int(at.qposadr[0])] = start
    seen = np.empty(len(targets))
    for i, goal in enumerate(targets):
        seen[i] = data.qpos[int(at.qposadr[0])]
        data.ctrl[number] = goal
        for _ in range(each):
            mujoco.mj_step(mj, data)
    return seen
