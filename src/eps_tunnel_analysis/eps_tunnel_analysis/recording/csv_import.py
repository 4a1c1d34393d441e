# SPDX-License-Identifier: Apache-2.0
"""A table of samples (CSV) to a bag, for rigs that log text."""

import csv
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.recording.message_types import JOINT_STATE, typestore
from eps_tunnel_analysis.recording.writer import BagWriter
from labyrinth_sim.errors import InputError, unknown_name


@dataclass(frozen=True)
class CsvColumns:
    """Which column of the table is what.

    Attributes:
        time: column of the time of measurement, s, from any origin.
        commands: joint -> column of its target angle, rad.
        position, velocity, effort: joint -> column, rad, rad/s and the drive's own unit.
    """

    time: str
    commands: Mapping[str, str] = field(default_factory=dict)
    position: Mapping[str, str] = field(default_factory=dict)
    velocity: Mapping[str, str] = field(default_factory=dict)
    effort: Mapping[str, str] = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        """Every column that is needed."""
        maps = (self.commands, self.position, self.velocity, self.effort)
        return [self.time, *(column for columns in maps for column in columns.values())]


def csv_to_bag(table: Path, columns: CsvColumns, out: Path, namespace: str = "/real") -> Path:
    """One CSV file with a header line to a new bag with `NS/joint_commands` and `NS/joint_states`.

    An empty cell in every command of a row means that no command was sent then; likewise for the measurements.

    Raises:
        InputError: the file, a column or a number cannot be read, a row is only partly filled, or `out` exists.
    """
    table = Path(table)
    if not columns.position:
        raise InputError(f"{table}: no position column named; expected at least one measured joint.")
    stray = [j for values in (columns.velocity, columns.effort) for j in values if j not in columns.position]
    if stray:
        raise InputError([f"{table}: {unknown_name('joint', j, columns.position)}" for j in stray])
    cells = _cells(table, columns.names)
    stamps = _stamps(table, columns.time, cells[columns.time])
    base = f"/{namespace.strip('/')}" if namespace.strip("/") else ""
    commands = _values(table, cells, columns.commands)
    states = [_values(table, cells, part) for part in (columns.position, columns.velocity, columns.effort)]
    for part, values in (("command", commands), ("measurement", np.hstack(states))):
        filled = np.isfinite(values).sum(axis=1)
        partly = np.flatnonzero((filled > 0) & (filled < values.shape[1]))
        if len(partly):
            raise InputError(
                f"{table}: line {partly[0] + 2}: only some {part} cells are filled. Expected all of them, or none."
            )
    with BagWriter(out, {"source": table.name}) as writer:
        if columns.commands:
            _write(writer, f"{base}/joint_commands", list(columns.commands), stamps, [commands])
        _write(writer, f"{base}/joint_states", list(columns.position), stamps, states)
    return Path(out)


def _cells(table: Path, names: list[str]) -> dict[str, list[str]]:
    try:
        with table.open(newline="", encoding="utf-8-sig") as stream:
            sample = stream.read(4096)
            stream.seek(0)
            reader = csv.DictReader(stream, delimiter=max(",;\t", key=sample.split("\n", 1)[0].count), strict=True)
            header = [name.strip() for name in reader.fieldnames or []]
            reader.fieldnames = header
            missing = [name for name in names if name not in header]
            if missing:
                raise InputError([f"{table}: {unknown_name('column', name, header)}" for name in missing])
            rows = list(reader)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{table}: cannot be read as CSV ({error}). Expected text with one header line.") from error
    if not rows:
        raise InputError(f"{table}: no rows below the header.")
    return {name: [(row[name] or "").strip() for row in rows] for name in names}


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


def _stamps(table: Path, name: str, cells: list[str]) -> NDArray[np.int64]:
    """(n,) ns from the first row on."""
    seconds = _numbers(table, name, cells)
    steps = np.diff(seconds)
    bad = np.flatnonzero(np.isnan(seconds)) if np.isnan(seconds).any() else np.flatnonzero(steps <= 0) + 1
    if len(bad):
        line, cell = bad[0] + 2, cells[bad[0]]
        raise InputError(f"{table}: line {line}: the time '{cell}' does not increase. Expected seconds that do.")
    return np.round((seconds - seconds[0]) * 1e9).astype(np.int64) + 1_000_000_000


def _values(table: Path, cells: Mapping[str, list[str]], columns: Mapping[str, str]) -> NDArray[np.float64]:
    """(n, joints)"""
    found = [_numbers(table, name, cells[name]) for name in columns.values()]
    return np.stack(found, axis=1) if found else np.empty((len(next(iter(cells.values()))), 0))


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
