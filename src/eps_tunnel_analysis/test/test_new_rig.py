# SPDX-License-Identifier: Apache-2.0
"""A rig from nothing but a robot's model and its recordings."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from command_line import eps_tunnel, refused

from eps_tunnel_analysis.inputs import load_recorded
from eps_tunnel_analysis.new_rig.drive import inertia_of, propose_drive
from eps_tunnel_analysis.new_rig.joints import Robot, Sampled, read_robot
from eps_tunnel_analysis.new_rig.tables import csv_bags, lerobot_bags
from eps_tunnel_analysis.new_rig.write import new_rig
from eps_tunnel_analysis.recording import read_all
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.simulate import simulate

STEP = 0.01
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
DISC = """<mujoco model="disc"><compiler angle="radian" autolimits="true"/>
  <option timestep="0.002" integrator="implicitfast"/><worldbody><body>
  <inertial pos="0 0 0" mass="0.4" diaginertia="0.002 0.002 0.002"/>
  <joint name="disc" axis="0 0 1" armature="0.01" range="-1.6 1.6"/></body></worldbody></mujoco>"""


def arm(joints: tuple[str, ...] = JOINTS) -> str:
    """A URDF of a chain of light links."""
    links = "".join(
        f"""<link name="link{i}"><inertial><origin xyz="0 0 0.04"/><mass value="{0.2 - 0.02 * i}"/>
        <inertia ixx="4e-4" iyy="4e-4" izz="2e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
        for i in range(len(joints) + 1)
    )
    hinges = "".join(
        f"""<joint name="{name}" type="revolute"><parent link="link{i}"/><child link="link{i + 1}"/>
        <origin xyz="0 0 0.08"/><axis xyz="{"0 0 1" if i in (0, 4) else "0 1 0"}"/>
        <limit lower="-1.7" upper="1.7" effort="3" velocity="6"/></joint>"""
        for i, name in enumerate(joints)
    )
    return f'<robot name="so101">{links}{hinges}</robot>'


def disc_tables(folder: Path, trials: int = 2) -> list[Path]:
    """A disc under a PD law of 4 N m/rad and 0.25 N m s/rad with 2 N m at most, in ms and degrees."""
    time = np.arange(400) * STEP
    target = 0.6 * np.sin(2.0 * time) + 0.3 * np.sin(5.1 * time)
    files = []
    for trial in range(trials):
        angle = speed = torque = 0.0
        seen = []
        random = np.random.default_rng(trial)
        for goal in target:
            torque = float(np.clip(4.0 * (goal - angle) - 0.25 * speed, -2.0, 2.0))
            seen.append((angle + 1e-4 * random.standard_normal(), torque))
            for _ in range(20):
                torque = float(np.clip(4.0 * (goal - angle) - 0.25 * speed, -2.0, 2.0))
                speed += STEP / 20 * torque / 0.012
                angle += STEP / 20 * speed
        table = np.column_stack(
            [1e3 * time, np.degrees(target), np.degrees([a for a, _ in seen]), [t for _, t in seen]]
        )
        files.append(folder / f"run{trial}.csv")
        np.savetxt(files[-1], table, fmt="%.9g", delimiter=",", header="time_ms,target,angle,torque", comments="")
    return files


def test_a_disc_from_tables_to_values(tmp_path: Path) -> None:
    (tmp_path / "disc.xml").write_text(DISC)
    tables = disc_tables(tmp_path)
    told = eps_tunnel("new-rig", tmp_path / "disc.xml", "--csv", *tables, "--out", tmp_path / "disc", "--candidates",
                      "coulomb_friction", "--threads", 1)  # fmt: skip
    assert told.returncode == 0, told.stderr
    assert "time from column 'time_ms' in ms" in told.stdout
    assert "Effects of axis disc that these commands excite. identifiable: coulomb_friction.disc" in told.stdout
    rig = (tmp_path / "disc" / "rig.yaml").read_text()
    assert "unit: deg}  # deg: reaches" in rig and "one actuator on each driven joint" in rig
    content = yaml.safe_load(rig)
    assert content["sample_time"] == STEP and content["axes"]["disc"]["limits"] == [-1.6, 1.6]
    assert "unit" not in content["axes"]["disc"]["measured"]["disc_effort"], "an effort in N m is told as such"
    model = load_model(tmp_path / "disc" / "model.yaml")
    values = model.values()
    assert model.drives["disc"].kind.name == "torque_pd" and model.unstated() == ()
    assert values["drive.disc.stiffness"] == pytest.approx(4.0, rel=0.1)
    assert values["drive.disc.damping"] == pytest.approx(0.25, rel=0.3)
    recorded = load_recorded(str(model.path), [tmp_path / "disc" / "bags"])
    assert np.abs(recorded.plays[0].trials.commands).max() < 1.0, "rad"
    refused("new-rig", tmp_path / "disc.xml", "--csv", *tables, "--out", tmp_path / "disc", told=["exists already"])


