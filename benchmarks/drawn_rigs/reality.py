# SPDX-License-Identifier: Apache-2.0
"""A rig as it really is: its physics, a command's way to the firmware, and sensors read at their own times."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter
from scipy.special import ndtri

from drawn_rigs.physics import RECORD, STEP, Array, Goals, Motion, Physics, play

SPREAD = ndtri((np.arange(15) + 0.5) / 15)  # a Gaussian's quantiles, for means over noise
AFTER = 0.05  # s of motion beyond the last reading


@dataclass(frozen=True)
class Path:
    """What becomes of one axis's command before the firmware has it.

    Attributes:
        delay, delay_jitter: s; the jitter is uniform, beyond the delay.
        tick: rad, of the goal register; `truncates` rounds down.
        gain: factor.
        cross: share of the other axis's command that is added.
        error, error_period, error_phase: rad, rad, turns; by angle.
        lost: probability that a message never arrives.
    """

    delay: float = 0.0
    delay_jitter: float = 0.0
    tick: float = 0.0
    truncates: bool = False
    gain: float = 1.0
    cross: float = 0.0
    error: float = 0.0
    error_period: float = 1.0
    error_phase: float = 0.0
    lost: float = 0.0


@dataclass(frozen=True)
class Sensor:
    """One measured signal.

    Attributes:
        axis: number of its axis.
        quantity: "motor", "motor_speed", "load", "load_speed" or "torque" of the motion.
        noise: standard deviation of a reading, in the signal's unit.
        tick: in the signal's unit; `truncates` rounds down.
        gain, bias: the reading is gain times the quantity plus bias.
        delay, delay_jitter: s; the jitter is uniform, beyond the delay.
        lag: s, of a first-order filter; `averages`: of a mean over that long instead.
        play: rad, width of the gap in which the sensor's own gear is held by friction; `play_mass`: s, the time in
            which it comes to rest behind the gap, 0 at once.
        ripple, ripple_period: rad, of an eccentric gear between joint and sensor.
        drift, drift_time: signal's unit and s, of a zero that warms.
    """

    axis: int
    quantity: str
    noise: float = 0.0
    tick: float = 0.0
    truncates: bool = False
    gain: float = 1.0
    bias: float = 0.0
    delay: float = 0.0
    delay_jitter: float = 0.0
    lag: float = 0.0
    averages: bool = False
    play: float = 0.0
    play_mass: float = 0.0
    ripple: float = 0.0
    ripple_period: float = 1.0
    drift: float = 0.0
    drift_time: float = 60.0


@dataclass(frozen=True)
class Reality:
    """A rig as it is.

    Attributes:
        physics: of the plant and its firmware.
        paths: of each axis.
        sensors: signal -> sensor.
        push: (u,) N m, standard deviation of a random torque in each round of the firmware.
        spread: rad, of the pose from which a trial's first goal is approached.
    """

    physics: Physics
    paths: tuple[Path, ...]
    sensors: Mapping[str, Sensor]
    push: tuple[float, ...]
    spread: float = 0.0

    def with_axis(self, axis: int, **values: float) -> "Reality":
        return replace(self, physics=self.physics.with_axis(axis, **values))

    def with_rig(self, **values: float) -> "Reality":
        return replace(self, physics=self.physics.with_rig(**values))

    def with_path(self, axis: int, **values: float) -> "Reality":
        paths = tuple(replace(p, **values) if i == axis else p for i, p in enumerate(self.paths))
        return replace(self, paths=paths)

    def with_sensor(self, signal: str, **values: float) -> "Reality":
        return replace(self, sensors={**self.sensors, signal: replace(self.sensors[signal], **values)})


@dataclass(frozen=True)
class Plan:
    """What is sent to a rig and how it is recorded.

    Attributes:
        times: (n,) s, when the host means to send, evenly.
        targets: (n, u) rad.
        seconds: from the first command to the last reading.
        rate: Hz of the readings.
        send_jitter, stamp_jitter: s, standard deviations: of the true times of commands and readings, of their stamps.
    """

    times: Array
    targets: Array
    seconds: float
    rate: float
    send_jitter: float = 0.0
    stamp_jitter: float = 0.0


@dataclass(frozen=True)
class Trial:
    """One trial as recorded; times from its start.

    Attributes:
        command_stamps: (n,) s.
        commands: (n, u) rad, as sent.
        stamps: (T,) s.
        readings: signal -> (T,).
    """

    command_stamps: Array
    commands: Array
    stamps: Array
    readings: Mapping[str, Array]


def record(reality: Reality, plan: Plan, trials: int, seed: int) -> list[Trial]:
    """Trials with all their noise, one after the other, a pause of 3 s between them."""
    return [_trial(reality, plan, np.random.default_rng([seed, i]), i * (plan.seconds + 3.0)) for i in range(trials)]


def clean(reality: Reality, plan: Plan) -> dict[str, Array]:
    """What readings at even times are on average, without jitter: signal -> (T,)."""
    still = replace(reality, push=(0.0,) * len(reality.paths), spread=0.0)
    paths = tuple(replace(p, delay=p.delay + p.delay_jitter / 2, delay_jitter=0.0) for p in still.paths)
    motion = _moved(replace(still, paths=paths), plan, plan.times, np.random.default_rng(0), 0.0)
    times = np.arange(int(plan.seconds * plan.rate) + 1) / plan.rate
    readings = {}
    for name, sensor in still.sensors.items():
        seen = _seen(replace(sensor, delay=sensor.delay + sensor.delay_jitter / 2), motion, times, 0.0)
        readings[name] = np.mean(
            [_ticked(seen + sensor.noise * z, sensor.tick, sensor.truncates) for z in SPREAD], axis=0
        )
    return readings


def _trial(reality: Reality, plan: Plan, rng: np.random.Generator, age: float) -> Trial:
    sent = _jittered(plan.times, plan.send_jitter, rng)
    sent[0] = plan.times[0]
    motion = _moved(reality, plan, sent, rng, age)
    step = 1.0 / plan.rate
    times = np.arange(int(plan.seconds * plan.rate) + 1) * step + rng.uniform(0.0, step)
    times = _jittered(times[times <= plan.seconds], plan.send_jitter, rng)
    times = np.maximum(times, 1e-6)
    readings = {}
    for name, sensor in reality.sensors.items():
        late = sensor.delay + sensor.delay_jitter * rng.random(len(times))
        seen = _seen(replace(sensor, delay=0.0), motion, times, age, late) + sensor.noise * rng.standard_normal(
            len(times)
        )
        readings[name] = _ticked(seen, sensor.tick, sensor.truncates)
    stamps = _jittered(times, plan.stamp_jitter, rng)
    return Trial(_jittered(sent, plan.stamp_jitter, rng), plan.targets, stamps, readings)


def _jittered(times: Array, size: float, rng: np.random.Generator) -> Array:
    """The times, moved by up to a third of their distance, still in order."""
    if size <= 0.0:
        return times.copy()
    most = 0.3 * float(np.diff(times).min())
    return times + np.clip(size * rng.standard_normal(len(times)), -most, most)


def _moved(reality: Reality, plan: Plan, sent: Array, rng: np.random.Generator, age: float) -> Motion:
    values, arrivals = [], []
    for i, path in enumerate(reality.paths):
        goal = plan.targets[:, i]
        if path.cross:
            goal = goal + path.cross * plan.targets[:, 1 - i]
        goal = path.gain * goal
        if path.error:
            goal = goal + path.error * np.sin(2 * np.pi * (goal / path.error_period + path.error_phase))
        goal = _ticked(goal, path.tick, path.truncates)
        if path.lost:
            kept = rng.random(len(goal)) >= path.lost
            kept[0] = True
            goal = goal[np.maximum.accumulate(np.where(kept, np.arange(len(goal)), 0))]
        late = sent + path.delay + (path.delay_jitter * rng.random(len(sent)) if path.delay_jitter else 0.0)
        values.append(goal)
        arrivals.append(np.maximum.accumulate(late))
    first = np.array([v[0] for v in values])
    start = first + (reality.spread * rng.standard_normal(len(first)) if reality.spread else 0.0)
    seed = rng.integers(2**32, size=2) if any(reality.push) else (0,)
    goals = Goals(np.array(arrivals), np.array(values), start, age, np.array(reality.push), tuple(int(s) for s in seed))
    return play(reality.physics, goals, plan.seconds + AFTER)


def _seen(sensor: Sensor, motion: Motion, times: Array, age: float, late: Array | None = None) -> Array:
    """What a sensor shows before noise and tick at these times (T,) s."""
    step = STEP * RECORD
    true = getattr(motion, sensor.quantity)[:, sensor.axis]
    if sensor.ripple:
        true = true + sensor.ripple * np.sin(2 * np.pi * true / sensor.ripple_period)
    if sensor.play:
        true = _behind(true, sensor.play, sensor.play_mass, step)
    if sensor.lag and sensor.averages:
        count = max(1, round(sensor.lag / step))
        total = np.cumsum(np.concatenate([np.full(count, true[0]), true]))
        true = (total[count:] - total[:-count]) / count
    elif sensor.lag:
        keep = np.exp(-step / sensor.lag)
        true = lfilter([1.0 - keep], [1.0, -keep], true, zi=[keep * true[0]])[0]
    past = times - (sensor.delay if late is None else late)
    seen = sensor.gain * np.interp(past, motion.time, true) + sensor.bias
    if sensor.drift:
        seen = seen + sensor.drift * -np.expm1(-(age + times) / sensor.drift_time)
    return seen


def _behind(angle: Array, width: float, mass: float, step: float) -> Array:
    """A sensor's wheel behind a gap: held by friction, or coasting for `mass` s after it was pushed."""
    out = np.empty_like(angle)
    last, speed, half = float(angle[0]), 0.0, width / 2
    keep = np.exp(-step / mass) if mass > 0 else 0.0
    for k, now in enumerate(angle.tolist()):
        coasted = last + speed * step
        moved = min(max(coasted, now - half), now + half)
        speed = (moved - last) / step if moved != coasted else speed * keep
        last = moved
        out[k] = last
    return out


def _ticked(values: Array, tick: float, truncates: bool) -> Array:
    if tick <= 0.0:
        return values
    return tick * (np.floor(values / tick) if truncates else np.round(values / tick))
