# SPDX-License-Identifier: Apache-2.0
"""Tables logged by other programs, as bags: CSV files whose columns are found by name, and LeRobot datasets."""

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eps_tunnel_analysis.recording.csv_import import CsvColumns, arrays_to_bag, columns_of, csv_to_bag
from labyrinth_sim.errors import InputError
from labyrinth_sim.trials import Array

TIME = ("time", "t", "timestamp", "stamp", "seconds", "sec", "time_s", "time_ms", "t_ms")
WORDS = {
    "command": ("command", "cmd", "target", "goal", "desired", "setpoint", "reference", "ref", "action", "u"),
    "velocity": ("velocity", "vel", "speed", "qd", "dq", "qdot"),
    "effort": ("effort", "torque", "current", "load", "duty", "pwm", "tau", "force"),
    "position": ("position", "pos", "angle", "measured", "actual", "state", "q", "y"),
}
"""Quantity -> words in a column's name by which it is recognised."""
ELEMENT = re.compile(r"(.+)\[(\d+)\]")
"""name of a column and the place in its lists"""
LOWEST_FRAME_RATE, HIGHEST_FRAME_RATE = 0.1, 1e5  # Hz, frames of a dataset
MOST_FRAMES = 1e8  # of a dataset


def csv_bags(tables: Sequence[Path], joints: Sequence[str], folder: Path) -> tuple[list[Path], list[str]]:
    """One bag for each CSV file, in a folder, and sentences on how columns were interpreted.

    Args:
        joints: names of the model's joints, by which columns are distinguished; one joint needs no name.

    Raises:
        InputError: no column of time or of a position; lists the columns.
    """
    notes: list[str] = []
    bags = []
    for table in tables:
        columns = _columns(table, joints, notes)
        csv_to_bag(table, columns, folder / table.stem)  # what it finds odd takes all for rad; units are inferred later
        bags.append(folder / table.stem)
    return bags, list(dict.fromkeys(notes))


def _columns(table: Path, joints: Sequence[str], notes: list[str]) -> CsvColumns:
    numbers = columns_of(table)
    time = next((name for name in numbers if name.lower() in TIME), None)
    if time is None:
        raise InputError(
            f"{table}: no column of time. Expected one named {', '.join(TIME[:4])}; it has {', '.join(numbers)}. "
            "Rename it, or use `eps-tunnel import-csv --time COLUMN`, then --bag."
        )
    by_quantity: dict[str, dict[str, str]] = {quantity: {} for quantity in WORDS}
    for name in numbers:
        if name == time or _base(name, joints):
            continue
        joint = _joint_of(name, joints)
        if joint is not None:
            by_quantity[_quantity(name, joint)].setdefault(joint, name)
    _add_lists(table, numbers, joints, by_quantity, notes)
    if not by_quantity["position"]:
        raise InputError(
            f"{table}: no column of a position. Expected the joint's name ({', '.join(joints)}), alone or with "
            f"{', '.join(WORDS['position'][:3])}; it has {', '.join(numbers)}. Rename one, or use `eps-tunnel "
            "import-csv --position JOINT=COLUMN`, then --bag."
        )
    measured = by_quantity["position"]
    for quantity in ("velocity", "effort"):
        by_quantity[quantity] = {j: c for j, c in by_quantity[quantity].items() if j in measured}
        if len(by_quantity[quantity]) < len(measured):
            by_quantity[quantity] = {}
    scale = _clock(numbers[time])
    sources = [f"{quantity} of {j} from column '{c}'" for quantity, by in by_quantity.items() for j, c in by.items()]
    unit = {1.0: "s", 1e-3: "ms", 1e-6: "us", 1e-9: "ns"}[scale]
    notes.append(f"Tables: time from column '{time}' in {unit}; {'; '.join(sources)}.")
    return CsvColumns(
        time, by_quantity["command"], measured, by_quantity["velocity"], by_quantity["effort"], time_scale=scale
    )


def _add_lists(
    table: Path, columns: Iterable[str], joints: Sequence[str], by_quantity: dict[str, dict[str, str]], notes: list[str]
) -> None:
    """Uses columns of lists for quantities without a column per joint, in the model's order of joints; notes which are
    used, and which are left out."""
    lists: dict[str, list[str]] = {}
    for name in columns:
        if base := _base(name, joints):
            lists.setdefault(base, []).append(name)
    for name, elements in lists.items():
        quantity = _quantity(name, "")
        if len(elements) != len(joints) or by_quantity[quantity]:
            why = (
                f"there is another column of a {quantity}" if by_quantity[quantity]
                else f"it has {len(elements)} number{'s' * (len(elements) > 1)} per cell, and the model "
                f"{len(joints)} joint{'s' * (len(joints) > 1)}"
            )  # fmt: skip
            notes.append(
                f"{table.name}: column '{name}' is left out, because {why}. To use it, say `eps-tunnel import-csv "
                f"--{quantity} JOINT={name}[0]`, then --bag."
            )
            continue
        by_quantity[quantity] = dict(zip(joints, elements, strict=True))
        order = ", ".join(joints)
        notes.append(f"Column '{name}' is a list, taken in the model's order of joints: {order}. Is that its order?")


