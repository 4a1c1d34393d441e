# SPDX-License-Identifier: Apache-2.0
"""Recordings for the frozen studies, made by the emulated testbed or by MuJoCo alone: the library under test only
turns their tables into bags.
"""

import contextlib
import csv
import io
import sys
from collections.abc import Sequence
from pathlib import Path
from subprocess import CompletedProcess

import mujoco
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "src" / "eps_tunnel_analysis" / "test"))

from command_line import eps_tunnel

from labyrinth_hw.testbed.command_line import main as testbed

MJCF = Path(__file__).resolve().parents[1] / "config" / "mjcf"
STEP = 0.01  # s between two samples
NOISE = 5e-4  # rad, standard deviation of a measured angle
EFFORT_NOISE = 0.02  # N m
Array = NDArray[np.float64]


def staircase(*targets: tuple[float, float]) -> Array:
    """(T,) rad, from pairs of target in rad and seconds for which it is held."""
    return np.concatenate([np.full(round(lasts / STEP), target) for target, lasts in targets])


def sine(amplitude: float, frequency: float, lasts: float) -> Array:
    """(T,) rad"""
    return amplitude * np.sin(2 * np.pi * frequency * STEP * np.arange(round(lasts / STEP)))


def late_horn(folder: Path) -> dict[str, list[Path]]:
    """A servo horn: four trials, two of them a sample late; the first three samples of each were not measured."""
    command = np.concatenate([staircase((0.1, 0.4), (-0.2, 0.5), (0.4, 0.4), (0.0, 0.4)), sine(0.3, 1.5, 1.2)])
    late = np.concatenate([command[:1], command[:-1]])
    bags = []
    for trial, sent in enumerate((command, late, command, late)):
        angles, _ = servo_arm("horn", sent[:, None], stiffness=(9.0,), damping=(0.25,), torque=(8.4,), friction=(0.05,))
        bags.append(to_bag(folder / f"trial_{trial}", ("joint",), sent[:, None], angles, None, seed=trial, unseen=3))
    return {"all": bags}


def unbalanced_labyrinth(folder: Path) -> dict[str, list[Path]]:
    """The emulated labyrinth, whose board is out of balance on y, as README's first step plays it."""
    sequence, table, bag = folder / "short.yaml", folder / "short.csv", folder / "real"
    sequence.write_text(SHORT, encoding="utf-8")
    called(eps_tunnel("sequences", sequence, "--csv", table))
    with contextlib.redirect_stdout(io.StringIO()):
        testbed(["--config", "healthy", "--effect", "gravity_load.y=medium", "--seed", "1", "--trials", "3",
                 "--bag", str(bag), "--commands", str(table)])  # fmt: skip
    return {"all": [bag]}


SHORT = """
description: Three seconds, both axes at once.
initial_deg: {motor_x: 0, motor_y: 0}
command:
  motor_x:
    - hold: {lasts_s: 0.2}
    - step: {to_deg: 3, lasts_s: 0.4}
    - step: {to_deg: -3, lasts_s: 0.4}
    - ramp: {to_deg: 1, lasts_s: 0.6}
    - triangle: {amplitude_deg: 1.5, frequency_hz: 1.25, lasts_s: 0.8}
    - step: {to_deg: 0, lasts_s: 0.6}
  motor_y:
    - hold: {lasts_s: 0.3}
    - step: {to_deg: 2.5, lasts_s: 0.4}
    - step: {to_deg: -2.5, lasts_s: 0.4}
    - ramp: {to_deg: 1, lasts_s: 0.5}
    - sine: {amplitude_deg: 1, frequency_hz: 2.5, lasts_s: 0.8}
    - step: {to_deg: 0, lasts_s: 0.6}
"""


