# SPDX-License-Identifier: Apache-2.0
"""The emulated rigs in motion: what physics.c needs to know of a rig, and one call that plays trials on it.

It imports nothing of this repository: a diagnosis is judged on a physics that is not the model's. It is C because a
step of 0.1 ms in numpy takes some 60 array operations of a few numbers each, seconds a trial; in C it takes 35 ms.
"""

import ctypes
import hashlib
import os
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from math import inf
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP = 1e-4  # s
RECORD = 5  # steps between the rows of a play, so 0.5 ms
LEAD = 1.0  # s before time zero in which the first goal is held
SOURCE = Path(__file__).with_name("physics.c")
FLAGS = ("-O2", "-ffp-contract=off", "-shared", "-fPIC", "-std=c11")  # the same bits on every machine of a kind

RIG = {
    "board": 0.0,  # 1: two nested frames, x around y; else links that hang down
    "yields": 0.0,  # 1: a belt or a spring between each motor and its load
    "tilt": 0.0,  # kg m^2, how much inertia about x grows as y tilts by a right angle
    "link": 0.0,  # m, from the first to the second joint of an arm
    "sag": 0.0,  # share of the voltage lost when one motor draws its stall current
    "sag_time": 0.0,  # s in which the supply's capacitor follows
}
"""What a rig has once, with its value in a rig that lacks it."""

AXIS = {
    # the load
    "inertia": 0.0,  # kg m^2 about the joint
    "below": 0.0,  # kg m, mass times distance below the joint
    "sideways": 0.0,  # kg m, mass times distance beside it
    "mass": 0.0,  # kg, of the second link
    "load_damping": 0.0,  # N m s/rad
    "load_coulomb": 0.0,  # N m
    "spring": 0.0,  # N m/rad to zero
    "spring_hardening": 0.0,  # 1/rad, at which angle it is twice as stiff
    "stop": inf,  # rad, either side
    # between motor and load
    "armature": 0.01,  # kg m^2
    "stiffness": 0.0,  # N m/rad
    "damping": 0.0,  # N m s/rad
    "hardening": 0.0,  # 1/rad
    "gap": 0.0,  # rad, width of the slack
    "contact": 0.0,  # s/rad, Hunt and Crossley's damping; 0: the belt's
    "hold": 0.0,  # N m that hold the load within the slack
    "cross": 0.0,  # rad a rad of the other axis's load
    "uneven": 0.0,  # rad, eccentric gear: the output's error over the motor's angle
    "uneven_period": 1.0,  # rad
    # friction in the motor's gear
    "friction_form": 0.0,  # 0 Coulomb, 1 tanh, 2 LuGre, 3 Dahl
    "coulomb": 0.0,  # N m
    "upward": 0.0,  # N m more for speeds above zero
    "downward": 0.0,  # N m more below
    "upward_viscous": 0.0,  # N m s/rad more for speeds above zero
    "downward_viscous": 0.0,  # N m s/rad more below
    "pull": 0.0,  # N m, whatever moves
    "cut_share": 1.0,  # of the full duty that is left once protection cuts in
    "cut_bound": inf,  # of the full duty asked for, from which on it counts
    "cut_time": 0.0,  # s until it cuts in
    "smooth_speed": 0.01,  # rad/s of the tanh
    "bristle": 0.0,  # N m/rad
    "bristle_damping": 0.0,  # N m s/rad
    "stribeck": 0.0,  # N m more at rest
    "stribeck_speed": 0.1,  # rad/s
    "stribeck_form": 0.0,  # 0 Gaussian, 1 rational, 2 exponential
    "load_driving": 0.0,  # share of the torque carried
    "load_driven": 0.0,
    "load_form": 0.0,  # 0: of motor against load, 1: of the load alone
    "viscous": 0.0,  # N m s/rad
    "thinning": 0.0,  # rad/s at which viscous friction is half of it; 0: never
    "drag": 0.0,  # N m s^2/rad^2
    "cogging": 0.0,  # N m
    "cogging_period": 0.2,  # rad
    "other_friction": 0.0,  # N m a rad of the other axis's angle
    "tight": 0.0,  # N m, friction at tight places of the gear
    "tight_period": 0.1,  # rad
    "warming": 0.0,  # share of friction that is lost as it warms
    "mount_play": 0.0,  # rad
    "mount_friction": 0.0,  # N m
    "mount_damping": 1.0,  # N m s/rad
    # motor and firmware
    "law": 0.0,  # 0 velocity PID, 1 torque PD, 2 duty cycle
    "p": 0.0,  # 1/s, N m/rad, or the gain register
    "i": 0.0,  # 1/s^2
    "d": 0.0,  # 1/s at 10 ms, or N m s/rad
    "gain": 0.0,  # N m s/rad of the speed loop, or duty a rad and register
    "torque": inf,  # N m, limit
    "torque_share": 1.0,  # of it, or of full duty, that is allowed
    "soft_limit": 0.0,  # 1: reached as a tanh reaches 1
    "no_load": inf,  # rad/s at which no torque is left
    "voltage": 1.0,  # V
    "resistance": 1.0,  # ohm
    "constant": 1.0,  # N m/A
    "feedback_tick": 0.0,  # rad
    "feedback_error": 0.0,  # rad, the servo's own angle sensor is uneven
    "feedback_period": 1.0,  # rad
    "feedback_phase": 0.0,  # turns
    "feedback_form": 0.0,  # 0 sine, 1 saw tooth
    "dead_band": 0.0,  # rad
    "dead_band_form": 0.0,  # 0: the error begins at its edge, 1: jumps there
    "rate": 0.0,  # rad/s of the profile; 0: none
    "rate_acceleration": 0.0,  # rad/s^2; 0: at once
}
"""What each axis has, with its value in a rig that lacks it."""


