# SPDX-License-Identifier: Apache-2.0
"""Converts a table of samples (CSV) to a bag, for rigs that log text."""

import csv
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.outputs import shown_number
from eps_tunnel_analysis.recording.decode import JOINT_STATE, typestore
from eps_tunnel_analysis.recording.plausible import Samples, doubts
from eps_tunnel_analysis.recording.writer import BagWriter, whole_bag
from labyrinth_sim.errors import InputError, unknown_name

STAMP_HOLDS = 2.0**31 - 2.0  # s that a ROS stamp holds, but for the first


@dataclass(frozen=True)
class CsvColumns:
    """Which column of the table is what.

    Attributes:
        time: column of the time of measurement, s, from any origin.
        commands: joint -> column of its target angle, rad.
        position, velocity, effort: joint -> column, rad, rad/s and the drive's own unit.
        scale: factor from the table's angles and speeds, targets included, to rad and rad/s.
        time_scale: factor from the table's times to s, as 1e-3 for ms.
    """

    time: str
    commands: Mapping[str, str] = field(default_factory=dict)
    position: Mapping[str, str] = field(default_factory=dict)
    velocity: Mapping[str, str] = field(default_factory=dict)
    effort: Mapping[str, str] = field(default_factory=dict)
    scale: float = 1.0
    time_scale: float = 1.0

    @property
    def names(self) -> list[str]:
        """Every column that is needed."""
        maps = (self.commands, self.position, self.velocity, self.effort)
        return [self.time, *(column for columns in maps for column in columns.values())]


def csv_to_bag(table: Path, columns: CsvColumns, out: Path, namespace: str = "/real") -> list[str]:
    """One CSV file with a header line to a new bag with `NS/joint_commands` and `NS/joint_states`.

    An empty cell in every command of a row means that no command was sent then; likewise for the measurements.

    Returns:
        What looks wrong in the table, one sentence each.

    Raises:
        InputError: the file, a column or a number cannot be read, a row is only partly filled, or `out` exists or
            cannot be written.
    """
    table = Path(table)
    if not columns.position:
        raise InputError(f"{table}: no position column named; expected at least one measured joint.")
    stray = [j for values in (columns.velocity, columns.effort) for j in values if j not in columns.position]
    if stray:
        raise InputError([f"{table}: {unknown_name('joint', j, columns.position)}" for j in stray])
    cells = _cells(table, columns.names)
    stamps = _stamps(table, columns.time, cells[columns.time], columns.time_scale)
    base = f"/{namespace.strip('/')}" if namespace.strip("/") else ""
    commands = columns.scale * _values(table, cells, columns.commands)
    states = [columns.scale * _values(table, cells, part) for part in (columns.position, columns.velocity)]
    states.append(_values(table, cells, columns.effort))
    for part, values in (("command", commands), ("measurement", np.hstack(states))):
        filled = np.isfinite(values).sum(axis=1)
        partly = np.flatnonzero((filled > 0) & (filled < values.shape[1]))
        if len(partly):
            raise InputError(
                f"{table}: line {partly[0] + 2}: only some {part} cells are filled. Expected all of them, or none."
            )
    with whole_bag(out, {"source": table.name}) as writer:
        if columns.commands:
            _write(writer, f"{base}/joint_commands", list(columns.commands), stamps, [commands])
        _write(writer, f"{base}/joint_states", list(columns.position), stamps, states)
    time = (stamps - stamps[0]) * 1e-9
    parts = (("command", columns.commands, commands), ("position", columns.position, states[0]))
    return doubts(
        (
            Samples(f"{what} '{joint}'", "rad", str(table), time[sent], values[sent, i], commanded=what == "command")
            for what, joints, values in parts
            for i, joint in enumerate(joints)
            for sent in [np.isfinite(values[:, i])]
        ),
        cure=" Then say --degrees.",
    )


def columns_of(table: Path) -> dict[str, NDArray[np.float64]]:
    """Every column of a CSV that holds numbers, by its header, (n,), NaN for empty cells. Raises InputError."""
    columns = {}
    for name, cells in _cells(table, None).items():
        try:
            columns[name] = _numbers(table, name, cells)
        except InputError:
            continue
    return columns


def arrays_to_bag(
    out: Path,
    time: NDArray[np.float64],
    joints: list[str],
    position: NDArray[np.float64],
    command: NDArray[np.float64] | None = None,
    namespace: str = "/real",
    metadata: Mapping[str, str] | None = None,
) -> Path:
    """Samples at `time` (n,) s, (n, joints) each, to a new bag. Raises InputError: `out` exists."""
    stamps = np.round((time - time[0]) * 1e9).astype(np.int64) + 1_000_000_000
    with BagWriter(out, dict(metadata or {})) as writer:
        if command is not None:
            _write(writer, f"{namespace}/joint_commands", joints, stamps, [command])
        _write(writer, f"{namespace}/joint_states", joints, stamps, [position])
    return Path(out)


