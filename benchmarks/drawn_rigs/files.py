# SPDX-License-Identifier: Apache-2.0
"""What a user would have of a drawn rig: an MJCF, a rig file and a model file with the stated values, and bags.

Bags are written by the project's own writer, message by message as a recorder would have got them, stamps as recorded.
"""

import hashlib
from collections.abc import Sequence
from pathlib import Path as File
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from drawn_rigs.reading import BagWriter, typestore
from drawn_rigs.reality import Trial
from drawn_rigs.rigs import Rig

EPOCH = 1_700_000_000  # s; a fixed date, so that the same seed writes the same messages
LATENCY = 0.002  # s from a stamp to the recorder
JOINT_STATE, TRIAL = "sensor_msgs/msg/JointState", "labyrinth_msgs/msg/Trial"
QUANTITIES = {"motor": "position", "load": "position", "motor_speed": "velocity", "torque": "torque"}
COLUMNS = {"_velocity": 1, "_effort": 2}
UNITS = {
    "p": "1/s", "i": "1/s^2", "d": "1/s", "delay": "s", "speed_gain": "N m s/rad", "torque": "N m", "goal_tick": "rad",
    "feedback_tick": "rad",
    "stiffness": "N m/rad", "damping": "N m s/rad", "kp": "1", "duty_gain": "1/rad", "voltage": "V",
    "resistance": "ohm", "torque_constant": "N m/A",
}  # fmt: skip


def write_rig(folder: File, rig: Rig, rate: float) -> File:
    """rig.xml, rig.yaml and model.yaml in a folder; returns the model's."""
    (folder / "rig.xml").write_text(MJCF[rig.kind](rig), encoding="utf-8")
    axes: dict[str, Any] = {}
    for i, name in enumerate(rig.axes):
        belt = rig.joints != rig.loads
        axes[name] = {"command": rig.joints[i], "actuator": rig.joints[i], "joint": rig.joints[i]}
        axes[name] |= {"load_joint": rig.loads[i], "belt": f"belt_{name}"} if belt else {}
        measured = {}
        for signal, sensor in rig.reality.sensors.items():
            if sensor.axis == i:
                joint = rig.loads[i] if sensor.quantity == "load" else rig.joints[i]
                measured[signal] = {"joint": joint, "quantity": QUANTITIES[sensor.quantity]}
                if measured[signal]["quantity"] == "position":
                    measured[signal]["resolution"] = round(sensor.tick, 9)
        axes[name]["measured"] = measured
    _dump(folder / "rig.yaml", {"name": "rig", "mjcf": "rig.xml", "sample_time": 1.0 / rate, "axes": axes})
    drives = {}
    for i, name in enumerate(rig.axes):
        values = {key: _value(number, UNITS[key]) for key, number in rig.drives[i].items()}
        drives[name] = {"kind": rig.law, "values": values}
    effects = []
    for i, name in enumerate(rig.axes if rig.friction else ()):
        torque, damping = rig.friction[i]
        effects += [
            {"name": "coulomb_friction", "place": name, "values": {"torque": _value(torque, "N m")}},
            {"name": "viscous_friction", "place": name, "values": {"damping": _value(damping, "N m s/rad")}},
        ]
    _dump(folder / "model.yaml", {"name": "model", "rig": "rig.yaml", "drives": drives, "effects": effects})
    return folder / "model.yaml"


def _value(number: float, unit: str) -> dict[str, Any]:
    return {"value": float(number), "unit": unit, "from": "data sheet"}


