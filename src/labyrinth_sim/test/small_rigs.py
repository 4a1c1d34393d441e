# SPDX-License-Identifier: Apache-2.0
"""Rigs so small that what they do can be worked out by hand, an integrator of their own, and the register of checks.

All axes are called a, b; their signals a, a_speed, a_effort, and behind a belt a_load.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from labyrinth_sim.effect import drives as library
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.simulate import simulate

G = 9.81  # m/s^2
OFF = float("nan")  # as a command: the drive is off
INERTIA = 0.01  # kg m^2, of a horn, an arm without its mass, and a belt's load
MASS, ARM = 0.2, 0.1  # kg, m; of the arm's mass, level with its axis at zero
SPRING = 1.0  # N m/rad, of the swing
BELT_MOTOR, BELT_RATIO, BELT_K, BELT_D = 0.02, 1.5, 2.0, 0.02  # kg m^2, 1, N m/rad, N m s/rad
RADIUS = 0.01  # m, of the ball
CENTRE = (0.3, 0.2)  # m, where the table turns, in the frame of the ball's position
WALL = 0.4  # m, the face of the slippery table's wall, likewise
HEAVY = 1e9  # kg m^2; stands still whatever acts on it
SLEDGE = 0.2  # kg m^2, of a sledge

CHECKED: dict[str, list[str]] = {}
"""Effect or drive -> the equations that its checks were written for."""


def checks(name: str, equation: str) -> Callable[[Any], Any]:
    """Registers a test as the check of an effect or a drive against the equation that its file states."""

    def register(test: Any) -> Any:
        CHECKED.setdefault(name, []).append(equation)
        return test

    return register


def _hinge(name: str, axis: str, inertia: float, place: str = "0 0 0", mass: float = 1.0, **joint: float) -> str:
    more = " ".join(f'{key}="{value}"' for key, value in joint.items())
    return f"""<body name="{name}_body">
        <inertial pos="{place}" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/>
        <joint name="{name}" axis="{axis}" {more}/></body>"""


def _mjcf(bodies: str, actuators: Sequence[str], tendons: str = "") -> str:
    motors = "".join(f'<motor name="{name}" joint="{name}"/>' for name in actuators)
    # A pyramid for a cone would let a ball's rolling friction share one limit with what makes it roll.
    return f"""<mujoco><compiler angle="radian"/>
        <option timestep="0.0002" integrator="implicitfast" cone="elliptic" gravity="0 0 {-G}"/>
        <worldbody>{bodies}</worldbody><tendon>{tendons}</tendon><actuator>{motors}</actuator></mujoco>"""


def _belt(name: str) -> str:
    return f"""<fixed name="{name}_belt" stiffness="{BELT_K}" damping="{BELT_D}" springlength="0 0">
        <joint joint="{name}" coef="{BELT_RATIO}"/><joint joint="{name}_load" coef="-1"/></fixed>"""


def _table(wall: str, contact: str) -> str:
    x, y = CENTRE
    ball = f'type="sphere" size="{RADIUS}" mass="0.01" priority="1" solref="0.004 1" solimp="0.99 0.999 0.0001"'
    still = 'mass="1" diaginertia="1e4 1e4 1e4"'
    return f"""<body name="frame"><inertial pos="0 0 0" {still}/><joint name="a" axis="1 0 0"/>
            <body name="board"><inertial pos="0 0 0" {still}/><joint name="b" axis="0 1 0"/>
            <site name="corner" pos="{-x} {-y} 0"/>
            <geom type="box" size="0.6 0.4 0.01" pos="0 0 -0.01"/>{wall}</body></body>
        <body name="ball" pos="-0.1 0.05 {RADIUS}"><freejoint name="ball"/><geom {ball} {contact}/></body>"""


_SLIPPERY = f"""<geom type="box" size="0.05 0.4 0.05" pos="{WALL - CENTRE[0] + 0.05} 0 0.05"/>"""
_BELTS = "".join(_hinge(name, "0 0 1", BELT_MOTOR) + _hinge(f"{name}_load", "0 0 1", INERTIA) for name in ("a", "b"))
MJCF = {
    "horn": _mjcf(_hinge("a", "0 0 1", INERTIA), "a"),
    "pair": _mjcf(_hinge("a", "0 0 1", HEAVY) + _hinge("b", "0 0 1", HEAVY), "ab"),
    "swing": _mjcf(_hinge("a", "0 0 1", INERTIA, stiffness=SPRING), "a"),
    "beam": _mjcf(_hinge("a", "0 1 0", INERTIA), "a"),
    "arm": _mjcf(_hinge("a", "0 1 0", INERTIA, f"{ARM} 0 0", MASS), "a"),
    "belts": _mjcf(_BELTS, "ab", _belt("a") + _belt("b")),
    "sledge": _mjcf(_hinge("a", "0 0 1", SLEDGE), "a"),
    "table": _mjcf(_table("", 'friction="0.6 0.005 0.0001"'), "ab"),
    "slippery": _mjcf(_table(_SLIPPERY, 'condim="1"'), "ab"),
}
"""What each rig is made of: a horn turns about an upright axis, beam and arm about a level one, a sledge is a heavy
horn, a pair stands still, a swing has a spring; a table stands still where it is put, and its ball rolls, or slides
without friction."""

DRIVES: Mapping[str, Mapping[str, float]] = {
    "torque_pd": {"stiffness": 4.0, "damping": 0.2, "torque": 1.5},
    "velocity_pid": {"p": 8.0, "i": 0.0, "d": 0.0, "speed_gain": 0.5, "torque": 1.5},
    "pwm_servo": {"kp": 400.0, "duty_gain": 1 / 150, "voltage": 6.0, "resistance": 2.0, "torque_constant": 0.5},
    "dc_motor_servo": {
        "kp": 4.0 / 1.5,
        "voltage": 6.0,
        "resistance": 3.0,
        "torque_constant": 0.005,
        "gear": 200.0,
        "efficiency": 0.75,
    },
}
"""All of them limited to 1.5 N m, and 4 N m/rad while at rest."""


def small(folder: Path, rig: str, drive: str = "torque_pd") -> Model:
    """A model of one of the rigs with the same drive on every axis, without effects, by way of its files."""
    axes: dict[str, Any] = {}
    for name in ("a", "b") if 'joint="b"' in MJCF[rig] else ("a",):
        quantities = {name: "position", f"{name}_speed": "velocity", f"{name}_effort": "torque"}
        measured = {signal: {"joint": name, "quantity": quantity} for signal, quantity in quantities.items()}
        axes[name] = {"command": name, "actuator": name, "joint": name, "measured": measured}
        if rig == "belts":
            axes[name] |= {"belt": f"{name}_belt", "load_joint": f"{name}_load"}
            measured[f"{name}_load"] = {"joint": f"{name}_load", "quantity": "position"}
    ball = {"ball": {"joint": "ball", "site": "corner"}} if rig in ("table", "slippery") else {}
    unit = {p.name: p.unit for p in library()[drive].parameters}
    values = {name: {"value": v, "unit": unit[name], "from": "chosen"} for name, v in DRIVES[drive].items()}
    drives = {name: {"kind": drive, "values": values} for name in axes}
    (folder / f"{rig}.xml").write_text(MJCF[rig])
    rig_file, model_file = folder / f"{rig}_rig.yaml", folder / f"{rig}_{drive}.yaml"
    rig_file.write_text(yaml.safe_dump({"name": rig, "mjcf": f"{rig}.xml", "axes": axes, **ball}))
    model_file.write_text(yaml.safe_dump({"name": rig, "rig": rig_file.name, "drives": drives, "effects": []}))
    return load_model(model_file)


def play(
    model: Model, time: np.ndarray, commands: Any = OFF, timestep: float | None = None, **initial: float
) -> dict[str, np.ndarray]:
    """Signal -> (T,) of a roll-out under commands (T, axes), or one number for all."""
    block = np.broadcast_to(np.asarray(commands, float), (len(time), len(model.rig.axes)))
    seen = simulate(model, time, block, initial, with_ball=bool(model.rig.ball), timestep=timestep)
    return {signal: seen.values[0, :, column] for column, signal in enumerate(seen.signals)}


def torques(model: Model, commands: Any, step: float = 0.01, axis: str = "a", **initial: float) -> np.ndarray:
    """(T,) N m that a drive gives at the beginning of each sample, under commands (T, axes) or (T,) of all.

    One MuJoCo step is one sample here, so that on a rig that stands still it is the torque all the time.
    """
    block = np.asarray(commands, float)
    block = block if block.ndim == 2 else np.repeat(block[:, None], len(model.rig.axes), axis=1)
    held = np.vstack([block, block[-1:]])
    return play(model, np.arange(len(held)) * step, held, step, **initial)[f"{axis}_effort"][: len(block)]


def integrated(slope: Callable[[np.ndarray], Sequence[float]], start: Sequence[float], time: np.ndarray) -> np.ndarray:
    """(T, n) states with d(state)/dt = slope(state), by Runge's and Kutta's method at a tenth of a millisecond."""
    found = [np.array(start, float)]
    for span in np.diff(time):
        state, parts = found[-1], max(1, round(span / 1e-4))
        h = span / parts
        for _ in range(parts):
            k1 = np.array(slope(state))
            k2 = np.array(slope(state + h / 2 * k1))
            k3 = np.array(slope(state + h / 2 * k2))
            k4 = np.array(slope(state + h * k3))
            state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        found.append(state)
    return np.array(found)