@dataclass(frozen=True)
class Physics:
    """One emulated rig: what differs from the tables' values, for the rig and for each axis."""

    rig: dict[str, float]
    axes: tuple[dict[str, float], ...]
    period: float = 0.001  # s, of the firmware's loop

    def with_rig(self, **values: float) -> "Physics":
        return Physics({**self.rig, **values}, self.axes, self.period)

    def with_axis(self, axis: int, **values: float) -> "Physics":
        changed = tuple({**a, **values} if i == axis else a for i, a in enumerate(self.axes))
        return Physics(self.rig, changed, self.period)

    def of(self, axis: int, name: str) -> float:
        """A quantity of an axis."""
        return self.axes[axis].get(name, AXIS[name])


@dataclass(frozen=True)
class Goals:
    """What reaches the firmware in one trial.

    Attributes:
        times: (u, n) s; a goal holds from its time to the next.
        values: (u, n) rad.
        start: (u,) rad, where the rig stands before the first goal.
        age: s that the rig has been running before.
        push: standard deviation of a random torque, N m (u,), drawn anew each round of the firmware.
        seed: of that torque.
    """

    times: Array
    values: Array
    start: Array
    age: float = 0.0
    push: Array | None = None
    seed: Sequence[int] = field(default=(0,))


@dataclass(frozen=True)
class Motion:
    """What happened in one trial, every 0.5 ms from time zero on; columns are the axes.

    Attributes:
        time: (T,) s.
        motor, motor_speed, load, load_speed, torque: (T, u) rad, rad/s, N m.
    """

    time: Array
    motor: Array
    motor_speed: Array
    load: Array
    load_speed: Array
    torque: Array


class DivergedError(RuntimeError):
    """The emulated rig left all bounds."""


def play(physics: Physics, goals: Goals, seconds: float) -> Motion:
    """One trial.

    Raises:
        DivergedError: numbers that no rig has.
        RuntimeError: no C compiler.
    """
    count = len(physics.axes)
    every = round(physics.period / STEP)
    rounds = round((LEAD + seconds) / physics.period) + 2
    rows = int(seconds / (STEP * RECORD)) + 1
    push = np.zeros((rounds, count))
    if goals.push is not None:
        push = np.random.default_rng(goals.seed).standard_normal((rounds, count)) * goals.push
    out = np.empty((rows, count, 5))
    failed = _library().play(
        _row(RIG, physics.rig), np.concatenate([_row(AXIS, a) for a in physics.axes]), count,
        np.ascontiguousarray(goals.times), np.ascontiguousarray(goals.values), goals.times.shape[1],
        np.ascontiguousarray(goals.start), LEAD, goals.age, rounds, every, RECORD, rows, push, out,
    )  # fmt: skip
    if failed:
        raise DivergedError(f"The emulated rig diverged: {physics}.")
    return Motion(np.arange(rows) * STEP * RECORD, *(np.ascontiguousarray(out[:, :, i]) for i in range(5)))


def _row(table: dict[str, float], values: dict[str, float]) -> Array:
    unknown = set(values) - set(table)
    if unknown:
        raise KeyError(f"unknown quantities {sorted(unknown)}")
    return np.array([values.get(name, default) for name, default in table.items()])


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    """The compiled physics, from the cache if this very source was compiled before."""
    text = _header() + SOURCE.read_text(encoding="utf-8")
    digest = hashlib.sha256((text + " ".join(FLAGS)).encode()).hexdigest()[:16]
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "eps_tunnel"
    file = folder / f"drawn_rigs_{digest}.so"
    if not file.exists():
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder) as workplace:
            source, made = Path(workplace) / "physics.c", Path(workplace) / "physics.so"
            source.write_text(text, encoding="utf-8")
            _compile(source, made)
            made.rename(file)
    library = ctypes.CDLL(str(file))
    numbers = np.ctypeslib.ndpointer(dtype=np.float64, flags="C_CONTIGUOUS")
    i, d = ctypes.c_int, ctypes.c_double
    library.play.argtypes = [numbers, numbers, i, numbers, numbers, i, numbers, d, d, i, i, i, i, numbers, numbers]
    library.play.restype = i
    return library


def _header() -> str:
    rig = ", ".join(name.upper() for name in RIG)
    axis = ", ".join(name.upper() for name in AXIS)
    return f'enum {{ {rig} }};\nenum {{ {axis}, AXIS_COUNT }};\n#line 1 "{SOURCE.name}"\n'


def _compile(source: Path, made: Path) -> None:
    try:
        subprocess.run(["cc", *FLAGS, str(source), "-o", str(made), "-lm"], check=True, capture_output=True, text=True)
    except FileNotFoundError as error:
        raise RuntimeError("The emulated rigs need a C compiler; install gcc, which provides cc.") from error
    except subprocess.CalledProcessError as error:
        raise RuntimeError(f"{SOURCE} does not compile:\n{error.stderr}") from error
