# SPDX-License-Identifier: Apache-2.0
"""Rigs, drawn: what their files state, and what they really are."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import pi

import numpy as np

from drawn_rigs.physics import Physics
from drawn_rigs.reality import Path, Reality, Sensor

OFF = 0.2  # by which share a stated value may be wrong
LONGEST_DELAY = 0.05  # s, that the library's drives can say
LAWS = ("velocity_pid", "torque_pd", "pwm_servo")
# What the library's drives take at most, less the share by which a stated value may be wrong.
STEEPEST = 0.09  # of full duty a rad and count of the gain register
STIFFEST = 16.0  # N m s/rad, of a speed loop
LARGEST = 40.0  # ohm
COUNT = 4096  # ticks a turn of a common servo


@dataclass(frozen=True)
class Loose:
    """A value that a refit may move.

    Attributes:
        axis: number of its axis.
        name: quantity of that axis in the physics, or "delay" of its path.
        low, high: how far it may be moved from its true value.
        step: by which a slope is taken.
    """

    axis: int
    name: str
    low: float
    high: float
    step: float


@dataclass(frozen=True)
class Rig:
    """One drawn rig, healthy.

    Attributes:
        kind: "labyrinth", "two_link_arm" or "pendulum".
        law: of its drives.
        axes: their short names.
        joints: of the motors; also the command channels.
        loads: of what the motors turn; the motors' own where nothing lies between.
        reach: (u,) rad, of commands.
        stated: numbers for the files: of the MJCF, and `drive` values by axis.
        friction: whether the model has Coulomb and viscous friction, with these stated values (N m, N m s/rad) by axis.
        reality: what it is.
        second: whether a second sensor sees each axis.
        loose: what a refit may move.
    """

    kind: str
    law: str
    axes: tuple[str, ...]
    joints: tuple[str, ...]
    loads: tuple[str, ...]
    reach: tuple[float, ...]
    stated: Mapping[str, float]
    drives: tuple[Mapping[str, float], ...]
    friction: tuple[tuple[float, float], ...]
    reality: Reality
    second: bool
    loose: tuple[Loose, ...] = field(default=())

    def positions(self, axis: int) -> tuple[str, ...]:
        """Signals that measure an axis's angle."""
        return tuple(n for n, s in self.reality.sensors.items() if s.axis == axis and s.quantity in ("motor", "load"))


@dataclass(frozen=True)
class Plant:
    """What a kind of rig is made of: stated numbers, and the physics that numbers give."""

    axes: tuple[str, ...]
    joints: tuple[str, ...]
    loads: tuple[str, ...]
    reach: tuple[float, ...]
    stated: dict[str, float]
    wrong: tuple[str, ...]  # of the stated numbers those that are off
    torque: tuple[float, ...]  # N m of each motor
    inertia: tuple[float, ...]  # kg m^2 that each motor turns, about
    physics: Callable[[Mapping[str, float]], tuple[dict[str, float], list[dict[str, float]]]]


def draw_rig(rng: np.random.Generator, kind: str, law: str, exact: bool = False) -> Rig:
    """A rig of a kind.

    Args:
        exact: every stated value is true, the motors have no torque-speed line, and nothing is uncertain but noise.
    """
    plant = PLANTS[kind](rng)
    off = 0.0 if exact else OFF
    true = {n: v * (rng.uniform(1 - off, 1 + off) if n in plant.wrong else 1.0) for n, v in plant.stated.items()}
    rig, axes = plant.physics(true)
    known = not exact and rng.random() < 0.35
    drives, paths, friction = [], [], []
    for i, axis in enumerate(axes):
        stated, real = _drive(rng, law, plant.torque[i], plant.inertia[i], off, exact)
        axis |= real
        goal_tick = stated.get("goal_tick", 0.0)
        paths.append(Path(delay=float(rng.uniform(0.0, 0.03)) if not exact else 0.01, tick=goal_tick))
        level = (
            (plant.torque[i] * rng.uniform(0.01, 0.04), plant.inertia[i] * rng.uniform(0.5, 3.0)) if known else (0, 0)
        )
        axis["coulomb"] = level[0]
        axis["viscous"] = axis.get("viscous", 0.0) + level[1]
        friction.append(tuple(float(v * rng.uniform(0.6, 1.5)) for v in level))
        drives.append(stated)
    period = 0.001 if exact else float(rng.choice([0.0005, 0.001, 0.001, 0.002]))
    second = kind == "labyrinth" or bool(rng.random() < 0.6)
    reality = Reality(
        physics=Physics(rig, tuple(axes), period),
        paths=tuple(paths),
        sensors=_sensors(rng, plant, second),
        push=tuple(float(t * rng.uniform(0.0005, 0.003)) for t in plant.torque),
        spread=float(plant.reach[0] * rng.uniform(0.002, 0.02)),
    )
    return Rig(
        kind, law, plant.axes, plant.joints, plant.loads, plant.reach, plant.stated, tuple(drives),
        tuple(friction) if known else (), reality, second, _loose(law, reality, known),
    )  # fmt: skip


