# SPDX-License-Identifier: Apache-2.0
"""What is exported moves as our own simulation does: one command through both."""

import ast
import importlib.util
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np
import pytest

from labyrinth_sim.effect import drives, effects
from labyrinth_sim.errors import InputError
from labyrinth_sim.export.export import Exported, export
from labyrinth_sim.model import DriveUse, Model, load_model
from labyrinth_sim.rig import BALL_SIGNALS
from labyrinth_sim.simulate import simulate

STEPS = 60
ON_AXES = [name for name, effect in effects().items() if effect.where != "ball" and "ball" not in effect.needs]


def commands(model: Model, size: float = 0.3) -> np.ndarray:
    """(STEPS, u) rad: steps and ramps."""
    time = np.arange(STEPS) * model.rig.sample_time
    own = [size * np.sign(np.sin(12.0 * time + i)) * np.minimum(2.0 * time, 1.0) for i in range(len(model.rig.axes))]
    return np.stack(own, axis=1)


def imported(exported: Exported, folder: Path) -> ModuleType:
    file = folder / "exported.py"
    file.write_text(exported.module)
    spec = importlib.util.spec_from_file_location("exported", file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def played(exported: Exported, folder: Path, targets: np.ndarray) -> list[dict[str, float]]:
    """Signals at the start of each sample, by nothing but the files."""
    (folder / "exported.xml").write_text(exported.mjcf)
    mj = mujoco.MjModel.from_xml_path(str(folder / "exported.xml"))
    data = mujoco.MjData(mj)
    if not exported.module:
        return by_ctrl(mj, data, targets)
    sim = imported(exported, folder).Simulation(mj, data)
    sim.reset(targets[0])
    seen = []
    for target in targets:
        before = sim.measure()
        sim.step(target)
        seen.append(before)
    return seen


def by_ctrl(mj: mujoco.MjModel, data: mujoco.MjData, targets: np.ndarray) -> list[dict[str, float]]:
    """The same where the MJCF is enough: targets are the controls, for 10 ms each."""
    seen = []
    for target in targets:
        position = {mj.joint(i).name: float(data.qpos[i]) for i in range(mj.njnt)}
        speed = {f"{mj.joint(i).name}_velocity": float(data.qvel[i]) for i in range(mj.njnt)}
        seen.append({**position, **speed})
        for i in range(mj.nu):
            if not mj.actuator(i).name.endswith("_emf"):
                data.ctrl[i] = target[mj.actuator_group[i] - 1]
        mujoco.mj_step(mj, data, round(0.01 / mj.opt.timestep))
    return seen


def apart(model: Model, folder: Path, targets: np.ndarray) -> float:
    """Largest difference of positions and speeds, over the size of each signal's motion."""
    time = np.arange(len(targets)) * model.rig.sample_time
    ours = simulate(model, time, targets, with_ball=model.rig.ball is not None)
    theirs = played(export(model), folder, targets)
    worst = 0.0
    for column, name in enumerate(ours.signals):
        if name in BALL_SIGNALS or name.endswith("_effort"):
            continue
        values = ours.values[0, :, column]
        other = np.array([row[name] for row in theirs])
        worst = max(worst, float(np.abs(values - other).max() / max(np.ptp(values), 1e-3)))
    return worst


@pytest.mark.parametrize("name", ON_AXES)
def test_each_effect_is_exported_as_it_acts(name: str, tmp_path: Path) -> None:
    for rig in ("two_link_arm", "labyrinth"):
        model = load_model(rig)
        if rig == "labyrinth" and model.rig.ball:
            model = alone(model)
        if model.places(name):
            model = model.with_effect(name, model.places(name)[0])
            assert apart(model, tmp_path, commands(model, 0.3 if rig == "two_link_arm" else 0.1)) < 1e-6, rig
            return
    pytest.fail(f"{name} acts nowhere on either rig")


@pytest.mark.parametrize("name", [name for name, effect in effects().items() if effect.steps_with])
def test_a_step_with_nothing_to_do_is_left_out(name: str, tmp_path: Path) -> None:
    model = load_model("two_link_arm")
    effect = model.registry.effects[name]
    needed = next(p for p in effect.parameters if p.name == effect.steps_with)
    says = f"def {name}_{'step' if effect.step else 'error'}("
    assert says not in export(model.with_effect(name, "elbow", {needed.name: 0.0})).module
    acting = model.with_effect(name, "elbow", {needed.name: 0.5 * needed.high})
    assert says in export(acting).module
    assert apart(acting, tmp_path, commands(acting, 0.3)) < 1e-6


def alone(model: Model) -> Model:
    """The model on its rig without the ball, which no effect here needs."""
    rig = replace(model.rig, mjcf=model.rig.mjcf_without_ball or model.rig.mjcf, mjcf_without_ball=None, ball=None)
    return replace(model, rig=rig)


@pytest.mark.parametrize("name", ["labyrinth", "pendulum", "horn", "two_link_arm", "labyrinth_mx64"])
def test_each_drive_is_exported_as_it_acts(name: str, tmp_path: Path) -> None:
    model = alone(load_model(name))
    changes = {f"drive.{axis.name}.delay": 0.013 for axis in model.rig.axes}
    changes |= {f"drive.{a.name}.i": 3.0 for a in model.rig.axes if f"drive.{a.name}.i" in model.parameters()}
    model = model.with_values(changes)
    targets = commands(model, 0.1)
    targets[20:25, 0] = np.nan  # switched off for a while
    assert apart(model, tmp_path, targets) < 1e-6


def driven(kind: str) -> Model:
    """An arm with a kind of drive on both axes, at its typical values."""
    model = load_model("two_link_arm")
    return replace(model, drives={axis: DriveUse(drives()[kind], {}) for axis in model.drives})


@pytest.mark.parametrize("kind", drives())
def test_the_table_says_of_every_value_of_a_drive_where_it_went(kind: str, tmp_path: Path) -> None:
    """Another value changes the files that the table names, and moves the exported files as our own simulation."""
    model = driven(kind)
    changed = {}
    for name, info in model.parameters().items():
        if name.startswith("drive.elbow."):
            up = info.value + 0.03 * (info.high - info.low)
            changed[name] = up if up <= info.high else info.value - 0.03 * (info.high - info.low)
    files = export(model)
    for name, value in changed.items():
        others = export(model.with_values({name: value}))
        (where,) = (p.where for p in others.placements if p.name == name)
        assert where in ("MJCF", "module", "MJCF and module"), name
        assert ("MJCF" in where) == (others.mjcf != files.mjcf), (name, where)
        assert "module" not in where or others.module != files.module, (name, where)
    assert apart(model.with_values(changed), tmp_path, commands(model)) < 1e-6


@cache
def plain(name: str) -> tuple[Model, Exported]:
    """A model and its files, without an effect."""
    model = load_model(name)
    return model, export(model)


@pytest.mark.parametrize("name", effects())
def test_the_table_says_of_every_value_of_an_effect_where_it_went(name: str) -> None:
    """It names the files that the effect changes, on an arm and on a board behind belts."""
    seen = set()
    for model, without in map(plain, ("two_link_arm", "labyrinth")):
        for place in model.places(name)[:1]:
            exported = export(model.with_effect(name, place))
            told = {p.name: p.where for p in exported.placements if p.name.startswith(f"{name}.{place}.")}
            assert set(told) == {f"{name}.{place}.{p.name}" for p in effects()[name].parameters}
            went = set(" and ".join(told.values()).split(" and "))
            assert ("MJCF" in went) == (exported.mjcf != without.mjcf)
            assert ("module" in went) == (exported.module != without.module)
            seen |= went
    assert seen and seen <= {"MJCF", "module", "no"}, "at its typical values it does something"


def test_without_anything_between_steps_the_mjcf_is_enough(tmp_path: Path) -> None:
    model = load_model("two_link_arm").with_effect("coulomb_friction", "elbow", {"torque": 0.3})
    exported = export(model)
    assert exported.module == "" and {p.where for p in exported.placements} <= {"MJCF", "off"}
    assert apart(model, tmp_path, commands(model)) < 1e-9


@pytest.mark.parametrize("kind", drives())
def test_a_delay_of_whole_samples_alone_is_the_actuators_own(kind: str, tmp_path: Path) -> None:
    """It is late by exactly that, for long; where more acts between the steps the module has it."""
    model = driven(kind)
    late = {"drive.shoulder.delay": 0.03, "drive.elbow.delay": 0.0}
    model = model.with_values({n: 0.0 if n.endswith(("delay", "_tick", ".i")) else v
                               for n, v in model.values().items() if n.startswith("drive.")} | late)  # fmt: skip
    exported = export(model)
    where = {p.name: p for p in exported.placements}
    own = where["drive.shoulder.delay"]
    assert where["drive.elbow.delay"].where == "off"
    time = np.arange(1500) * model.rig.sample_time
    targets = 0.3 * np.stack([np.sign(np.sin(5.0 * time)) * np.minimum(time, 1.0), np.sin(7.0 * time)], axis=1)
    if kind == "velocity_pid":  # whose law makes the control
        assert own.where == "module" and exported.module
    else:
        assert own.where == "MJCF" and "3 samples less half a step" in own.how and exported.module == ""
        mj = mujoco.MjModel.from_xml_string(exported.mjcf)
        delays = [float(mj.actuator_delay[mj.actuator(axis.actuator).id]) for axis in model.rig.axes]
        assert delays == [pytest.approx(0.03, abs=0.0011), 0.0]
        assert apart(model.with_values({"drive.shoulder.delay": 0.02}), tmp_path, targets[:200]) < 1e-6
    assert apart(model, tmp_path, targets) < 1e-6


def test_a_delay_off_the_grid_of_samples_stays_in_the_module_and_the_table_says_why(tmp_path: Path) -> None:
    model = driven("torque_pd").with_values({"drive.shoulder.delay": 0.013, "drive.elbow.delay": 0.02})
    exported = export(model)
    told = {p.name: p for p in exported.placements}
    assert told["drive.shoulder.delay"].where == told["drive.elbow.delay"].where == "module"
    assert "would need a whole number of samples of 0.01 s" in told["drive.shoulder.delay"].how
    assert apart(model, tmp_path, commands(model)) < 1e-6


def test_the_module_needs_numpy_and_mujoco_only(tmp_path: Path) -> None:
    model = alone(
        load_model("labyrinth").with_effect("stribeck_friction", "x").with_effect("sensor_quantisation", "motor_x")
    )
    exported = export(model)
    names = {
        part.split(".")[0]
        for node in ast.walk(ast.parse(exported.module))
        for part in ([a.name for a in node.names] if isinstance(node, ast.Import)
                     else [node.module] if isinstance(node, ast.ImportFrom) else [])
    }  # fmt: skip
    assert names <= {"math", "types", "numpy", "mujoco"}
    assert "labyrinth_sim" not in exported.module
    where = {p.name: p.where for p in exported.placements}
    assert where["stribeck_friction.x.extra"] == "module" and where["drive.x.torque"] == "MJCF"


def test_the_ball_s_world_goes_into_the_mjcf(tmp_path: Path) -> None:
    model = load_model("labyrinth").with_effect("board_not_level", "x", {"angle": 0.02})
    model = model.with_effect("rolling_friction", "ball").with_effect("camera_latency", "ball")
    exported = export(model)
    mj = mujoco.MjModel.from_xml_string(exported.mjcf)
    assert abs(mj.opt.gravity[1]) == pytest.approx(9.81 * np.sin(0.02), rel=1e-3)
    where = {p.name: p.where for p in exported.placements}
    assert where["camera_latency.ball.delay"] == "no" and where["rolling_friction.ball.coefficient"] == "MJCF"


def test_an_effect_that_needs_more_is_refused(tmp_path: Path) -> None:
    (tmp_path / "effects").mkdir()
    (tmp_path / "effects" / "shaky.py").write_text(
        """
import numpy as np
from scipy.signal import lfilter
from labyrinth_sim.effect import Effect, Parameter
from labyrinth_sim.filters import Map


def command(values, site, step, start):
    return Map(lambda target: lfilter([1.0], [1.0], target) + values["size"][:, None])


EFFECT = Effect(
    name="shaky", title="t", physics="p", equation="e",
    parameters=(Parameter("size", "rad", 0.0, 1.0, 0.0, 0.1, "w"),),
    stage="command", mark="m", shows="passing", confused_with=(), separated_by="s", command=command,
)
"""
    )
    model = load_model("two_link_arm", tmp_path / "effects").with_effect("shaky", "elbow")
    with pytest.raises(InputError, match=r"shaky.py: uses 'scipy.signal'"):
        export(model)
