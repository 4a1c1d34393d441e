# SPDX-License-Identifier: Apache-2.0
"""Models and tables as other people write them, through new-rig."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from command_line import eps_tunnel, refused

from eps_tunnel_analysis.inputs import load_recorded
from eps_tunnel_analysis.new_rig.drive import effort_unit
from eps_tunnel_analysis.new_rig.joints import Sampled, read_robot
from eps_tunnel_analysis.new_rig.tables import csv_bags
from eps_tunnel_analysis.new_rig.write import NewRig, new_rig
from eps_tunnel_analysis.recording import read_all
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import load_model, save_model
from labyrinth_sim.simulate import simulate

STEP = 0.01
TIME = np.arange(300) * STEP
TARGET = 0.5 * np.sin(2.0 * TIME) + 0.2 * np.sin(6.0 * TIME)
ANGLE = np.concatenate([np.zeros(5), TARGET[:-5]])
DISC = """<mujoco model="disc"><compiler angle="radian" autolimits="true"/>
  <option timestep="0.002" integrator="implicitfast"/><worldbody><body>
  <inertial pos="0 0 0" mass="0.4" diaginertia="0.002 0.002 0.002"/>
  <joint name="disc" axis="0 0 1" armature="0.01" range="-1.6 1.6"/></body></worldbody>
  <actuator>{actuators}</actuator></mujoco>"""


def table(file: Path, header: str, *columns: np.ndarray) -> Path:
    """A CSV of time and columns."""
    np.savetxt(file, np.column_stack([TIME, *columns]), fmt="%.9g", delimiter=",", header=header, comments="")
    return file


def made(folder: Path, mjcf: str, csv: Path, **units: str) -> NewRig:
    """A rig of a disc and a table."""
    folder.mkdir(exist_ok=True)
    (folder / "disc.xml").write_text(mjcf)
    robot = read_robot(folder / "disc.xml")
    bags, notes = csv_bags([csv], robot.joints, folder / "bags")
    found = new_rig(robot, read_all(bags), folder, **units)
    return NewRig(found.model, (*notes, *found.notes), found.known)


def alone(folder: Path) -> np.ndarray:
    """What the model does under the target, with the drive on throughout or not, (n,) rad."""
    model = load_model(folder / "model.yaml")
    off = np.where((TIME > 1.0) & (TIME < 1.5), np.nan, TARGET)  # the drive is switched off for a while
    law = model.with_effect("stribeck_friction", "disc")  # acts between MuJoCo's steps
    runs = [simulate(m, TIME, t[:, None]) for m in (model, law) for t in (TARGET, off)]
    return np.concatenate([run.select(["disc"]).values[0, :, 0] for run in runs])


@pytest.mark.parametrize(
    ("actuators", "told", "kept"),
    [
        ('<position joint="disc" kp="100"/>', "has no name in disc.xml; in robot.xml it is called disc", ["disc"]),
        (
            '<position joint="disc" kp="100"/><velocity name="brake" joint="disc" kv="5"/>',
            "uses brake; disc would act in addition and is switched off",
            ["disc", "brake"],
        ),
        (
            '<motor name="m" joint="disc"/><position name="hold" joint="disc" kp="100"/>',
            "uses m; hold would act in addition",
            ["m", "hold"],
        ),
    ],
)
def test_an_actuator_without_a_name_or_beside_another_does_not_act_beside_the_drive(
    tmp_path: Path, actuators: str, told: str, kept: list[str]
) -> None:
    expected = tmp_path / "expected"
    csv = table(tmp_path / "run.csv", "t,target,angle", TARGET, ANGLE)
    assert "switched off" not in " ".join(made(expected, DISC.format(actuators=""), csv).notes)
    found = made(tmp_path, DISC.format(actuators=actuators), csv)
    assert told in " ".join(found.notes)
    mj = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    assert [mj.actuator(i).name for i in range(mj.nu)] == kept
    assert alone(tmp_path) == pytest.approx(alone(expected), abs=1e-9)


def listed(values: np.ndarray, form: str) -> list[str]:
    """Rows (n, m) as one cell each."""
    rows = [[f"{v:.9g}" for v in row] for row in values]
    return [f'"[{", ".join(row)}]"' if form == "[,]" else f"[{' '.join(row)}]" if form == "[ ]" else " ".join(row)
            for row in rows]  # fmt: skip


ARM = """<mujoco model="arm"><compiler angle="radian" autolimits="true"/>
  <option timestep="0.002" integrator="implicitfast"/><worldbody><body>
  <inertial pos="0 0 0" mass="0.4" diaginertia="0.002 0.002 0.002"/>
  <joint name="pan" axis="0 0 1" armature="0.01"/><body>
  <inertial pos="0 0 0" mass="0.1" diaginertia="0.001 0.001 0.001"/>
  <joint name="tilt" axis="0 1 0" armature="0.01"/></body></body></worldbody></mujoco>"""


@pytest.mark.parametrize("form", ["[,]", "[ ]", " "])
def test_columns_of_lists_are_taken_in_the_models_order_of_joints(tmp_path: Path, form: str) -> None:
    targets, angles = np.stack([TARGET, -0.5 * TARGET], axis=1), np.stack([ANGLE, -0.5 * ANGLE], axis=1)
    lines = ["time,action,observation.state,effort"]
    cells = (listed(targets, form), listed(angles, form), listed(angles[:, [0, 1, 1]], form))
    lines += [f"{t:.3f},{','.join(row)}" for t, *row in zip(TIME, *cells, strict=True)]
    (tmp_path / "run.csv").write_text("\n".join(lines))
    (tmp_path / "arm.xml").write_text(ARM)
    robot = read_robot(tmp_path / "arm.xml")
    bags, notes = csv_bags([tmp_path / "run.csv"], robot.joints, tmp_path / "bags")
    told = " ".join(notes)
    assert "Column 'action' is a list, taken in the model's order of joints: pan, tilt." in told
    assert "column 'effort' is left out, because it has 3 numbers per cell, and the model 2 joints." in told
    (recording,) = read_all(bags)
    states, commands = (recording.topics[f"/real/joint_{name}"] for name in ("states", "commands"))
    for i, joint in enumerate(("pan", "tilt")):
        assert states.columns[f"{joint}.position"] == pytest.approx(angles[:, i], abs=1e-8)
        assert commands.columns[f"{joint}.position"] == pytest.approx(targets[:, i], abs=1e-8)
    done = eps_tunnel("import-csv", tmp_path / "run.csv", "--time", "time", "--command", "tilt=action[1]", "--position",
                      "tilt=observation.state[1]", "--out", tmp_path / "one")  # fmt: skip
    assert done.returncode == 0, done.stderr
    (alone,) = read_all([tmp_path / "one"])
    assert alone.topics["/real/joint_states"].columns["tilt.position"] == pytest.approx(angles[:, 1], abs=1e-8)
    refused("import-csv", tmp_path / "run.csv", "--time", "time", "--position", "tilt=action", "--out",
            tmp_path / "two", told=["Unknown column 'action'. Did you mean 'action[1]'"])  # fmt: skip


def test_a_list_of_another_length_is_refused_and_one_of_two_that_do_not_fit_is_told(tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text("t,state\n0,1 2\n1,1 2 3\n")
    with pytest.raises(InputError, match="line 3, column 'state': '1 2 3' is not a list of 2 numbers"):
        csv_bags([tmp_path / "run.csv"], ["a", "b"], tmp_path / "bags")
    (tmp_path / "run.csv").write_text("t,q1[deg],state[0],state[1]\n0,1,5,6\n1,2,5,6\n")
    _, notes = csv_bags([tmp_path / "run.csv"], ["q1"], tmp_path / "bags")
    assert "position of q1 from column 'q1[deg]'" in notes[-1]
    assert "column 'state' is left out, because there is another column of a position" in notes[0]


COUNTS = 4096 / (2 * np.pi)


@pytest.mark.parametrize("direction", [1, -1])
def test_ticks_are_stated_by_their_turn_and_their_zero(tmp_path: Path, direction: int) -> None:
    target, angle = (np.round(1900 + direction * COUNTS * values) for values in (TARGET, ANGLE))
    csv = table(tmp_path / "run.csv", "t,target,angle,disc_speed", target, angle, np.gradient(angle, STEP))
    (tmp_path / "disc.xml").write_text(DISC.format(actuators=""))
    line = ("new-rig", tmp_path / "disc.xml", "--csv", csv, "--no-check", "--out", tmp_path / "out")
    refused(*line, told=["--position-unit ticks --ticks-per-turn 4096 --zero 2048"])
    refused(*line, "--position-unit", "ticks", told=["belong together"])
    refused(*line, "--zero", 3, told=["belong together"])
    ticks = ("--position-unit", "ticks", "--ticks-per-turn", 4096 * direction, "--zero")
    refused(*line, *ticks, "disk=1900", told=["Did you mean 'disc'"])
    done = eps_tunnel(*line, *ticks, 5, "disc=1900")
    assert done.returncode == 0, done.stderr
    assert "in ticks: as --position-unit says" in done.stdout and "1900 where the joint is at 0" in done.stdout
    model = load_model(tmp_path / "out" / "model.yaml")
    assert model.rig.axes[0].limits == (-1.6, 1.6), "the model's; nothing recorded lies beyond"
    (play,) = load_recorded(model, [tmp_path / "out" / "bags"]).plays
    assert play.trials.values[0, :, 0] == pytest.approx(ANGLE[: len(play.trials.time)], abs=0.6 / COUNTS)
    assert play.trials.commands[0, :, 0] == pytest.approx(TARGET[: len(play.trials.time)], abs=0.6 / COUNTS)


def test_whole_numbers_and_a_hundred_exactly_are_doubted(tmp_path: Path) -> None:
    mjcf = DISC.format(actuators="").replace(' range="-1.6 1.6"', "")
    whole = table(tmp_path / "whole.csv", "t,target,angle", np.round(100 + 90 * TARGET), np.round(100 + 90 * ANGLE))
    assert "whole numbers throughout: if these are ticks" in " ".join(made(tmp_path / "a", mjcf, whole).notes)
    scaled = [100 * values / np.abs(TARGET).max() for values in (TARGET, ANGLE)]
    normal = table(tmp_path / "normal.csv", "t,target,angle", *scaled)
    for given in ({}, {"position": "deg"}):
        told = made(tmp_path / f"b{len(given)}", mjcf, normal, **given).notes
        assert any(note.startswith("! disc reaches exactly 100") and "72000/R" in note for note in told)
    other = table(tmp_path / "other.csv", "t,target,angle", 0.99 * scaled[0], 0.99 * scaled[1])
    assert not any("exactly" in note or "whole" in note for note in made(tmp_path / "c", mjcf, other).notes)


def under_a_law(
    stiffness: float, damping: float, friction: float = 0.0, own: float = 0.0, full: float = 1.0
) -> Sampled:
    """A disc of 0.05 kg m^2 and its effort, in `full` N m; the motor's own voltage damps by `own` N m s/rad."""
    angle = speed = 0.0
    seen = []
    for goal in TARGET:
        seen.append((angle, (stiffness * (goal - angle) - damping * speed) / full))
        for _ in range(40):
            torque = stiffness * (goal - angle) - (damping + own) * speed
            moved = speed + STEP / 40 * torque / 0.05
            speed = float(np.sign(moved) * max(abs(moved) - STEP / 40 * friction / 0.05, 0.0))
            angle += STEP / 40 * speed
    angles, efforts = np.array(seen).T
    return Sampled(TIME, TARGET, angles + 1e-5 * np.random.default_rng(0).standard_normal(len(TIME)), efforts)