def answered(robot: Robot, joint: str, target: np.ndarray, fastest: float) -> Sampled:
    """How a servo of 0.5 N m/rad, 0.06 N m s/rad that turns no faster than `fastest` rad/s follows a target."""
    inertia, _ = inertia_of(robot, joint)
    angle = speed = 0.0
    seen = []
    for goal in target:
        seen.append(angle)
        for _ in range(20):
            speed += STEP / 20 * (0.5 * (goal - angle) - 0.06 * speed) / inertia
            speed = float(np.clip(speed, -fastest, fastest))
            angle += STEP / 20 * speed
    return Sampled(np.arange(len(target)) * STEP, target, np.array(seen), np.full(len(target), np.nan))


def test_a_recording_that_saturates_does_not_spoil_the_proposed_drive(tmp_path: Path) -> None:
    (tmp_path / "disc.xml").write_text(DISC)
    robot = read_robot(tmp_path / "disc.xml")
    time = np.arange(400) * STEP
    free = answered(robot, "disc", 0.2 * np.sin(2.0 * time) + 0.1 * np.sin(7.0 * time), 9.0)
    saturated = answered(robot, "disc", 1.5 * np.sign(np.sin(4.0 * time)), 0.8)
    found = propose_drive(robot, "disc", [saturated, free, saturated], 1.0, 0.0, "", "none recorded")
    assert found.kind == "torque_pd"
    assert found.values["stiffness"].value == pytest.approx(0.5, rel=0.15)
    assert 0.05 < found.values["torque"].value < 1.0


def jolted(seed: int, size: float, slow: bool) -> Sampled:
    """The disc's answer under 4 N m/rad and 0.05 N m s/rad: steps, or ramps; the current, 0.5 N m/A, noisy."""
    random, time = np.random.default_rng(seed), np.arange(400) * STEP
    target = size * (np.abs((time % 4.0) - 2.0) - 1.0 if slow else np.sign(np.sin(2.0 * time + 0.5)))
    angle, speed, seen, current = float(target[0]), 0.0, [], []
    for goal in target:
        seen.append(angle)
        current.append((4.0 * (goal - angle) - 0.05 * speed) / 0.5)
        for _ in range(20):
            speed += STEP / 20 * (4.0 * (goal - angle) - 0.05 * speed) / 0.012
            angle += STEP / 20 * speed
    noisy = np.array(current) + 0.5 * np.std(current) * random.standard_normal(len(time))
    return Sampled(time, target, np.array(seen), noisy)


def test_a_law_that_all_recordings_show_roughly_is_one_and_tells_what_its_unit_stands_for(tmp_path: Path) -> None:
    (tmp_path / "disc.xml").write_text(DISC)
    robot = read_robot(tmp_path / "disc.xml")
    samples = [jolted(seed, 0.1 * (1 + seed), slow=seed % 2 == 1) for seed in range(4)]
    found = propose_drive(robot, "disc", samples, 1.0, 0.0, "A", "as stated")
    assert found.kind == "torque_pd"
    assert found.values["stiffness"].value == pytest.approx(4.0, rel=0.15), "told by the steps, not by the ramps"
    assert found.factor == pytest.approx(0.5, rel=0.2)
    assert found.values["torque"].value > 4.0 * 0.5 * max(np.abs(s.effort).max() for s in samples), "never seen"
    apart = [replace(s, effort=s.effort * (1 + i)) for i, s in enumerate(samples)]  # each with a gain of its own
    assert propose_drive(robot, "disc", apart, 1.0, 0.0, "A", "as stated").factor is None


