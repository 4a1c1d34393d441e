# SPDX-License-Identifier: Apache-2.0
"""The parts of a model file, from and to YAML. Readers collect complaints rather than raise."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from labyrinth_sim.effect import Effect, Parameter, drives
from labyrinth_sim.errors import unknown_name
from labyrinth_sim.parts import DriveUse, EffectUse, Value, check_bounds, effect_complaints
from labyrinth_sim.rig import Rig, is_number


def read_drives(path: Path, rig: Rig, data: Any, complaints: list[str]) -> Iterator[tuple[str, DriveUse]]:
    library = drives()
    names = [axis.name for axis in rig.axes]
    if not isinstance(data, dict):
        complaints.append(f"{path}: 'drives' must be a mapping from axis to drive, got {data!r}.")
        return
    complaints += [f"{path}: {unknown_name('axis', key, names)}" for key in data if key not in names]
    for axis in names:
        entry = data.get(axis)
        if not isinstance(entry, dict) or "kind" not in entry:
            complaints.append(f"{path}: drives.{axis} needs a 'kind' (one of {', '.join(library)}) and 'values'.")
        elif str(entry["kind"]) not in library:
            complaints.append(f"{path}: drives.{axis}: {unknown_name('drive', str(entry['kind']), library)}")
        else:
            kind = library[str(entry["kind"])]
            where = f"{path}: drive.{axis}"
            yield axis, DriveUse(kind, read_values(where, kind.parameters, entry.get("values") or {}, complaints))


def read_effects(
    path: Path, rig: Rig, data: Any, library: Mapping[str, Effect], complaints: list[str]
) -> Iterator[EffectUse]:
    if not isinstance(data, list):
        complaints.append(f"{path}: 'effects' must be a list, got {data!r}.")
        return
    seen: set[tuple[str, str]] = set()
    for entry in data:
        if (
            not isinstance(entry, dict)
            or set(entry) - {"name", "place", "values"}
            or not {"name", "place"} <= set(entry)
        ):
            complaints.append(f"{path}: an effect needs name, place and values, got {entry!r}.")
            continue
        name, place = str(entry["name"]), str(entry["place"])
        if name not in library:
            complaints.append(f"{path}: {unknown_name('effect', name, library)}")
            continue
        complaints += [f"{path}: {c}" for c in effect_complaints(rig, library[name], place)]
        if (name, place) in seen:
            complaints.append(f"{path}: {name} occurs twice at '{place}'.")
        seen.add((name, place))
        where = f"{path}: {name}.{place}"
        yield EffectUse(
            library[name], place, read_values(where, library[name].parameters, entry.get("values") or {}, complaints)
        )


def read_values(where: str, declared: tuple[Parameter, ...], data: Any, complaints: list[str]) -> dict[str, Value]:
    by_name = {p.name: p for p in declared}
    found = {}
    if not isinstance(data, dict):
        complaints.append(f"{where}: values must be a mapping, got {data!r}.")
        return {}
    for name, entry in data.items():
        if name not in by_name:
            complaints.append(f"{where}: {unknown_name('parameter', str(name), by_name)}")
            continue
        value = read_value(f"{where}.{name}", by_name[name], entry, complaints)
        if value:
            found[name] = value
    return found


def read_value(where: str, p: Parameter, entry: Any, complaints: list[str]) -> Value | None:
    if not isinstance(entry, dict) or set(entry) != {"value", "unit", "from"}:
        complaints.append(f"{where} needs value, unit and from, got {entry!r}.")
        return None
    found = []
    if str(entry["unit"]) != p.unit:
        found.append(f"{where} must be given in {p.unit}, got unit '{entry['unit']}'. Convert the value.")
    if not is_number(entry["value"]):
        found.append(f"{where} must be a number, got {entry['value']!r} (YAML wants 1.0e+3, not 1e3).")
    else:
        found += check_bounds(where, p, float(entry["value"]))
    complaints += found
    return None if found else Value(float(entry["value"]), p.unit, str(entry["from"]))


def plain_values(values: Mapping[str, Value]) -> dict[str, dict[str, Any]]:
    return {name: {"value": v.value, "unit": v.unit, "from": v.source} for name, v in values.items()}
