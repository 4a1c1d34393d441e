# SPDX-License-Identifier: Apache-2.0
"""A model of a rig: its drives, its effects, and the value of everything. Read from config/models/NAME.yaml."""

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from labyrinth_sim.build import compiled, mjcf_quantities
from labyrinth_sim.config import find
from labyrinth_sim.effect import Effect, Parameter, effects
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.model_yaml import plain_values, read_drives, read_effects, read_value
from labyrinth_sim.parts import (
    PLAIN,
    DriveUse,
    EffectUse,
    ParameterInfo,
    Value,
    check_bounds,
    effect_complaints,
    places,
)
from labyrinth_sim.rig import Rig, load_rig, read_yaml


@dataclass(frozen=True)
class Model:
    """A model. Immutable: every change gives a new one.

    Attributes:
        rig: what is modelled.
        drives: by axis name.
        effects: with values; no effect twice at one place.
        quantities: plain MJCF quantities by full name; the MJCF's own value holds for the others.
        description: for people.
        provenance: bags, date, held-out error and the like, as a calibration wrote them.
        path: of the file, None for a model that was never saved.
    """

    name: str
    rig: Rig
    drives: Mapping[str, DriveUse]
    effects: tuple[EffectUse, ...] = ()
    quantities: Mapping[str, Value] = field(default_factory=dict)
    description: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    path: Path | None = None

    def parameters(self) -> dict[str, ParameterInfo]:
        """Every number by full name: `drive.x.p`, `backlash.x.width`, `joint.motor_x.armature`."""
        return {info.name: info for info in self._parameters()}

    def _parameters(self) -> Iterator[ParameterInfo]:
        for axis, drive in self.drives.items():
            for p in drive.kind.parameters:
                yield _info(f"drive.{axis}.{p.name}", p, p.typical, drive.values.get(p.name))
        for use in self.effects:
            for p in use.effect.parameters:
                yield _info(
                    f"{use.effect.name}.{use.place}.{p.name}", p, use.effect.off[p.name], use.values.get(p.name)
                )
        for name, (p, default) in self._plain().items():
            yield _info(name, p, default, self.quantities.get(name))

    def _plain(self) -> dict[str, tuple[Parameter, float]]:
        return {name: (PLAIN[name.split(".")[0]][index], value) for name, index, value in mjcf_quantities(self.rig)}

    def values(self) -> dict[str, float]:
        """Every number that is set or has a default, by full name."""
        return {name: info.value for name, info in self.parameters().items()}

    def with_values(self, values: Mapping[str, float], source: str = "set by hand") -> "Model":
        """The same model with other numbers.

        Args:
            values: full name -> number in the declared unit.
            source: where they came from, kept with each.

        Raises:
            InputError: unknown names, numbers out of bounds; all at once.
        """
        known = self.parameters()
        complaints = []
        for name, number in values.items():
            if name not in known:
                complaints.append(unknown_name("parameter", name, known))
            else:
                complaints += check_bounds(name, known[name], float(number))
        if complaints:
            raise InputError(complaints)
        new = {name: Value(float(number), known[name].unit, source) for name, number in values.items()}
        return replace(
            self,
            drives={a: replace(d, values=_merged(d.values, f"drive.{a}.", new)) for a, d in self.drives.items()},
            effects=tuple(
                replace(u, values=_merged(u.values, f"{u.effect.name}.{u.place}.", new)) for u in self.effects
            ),
            quantities={**self.quantities, **{n: v for n, v in new.items() if n.split(".")[0] in PLAIN}},
        )

    def with_effect(
        self, effect: str | Effect, place: str, values: Mapping[str, float] | None = None, source: str = "set by hand"
    ) -> "Model":
        """The same model with one more effect, at its typical values unless others are given.

        Args:
            effect: name, or a declaration.
            place: one of `places(effect)`.
            values: parameter name (without effect and place) -> number.

        Raises:
            InputError: unknown names, bounds, an effect that cannot act there or is there already.
        """
        chosen = self._effect(effect)
        complaints = effect_complaints(self.rig, chosen, place)
        if any(u.effect.name == chosen.name and u.place == place for u in self.effects):
            complaints.append(f"{chosen.name} is in the model at '{place}' already; change it by with_values.")
        if complaints:
            raise InputError(complaints)
        typical = {p.name: Value(p.typical, p.unit, "typical") for p in chosen.parameters}
        model = replace(self, effects=(*self.effects, EffectUse(chosen, place, typical)))
        given = {f"{chosen.name}.{place}.{name}": number for name, number in (values or {}).items()}
        return model.with_values(given, source) if given else model

    def without_effect(self, effect: str, place: str) -> "Model":
        """The same model without an effect. Raises InputError where it is not there."""
        rest = tuple(u for u in self.effects if (u.effect.name, u.place) != (effect, place))
        if len(rest) == len(self.effects):
            present = [f"{u.effect.name}.{u.place}" for u in self.effects]
            raise InputError(unknown_name("effect in this model", f"{effect}.{place}", present))
        return replace(self, effects=rest)

    def places(self, effect: str | Effect) -> tuple[str, ...]:
        """Where an effect can act on this rig: axis names, signals, or "ball"; empty where it cannot."""
        return places(self.rig, self._effect(effect))

    def _effect(self, effect: str | Effect) -> Effect:
        if isinstance(effect, Effect):
            return effect
        library = effects()
        if effect not in library:
            raise InputError(unknown_name("effect", effect, library))
        return library[effect]