def _base(column: str, joints: Sequence[str]) -> str:
    """The name of the list that a column is an element of; "" if it is not one, or if its index is part of a joint's
    name, such as q[1] and the joint q1."""
    listed = ELEMENT.fullmatch(column)
    if not listed or _joint_of(column, joints) != _joint_of(listed[1], joints):
        return ""
    return listed[1]


def _clock(times: Array) -> float:
    """s of one unit of a clock: no rig is expected to be sampled below 1 Hz or above 1 MHz."""
    step = float(np.nanmedian(np.diff(times))) if len(times) > 1 else 1.0
    return 1.0 if step < 1.0 else 1e-3 if step < 1e3 else 1e-6 if step < 1e5 else 1e-9


def _parts(name: str) -> list[str]:
    return [part for part in re.split(r"[^a-z0-9]+", name.lower()) if part]


def _joint_of(column: str, joints: Sequence[str]) -> str | None:
    flat = "_".join(_parts(column))
    named = [joint for joint in joints if "_".join(_parts(joint)) in flat]
    if named:
        return max(named, key=len)
    return joints[0] if len(joints) == 1 else None


def _quantity(column: str, joint: str) -> str:
    rest = _parts("_".join(_parts(column)).replace("_".join(_parts(joint)), "", 1))
    for quantity, words in WORDS.items():
        if set(rest) & set(words):
            return quantity
    return "position"


# ---- LeRobot


def lerobot_bags(dataset: Path, folder: Path) -> tuple[list[Path], list[str]]:
    """One bag for each episode of a LeRobot dataset (v2 or v3, parquet): `action` as command, `observation.state` as
    position, in the units of the dataset.

    Raises:
        InputError: no dataset, or pyarrow is not installed.
    """
    try:
        from pyarrow import ArrowException, parquet  # type: ignore[import-untyped]
    except ImportError as error:
        raise InputError(
            "LeRobot datasets are parquet files; reading them needs pyarrow: pip install pyarrow."
        ) from error
    info = dataset / "meta" / "info.json"
    files = sorted((dataset / "data").rglob("*.parquet"))
    if not info.is_file() or not files:
        raise InputError(f"{dataset}: expected a LeRobot dataset, a folder with meta/info.json and data/**/*.parquet.")
    try:
        about = json.loads(info.read_text(encoding="utf-8"))
        state, action = about["features"]["observation.state"], about["features"].get("action")
        rate = float(about["fps"])
        names = _names(state)
        targets = _names(action) if action else []
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{info}: cannot be read ({error!r}). Expected fps and features.observation.state.") from error
    if not (LOWEST_FRAME_RATE <= rate <= HIGHEST_FRAME_RATE and names and all(names)):
        raise InputError(
            f"{info}: {rate:g} frames a second of {names}; "
            f"expected {LOWEST_FRAME_RATE:g} to {HIGHEST_FRAME_RATE:g} Hz and names."
        )
    shared = targets == names
    joints = len(names)
    columns = {
        "episode_index": 0,
        "frame_index": 0,
        "observation.state": joints,
        **({"action": joints} if shared else {}),
    }
    parts: dict[str, list[Array]] = {name: [] for name in columns}
    for file in files:
        try:
            table = parquet.read_table(file, columns=list(columns))
            for name, width in columns.items():
                parts[name].append(_stacked(table[name], width))
        except (ArrowException, ValueError, TypeError, KeyError, OSError) as error:
            reason = f"cannot be read ({str(error).partition(chr(10))[0]:.200})"
            raise InputError(f"{file}: {reason}. Expected parquet with {', '.join(columns)}.") from error
    episode, frame, seen, *sent = (np.concatenate(part) for part in parts.values())
    numbers = np.concatenate([episode, frame])
    if not ((numbers >= 0.0) & (numbers < MOST_FRAMES)).all():
        raise InputError(f"{dataset}: episode_index and frame_index must be numbers from 0 to {MOST_FRAMES:g}.")
    bags = []
    for number in np.unique(episode):
        here = np.flatnonzero(episode == number)
        here = here[np.argsort(frame[here])]
        bags.append(
            arrays_to_bag(folder / f"episode_{int(number):03d}", frame[here] / rate, names, seen[here],
                          sent[0][here] if sent else None, metadata={"source": dataset.name})
        )  # fmt: skip
    note = f"{dataset.name}: {len(bags)} episodes at {rate:g} Hz, joints {', '.join(names)}."
    if not shared:
        note += " Actions are not of the same joints as states, so there are no commands."
    return bags, [note]


def _names(feature: Mapping[str, Any]) -> list[str]:
    """Names of a feature's elements without their common ending, such as `.pos`."""
    names = feature["names"]
    flat = next(iter(names.values()), ()) if isinstance(names, Mapping) else names
    plain = [str(name).removesuffix(".pos").removesuffix("_pos") for name in flat]
    return [re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_") for name in plain]


def _stacked(column: Any, joints: int) -> Array:
    """Of N rows: (N,), or (N, joints) of lists. Raises ValueError for values that are not numbers, or lists of another
    length."""
    values = np.array(column.to_pylist(), dtype=np.float64)
    if values.shape[1:] != ((joints,) if joints else ()):
        raise ValueError(f"rows of {values.shape[1:]} numbers where {joints or 1} are expected")
    return values
