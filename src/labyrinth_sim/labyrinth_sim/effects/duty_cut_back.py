# SPDX-License-Identifier: Apache-2.0
"""Duty cut back under stall: the limit of MuJoCo's servo, or of what its joint gets, rewritten before every step."""

import numba

from labyrinth_sim.effect import Effect, Parameter
from labyrinth_sim.law import law, state
from labyrinth_sim.servo import asked


@numba.njit  # type: ignore[untyped-decorator]
def _part_cut(beyond: float, then: float, lasted: float, time: float, step: float) -> float:
    """Share of a step in which the duty is cut, if what is asked for moves from `beyond` the bound to `then`.

    Args:
        lasted: s, for which it has been beyond the bound when the step begins.
        time: s, for which it has to be.
    """
    begins, ends = 0.0, 1.0
    if beyond < 0.0:
        if then <= 0.0:
            return 0.0
        begins = beyond / (beyond - then)
    elif then < 0.0:
        ends = beyond / (beyond - then)
    return max(ends - max(begins, begins + (time - lasted) / step), 0.0)


@law
def step(raw: int) -> None:
    s = state(raw)
    share, bound, time = s.values[0], s.values[1], s.values[2]
    bias, full = s.base_bias[s.drive], s.base_limits[s.drive, 1]
    second, by_duty = s.drives[s.channel, 3], s.drives[s.channel, 4]
    # What a drive that regulates its torque asks for is what it gives together with back-EMF.
    emf = s.base_bias[second, 2] if second >= 0 and by_duty == 0 else 0.0
    gain, angle, speed, command = s.base_gain[s.drive], s.qpos[s.angle], s.qvel[s.dof], s.ctrl[s.drive]
    beyond = abs(asked(gain, bias, command, angle, speed, emf)) - bound * full
    if s.error[s.channel] != s.error[s.channel]:  # it is no number where the drive is off
        beyond = -bound * full
    # During a step it moves steadily, and where the command steps it jumps.
    before, arrived, begun = beyond, beyond, s.memory[3] > 0.0
    if begun:
        before = s.memory[1]
        arrived = abs(asked(gain, bias, s.memory[2], angle, speed, emf)) - bound * full
    # When it crosses the bound, and when the time is over, is found within a step. Otherwise a small change of either
    # would do nothing, or move the cut by a whole step.
    if beyond < 0.0 or arrived < 0.0 or not begun:
        lasted = 0.0
    elif before < 0.0:
        lasted = s.step * arrived / (arrived - before)
    else:
        lasted = s.memory[0] + s.step
    s.memory[0], s.memory[1], s.memory[2], s.memory[3] = lasted, beyond, command, 1.0
    cut = _part_cut(beyond, beyond + arrived - before, lasted, time, s.step)
    if cut > 0.0:
        left = 1.0 - cut * (1.0 - share)
        for k in range(2):
            if by_duty or s.joint_limits[s.joint, 1] <= 0.0:
                s.limits[s.drive, k] *= left
            else:
                s.joint_limits[s.joint, k] *= left


EFFECT = Effect(
    name="duty_cut_back",
    title="Duty cut back under stall",
    physics="The firmware protects the motor: after it has requested a large part of the full duty for some time, it "
    "limits the duty to a small share until it requests less. A firmware that regulates the current limits that "
    "instead.",
    equation="|duty| <= s while |duty asked for| >= b for longer than T; of a drive that regulates its torque, torques "
    "in place of duties, as shares of the largest",
    parameters=(
        Parameter("share", "1", 0.002, 1.0, 1.0, 0.25, "protective torque in the firmware: next to none, to no cut"),
        Parameter(
            "bound",
            "1",
            0.002,
            1.0,
            None,
            0.4,
            "overload torque in the firmware; Feetech's default is 0.8",
            begin=(0.006, 0.02, 0.06, 0.2, 0.5, 0.9),
            abrupt=True,
        ),
        Parameter(
            "time",
            "s",
            0.0,
            3.0,
            None,
            0.0,
            "protection time in the firmware; Feetech's default is 2 s",
            begin=(0.0, 0.02, 0.1, 0.5, 2.0),
            abrupt=True,
        ),
    ),
    stage="force",
    mark="Large steps and heavy loads stop half-way: the axis sinks back or creeps; small motions are unchanged.",
    shows="passing",
    confused_with=(
        "torque_saturation",
        "supply_sag",
        "rate_limit",
        "motion_profile",
        "command_delay",
        "load_friction",
    ),
    contains=(
        ("share", "torque_saturation", "share"),
        ("bound", "torque_saturation", "share"),
        ("time", "torque_saturation", 0.0),
    ),
    separated_by="Steps of growing size under load: saturation slows all large ones alike, the cut-back makes those "
    "beyond its bound slower than those just below.",
    touches=("actuator_gainprm", "actuator_biasprm", "actuator_forcerange", "jnt_actfrcrange"),
    step=step,
)