PENDULUM = """<mujoco model="pendulum"><compiler angle="radian" autolimits="true"/>
  <option timestep="0.002" integrator="implicitfast"/><worldbody><body>
  <joint name="pendulum" axis="0 1 0" range="-1.6 1.6"/>
  <geom type="sphere" pos="0 0 -0.1" size="0.01" mass="1.0"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize(("weight", "kind"), [(9.81, "pwm_servo"), (0.0, "torque_pd")])
def test_a_drive_that_gives_way_to_the_weight_is_one_by_duty_cycle(tmp_path: Path, weight: float, kind: str) -> None:
    """20 N m/rad under 0.98 N m, with 1.2 N m s/rad of back-EMF; without the weight nothing shows that it gives way."""
    (tmp_path / "pendulum.xml").write_text(PENDULUM)
    robot = read_robot(tmp_path / "pendulum.xml")
    inertia, load = inertia_of(robot, "pendulum")
    assert load == pytest.approx(0.98, rel=0.01)
    time = np.arange(600) * STEP
    target = 0.9 * np.sin(2.0 * time) + 0.4 * np.sin(5.0 * time)
    angle = speed = 0.0
    seen = []
    for goal in target:
        seen.append(angle)
        for _ in range(50):
            torque = 20.0 * (goal - angle) - 1.2 * speed - 0.1 * weight * np.sin(angle)
            speed += STEP / 50 * torque / inertia
            angle += STEP / 50 * speed
    sample = Sampled(time, target, np.array(seen), np.full(len(time), np.nan))
    found = propose_drive(robot, "pendulum", [sample], 1.0, 0.0, "", "none recorded")
    assert found.kind == kind
    if weight:
        values = {name: one.value for name, one in found.values.items()}
        stall = values["torque_constant"] * values["voltage"] / values["resistance"]
        assert values["kp"] * values["duty_gain"] * stall == pytest.approx(20.0, rel=0.1)


def servo_disc(folder: Path, actuator: str) -> Robot:
    """The disc with an actuator of its own."""
    actuators = f'<actuator><{actuator} name="m" joint="disc"/></actuator></mujoco>'
    (folder / "servo.xml").write_text(DISC.replace("</mujoco>", actuators))
    return read_robot(folder / "servo.xml")


def stiff(robot: Robot) -> Sampled:
    """How a servo of 200 N m/rad with 0.4 N m at most, which saturates at each step, follows jumps and a sine."""
    time = np.arange(500) * STEP
    target = 0.4 * np.sin(2.0 * time) + 0.3 * (np.sin(1.3 * time) > 0.0)
    inertia, _ = inertia_of(robot, "disc")
    angle = speed = 0.0
    seen = []
    for goal in target:
        seen.append(angle)
        for _ in range(50):
            speed += STEP / 50 * float(np.clip(200.0 * (goal - angle) - 0.9 * speed, -0.4, 0.4)) / inertia
            angle += STEP / 50 * speed
    return Sampled(time, target, np.array(seen), np.full(len(time), np.nan))


@pytest.mark.parametrize("gear", [1.0, 2.0])
def test_the_models_own_servo_is_taken_where_it_moves_as_was_recorded(tmp_path: Path, gear: float) -> None:
    servo = f'kp="{180.0 / gear**2}" kv="{1.0 / gear**2}" forcerange="-{0.4 / gear} {0.4 / gear}" gear="{gear}"'
    robot = servo_disc(tmp_path, f"position {servo}")
    found = propose_drive(robot, "disc", [stiff(robot)], 1.0, 0.0, "", "none recorded")
    assert found.kind == "torque_pd" and found.why.startswith("the model's own position servo matches")
    values = {name: one.value for name, one in found.values.items()}
    assert values == pytest.approx({"stiffness": 180.0, "damping": 1.0, "torque": 0.4, "delay": 0.0})
    assert found.values["stiffness"].why == "the actuator's kp in the model"


@pytest.mark.parametrize(
    "actuator",
    [
        'position kp="1" forcerange="-0.4 0.4"',
        "motor",
        'velocity kv="3"',
        'position kp="180" kv="1" timeconst="0.1" forcerange="-0.4 0.4"',
    ],
)
def test_a_model_without_a_servo_that_fits_gets_its_drive_from_the_response(tmp_path: Path, actuator: str) -> None:
    robot = servo_disc(tmp_path, actuator)
    found = propose_drive(robot, "disc", [stiff(robot)], 1.0, 0.0, "", "none recorded")
    assert "position servo" not in found.why
    assert found.values["stiffness"].value > 2.0 if "stiffness" in found.values else found.kind == "velocity_pid"


def played(model: Model, seconds: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    time = np.arange(int(seconds / STEP)) * STEP
    random = np.random.default_rng(seed)
    count = len(model.rig.axes)
    target = 0.25 * np.sin(np.outer(time, random.uniform(2.0, 5.0, count)))
    seen = simulate(model, time, target).select([axis.measured[0].signal for axis in model.rig.axes])
    return time, target, seen.values[0] + 1e-4 * random.standard_normal(target.shape)


def test_a_six_joint_arm_from_a_urdf_through_the_loop(tmp_path: Path) -> None:
    """From nothing: the arm's own simulation with other values stands for the rig; each joint is found and fitted."""
    (tmp_path / "so101.urdf").write_text(arm())
    robot = read_robot(tmp_path / "so101.urdf")
    assert robot.joints == JOINTS
    time = np.arange(200) * STEP
    target = 0.25 * np.sin(np.outer(time, np.linspace(2.0, 5.0, 6)))
    late = np.vstack([np.zeros((3, 6)), target[:-3]])
    files = write_tables(tmp_path, time, target, late)
    bags, notes = csv_bags(files, robot.joints, tmp_path / "bags")
    assert "position of wrist_roll from column 'wrist_roll.pos'" in notes[0]
    made = new_rig(robot, read_all(bags), tmp_path)
    model = load_model(made.model)
    assert [axis.name for axis in model.rig.axes] == list(JOINTS) and model.unstated() == ()
    assert all(number.source for use in model.drives.values() for number in use.values.values())
    truth = model.with_values({f"drive.{j}.delay": 0.02 for j in JOINTS})
    (tmp_path / "truth").mkdir()
    files = write_tables(tmp_path / "truth", *played(truth, 1.5, 1))
    bags, _ = csv_bags(files, robot.joints, tmp_path / "truth" / "bags")
    out = tmp_path / "fitted.yaml"
    done = eps_tunnel("calibrate", "--real", *bags, "--model", made.model, "--free", "drive.*.delay", "--out", out,
                      "--budget", 40, "--progress", "none", "--threads", 1, "--json")  # fmt: skip
    assert done.returncode == 0, done.stderr
    fitted = json.loads(done.stdout)["values"]
    assert fitted == pytest.approx({f"drive.{j}.delay": 0.02 for j in JOINTS}, abs=2e-3)


