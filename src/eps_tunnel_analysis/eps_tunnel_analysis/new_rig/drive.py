# SPDX-License-Identifier: Apache-2.0
"""Which kind of drive a joint's recordings suggest, and which values to start from.

If an effort is recorded, the law is fitted to it: effort = K (target - angle) - C speed, which is linear. If none
is, but the joint stays behind its target in proportion to its weight, the drive sags like a P control of the duty
cycle. Otherwise a first-order and a second-order response to the commands are fitted, and the better one decides. Where
the model's own position servo matches the recording better than these, its gains are taken.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.optimize import least_squares

from eps_tunnel_analysis.new_rig.joints import Robot, Sampled
from eps_tunnel_analysis.new_rig.own_servo import OwnServo, misses, own_servo
from labyrinth_sim.build import inertia_at_rest
from labyrinth_sim.trials import Array

LAW = 0.9  # share of the effort's variance that a straight law explains, from which it is one
ANSWERS = 4  # recordings on which orders are fitted, at most, and
FITTED = 1500  # samples on which orders are fitted
SEVERAL = 3  # recordings, that show the same law together though none of them does alone:
ROUGH_LAW = 0.6  # share that it explains of each one's effort, and
AGREE = 1.15  # times the smallest gain, within which all lie
YIELDS = 0.5  # share of what else the error leaves that the weight explains, from which the drive gives way to it
BETTER = 0.8  # of the first order's error, at most, for the second to be worth its values
LARGEST_P = 25.0  # 1/s, of velocity_pid's P
DELAYS = (0.0, 0.01, 0.02, 0.03, 0.05)  # s
ROUND = 3  # digits of proposed values
INERTIA = (
    0.4  # share of the effort's variance that the model's own inverse dynamics explains, for its unit to be inferred
)
DUTY_GAIN = 0.01  # 1/rad; only its product with kp is known
STALL = 3.0  # times the largest load of gravity, that full duty gives
SAMPLES_OF_A_LAW = 20  # samples that are enough for a law
UNSEEN = 5.0  # times the largest effort, of a limit that the recordings do not show
ROOM = 2.0  # of a drive's torque over what the recorded motion needs
SAME_UNIT = 1.33  # times what it gives, up to which the effort is in that unit


@dataclass(frozen=True)
class Proposed:
    """A proposed value: SI, its unit, and why."""

    value: float
    unit: str
    why: str


@dataclass(frozen=True)
class DriveProposal:
    """Kind of drive and its values by name, the effort's unit ("" where none is recorded), each with a reason.

    Attributes:
        gains: kp of each recording, of a drive by duty cycle.
        factor: N m (N) per recorded unit of effort, where it is not stated and the law determines it.
    """

    kind: str
    why: str
    values: dict[str, Proposed]
    effort: str
    effort_why: str
    gains: tuple[float, ...] = ()
    factor: float | None = None


def effort_unit(robot: Robot, joint: str, samples: Sequence[Sampled], scale: float, zero: float) -> tuple[str, str]:
    """Unit of a recorded effort and why: "" where there is none.

    Args:
        scale, zero: rad or m per recorded unit of position, and the recorded zero.
    """
    efforts = np.concatenate([s.effort for s in samples])
    seen = efforts[np.isfinite(efforts)]
    si = "N" if _slides(robot, joint) else "N m"
    if not len(seen) or np.ptp(seen) == 0.0:
        return "", "none recorded"
    most = float(np.abs(seen).max())
    others = f'if it is a torque, say --effort-unit "{si}"; if a current, --effort-unit A'
    duty = 0.05 < most <= 1.0 and not np.allclose(seen, np.round(seen))
    if duty and (damped := _damped(samples, scale, zero)):
        return si, f"{damped}; if it is a current, say --effort-unit A"
    if duty and most > 0.999:
        return "duty", f"it never exceeds 1 and reaches it; {others}"
    explained, factor = _inverse(robot, joint, samples, scale, zero)
    if explained > INERTIA and 1.0 / SAME_UNIT < factor < SAME_UNIT:
        return (
            si,
            f"the model's own inverse dynamics gives {factor:.2g} times as much, and explains {explained:.0%} of it",
        )
    share, k, *_ = _laws(samples, scale, zero)
    if share > 0.0:
        moved = inertia_of(robot, joint)[0] * _orders(samples, scale, zero)[1][1] ** 2
        if 1.0 / SAME_UNIT < k / max(moved, 1e-300) < SAME_UNIT:
            rad = "m" if _slides(robot, joint) else "rad"
            return si, f"its stiffness, {k:.3g} {si}/{rad}, is that with which the model's inertia moves, {moved:.3g}"
    if duty:
        return "duty", f"never beyond 1 (at most {most:.3g}), and not what the model's inverse dynamics gives; {others}"
    counts = " in whole numbers" if np.allclose(seen, np.round(seen)) else ""
    return (
        "raw",
        f"up to {most:.4g}{counts}, which is not the model's {si}; write A with torque_constant if it is a current",
    )


def _damped(samples: Sequence[Sampled], scale: float, zero: float) -> str:
    """Why an effort is the whole torque on the joint: it is a law of error and speed that damps as the joint's motion
    is damped; "" if it is not. A duty does not include the damping by back-EMF.
    """
    share, k, c, _ = _laws(samples, scale, zero)
    if share <= 0.0 or c <= 0.0:
        return ""
    _, frequency, ratio, _ = _orders(samples, scale, zero)[1]
    moved = 2.0 * ratio / frequency
    if not 1.0 / SAME_UNIT < c / k / moved < SAME_UNIT:
        return ""
    return (
        f"a linear law of error and speed explains {share:.0%} of it, and damps the joint as it moves: damping over "
        f"stiffness is {c / k:.3g} s in the law and {moved:.3g} s in the motion"
    )


def _inverse(robot: Robot, joint: str, samples: Sequence[Sampled], scale: float, zero: float) -> tuple[float, float]:
    """Share of the effort that is explained by the torque needed for the motion, and the factor between them."""
    mj, data = robot.mj, mujoco.MjData(robot.mj)
    at = robot.mj.joint(joint)
    need, have = [], []
    for s in samples[:3]:
        q, v, a = derivatives(s, scale, zero)
        for k in range(0, len(q), max(1, len(q) // 1000)):
            if not np.isfinite(q[k] + v[k] + a[k] + s.effort[k]):
                continue
            data.qpos[:], data.qvel[:], data.qacc[:] = mj.qpos0, 0.0, 0.0
            data.qpos[int(at.qposadr[0])], data.qvel[int(at.dofadr[0])] = q[k], v[k]
            data.qacc[int(at.dofadr[0])] = a[k]
            mujoco.mj_inverse(mj, data)
            need.append(float(data.qfrc_inverse[int(at.dofadr[0])]))
            have.append((float(s.effort[k]), float(v[k])))
    if len(need) < 20:
        return 0.0, 1.0
    x, (y, speed) = np.array(need), np.array(have).T
    if np.ptp(x) < 1e-12:
        return 0.0, 1.0
    # Friction is no part of the model yet, so it may take its share.
    columns = np.column_stack([x, np.sign(speed), speed, np.ones_like(x)])
    best = np.linalg.lstsq(columns, y, rcond=None)[0]
    own = best[0] * (x - x.mean())
    return float(np.clip(np.var(own) / max(float(np.var(y)), 1e-300), 0.0, 1.0)), float(best[0])


def _needed(robot: Robot, joint: str, samples: Sequence[Sampled], scale: float, zero: float) -> float:
    """N m (N) that the recorded motion needs in 99 % of the time, by the model's inertia and weight."""
    mj, data = robot.mj, mujoco.MjData(robot.mj)
    at = robot.mj.joint(joint)
    inertia, _ = inertia_of(robot, joint)
    taken = []
    for s in samples:
        q, _, a = derivatives(s, scale, zero)
        for k in range(0, len(q), max(1, len(q) // 200)):
            if np.isfinite(q[k] + a[k]):
                data.qpos[:] = mj.qpos0
                data.qpos[int(at.qposadr[0])] = q[k]
                mujoco.mj_forward(mj, data)
                taken.append(abs(inertia * float(a[k]) + float(data.qfrc_bias[int(at.dofadr[0])])))
    return float(np.quantile(taken, 0.99)) if taken else 0.0


def derivatives(s: Sampled, scale: float, zero: float) -> tuple[Array, Array, Array]:
    """Position, speed and acceleration in SI, smoothed over about 50 ms."""
    from scipy.signal import savgol_filter

    q = scale * (s.position - zero)
    step = float(s.time[1] - s.time[0]) if len(s.time) > 1 else 0.01
    window = max(5, 2 * round(0.03 / step) + 1)
    if len(q) <= window or not np.isfinite(q).any():
        return q, np.zeros_like(q), np.zeros_like(q)
    filled = np.interp(s.time, s.time[np.isfinite(q)], q[np.isfinite(q)])
    v, a = (savgol_filter(filled, window, 3, deriv=d, delta=step) for d in (1, 2))
    return q, v, a


def _slides(robot: Robot, joint: str) -> bool:
    return int(robot.mj.joint(joint).type[0]) == int(mujoco.mjtJoint.mjJNT_SLIDE)


def propose_drive(
    robot: Robot, joint: str, samples: Sequence[Sampled], scale: float, zero: float, unit: str, unit_why: str
) -> DriveProposal:
    """A kind of drive for a joint; see the module.

    Args:
        scale, zero: of recorded positions, as in `effort_unit`.
        unit: of the effort.
    """
    n, rad = ("N", "m") if _slides(robot, joint) else ("N m", "rad")
    effort = np.concatenate([s.effort for s in samples])
    most = float(np.nanmax(np.abs(effort), initial=0.0))
    inertia, load = inertia_of(robot, joint)
    limit, limit_why = _model_torque(robot, joint)
    stall = limit or STALL * load or 1.0
    stall_why = limit_why or f"so that full duty gives {STALL:g} times the largest load; to be fitted"
    share, k, c, limited = _laws(samples, scale, zero) if unit else (0.0, 0.0, 0.0, False)
    straight = share > 0.0
    if straight:
        line = f"{k:.4g} (target - position) {'-' if c > 0 else '+'} {abs(c):.3g} speed"
        explanation = f"effort = {line} explains {share:.1%} of it"
        if unit == "duty":
            gains = tuple(_law([s], scale, zero)[1] / DUTY_GAIN for s in samples)
            kp = Proposed(_round(k / DUTY_GAIN), "1", f"read from the recordings: {explanation}")
            values = _duty_values(kp, stall, stall_why, n, rad)
            return DriveProposal("pwm_servo", f"duty follows the error: {explanation}", values, unit, unit_why, gains)
        if unit == n:
            torque = most if limited else 1.2 * most
            values = {
                "stiffness": Proposed(_round(k), f"{n}/{rad}", f"read from the recordings: {explanation}"),
                "damping": Proposed(_round(max(c, 0.0)), f"{n} s/{rad}", "the same line"),
                "torque": Proposed(
                    _round(limit if limit and not limited else torque), n,
                    "the largest recorded effort, where it is clipped" if limited
                    else limit_why or "a fifth beyond the largest recorded effort",
                ),
                "delay": Proposed(0.0, "s", "to be fitted"),
            }  # fmt: skip
            return DriveProposal("torque_pd", f"effort is a PD law on the error: {explanation}", values, unit, unit_why)
    first, second = _orders(samples, scale, zero)
    servo = None if straight else own_servo(robot, joint)
    if servo is not None:
        response = min(first[0], second[0])
        left = misses(robot, joint, servo, max(samples, key=_life), scale, zero)
        if left < response:
            within, effort_is = (limit, limit_why), (unit, unit_why)
            return _of_servo(servo, left / response, within, _error(samples, scale), effort_is, n, rad)
    if not unit:
        share, gives_way = _yielding(robot, joint, samples, scale, zero)
        if share > YIELDS:
            by = f"{gives_way:.3g} {n}/{rad}"
            explanation = f"it sags under its weight by {by}, which explains {share:.0%} of what speed does not"
            kp = Proposed(_round(gives_way / DUTY_GAIN / stall), "1", "so that full duty times it is that")
            values = _duty_values(kp, stall, stall_why, n, rad)
            return DriveProposal("pwm_servo", explanation, values, unit, unit_why)
    ratio = second[0] / max(first[0], 1e-300)
    if ratio < BETTER or straight or first[1] > 0.9 * LARGEST_P:
        frequency, damping = second[1], second[2]
        stiffness = inertia * frequency**2
        torque, torque_why = limit, limit_why
        if not torque:
            asked = stiffness * _error(samples, scale)
            torque = max(min(asked, ROOM * _needed(robot, joint, samples, scale, zero)), 1.5 * load, 1e-3)
            torque_why = "twice what the recorded motion needs; to be checked against the data sheet"
            if torque == asked:
                torque_why = "the torque of that stiffness at the largest error; to be checked against the data sheet"
        if straight:
            torque = limit or stiffness * most / k * (1.0 if limited else UNSEEN)
            torque_why = limit_why or (
                "the largest recorded effort in terms of that stiffness, where it is clipped" if limited
                else f"{UNSEEN:g} times the largest recorded effort in terms of that stiffness, because it is never "
                "clipped"
            )  # fmt: skip
        why = (
            "its effort is a PD law on the error" if straight
            else f"a second-order response matches the recording with {ratio:.0%} of a first-order response's error"
            if ratio < BETTER else "it follows faster than a speed loop does"
        )  # fmt: skip
        reason = f"inertia {inertia:.3g} at the model's pose times {frequency:.3g} 1/s squared"
        values = {
            "stiffness": Proposed(_round(stiffness), f"{n}/{rad}", reason),
            "damping": Proposed(
                _round(2.0 * damping * frequency * inertia), f"{n} s/{rad}", f"damping ratio {damping:.2g}"
            ),
            "torque": Proposed(_round(torque), n, torque_why),
            "delay": Proposed(min(second[3], 0.05), "s", "of that response"),
        }
        factor = stiffness / k if straight else None
        return DriveProposal("torque_pd", why, values, unit, unit_why, factor=factor)
    p = min(first[1], 0.95 * LARGEST_P)
    torque = limit or max(2.0 * load, 10.0 * inertia, 1e-3)
    values = {
        "p": Proposed(_round(p), "1/s", "of the first-order response"),
        "i": Proposed(0.0, "1/s^2", "none is seen"),
        "d": Proposed(0.0, "1/s", "none is seen"),
        "delay": Proposed(min(first[2], 0.05), "s", "of that response"),
        "speed_gain": Proposed(_round(max(20.0 * inertia, 1e-3)), f"{n} s/{rad}", "so that the speed settles in 50 ms"),
        "torque": Proposed(
            _round(torque), n, limit_why or "enough for twice the load; to be checked against the data sheet"
        ),
    }
    return DriveProposal(
        "velocity_pid",
        f"a first-order response matches the recording; a second-order one leaves {ratio:.0%} of its error",
        values,
        unit,
        unit_why,
    )


def _of_servo(
    servo: OwnServo, share: float, limit: tuple[float, str], error: float, unit: tuple[str, str], n: str, rad: str
) -> DriveProposal:
    """The drive that the model has.

    Args:
        share: of what a linear response leaves, that it leaves.
        limit: of its torque, 0 if it has none, and `unit` of its effort, each with a reason.
        error: rad (m), the largest in the recordings.
    """
    values = {
        "stiffness": Proposed(servo.stiffness, f"{n}/{rad}", "the actuator's kp in the model"),
        "damping": Proposed(servo.damping, f"{n} s/{rad}", "the actuator's kv in the model"),
        "torque": Proposed(
            limit[0] or _round(max(UNSEEN * servo.stiffness * error, 1e-3)), n,
            limit[1] or f"{UNSEEN:g} times what its stiffness gives at the largest error, because the model states no "
            "limit",
        ),
        "delay": Proposed(0.0, "s", "to be fitted"),
    }  # fmt: skip
    why = f"the model's own position servo matches the recording with {share:.0%} of a linear response's error"
    return DriveProposal("torque_pd", why, values, *unit)


def _duty_values(kp: Proposed, stall: float, why: str, n: str, rad: str) -> dict[str, Proposed]:
    """Values of a drive by duty cycle with the gain `kp`, per DUTY_GAIN, and `stall` N m (N) at full duty."""
    return {
        "kp": kp,
        "duty_gain": Proposed(DUTY_GAIN, f"1/{rad}", "a scale, so that kp is near those of registers"),
        "voltage": Proposed(12.0, "V", "a usual supply; only voltage over resistance matters"),
        "resistance": Proposed(5.0, "ohm", "a usual winding; to be fitted"),
        "torque_constant": Proposed(
            _round(stall * 5.0 / 12.0),
            f"{n}/A",
            why,
        ),
        "delay": Proposed(0.0, "s", "to be fitted"),
    }


def _yielding(robot: Robot, joint: str, samples: Sequence[Sampled], scale: float, zero: float) -> tuple[float, float]:
    """Share of the remaining error that the weight explains, and the stiffness with which the drive carries it,
    N m/rad (N/m): the median of the recordings whose error (target - angle) a linear law explains.

    error = (inertia acceleration + weight) / K + c speed + f sign(speed): the error of a P control of the duty cycle.
    """
    mj, data = robot.mj, mujoco.MjData(robot.mj)
    at = robot.mj.joint(joint)
    found, inertia = [], inertia_of(robot, joint)[0]
    for s in samples:
        q, v, a = derivatives(s, scale, zero)
        error = scale * (s.target - zero) - q
        rows = np.flatnonzero(np.isfinite(error))
        weight = np.zeros(len(rows))
        for i, row in enumerate(rows):
            data.qpos[:] = mj.qpos0
            data.qpos[int(at.qposadr[0])] = q[row]
            mujoco.mj_forward(mj, data)
            weight[i] = data.qfrc_bias[int(at.dofadr[0])]
        if len(rows) < SAMPLES_OF_A_LAW or np.ptp(weight) == 0.0:
            continue
        others = np.column_stack([inertia * a, v, np.sign(v), np.ones_like(v)])[rows]
        columns = np.column_stack([weight, others])
        slope = float(np.linalg.lstsq(columns, error[rows], rcond=None)[0][0])
        residual, without = (float(np.var(_beside(c, error[rows]))) for c in (columns, others))
        if slope > 0.0 and residual < (1.0 - LAW) * float(np.var(error[rows])):
            found.append((1.0 - residual / without, 1.0 / slope))
    if len(found) < len(samples) / 3:
        return 0.0, 0.0
    return float(np.median([share for share, _ in found])), float(np.median([k for _, k in found]))


def _beside(columns: Array, wanted: Array) -> Array:
    """Residual of `wanted` after a linear fit in `columns`."""
    return np.asarray(wanted - columns @ np.linalg.lstsq(columns, wanted, rcond=None)[0])


def _error(samples: Sequence[Sampled], scale: float) -> float:
    return float(max(np.nanmax(np.abs(scale * (s.target - s.position)), initial=0.0) for s in samples))


def _laws(samples: Sequence[Sampled], scale: float, zero: float) -> tuple[float, float, float, bool]:
    """As `_law`, of the recordings one by one, because they may have been made with different gains; a share of 0
    unless a third of them show a law, or all of them roughly the same one. Steps alone do not: the sample logged at a
    jump belongs to the time before it. Where ticks are a large part of the error no single recording may.
    """
    laws = [_law([s], scale, zero) for s in samples]
    good = [law for law in laws if law[0] > LAW and law[1] > 0.0]
    if len(laws) >= SEVERAL and all(law[0] > ROUGH_LAW and law[1] > 0.0 for law in laws):
        gains = [law[1] for law in laws]
        good = laws if max(gains) < AGREE * min(gains) else good
    if len(good) < len(laws) / 3:
        return 0.0, 0.0, 0.0, False
    return float(np.median([law[0] for law in good])), good[0][1], good[0][2], any(law[3] for law in laws)


def _law(samples: Sequence[Sampled], scale: float, zero: float) -> tuple[float, float, float, bool]:
    """Share of the effort explained by K error - C speed, K, C, and whether the effort is clipped at its largest."""
    rows, efforts = [], []
    for s in samples:
        q, v, _ = derivatives(s, scale, zero)
        error = scale * (s.target - zero) - q
        good = np.isfinite(error) & np.isfinite(s.effort)
        rows.append(np.column_stack([error, -v])[good])
        efforts.append(s.effort[good])
    columns, effort = np.concatenate(rows), np.concatenate(efforts)
    if len(effort) < 20 or np.ptp(effort) == 0.0:
        return 0.0, 0.0, 0.0, False
    most = float(np.abs(effort).max())
    at_most = np.abs(effort) > 0.999 * most
    limited = float(np.mean(at_most)) > 0.005
    free = ~at_most if limited else np.ones(len(effort), dtype=bool)
    best = np.linalg.lstsq(columns[free], effort[free], rcond=None)[0]
    residual = effort[free] - columns[free] @ best
    share = 1.0 - float(np.var(residual)) / max(float(np.var(effort[free])), 1e-300)
    return share, float(best[0]), float(best[1]), limited


def _orders(samples: Sequence[Sampled], scale: float, zero: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """(error, P, delay) of the best first-order response; (error, frequency, damping ratio, delay) of the best
    second-order response."""
    lively = sorted(samples, key=_life, reverse=True)
    # A saturated or switched-off drive does not respond linearly, and slow motion does not show the order. So take the
    # recording where a second-order response is better than a first-order one by most, or else the best matched one.
    fits = [_orders_of(s, scale, zero) for s in lively[:: max(1, len(lively) // ANSWERS)][:ANSWERS]]
    clearest = min(fits, key=lambda orders: orders[1][0] / max(orders[0][0], 1e-300))
    if clearest[1][0] < BETTER * clearest[0][0]:
        return clearest
    return min(fits, key=lambda orders: min(orders[0][0], orders[1][0]))


def _life(s: Sampled) -> float:
    """How far the target moves, as recorded."""
    return float(np.nan_to_num(np.nanstd(s.target)))


def _orders_of(s: Sampled, scale: float, zero: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """The same of one recording; errors are relative to how far its target moves."""
    step = float(s.time[1] - s.time[0])
    every = max(1, round(0.005 / step))
    u, q = (scale * (x[::every] - zero) for x in (s.target, s.position))
    step *= every
    good = np.isfinite(u) & np.isfinite(q)
    end = int(np.argmin(good)) if not good.all() else len(good)
    u, q = (u, q) if end == 0 else (u[:end], q[:end])
    u, q = np.nan_to_num(u[:FITTED]), np.nan_to_num(q[:FITTED])
    if len(q) < 20 or np.ptp(u) == 0.0:
        return (1.0, 10.0, 0.0), (1.0, 20.0, 1.0, 0.0)

    def late(delay: float) -> Array:
        back = round(delay / step)
        return np.concatenate([np.full(back, u[0]), u[: len(u) - back]]) if back else u

    moved = float(np.std(u))

    def left(answer: Array) -> Array:
        return np.asarray(answer - q - np.mean(answer - q)) / moved

    def first(p: float, delay: float) -> Array:
        from scipy.signal import lfilter

        keep = np.exp(-p * step)
        return np.asarray(lfilter([0.0, 1.0 - keep], [1.0, -keep], late(delay) - q[0])) + q[0]

    def second(frequency: float, ratio: float, delay: float) -> Array:
        from scipy.signal import cont2discrete, lfilter

        b, a, _ = cont2discrete(
            (np.array([frequency**2]), np.array([1.0, 2.0 * ratio * frequency, frequency**2])), step
        )
        return np.asarray(lfilter(b[0], a, late(delay) - q[0])) + q[0]

    ones, twos = [], []
    for delay in DELAYS:

        def one_left(x: Array, delay: float = delay) -> Array:
            return left(first(float(np.exp(x[0])), delay))

        def two_left(x: Array, delay: float = delay) -> Array:
            return left(second(float(np.exp(x[0])), float(np.exp(x[1])), delay))

        one = least_squares(one_left, [2.3], bounds=([-2.0], [5.0]))
        ones.append((float(np.std(one.fun)), float(np.exp(one.x[0])), delay))
        two = least_squares(two_left, [3.0, 0.0], bounds=([0.0, -3.0], [6.0, 2.0]))
        twos.append((float(np.std(two.fun)), float(np.exp(two.x[0])), float(np.exp(two.x[1])), delay))
    return min(ones), min(twos)


def inertia_of(robot: Robot, joint: str) -> tuple[float, float]:
    """kg m^2 (kg) that a joint turns at the model's pose, armature included, and the largest N m (N) that gravity puts
    on it over its range."""
    mj, data = robot.mj, mujoco.MjData(robot.mj)
    at = mj.joint(joint)
    dof, place = int(at.dofadr[0]), int(at.qposadr[0])
    low, high = mj.jnt_range[at.id] if mj.jnt_limited[at.id] else (-1.5, 1.5)
    load = 0.0
    for angle in np.linspace(low, high, 9):
        data.qpos[:] = mj.qpos0
        data.qpos[place] = angle
        mujoco.mj_forward(mj, data)
        load = max(load, abs(float(data.qfrc_bias[dof])))
    return inertia_at_rest(mj, joint), load


def _model_torque(robot: Robot, joint: str) -> tuple[float, str]:
    mj = robot.mj
    at = mj.joint(joint)
    if mj.jnt_actfrclimited[at.id]:
        return float(np.abs(mj.jnt_actfrcrange[at.id]).max()), "the joint's actuatorfrcrange in the model"
    name = robot.actuators.get(joint)
    if name is not None and mj.actuator_forcelimited[mj.actuator(name).id]:
        number = mj.actuator(name).id
        gear = abs(float(mj.actuator_gear[number, 0]))
        return float(np.abs(mj.actuator_forcerange[number]).max()) * gear, "the actuator's forcerange in the model"
    return 0.0, ""


def _round(value: float) -> float:
    return float(f"{value:.{ROUND}g}")
