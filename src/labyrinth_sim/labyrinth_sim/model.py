# SPDX-License-Identifier: Apache-2.0
"""A model of a rig: its drives, its effects, and the value of everything. Read from config/models/NAME.yaml."""

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from pydantic import Field

from labyrinth_sim.config import find
from labyrinth_sim.effect import Drive, Effect, Parameter, Size
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.quantities import EFFORT, PLAIN, Quantities, check_mjcf, effort_scales, mjcf_quantities
from labyrinth_sim.registry import Registry
from labyrinth_sim.rig import Rig, load_rig
from labyrinth_sim.shown import shown
from labyrinth_sim.validity import Validity, read_validity
from labyrinth_sim.whole_file import write_new
from labyrinth_sim.yaml_file import Document, Entry, Text, Where, read_yaml, yaml_text

DEFAULT = "default"  # source of a number that the model does not state


@dataclass(frozen=True)
class Value:
    """A number, its unit, and where it came from."""

    value: float
    unit: str
    source: str


@dataclass(frozen=True)
class ParameterInfo:
    """One number of a model that can be set or fitted.

    `off` is the value at which its effect vanishes, None where there is no such value; `default` what holds where the
    model says nothing; `span` a large change of it, at most the distance of its bounds.
    """

    name: str
    unit: str
    low: float
    high: float
    off: float | None
    default: float
    value: float
    source: str
    why: str
    span: float


@dataclass(frozen=True)
class DriveUse:
    """The drive of one axis, with values by parameter name."""

    kind: Drive
    values: Mapping[str, Value]


@dataclass(frozen=True)
class EffectUse:
    """An effect at one place: an axis, a measured position, or "ball"."""

    effect: Effect
    place: str
    values: Mapping[str, Value]


