# SPDX-License-Identifier: Apache-2.0
"""What a servo gives near its limit, over a step of a roll-out.

MuJoCo limits what a servo asks for as a step begins. Within the limit it takes the servo's damping at the speed with
which the step ends, which gives much less; so near the limit the torque of a step jumps with the time at which the step
begins. A control that steps within a step of MuJoCo's asks for its mean, and a servo gives all it has for that even if
most of the step was over before. Neither error shrinks smoothly with the steps, so neither can be extrapolated.

Here a servo is limited by what it asks for at the end of a step, and before and after a control's step, each for its
share. What differs from what MuJoCo gives acts as an additional torque, which is exactly 0 away from the limit.

Roll-outs that stand for a model as it runs step by step keep MuJoCo's own limit, at the beginning of a step; there only
a control's step is split.
"""

from labyrinth_sim.law import law, state
from labyrinth_sim.servo import asked

PER_TORQUE, SHARE, PART, BEFORE, MEAN = range(5)  # what `limit` finds in `values`
SPEED, GAVE, LIMITED, LOW, HIGH, BEGUN = range(6)  # and keeps in `memory`, of the last step

BEGINNING, END = 0, 1  # of a step: when a drive asks for what limits it
LEAST = 0.1  # of the divisor by damping, where the law of a drive pushes its moving joint on


@law
def limit(raw: int) -> None:
    """Adds what is missing of a drive's torque.

    Its values are the acceleration of its joint by a torque, 0 for MuJoCo's own limits; then, of a control that steps,
    the share of the step that is left after it, how far it counts, and by how much it is before and in the mean beside
    what the drive is given.
    """
    s = state(raw)
    if s.error[s.channel] != s.error[s.channel]:  # it is no number where the drive is off
        s.memory[BEGUN] = 0.0
        return
    bias, second, gain = s.act_bias[s.drive], s.drives[s.channel, 3], s.gain[s.drive, 0]
    speed, damping = s.qvel[s.dof], -bias[2]
    low, high = s.limits[s.drive, 0], s.limits[s.drive, 1]
    if s.joint_limits[s.joint, 1] > 0.0:  # what limits both of its actuators together
        emf = s.act_bias[second, 2] * speed if second >= 0 else 0.0
        low, high = max(low, s.joint_limits[s.joint, 0] - emf), min(high, s.joint_limits[s.joint, 1] - emf)
    wanted = asked(s.gain[s.drive], bias, s.ctrl[s.drive], s.qpos[s.angle], speed, 0.0)
    per_torque = s.step * s.values[PER_TORQUE]
    free = 0.0  # by how much all else changes the speed; as in the last step
    if s.memory[BEGUN] > 0.0 and per_torque > 0.0:
        gained = speed - s.memory[SPEED]
        gave = s.memory[GAVE] if s.memory[LIMITED] > 0.0 else s.memory[GAVE] - damping * gained
        free = gained - per_torque * gave
    coming, less = wanted - damping * free, max(1.0 + per_torque * damping, LEAST)
    part, share = s.values[PART], s.values[SHARE]
    own = min(max((coming + gain * s.values[MEAN]) / less, low), high)
    if part > 0.0:  # effects on its limits were told what is asked for after the step, and before it in the last one
        before = min(max((coming + gain * s.values[BEFORE]) / less, s.memory[LOW]), s.memory[HIGH])
        after = min(max(coming / less, low), high)
        own = part * (share * after + (1.0 - share) * before) + (1.0 - part) * own
    s.memory[LOW], s.memory[HIGH] = low, high
    within = low < wanted < high
    s.memory[SPEED], s.memory[BEGUN] = speed, 1.0
    if part == 0.0 and within and low < own < high:
        s.memory[GAVE], s.memory[LIMITED] = wanted, 0.0
        return
    s.memory[GAVE], s.memory[LIMITED] = own, 1.0
    given = wanted - damping * (free + per_torque * own) if within else min(max(wanted, low), high)
    s.applied[s.dof] += own - given