def elbow_friction(folder: Path) -> dict[str, list[Path]]:
    """An arm of two links with dry friction at the elbow: three trials each of two commands."""
    both = np.stack([sine(0.3, 0.8, 2.5), sine(-0.3, 1.2, 2.5)], axis=1)
    elbow = np.stack([sine(0.0, 1.0, 2.5), sine(0.4, 0.6, 2.5)], axis=1)
    bags: dict[str, list[Path]] = {"both": [], "elbow": []}
    for name, sent in (("both", both), ("elbow", elbow)):
        angles, efforts = servo_arm("two_link_arm", sent, stiffness=(100.0, 60.0), damping=(5.0, 2.0),
                                    torque=(15.0, 6.0), friction=(0.0, 0.2))  # fmt: skip
        for trial in range(3):
            where = folder / f"{name}_{trial}"
            bags[name].append(to_bag(where, ("shoulder", "elbow"), sent, angles, efforts, seed=trial))
    return {**bags, "all": [*bags["both"], *bags["elbow"]]}


def servo_arm(
    mjcf: str,
    commands: Array,
    stiffness: Sequence[float],
    damping: Sequence[float],
    torque: Sequence[float],
    friction: Sequence[float],
) -> tuple[Array, Array]:
    """Joints moved by torque = clip(stiffness (target - angle) - damping speed), with dry friction, from rest.

    Args:
        mjcf: one of config/mjcf with a motor for each joint.
        commands: (T, u) rad, each held for STEP; the joints start at the first.
        stiffness, damping, torque, friction: u each, N m/rad, N m s/rad, N m, N m.

    Returns:
        (T, u) rad and (T, u) N m at each command's time.
    """
    model = mujoco.MjModel.from_xml_path(str(MJCF / f"{mjcf}.xml"))
    model.dof_frictionloss[:] = friction
    model.actuator_biastype[:] = mujoco.mjtBias.mjBIAS_AFFINE
    model.actuator_gainprm[:, 0] = stiffness
    model.actuator_biasprm[:, 1:3] = -np.stack([stiffness, damping], axis=1)
    model.actuator_forcelimited[:] = True
    model.actuator_forcerange[:] = np.outer(torque, (-1.0, 1.0))
    data = mujoco.MjData(model)
    data.qpos[:] = data.ctrl[:] = commands[0]
    angles, efforts = np.empty_like(commands), np.empty_like(commands)
    for k, target in enumerate(commands):
        angles[k], efforts[k] = data.qpos, data.qfrc_actuator
        data.ctrl[:] = target
        mujoco.mj_step(model, data, nstep=round(STEP / model.opt.timestep))
    return angles, efforts


def to_bag(
    bag: Path, joints: Sequence[str], commands: Array, angles: Array, efforts: Array | None, seed: int, unseen: int = 0
) -> Path:
    """One trial (T, u) as a bag, with noise on its angles and without its first `unseen` measurements."""
    rng = np.random.default_rng(seed)
    measured = angles + NOISE * rng.standard_normal(angles.shape)
    if efforts is not None:
        measured = np.hstack([measured, efforts + EFFORT_NOISE * rng.standard_normal(efforts.shape)])
    table = bag.with_suffix(".csv")
    kinds = ["target", "angle"] + (["effort"] if efforts is not None else [])
    with table.open("x", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["t", *(f"{joint}_{kind}" for kind in kinds for joint in joints)])
        for k, (sent, seen) in enumerate(zip(commands, measured, strict=True)):
            cells = [f"{v:.9f}" if k >= unseen else "" for v in seen]
            writer.writerow([f"{k * STEP:.3f}", *(f"{v:.9f}" for v in sent), *cells])
    columns = {kind: [f"{joint}={joint}_{kind}" for joint in joints] for kind in kinds}
    effort = ["--effort", *columns["effort"]] if efforts is not None else []
    called(eps_tunnel("import-csv", table, "--time", "t", "--command", *columns["target"],
                      "--position", *columns["angle"], *effort, "--out", bag))  # fmt: skip
    return bag


def called(result: "CompletedProcess[str]") -> str:
    """What a command line printed; fails unless its exit code is 0."""
    assert result.returncode == 0, result.stderr
    return result.stdout