@shown
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
        valid: range over which it was validated; None if it was not, and after its values or effects were changed.
        registry: the effects and drives that can be added.
    """

    name: str
    rig: Rig
    drives: Mapping[str, DriveUse]
    effects: tuple[EffectUse, ...] = ()
    quantities: Mapping[str, Value] = field(default_factory=dict)
    description: str = ""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    path: Path | None = None
    valid: Validity | None = None
    registry: Registry = field(default_factory=Registry.load, compare=False, repr=False)

    def parameters(self) -> dict[str, ParameterInfo]:
        """Every number by full name: `drive.x.p`, `backlash.x.width`, `joint.motor_x.armature`."""
        return {info.name: info for info in self._parameters}

    def size(self, place: str) -> Size:
        """How large the axis is that a place belongs to: an axis, a signal, a joint, a body, or "ball"."""
        return size_at(self.rig, self.drives, place)

    def _declared(self) -> "Iterator[_Declared]":
        for axis in self.rig.axes:
            drive = self.drives[axis.name]
            for p in drive.kind.parameters:
                yield _Declared(f"drive.{axis.name}.{p.name}", p, self.size(axis.name), drive.values.get(p.name))
        for use in self.effects:
            for p in use.effect.parameters:
                yield _Declared(f"{_prefix(use)}{p.name}", p, self.size(use.place), use.values.get(p.name))
        for name, (p, number) in mjcf_quantities(self.rig).items():
            place = name.split(".", 1)[1].rpartition(".")[0]
            yield _Declared(name, p, self.size(place), self.quantities.get(name), number)
        for name, (p, number) in self._effort_scales().items():
            yield _Declared(name, p, Size(), self.quantities.get(name), number)

    def _effort_scales(self) -> Quantities:
        return effort_scales(self.rig, {name: v.value for name, v in self.quantities.items()})

    @cached_property
    def _parameters(self) -> tuple[ParameterInfo, ...]:
        return tuple(declared.info() for declared in self._declared())

    def unstated(self) -> tuple[ParameterInfo, ...]:
        """Numbers of drives and effects that the model leaves out and whose default is neither 0 nor off."""
        return tuple(
            info
            for info in self._parameters
            if info.source == DEFAULT
            and info.name.split(".")[0] not in (*PLAIN, EFFORT)
            and info.default not in (info.off, 0.0)
        )

    @property
    def open_scales(self) -> tuple[str, ...]:
        """Full names of the factors of efforts that neither the rig nor the model states."""
        return tuple(name for name in self._effort_scales() if name not in self.quantities)

    def with_scales(self, values: Mapping[str, float], source: str) -> "Model":
        """The same model with other factors of its `open_scales`; any number but 0, for nothing says how large."""
        new = {name: Value(float(v), self._effort_scales()[name][0].unit, source) for name, v in values.items()}
        return replace(self, quantities={**self.quantities, **new})

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
        known = {declared.name: declared for declared in self._declared()}
        complaints = []
        for name, number in values.items():
            if name not in known:
                complaints.append(unknown_name("parameter", name, known))
            elif text := known[name].p.complaint(known[name].size, float(number)):
                complaints.append(f"{name} {text}")
        if complaints:
            raise InputError(complaints)
        new = {name: Value(float(number), known[name].info().unit, source) for name, number in values.items()}
        return replace(
            self,
            valid=None if new else self.valid,
            drives={a: replace(d, values=_merged(d.values, f"drive.{a}.", new)) for a, d in self.drives.items()},
            effects=tuple(replace(u, values=_merged(u.values, _prefix(u), new)) for u in self.effects),
            quantities={**self.quantities, **{n: v for n, v in new.items() if n.split(".")[0] in (*PLAIN, EFFORT)}},
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
        chosen = self.registry.effect(effect)
        complaints = effect_complaints(self.rig, chosen, place)
        if any(u.effect.name == chosen.name and u.place == place for u in self.effects):
            complaints.append(f"{chosen.name} is in the model at '{place}' already; change it by with_values.")
        if complaints:
            raise InputError(complaints)
        declared = (p.sized(self.size(place)) for p in chosen.parameters)
        typical = {p.name: Value(p.typical, p.unit, "typical") for p in declared}
        model = replace(self, valid=None, effects=(*self.effects, EffectUse(chosen, place, typical)))
        given = {f"{chosen.name}.{place}.{name}": number for name, number in (values or {}).items()}
        return model.with_values(given, source) if given else model

    def without_effect(self, effect: str, place: str) -> "Model":
        """The same model without an effect. Raises InputError where it is not there."""
        rest = tuple(u for u in self.effects if (u.effect.name, u.place) != (effect, place))
        if len(rest) == len(self.effects):
            present = [f"{u.effect.name}.{u.place}" for u in self.effects]
            raise InputError(unknown_name("effect in this model", f"{effect}.{place}", present))
        return replace(self, valid=None, effects=rest)

    def places(self, effect: str | Effect) -> tuple[str, ...]:
        """Where an effect can act on this rig: axis names, signals, or "ball"; empty where it cannot."""
        return places(self.rig, self.registry.effect(effect))


def size_at(rig: Rig, drives: Mapping[str, DriveUse], place: str) -> Size:
    """How large the axis is that a place belongs to; for a body, the largest of the rig's axes.

    `drives` may lack those that are not known yet.
    """
    sizes = {}
    for axis in rig.axes:
        use, full = drives.get(axis.name), 0.0
        if use and use.kind.full:
            full = use.kind.full(
                {p.name: use.values[p.name].value if p.name in use.values else p.typical for p in use.kind.parameters}
            )
        sizes[axis.name] = Size.of_axis(axis.slides, axis.limits, full)
        if place in (axis.name, axis.joint, axis.load, axis.belt, *(m.signal for m in axis.measured)):
            return sizes[axis.name]
    if place == "ball":
        return Size()
    return max(sizes.values(), key=lambda size: size.force / size.length)


@dataclass(frozen=True)
class _Declared:
    """A parameter's full name, its declaration, the axis it is for, and what the model states for it.

    `number` is what holds where nothing is stated; None for the value at which an effect vanishes or a drive's typical.
    """

    name: str
    p: Parameter
    size: Size
    value: Value | None
    number: float | None = None

    def info(self) -> ParameterInfo:
        here = self.p.sized(self.size, self.value.value if self.value else self.number)
        default = self.number if self.number is not None else here.typical if here.off is None else here.off
        value = self.value or Value(default, here.unit, DEFAULT)
        return ParameterInfo(
            self.name,
            here.unit,
            here.low,
            here.high,
            here.off,
            default,
            value.value,
            value.source,
            here.why,
            here.span or here.high - here.low,
        )


def _prefix(use: EffectUse) -> str:
    return f"{use.effect.name}.{use.place}."


def _merged(old: Mapping[str, Value], prefix: str, new: Mapping[str, Value]) -> dict[str, Value]:
    return {**old, **{name.removeprefix(prefix): v for name, v in new.items() if name.startswith(prefix)}}


def places(rig: Rig, effect: Effect) -> tuple[str, ...]:
    """Where an effect can act on a rig."""
    if effect.where == "ball":
        return ("ball",) if rig.ball else ()
    if effect.where == "signal":
        return rig.positions
    if "ball" in effect.needs and rig.ball is None:
        return ()
    if "other_axis" in effect.needs and len(rig.axes) < 2:
        return ()
    lacks = {"belt": lambda axis: not axis.belt, "hinge": lambda axis: axis.slides}
    return tuple(axis.name for axis in rig.axes if not any(lacks[n](axis) for n in effect.needs if n in lacks))


def effect_complaints(rig: Rig, effect: Effect, place: str) -> list[str]:
    """Why an effect cannot act at a place of a rig; empty if it can."""
    valid = places(rig, effect)
    if place in valid:
        return []
    if not valid:
        lacks = (
            "no ball"
            if effect.where == "ball" or "ball" in effect.needs
            else f"nothing for it to act on (it needs {', '.join(effect.needs)})"
        )
        return [f"{effect.name} cannot act on rig '{rig.name}': the rig has {lacks}."]
    return [f"{effect.name} acts on each {effect.where}. {unknown_name(effect.where, place, valid)}"]


# The file


class _ModelFile(Entry):
    name: Text
    rig: Text
    drives: dict[str, Any]
    description: Text = ""
    effects: list[Any] | None = None
    quantities: dict[str, Any] | None = None
    provenance: dict[str, Any] | None = None
    valid: dict[str, Any] | None = None


class _DriveEntry(Entry):
    kind: Text
    values: dict[str, Any] | None = None


class _EffectEntry(Entry):
    name: Text
    place: Text
    values: dict[str, Any] | None = None


class _ValueEntry(Entry):
    value: float
    unit: Text
    source: Text = Field(alias="from")


def load_model(name: str | Path, registry: Registry | Path | str | None = None) -> Model:
    """Reads config/models/NAME.yaml, or a file by path.

    Args:
        name: of a model, or path of a file.
        registry: the effects and drives that there are; or the folder of the user's own effects.

    Raises:
        InputError: all that is wrong with the file, with its rig, and with the MJCF it leads to.
    """
    path = find("models", name)
    known = registry if isinstance(registry, Registry) else Registry.load(registry)
    document = read_yaml(path)
    entry = document.read(_ModelFile)
    rig_path = document.file(("rig",), "rigs", path)
    if rig_path is None:
        document.check()
    assert rig_path is not None
    try:
        rig = load_rig(rig_path)
        check_mjcf(rig)
    except InputError as error:
        raise InputError([*document.complaints, *error.complaints]) from error
    drives = dict(_read_drives(document, rig, known))
    effects = tuple(_read_effects(document, rig, drives, known))
    plain = {
        name: (p, size_at(rig, drives, name.split(".", 1)[1].rpartition(".")[0]))
        for name, (p, _) in mjcf_quantities(rig).items()
    }
    given = document.mapping(("quantities",))
    stated = {
        n: float(v)
        for n, e in given.items()
        if isinstance(e, dict) and isinstance(v := e.get("value"), float | int) and v
    }
    plain |= {name: (p, Size()) for name, (p, _) in effort_scales(rig, stated).items()}
    quantities = _read_values(document, ("quantities",), "quantity", "", plain)
    valid = read_validity(document, rig)
    document.check()
    assert entry is not None
    return Model(
        name=entry.name,
        rig=rig,
        drives=drives,
        effects=effects,
        quantities=quantities,
        description=entry.description,
        provenance=entry.provenance or {},
        path=path,
        valid=valid,
        registry=known,
    )


def _read_drives(document: Document, rig: Rig, registry: Registry) -> Iterator[tuple[str, DriveUse]]:
    names = [axis.name for axis in rig.axes]
    given = document.mapping(("drives",))
    for key in given:
        if key not in names:
            document.complain(("drives", key), unknown_name("axis", key, names), "drives")
    for axis in rig.axes:
        where: Where = ("drives", axis.name)
        if axis.name not in given:
            kinds = ", ".join(registry.drives)
            document.complain(("drives",), f"axis '{axis.name}' has no drive. Give its 'kind' ({kinds}) and 'values'.")
            continue
        entry = document.read(_DriveEntry, where)
        if entry is None:
            continue
        if entry.kind not in registry.drives:
            document.complain((*where, "kind"), unknown_name("drive", entry.kind, registry.drives))
            continue
        kind = registry.drives[entry.kind]
        declared = {p.name: (p, size_at(rig, {}, axis.name)) for p in kind.parameters}
        values = _read_values(document, (*where, "values"), "parameter", f"drive.{axis.name}", declared)
        yield axis.name, DriveUse(kind, values)


def _read_effects(
    document: Document, rig: Rig, drives: Mapping[str, DriveUse], registry: Registry
) -> Iterator[EffectUse]:
    seen: set[tuple[str, str]] = set()
    for index in range(len(document.sequence(("effects",)))):
        where: Where = ("effects", index)
        entry = document.read(_EffectEntry, where)
        if entry is None:
            continue
        if entry.name not in registry.effects:
            document.complain((*where, "name"), unknown_name("effect", entry.name, registry.effects))
            continue
        effect = registry.effects[entry.name]
        for text in effect_complaints(rig, effect, entry.place):
            document.complain((*where, "place"), text)
        if (entry.name, entry.place) in seen:
            document.complain(where, f"{entry.name} occurs twice at '{entry.place}'.")
        seen.add((entry.name, entry.place))
        declared = {p.name: (p, size_at(rig, drives, entry.place)) for p in effect.parameters}
        values = _read_values(document, (*where, "values"), "parameter", f"{entry.name}.{entry.place}", declared)
        yield EffectUse(effect, entry.place, values)


def _read_values(
    document: Document, where: Where, noun: str, prefix: str, declared: Mapping[str, tuple[Parameter, Size]]
) -> dict[str, Value]:
    values = {}
    for name in document.mapping(where):
        place, full = (*where, name), f"{prefix}.{name}".removeprefix(".")
        if name not in declared:
            document.complain(place, unknown_name(noun, name, declared), prefix or "quantities")
            continue
        (p, size), entry = declared[name], document.read(_ValueEntry, place, full)
        if entry is None:
            continue
        unit = p.sized(size).unit
        if entry.unit != unit:
            text = f"must be given in {unit}, got unit '{entry.unit:.60}'. Convert the value."
            document.complain((*place, "unit"), text, full)
        elif text := p.complaint(size, entry.value):
            document.complain((*place, "value"), text, full)
        values[name] = Value(entry.value, unit, entry.source)
    return values


def save_model(model: Model, path: Path | str) -> Path:
    """Writes a model file; never overwrites one. A rig in the file's own folder is named relative to it.

    Raises:
        InputError: the file exists or cannot be written.
    """
    path = Path(path)
    data: dict[str, Any] = {"name": path.stem, "rig": _rig_entry(model.rig, path)}
    if model.description:
        data["description"] = model.description
    data["drives"] = {a: {"kind": d.kind.name, "values": _plain(d.values)} for a, d in model.drives.items()}
    data["effects"] = [{"name": u.effect.name, "place": u.place, "values": _plain(u.values)} for u in model.effects]
    if model.quantities:
        data["quantities"] = _plain(model.quantities)
    if model.provenance:
        data["provenance"] = dict(model.provenance)
    if model.valid:
        data["valid"] = model.valid.to_yaml()
    try:
        write_new(path, yaml_text(data), by="Model")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error}). Nothing is left of it.") from error
    return path


def _rig_entry(rig: Rig, path: Path) -> str:
    if rig.path is None:
        return rig.name
    with contextlib.suppress(InputError):
        if find("rigs", rig.name, beside=path) == rig.path:
            return rig.name
    folder = path.parent.resolve()
    return str(rig.path.relative_to(folder) if rig.path.is_relative_to(folder) else rig.path)


def _plain(values: Mapping[str, Value]) -> dict[str, dict[str, Any]]:
    return {name: {"value": v.value, "unit": v.unit, "from": v.source} for name, v in values.items()}