def _labyrinth(rng: np.random.Generator) -> Plant:
    size = rng.uniform(0.7, 1.5)  # of the board
    stated = {
        "frame_x": 0.001878842 * size, "frame_y": 0.002369771 * size, "frame_z": 0.004248613 * size,
        "board_x": 0.001525225 * size, "board_y": 0.0021316 * size, "board_z": 0.003656825 * size,
        "armature_x": 0.01 * rng.uniform(0.6, 1.4), "armature_y": 0.01 * rng.uniform(0.6, 1.4),
        "stiffness_x": rng.uniform(60, 150), "stiffness_y": rng.uniform(60, 150),
    }  # fmt: skip
    stated |= {f"damping_{a}": 0.3 * rng.uniform(0.6, 1.4) for a in "xy"}
    stated |= {f"{body}_z": 0.999 * stated[f"{body}_z"] for body in ("frame", "board")}  # no body is thinner than flat

    def physics(n: Mapping[str, float]) -> tuple[dict[str, float], list[dict[str, float]]]:
        shared = {"board": 1.0, "yields": 1.0, "tilt": n["board_z"] - n["board_x"]}
        inertia = (n["frame_x"] + n["board_x"], n["board_y"])
        return shared, [
            {"inertia": inertia[i], "armature": n[f"armature_{a}"] + 1e-6, "stiffness": n[f"stiffness_{a}"],
             "damping": n[f"damping_{a}"], "stop": 0.1396263}
            for i, a in enumerate("xy")
        ]  # fmt: skip

    torque = tuple(rng.choice([2.8, 6.0]) for _ in "xy")
    turned = tuple(stated[f"armature_{a}"] + 0.0027 * size for a in "xy")
    names = ("motor_x", "motor_y"), ("board_x", "board_y")
    return Plant(("x", "y"), *names, (0.087, 0.087), stated, tuple(stated), torque, turned, physics)


def _pendulum(rng: np.random.Generator) -> Plant:
    mass, below = 0.49 * rng.uniform(0.6, 1.1), 0.1 * rng.uniform(0.7, 1.1)
    stated = {"mass": mass, "below": below, "about_mass": 1e-4 + mass * 0.002 * rng.uniform(0.2, 1.0),
              "armature": 0.002 * rng.uniform(0.6, 1.5)}  # fmt: skip

    def physics(n: Mapping[str, float]) -> tuple[dict[str, float], list[dict[str, float]]]:
        inertia = n["about_mass"] + n["mass"] * n["below"] ** 2
        return {}, [{"inertia": inertia, "below": n["mass"] * n["below"], "armature": n["armature"]}]

    turned = stated["about_mass"] + mass * below**2 + stated["armature"]
    name = ("pendulum",)
    wrong = ("about_mass", "armature")
    return Plant(
        name, name, name, (rng.uniform(0.5, 1.4),), stated, wrong, (rng.uniform(0.8, 1.6),), (turned,), physics
    )


def _two_link_arm(rng: np.random.Generator) -> Plant:
    size = rng.uniform(0.8, 1.1)
    stated = {
        "mass_1": 1.2 * size, "below_1": 0.15 * size, "inertia_1": 0.009 * size**3, "armature_1": 0.02 * size,
        "mass_2": 0.7 * size, "below_2": 0.12 * size, "inertia_2": 0.0035 * size**3, "armature_2": 0.01 * size,
        "damping_1": 0.05, "damping_2": 0.03, "link": 0.3 * size,
    }  # fmt: skip

    def physics(n: Mapping[str, float]) -> tuple[dict[str, float], list[dict[str, float]]]:
        return {"link": n["link"]}, [
            {"inertia": n[f"inertia_{i}"] + n[f"mass_{i}"] * n[f"below_{i}"] ** 2, "mass": n[f"mass_{i}"],
             "below": n[f"mass_{i}"] * n[f"below_{i}"], "armature": n[f"armature_{i}"],
             "load_damping": n[f"damping_{i}"]}
            for i in (1, 2)
        ]  # fmt: skip

    n = stated
    outer = n["inertia_2"] + n["mass_2"] * n["below_2"] ** 2 + n["armature_2"]
    inner = n["inertia_1"] + n["mass_1"] * n["below_1"] ** 2 + n["armature_1"]
    inner += outer + n["mass_2"] * (n["link"] ** 2 + 2 * n["link"] * n["below_2"])
    names = ("shoulder", "elbow")
    wrong = ("inertia_1", "inertia_2", "armature_1", "armature_2", "damping_1", "damping_2")
    reach = (rng.uniform(0.3, 0.9), rng.uniform(0.4, 1.2))
    return Plant(names, names, names, reach, stated, wrong, (7.5 * size, 4.5 * size), (inner, outer), physics)


PLANTS: dict[str, Callable[[np.random.Generator], Plant]] = {
    "labyrinth": _labyrinth,
    "two_link_arm": _two_link_arm,
    "pendulum": _pendulum,
}