def _cells(table: Path, names: list[str] | None) -> dict[str, list[str]]:
    """Cells by column; a column of lists, as `[1, 2]` or `1 2`, is one column for each element, as `name[0]`."""
    try:
        with table.open(newline="", encoding="utf-8-sig") as stream:
            sample = stream.read(4096)
            stream.seek(0)
            reader = csv.DictReader(stream, delimiter=max(",;\t", key=sample.split("\n", 1)[0].count), strict=True)
            header = [name.strip() for name in reader.fieldnames or []]
            reader.fieldnames = header
            rows = list(reader)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{table}: cannot be read as CSV ({error}). Expected text with one header line.") from error
    if not rows:
        raise InputError(f"{table}: no rows below the header.")
    cells: dict[str, list[str]] = {}
    for name in header:
        cells |= _elements(table, name, [(row[name] or "").strip() for row in rows])
    missing = [name for name in names or () if name not in cells]
    if missing:
        raise InputError([f"{table}: {unknown_name('column', name, cells)}" for name in missing])
    return cells if names is None else {name: cells[name] for name in names}


def _elements(table: Path, name: str, cells: list[str]) -> dict[str, list[str]]:
    """One column, or those of its elements where its first cell that is not empty is a list."""
    first = _list(next(filter(None, cells), ""))
    if first is None:
        return {name: cells}
    rows = [(_list(cell) or []) if cell else [""] * len(first) for cell in cells]
    odd = next((i for i, row in enumerate(rows) if len(row) != len(first)), None)
    if odd is not None:
        raise InputError(
            f"{table}: line {odd + 2}, column '{name}': '{cells[odd]:.80}' is not a list of {len(first)} numbers like "
            "the cells above it. Expected one length throughout."
        )
    return {f"{name}[{i}]": [row[i] for row in rows] for i in range(len(first))}


def _list(cell: str) -> list[str] | None:
    """The elements of a cell that is a list of numbers: in brackets, or separated by spaces."""
    inside = cell.strip("[]()")
    parts = [part for part in re.split(r"[,;\s]+", inside) if part]
    if not parts or (len(parts) == 1 and inside == cell):
        return None
    try:
        _ = [float(part) for part in parts]
    except ValueError:
        return None
    return parts


def _numbers(table: Path, name: str, cells: list[str]) -> NDArray[np.float64]:
    """(n,), NaN for empty cells."""
    values = np.full(len(cells), np.nan)
    for row, cell in enumerate(cells):
        if not cell:
            continue
        try:
            values[row] = float(cell)
        except ValueError as error:
            raise InputError(f"{table}: line {row + 2}, column '{name}': '{cell}' is not a number.") from error
        if not np.isfinite(values[row]):
            raise InputError(f"{table}: line {row + 2}, column '{name}': {cell} is not finite. Leave it empty.")
    return values


def _stamps(table: Path, name: str, cells: list[str], scale: float) -> NDArray[np.int64]:
    """(n,) ns since the first row."""
    seconds = scale * _numbers(table, name, cells)
    steps = np.diff(seconds)
    bad = np.flatnonzero(np.isnan(seconds)) if np.isnan(seconds).any() else np.flatnonzero(steps <= 0) + 1
    if len(bad):
        line, cell = bad[0] + 2, cells[bad[0]]
        raise InputError(f"{table}: line {line}: the time '{cell}' does not increase. Expected seconds that do.")
    since = seconds - seconds[0]
    if not since[-1] < STAMP_HOLDS:
        line = int(np.flatnonzero(~(since < STAMP_HOLDS))[0])
        raise InputError(
            f"{table}: line {line + 2}: the time '{cells[line]}' lies {shown_number(since[line])} s after the first "
            f"row's; a stamp holds {shown_number(STAMP_HOLDS)} s. Is it in ms or us? Say so by --time-unit."
        )
    return np.round(since * 1e9).astype(np.int64) + 1_000_000_000


def _values(table: Path, cells: Mapping[str, list[str]], columns: Mapping[str, str]) -> NDArray[np.float64]:
    """(n, joints)"""
    columns_read = [_numbers(table, name, cells[name]) for name in columns.values()]
    return np.stack(columns_read, axis=1) if columns_read else np.empty((len(next(iter(cells.values()))), 0))


def _write(
    writer: BagWriter, topic: str, joints: list[str], stamps: NDArray[np.int64], fields: list[NDArray[np.float64]]
) -> None:
    store = typestore()
    types: Mapping[str, Any] = store.types
    writer.add_topic(topic, JOINT_STATE)
    none = np.zeros(0)
    filled = [bool(cells.all()) for cells in np.isfinite(np.hstack(fields))]
    for row, stamp in enumerate(stamps):
        if not filled[row]:
            continue
        time = types["builtin_interfaces/msg/Time"](*divmod(int(stamp), 1_000_000_000))
        values = [*(part[row] for part in fields), none, none][:3]
        message = types[JOINT_STATE](types["std_msgs/msg/Header"](time, ""), joints, *values)
        writer.write(topic, int(stamp), store.serialize_cdr(message, JOINT_STATE))