def write_tables(folder: Path, time: np.ndarray, target: np.ndarray, angle: np.ndarray) -> list[Path]:
    names = [*(f"{j}.cmd" for j in JOINTS), *(f"{j}.pos" for j in JOINTS)]
    file = folder / "run.csv"
    np.savetxt(file, np.column_stack([time, target, angle]), fmt="%.9g", delimiter=",",
               header=",".join(["timestamp", *names]), comments="")  # fmt: skip
    return [file]


def lerobot(folder: Path, **changed: object) -> np.ndarray:
    """A dataset of two episodes of 25 frames; `changed` replaces columns, or what info.json says. Returns the states,
    (50, 6) deg."""
    pyarrow = pytest.importorskip("pyarrow", reason="LeRobot datasets need pyarrow")
    from pyarrow import parquet

    time = np.arange(50) / 30.0
    state = np.degrees(0.4 * np.sin(np.outer(time, np.arange(1, 7))))
    rows = {"episode_index": np.repeat([0, 1], 25), "frame_index": np.tile(np.arange(25), 2),
            "observation.state": list(state), "action": list(state + 1.0)}  # fmt: skip
    names = {"names": [f"{j}.pos" for j in JOINTS]}
    info = {"fps": 30, "features": {"observation.state": names, "action": names}}
    (folder / "data" / "chunk-000").mkdir(parents=True)
    table = pyarrow.table({**rows, **{name: value for name, value in changed.items() if name in rows}})
    parquet.write_table(table, folder / "data" / "chunk-000" / "file-000.parquet")
    (folder / "meta").mkdir()
    (folder / "meta" / "info.json").write_text(json.dumps({**info, **{k: v for k, v in changed.items() if k in info}}))
    return state