def _drive(
    rng: np.random.Generator, law: str, torque: float, inertia: float, off: float, exact: bool
) -> tuple[dict[str, float], dict[str, float]]:
    """Values of the library's drive as stated, and what the firmware and the motor really are."""

    def about(value: float, share: float) -> float:
        return float(value * rng.uniform(1 - share, 1 + share))

    unsure = 0.0 if exact else 0.25  # of what calibrations fit anyway
    fastest = float(rng.uniform(5.0, 9.0))  # rad/s without load
    tick = 2 * pi / COUNT if rng.random() < 0.5 and not exact else 0.0
    real: dict[str, float] = {"feedback_tick": 2 * pi / COUNT / float(rng.choice([1, 4, 16])) if not exact else 0.0}
    if law == "velocity_pid":
        p, d = float(rng.uniform(9, 20)), float(rng.choice([0.0, rng.uniform(0.0, 1.0)]))
        gain = min(inertia * float(rng.uniform(90, 180)), STIFFEST)
        real |= {"law": 0.0, "p": p, "d": d, "gain": gain, "torque": torque}
        stated = {"p": min(about(p, unsure), 25.0), "i": 0.0, "d": d if exact else 0.0, "delay": 0.0,
                  "speed_gain": about(gain, off), "torque": about(torque, off)}  # fmt: skip
    elif law == "torque_pd":
        quick = float(rng.uniform(22, 45))  # rad/s
        stiffness, damping = inertia * quick**2, 2 * float(rng.uniform(0.6, 1.1)) * inertia * quick
        real |= {"law": 1.0, "p": stiffness, "d": damping, "torque": torque}
        stated = {"stiffness": min(about(stiffness, unsure), 500.0), "damping": min(about(damping, unsure), 20.0),
                  "delay": 0.0, "torque": about(torque, off)}  # fmt: skip
    else:
        volts = float(rng.choice([v for v in (7.4, 12.0, 24.0) if v**2 / fastest / torque < LARGEST]))
        constant = volts / fastest
        resistance = constant * volts / torque
        quick = float(rng.uniform(22, 40))
        register = max(float(rng.choice([100, 200, 400, 850])), round(inertia * quick**2 / torque / STEEPEST))
        gain = inertia * quick**2 / torque / register
        real |= {"law": 2.0, "p": register, "gain": gain, "voltage": volts, "resistance": resistance,
                 "constant": constant, "torque": torque}  # fmt: skip
        stated = {"kp": register, "duty_gain": gain, "voltage": volts, "resistance": about(resistance, unsure),
                  "torque_constant": about(constant, unsure), "delay": 0.0}  # fmt: skip
    if law != "pwm_servo" and not exact:
        real["no_load"] = fastest
    if exact:
        stated["delay"] = 0.01
    elif rng.random() < 0.5:
        stated["delay"] = float(rng.uniform(0.0, 0.02))
    stated["goal_tick"], stated["feedback_tick"] = tick, real["feedback_tick"]
    return stated, real


def _sensors(rng: np.random.Generator, plant: Plant, second: bool) -> dict[str, Sensor]:
    sensors = {}
    efforts, speeds = rng.random() < 0.9, rng.random() < 0.4
    belt = plant.joints != plant.loads
    for i, joint in enumerate(plant.joints):
        tick = 2 * pi / COUNT / float(rng.choice([1, 1, 4, 16]))
        sensors[joint] = Sensor(i, "motor", noise=tick * float(rng.uniform(0.15, 1.0)), tick=tick)
        if speeds:
            sensors[f"{joint}_velocity"] = Sensor(i, "motor_speed", noise=float(rng.uniform(0.005, 0.03)))
        if efforts:
            step = plant.torque[i] * float(rng.choice([0.001, 0.004]))
            sensors[f"{joint}_effort"] = Sensor(
                i, "torque", noise=plant.torque[i] * float(rng.uniform(0.001, 0.006)), tick=step
            )
        if second:
            tick = plant.reach[i] * float(rng.uniform(0.002, 0.012))
            name = plant.loads[i] if belt else f"{joint}_link"
            sensors[name] = Sensor(i, "load", noise=tick * float(rng.uniform(0.2, 0.8)), tick=tick)
    return sensors


def _loose(law: str, reality: Reality, friction: bool) -> tuple[Loose, ...]:
    """The drive's values freely, the stated ones as far as they may be wrong."""
    values = []
    for axis, path in enumerate(reality.paths):
        names = {
            "velocity_pid": ("p", "d"),
            "torque_pd": ("p", "d"),
            "pwm_servo": ("resistance", "constant", "armature"),
        }
        for name in (*names[law], *(("coulomb", "viscous") if friction else ())):
            value = reality.physics.of(axis, name)
            step = 0.02 * value if value else 0.05
            values.append(Loose(axis, name, -np.inf, np.inf, step))
        values.append(Loose(axis, "delay", -path.delay, LONGEST_DELAY - path.delay, 0.001))
        for name in ("gain", "torque", "armature", "inertia", "stiffness", "damping"):
            value = reality.physics.of(axis, name)
            if value > 0 and np.isfinite(value) and name not in names[law] and (law, name) != ("pwm_servo", "gain"):
                values.append(Loose(axis, name, -OFF * value, OFF / (1 - OFF) * value, 0.03 * value))
    return tuple(values)