def _dump(file: File, content: dict[str, Any]) -> None:
    file.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def _labyrinth(rig: Rig) -> str:
    n = rig.stated
    motors = "".join(
        f'<body name="motor_{a}"><inertial pos="0 0 0" mass="0.02" diaginertia="1e-6 1e-6 1e-6"/>'
        f'<joint name="motor_{a}" axis="{axis}" armature="{n[f"armature_{a}"]:.9g}"/></body>'
        for a, axis in (("x", "1 0 0"), ("y", "0 1 0"))
    )
    belts = "".join(
        f'<fixed name="belt_{a}" stiffness="{n[f"stiffness_{a}"]:.9g}" damping="{n[f"damping_{a}"]:.9g}" '
        f'springlength="0 0"><joint joint="motor_{a}" coef="1"/><joint joint="board_{a}" coef="-1"/></fixed>'
        for a in "xy"
    )
    return _mjcf(
        '<body name="frame">'
        f'<inertial pos="0 0 0" mass="0.15" diaginertia="{_three(n, "frame")}"/>'
        '<joint name="board_x" axis="1 0 0" range="-0.1396263 0.1396263"/>'
        '<body name="board">'
        f'<inertial pos="0 0 0" mass="0.3" diaginertia="{_three(n, "board")}"/>'
        f'<joint name="board_y" axis="0 1 0" range="-0.1396263 0.1396263"/></body></body>{motors}',
        rig,
        f"<tendon>{belts}</tendon>",
    )


def _three(n: Any, body: str) -> str:
    return " ".join(f"{n[f'{body}_{axis}']:.9g}" for axis in "xyz")


def _pendulum(rig: Rig) -> str:
    n = rig.stated
    about = f"{n['about_mass']:.9g}"
    return _mjcf(
        f'<body name="pendulum"><inertial pos="0 0 {-n["below"]:.9g}" mass="{n["mass"]:.9g}" '
        f'diaginertia="{about} {about} {about}"/>'
        f'<joint name="pendulum" axis="0 1 0" armature="{n["armature"]:.9g}"/></body>',
        rig,
    )


def _two_link_arm(rig: Rig) -> str:
    n = rig.stated
    text = ""
    for i, (body, at) in enumerate((("upper_arm", 0.7), ("forearm", -n["link"])), start=1):
        about = f"{n[f'inertia_{i}']:.9g}"
        text += (
            f'<body name="{body}" pos="0 0 {at:.9g}"><inertial pos="0 0 {-n[f"below_{i}"]:.9g}" '
            f'mass="{n[f"mass_{i}"]:.9g}" diaginertia="{about} {about} {0.5 * n[f"inertia_{i}"]:.9g}"/>'
            f'<joint name="{rig.joints[i - 1]}" axis="0 1 0" armature="{n[f"armature_{i}"]:.9g}" '
            f'damping="{n[f"damping_{i}"]:.9g}"/>'
        )
    return _mjcf(f"{text}</body></body>", rig)


MJCF = {"labyrinth": _labyrinth, "pendulum": _pendulum, "two_link_arm": _two_link_arm}


def _mjcf(bodies: str, rig: Rig, more: str = "") -> str:
    motors = "".join(f'<motor name="{joint}" joint="{joint}"/>' for joint in rig.joints)
    return (
        f'<mujoco model="rig"><compiler angle="radian" autolimits="true"/>'
        f'<option timestep="0.002" integrator="implicitfast"/><worldbody>{bodies}</worldbody>{more}'
        f"<actuator>{motors}</actuator></mujoco>\n"
    )


def write_bags(folder: File, rig: Rig, name: str, trials: Sequence[Trial], seconds: float, marked: bool) -> list[File]:
    """One bag with trial marks, or one for each trial without them."""
    digest = hashlib.sha256(trials[0].commands.tobytes()).hexdigest()
    metadata = {"sequence": name, "sequence_hash": digest}
    if marked:
        begins = [1.0 + i * (seconds + 3.0) for i in range(len(trials))]
        return [_write(folder / name, rig, trials, begins, metadata, seconds)]
    return [_write(folder / f"{name}_{i}", rig, [t], [1.0], metadata, None) for i, t in enumerate(trials)]


