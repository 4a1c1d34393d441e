# SPDX-License-Identifier: Apache-2.0
"""An arm, or a sledge, on one servo: its files in any unit, and recordings of what its model does."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import yaml

from eps_tunnel_analysis.recording import CsvColumns, csv_to_bag
from labyrinth_sim.model import Model
from labyrinth_sim.simulate import simulate
from labyrinth_sim.trials import Array

MJCF = """<mujoco><compiler angle="radian"/><option timestep="0.002" integrator="implicitfast"/>
  <worldbody>{bodies}</worldbody><actuator><motor name="arm" joint="arm"/></actuator></mujoco>"""
ARM = """<body><inertial pos="0.05 0 -0.1" mass="0.3" diaginertia="0.001 0.001 0.001"/>
  <joint name="arm" axis="0 1 0" armature="0.01"/></body>"""
SLEDGE = (
    '<body name="sledge"><inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/>'
    '<joint name="arm" type="slide" axis="1 0 0"/></body>'
)
DRIVE = {"stiffness": "N m/rad", "damping": "N m s/rad", "torque": "N m", "delay": "s"}


def write_rig(folder: Path, slides: bool = False, **units: dict[str, object]) -> Path:
    """A rig of one arm, or of a sledge; returns the model's file. `units` are entries of command, position, effort."""
    (folder / "rig.xml").write_text(MJCF.format(bodies=SLEDGE if slides else ARM))
    axis = {
        "command": {"channel": "arm", **units.get("command", {})},
        "actuator": "arm",
        "joint": "arm",
        "limits": [-0.5, 0.5],
        "measured": {
            "arm": {"joint": "arm", "quantity": "position", **units.get("position", {})},
            "arm_effort": {"joint": "arm", "quantity": "torque", **units.get("effort", {})},
        },
    }
    (folder / "rig.yaml").write_text(yaml.safe_dump({"name": "rig", "mjcf": "rig.xml", "axes": {"a": axis}}))
    numbers = {"stiffness": 60.0, "damping": 12.0, "torque": 30.0} if slides else {"stiffness": 8.0, "damping": 0.3}
    turn = (lambda unit: unit.replace("N m", "N").replace("rad", "m")) if slides else (lambda unit: unit)
    numbers = {"torque": 5.0, "delay": 0.0, **numbers}
    values = {name: {"value": v, "unit": turn(DRIVE[name]), "from": "chosen"} for name, v in numbers.items()}
    content = {"name": "m", "rig": "rig.yaml", "drives": {"a": {"kind": "torque_pd", "values": values}}, "effects": []}
    (folder / "model.yaml").write_text(yaml.safe_dump(content))
    return folder / "model.yaml"


def record(
    model: Model, bag: Path, position: float = 1.0, zero: float = 0.0, effort: float = 1.0, seed: int = 0,
    moves: Callable[[Array], Array] = lambda time: 0.3 * np.sin(2.0 * time**1.5),
) -> Path:  # fmt: skip
    """What the model does, as a bag: angles and targets in `position` rad, efforts in `effort` N m."""
    time = np.arange(300) * 0.01
    target = moves(time)
    seen = simulate(model, time, target[:, None])
    random = np.random.default_rng(seed)
    angle = seen.values[0, :, 0] + 1e-5 * random.standard_normal(300)
    columns = (time, target / position + zero, angle / position + zero, seen.values[0, :, 1] / effort)
    table = bag.with_name(f"{bag.name}.csv")
    np.savetxt(table, np.column_stack(columns), fmt="%.9g", delimiter=",", header="t,u,q,e", comments="")
    csv_to_bag(table, CsvColumns("t", {"arm": "u"}, {"arm": "q"}, {}, {"arm": "e"}), bag)
    return bag