def test_a_weak_torque_is_told_from_a_duty_by_its_damping_though_the_models_inertia_is_wrong(tmp_path: Path) -> None:
    (tmp_path / "disc.xml").write_text(DISC.format(actuators=""))
    robot = read_robot(tmp_path / "disc.xml")
    torque, duty = under_a_law(1.0, 0.1), under_a_law(4.0, 0.0, own=0.4, full=2.0)
    assert max(np.abs(one.effort).max() for one in (torque, duty)) < 1.0
    unit, why = effort_unit(robot, "disc", [torque], 1.0, 0.0)
    assert unit == "N m" and "damps the joint as it moves" in why
    for sample in (duty, under_a_law(1.0, 0.1, friction=0.1)):
        unit, why = effort_unit(robot, "disc", [sample], 1.0, 0.0)
        assert unit == "duty" and '--effort-unit "N m"' in why and "--effort-unit A" in why


GRIPPER = """<mujoco model="heron">
  <compiler angle="radian" meshdir="assets" autolimits="true"/>
  <option integrator="implicitfast" timestep="0.002"/>
  <default>
    <default class="heron">
      <joint armature="0.01" damping="0.05" frictionloss="0.02"/>
      <position kp="30" dampratio="1"/>
      <default class="neck"><joint axis="0 1 0" range="-1.5 1.5"/><position forcerange="-3.5 3.5"/></default>
      <default class="visual"><geom type="mesh" contype="0" conaffinity="0" group="2" density="0"/></default>
      <default class="collision"><geom type="capsule" group="3" size="0.02" mass="0.2"/></default>
    </default>
  </default>
  <asset><mesh file="shell.obj" scale="0.001 0.001 0.001"/></asset>
  <worldbody>
    <body name="base" childclass="heron"><geom class="visual" mesh="shell"/>
      <body name="upper" pos="0 0 0.1"><joint name="Neck_Pitch" class="neck"/>
        <geom class="visual" mesh="shell"/><geom class="collision" fromto="0 0 0 0 0 0.15"/>
        <body name="lower" pos="0 0 0.15"><joint name="beak" class="neck" range="-0.5 1.1"/>
          <geom class="visual" mesh="shell"/><geom class="collision" fromto="0 0 0 0 0 0.1"/>
          <site name="tip" pos="0 0 0.1"/></body></body></body>
  </worldbody>
  <contact><exclude body1="base" body2="upper"/></contact>
  <actuator>
    <position class="neck" name="neck" joint="Neck_Pitch" inheritrange="1"/>
    <position class="neck" joint="beak" inheritrange="1"/>
  </actuator>
  <sensor><actuatorfrc name="felt" actuator="neck"/><framepos name="where" objtype="site" objname="tip"/></sensor>
  <keyframe><key name="home" qpos="0.3 0.1" ctrl="0.3 0.1"/></keyframe>
</mujoco>"""
SHELL = "v 0 0 0\nv 30 0 0\nv 0 30 0\nv 0 0 60\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def test_a_model_as_in_collections_of_robots_goes_in_and_out_again(tmp_path: Path) -> None:
    """Classes of defaults, meshes in a folder beside it, a force range, sensors, a keyframe; one actuator unnamed."""
    home = tmp_path / "heron"
    (home / "assets").mkdir(parents=True)
    (home / "heron.xml").write_text(GRIPPER)
    (home / "assets" / "shell.obj").write_text(SHELL)
    header = "t,neck_pitch_target,beak_target,neck_pitch,beak"
    csv = table(tmp_path / "run.csv", header, TARGET, 0.5 * TARGET, ANGLE, 0.5 * ANGLE)
    out = tmp_path / "rig"
    done = eps_tunnel("new-rig", home / "heron.xml", "--csv", csv, "--no-check", "--out", out)
    assert done.returncode == 0, done.stderr
    assert "Joint Neck_Pitch is recorded as Neck_Pitch" in done.stdout
    assert "The actuator of joint beak has no name in heron.xml" in done.stdout
    model = load_model(out / "model.yaml")
    assert [(a.joint, a.actuator) for a in model.rig.axes] == [("Neck_Pitch", "neck"), ("beak", "beak")]
    assert model.rig.axes[1].limits == (-0.5, 1.1)
    assert "forcerange in the model" in (out / "model.yaml").read_text()
    made = mujoco.MjModel.from_xml_path(str(out / "robot.xml"))
    assert made.nkey == 1 and made.nmesh == 1 and made.nsensor == 2 and made.key_qpos[0].tolist() == [0.3, 0.1]
    delays = {f"drive.{axis.name}.delay": 0.02 for axis in model.rig.axes}
    named = model.with_effect("coulomb_friction", "beak", {"torque": 0.1}).with_values(delays)
    save_model(named, tmp_path / "better.yaml")
    exported = tmp_path / "elsewhere" / "heron.xml"
    exported.parent.mkdir()
    done = eps_tunnel("export", "--model", tmp_path / "better.yaml", "--mjcf", exported)
    assert done.returncode == 0, done.stderr
    mj = mujoco.MjModel.from_xml_path(str(exported))
    assert mj.nkey == 1 and mj.nmesh == 1 and mj.key_qpos[0].tolist() == [0.3, 0.1]
    targets = np.stack([TARGET, 0.5 * TARGET], axis=1)
    ours = simulate(named, TIME, targets).select(["Neck_Pitch", "beak"]).values[0]
    assert not exported.with_name("heron_effects.py").exists(), "MuJoCo says it all"
    data, seen = mujoco.MjData(mj), []
    for target in targets:
        seen.append(data.qpos.copy())
        data.ctrl[[mj.actuator("neck").id, mj.actuator("beak").id]] = target
        mujoco.mj_step(mj, data, round(STEP / mj.opt.timestep))
    assert np.ptp(ours, axis=0).min() > 0.2
    assert np.array(seen) == pytest.approx(ours, abs=1e-6)