def _write(
    folder: File,
    rig: Rig,
    trials: Sequence[Trial],
    begins: Sequence[float],
    metadata: dict[str, str],
    marks: float | None,
) -> File:
    messages: list[tuple[int, str, bytes]] = []
    names = list(rig.joints)
    readings = list(trials[0].readings)
    joints = list(dict.fromkeys(s.removesuffix("_velocity").removesuffix("_effort") for s in readings))
    for number, (trial, begin) in enumerate(zip(trials, begins, strict=True)):
        if marks is not None:
            for phase, at in ((0, begin), (1, begin + marks)):
                messages.append((_ns(at), "/real/trial", _mark(_ns(at), phase, metadata, number, marks)))
        stamps = [_ns(begin + t) for t in trial.command_stamps]
        rows = _joint_states(stamps, names, [trial.commands, np.empty((len(stamps), 0)), np.empty((len(stamps), 0))])
        messages += [(at, "/real/joint_commands", row) for at, row in zip(stamps, rows, strict=True)]
        stamps = [_ns(begin + t) for t in trial.stamps]
        columns = [np.full((len(stamps), len(joints)), np.nan) for _ in range(3)]
        for signal, values in trial.readings.items():
            suffix = next((s for s in COLUMNS if signal.endswith(s)), "")
            columns[COLUMNS.get(suffix, 0)][:, joints.index(signal.removesuffix(suffix) if suffix else signal)] = values
        rows = _joint_states(stamps, joints, columns)
        messages += [(at, "/real/joint_states", row) for at, row in zip(stamps, rows, strict=True)]
    with BagWriter(folder, metadata) as writer:
        for topic in ("/real/joint_commands", "/real/joint_states"):
            writer.add_topic(topic, JOINT_STATE)
        if marks is not None:
            writer.add_topic("/real/trial", TRIAL)
        for at, topic, row in sorted(messages, key=lambda m: m[0]):
            writer.write(topic, at + round(LATENCY * 1e9), row)
    return folder


def _ns(seconds: float) -> int:
    return EPOCH * 10**9 + round(seconds * 1e9)


def _joint_states(stamps: Sequence[int], names: Sequence[str], columns: Sequence[NDArray[np.float64]]) -> list[bytes]:
    """Serialised messages (CDR), all of one layout: one is serialised by the book, the numbers are put into copies."""
    store = typestore()
    kinds = store.types
    marker = 1.2345678912345e-7
    header = kinds["std_msgs/msg/Header"](stamp=kinds["builtin_interfaces/msg/Time"](sec=0, nanosec=0), frame_id="")
    fields = [np.full(c.shape[1], marker) for c in columns]
    message = kinds[JOINT_STATE](
        header=header, name=list(names), position=fields[0], velocity=fields[1], effort=fields[2]
    )
    one = np.frombuffer(bytes(store.serialize_cdr(message, JOINT_STATE)), dtype=np.uint8)
    rows = np.tile(one, (len(stamps), 1))
    sent = np.asarray(stamps, dtype=np.int64)
    rows[:, 4:8] = (sent // 10**9).astype("<i4")[:, None].view(np.uint8)
    rows[:, 8:12] = (sent % 10**9).astype("<u4")[:, None].view(np.uint8)
    raw, wanted, at = one.tobytes(), np.float64(marker).tobytes(), 0
    for column in columns:
        if column.shape[1]:
            at = raw.index(wanted, at)
            size = 8 * column.shape[1]
            rows[:, at : at + size] = np.ascontiguousarray(column, dtype="<f8").view(np.uint8).reshape(len(rows), size)
            at += size
    return [row.tobytes() for row in rows]


def _mark(at: int, phase: int, metadata: dict[str, str], trial: int, seconds: float) -> bytes:
    store = typestore()
    kinds = store.types
    time = kinds["builtin_interfaces/msg/Time"](sec=at // 10**9, nanosec=at % 10**9)
    header = kinds["std_msgs/msg/Header"](stamp=time, frame_id="")
    mark = kinds[TRIAL](header=header, phase=phase, trial=trial, duration=seconds, **metadata)
    return bytes(store.serialize_cdr(mark, TRIAL))
