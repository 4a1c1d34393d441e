# SPDX-License-Identifier: Apache-2.0
"""A diagnosis of an arm of six joints, 30 s of motion and the whole library, over one of the labyrinth, 12 s."""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parent))
from ten_diagnoses import SEED, timed_diagnosis
from testbed_cases import draw, play, rig

from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.sequence_file import find_sequence
from labyrinth_hw.testbed.hidden import hide
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.simulate import simulate
from labyrinth_sim.yaml_file import yaml_text

JOINTS = 6
SECONDS = 30.0
TRIALS = 3
NOISE = 2e-4
"""rad"""
FINE = 2.5e-4
"""s between steps: a rig has none, and must not move by those of the model that is to be judged"""
AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
LINK = 0.2
"""m"""
HIDDEN = "coulomb_friction.a1"


def measure() -> dict[str, float]:
    """`six_joint_diagnosis`, and `six_joint_named`: 1 if the friction is named and nothing else."""
    command = find_sequence("excite_12s").commands[0]
    labyrinth = play(rig((hide("gravity_load", "y"),)), command, SEED)
    with tempfile.TemporaryDirectory() as folder:
        model = arm(Path(folder))
        six = timed_diagnosis(model, motion(model))
    one = timed_diagnosis(draw(SEED)[2], labyrinth).seconds
    return {
        "six_joint_diagnosis": six.seconds / one,
        "six_joint_named": float(six.named == (HIDDEN,)),
        "six_joint_seconds": six.seconds,
        "six_joint_labyrinth_seconds": one,
    }


def arm(folder: Path, joints: int = JOINTS) -> Model:
    """A chain of links, each lighter than the one that carries it, on servos with a PD law."""
    opened, actuators, axes, drives = "", "", {}, {}
    for i in range(joints):
        mass = 1.5 * 0.7**i
        opened += (
            f'<body name="link_{i}" pos="0 0 {LINK if i else 0.5}"><joint name="joint_{i}" axis="{AXES[i]}" '
            f'armature="0.02" damping="0.1"/><geom type="capsule" fromto="0 0 0 0 0 {LINK}" size="0.02" '
            f'mass="{mass:.4f}"/>'
        )
        actuators += f'<motor name="motor_{i}" joint="joint_{i}"/>'
        axes[f"a{i}"] = {
            "command": f"joint_{i}", "actuator": f"motor_{i}", "joint": f"joint_{i}", "limits": [-1.5, 1.5],
            "measured": {
                f"joint_{i}": {"joint": f"joint_{i}", "quantity": "position"},
                f"joint_{i}_effort": {"joint": f"joint_{i}", "quantity": "torque"},
            },
        }  # fmt: skip
        values = {"stiffness": (100.0 * 0.7**i, "N m/rad"), "damping": (5.0 * 0.7**i, "N m s/rad"),
                  "torque": (20.0 * 0.7**i, "N m"), "delay": (0.0, "s")}  # fmt: skip
        stated_values = {
            name: {"value": value, "unit": unit, "from": "chosen"} for name, (value, unit) in values.items()
        }
        drives[f"a{i}"] = {"kind": "torque_pd", "values": stated_values}
    (folder / "arm.xml").write_text(
        '<mujoco model="arm"><compiler angle="radian" autolimits="true"/><option timestep="0.002" '
        'integrator="implicitfast"/><default><geom contype="0" conaffinity="0"/></default><worldbody>'
        f"{opened}{'</body>' * joints}</worldbody><actuator>{actuators}</actuator></mujoco>",
        encoding="utf-8",
    )
    stated = {"name": "arm", "description": "A chain of links.", "mjcf": "arm.xml", "sample_time": 0.01, "axes": axes}
    (folder / "rig.yaml").write_text(yaml_text(stated), encoding="utf-8")
    content = {"name": "arm", "description": "A chain of links.", "rig": "rig.yaml", "drives": drives, "effects": []}
    (folder / "model.yaml").write_text(yaml_text(content), encoding="utf-8")
    return load_model(folder / "model.yaml")


def motion(model: Model, seconds: float = SECONDS) -> Play:
    """All joints at once, each by sines and steps of its own, with friction in one that the model lacks."""
    time = np.arange(round(seconds / 0.01) + 1) * 0.01
    count = len(model.rig.axes)
    phases = np.arange(count)
    waves = 0.3 * np.sin(2 * np.pi * (0.2 + 0.05 * phases) * time[:, None])
    commands = waves + 0.15 * np.sign(np.sin(2 * np.pi * (0.11 + 0.02 * phases) * time[:, None]))
    commands[time < 0.3] = 0.0
    rubbing = model.with_effect(*HIDDEN.split("."))
    run = simulate(rubbing, time, commands, timestep=FINE)
    noise = np.random.default_rng(0).standard_normal((TRIALS, *run.values.shape[1:]))
    sizes = np.where([unit == "rad" for unit in run.units], NOISE, 0.0)
    values = np.repeat(run.values, TRIALS, axis=0) + sizes * noise
    return Play("motion", replace(run, values=values, commands=np.repeat(run.commands, TRIALS, axis=0)))


if __name__ == "__main__":
    for key, value in measure().items():
        print(f"{key:30s} {value:.6g}")