def _info(name: str, p: Parameter, default: float, value: Value | None) -> ParameterInfo:
    set_to = value or Value(default, p.unit, "default")
    return ParameterInfo(name, p.unit, p.low, p.high, p.off, default, set_to.value, set_to.source, p.why)


def _merged(old: Mapping[str, Value], prefix: str, new: Mapping[str, Value]) -> dict[str, Value]:
    return {**old, **{name.removeprefix(prefix): v for name, v in new.items() if name.startswith(prefix)}}


def load_model(name: str | Path, effects_folder: Path | str | None = None) -> Model:
    """Reads config/models/NAME.yaml, or a file by path.

    Args:
        name: of a model, or path of a file.
        effects_folder: with the user's own effects.

    Raises:
        InputError: all that is wrong with the file, and with the MJCF it leads to.
    """
    path = find("models", name)
    data = read_yaml(path)
    complaints: list[str] = []
    known = {"name", "rig", "description", "drives", "effects", "quantities", "provenance"}
    complaints += [f"{path}: {unknown_name('entry', key, known)}" for key in data if key not in known]
    missing = [f"{path}: '{key}' is missing." for key in ("name", "rig", "drives") if key not in data]
    if missing:
        raise InputError(complaints + missing)
    for key in ("quantities", "provenance"):
        if not isinstance(data.get(key) or {}, dict):
            complaints.append(f"{path}: '{key}' must be a mapping, got {data.pop(key)!r}.")
    rig_file = path.parent / str(data["rig"])
    try:
        rig = load_rig(rig_file if rig_file.is_file() else str(data["rig"]))
    except InputError as error:
        raise InputError([*complaints, *error.complaints]) from error
    model = Model(
        name=str(data["name"]),
        rig=rig,
        drives=dict(read_drives(path, rig, data["drives"], complaints)),
        effects=tuple(read_effects(path, rig, data.get("effects") or [], effects(effects_folder), complaints)),
        description=str(data.get("description", "")),
        provenance=data.get("provenance") or {},
        path=path,
    )
    try:
        plain = model._plain()
        quantities: dict[str, Value] = {}
        for full, entry in (data.get("quantities") or {}).items():
            if full not in plain:
                complaints.append(f"{path}: {unknown_name('quantity', full, plain)}")
            else:
                value = read_value(f"{path}: {full}", plain[full][0], entry, complaints)
                quantities |= {full: value} if value else {}
        if not complaints:
            model = replace(model, quantities=quantities)
            compiled(model, with_ball=bool(rig.ball))
    except InputError as error:
        complaints += error.complaints
    if complaints:
        raise InputError(complaints)
    return model


def save_model(model: Model, path: Path) -> Path:
    """Writes a model file; never overwrites one.

    Raises:
        InputError: the file exists or cannot be written.
    """
    rig = str(model.rig.path) if model.rig.path else model.rig.name
    with contextlib.suppress(InputError):
        rig = model.rig.name if find("rigs", model.rig.name) == model.rig.path else rig
    data: dict[str, Any] = {"name": path.stem, "rig": rig}
    if model.description:
        data["description"] = model.description
    data["drives"] = {a: {"kind": d.kind.name, "values": plain_values(d.values)} for a, d in model.drives.items()}
    data["effects"] = [
        {"name": u.effect.name, "place": u.place, "values": plain_values(u.values)} for u in model.effects
    ]
    if model.quantities:
        data["quantities"] = plain_values(model.quantities)
    if model.provenance:
        data["provenance"] = dict(model.provenance)
    text = "# SPDX-License-Identifier: Apache-2.0\n" + yaml.safe_dump(
        data, sort_keys=False, allow_unicode=True, width=120
    )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError as error:
        raise InputError(f"{path} exists and is never overwritten; choose another name.") from error
    except OSError as error:
        raise InputError(f"Cannot write {path}: {error}") from error
    return path