HALF = [[1.0] * 6, *[[1.0] * 3] * 49]


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"fps": 0}, "0 frames a second"),
        ({"fps": 1e300}, "1e+300 frames a second"),
        ({"features": {"observation.state": {"names": {}}}}, "of []; expected"),
        ({"features": {"observation.state": {"names": ["a", "!"]}}}, "of ['a', '']"),
        ({"features": []}, "info.json: cannot be read"),
        ({"observation.state": HALF}, "file-000.parquet: cannot be read"),
        ({"observation.state": [[1.0] * 3] * 50}, "rows of (3,) numbers where 6 are expected"),
        ({"frame_index": [None] * 50}, "must be numbers from 0"),
        ({"episode_index": [1e300] * 50}, "must be numbers from 0"),
        ({"episode_index": ["x"] * 50}, "file-000.parquet: cannot be read"),
    ],
)
def test_a_damaged_lerobot_dataset_is_refused(tmp_path: Path, changed: dict[str, object], told: str) -> None:
    lerobot(tmp_path / "set", **changed)
    (tmp_path / "arm.urdf").write_text(arm())
    line = ("new-rig", tmp_path / "arm.urdf", "--lerobot", tmp_path / "set", "--out", tmp_path / "out", "--no-check")
    refused(*line, told=[told])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["arm.urdf", "set"]


def test_a_parquet_file_that_is_none_is_refused(tmp_path: Path) -> None:
    lerobot(tmp_path)
    (file,) = tmp_path.rglob("*.parquet")
    whole = file.read_bytes()
    for content in (b"", b"PAR1", whole[: len(whole) // 2], whole[:40] + bytes(400) + whole[440:]):
        file.write_bytes(content)
        with pytest.raises(InputError, match=r"file-000.parquet: cannot be read"):
            lerobot_bags(tmp_path, tmp_path / "bags")


def test_lerobot_episodes_become_bags(tmp_path: Path) -> None:
    state = lerobot(tmp_path)
    bags, notes = lerobot_bags(tmp_path, tmp_path / "bags")
    assert len(bags) == 2 and "2 episodes at 30 Hz" in notes[0]
    (recording, _) = read_all(bags)
    assert recording.topics["/real/joint_states"].joints == JOINTS
    assert recording.topics["/real/joint_states"].columns["gripper.position"] == pytest.approx(state[:25, 5])
    assert np.diff(recording.stamps("/real/joint_states")) == pytest.approx(1e9 / 30, rel=1e-6)


def test_what_does_not_match_is_told_with_what_to_write(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(arm(("a", "b")))
    robot = read_robot(tmp_path / "arm.urdf")
    (tmp_path / "t.csv").write_text("when,a\n0,1\n1,2\n")
    with pytest.raises(InputError, match=r"no column of time.*it has when, a.*import-csv"):
        csv_bags([tmp_path / "t.csv"], robot.joints, tmp_path / "bags")
    (tmp_path / "u.csv").write_text("t,left,right\n0,1,1\n0.1,2,1\n0.2,2,1\n")
    with pytest.raises(InputError, match="no column of a position"):
        csv_bags([tmp_path / "u.csv"], robot.joints, tmp_path / "bags")
    refused(
        "new-rig", tmp_path / "none.xml", "--csv", tmp_path / "u.csv", "--out", tmp_path / "o", told=["no such file"]
    )
    (tmp_path / "v.csv").write_text("t,a,b\n0,0,1\n0.1,0.2,1\n0.2,0.1,1\n")
    bags, _ = csv_bags([tmp_path / "v.csv"], robot.joints, tmp_path / "bags2")
    with pytest.raises(InputError, match="hold no commands"):
        new_rig(robot, read_all(bags), tmp_path)
    with pytest.raises(InputError, match="--match a=x: no such pair"):
        new_rig(robot, read_all(bags), tmp_path, {"a": "x"})
