# SPDX-License-Identifier: Apache-2.0
"""What the file of an effect or a drive declares, and how such files are found.

A hook works on all simulations of a batch at once: every parameter it gets is an array (nsim,). An effect has the hooks
that it needs and leaves the others None.
"""

import importlib
import importlib.metadata
import importlib.util
import math
import os
import pkgutil
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.law import Law, Tables
from labyrinth_sim.live import Fields, Live
from labyrinth_sim.marks import MARKS
from labyrinth_sim.shown import shown
from labyrinth_sim.site import Site
from labyrinth_sim.trials import Array

if TYPE_CHECKING:
    import mujoco

Values = Mapping[str, Array]
"""Parameter name -> (nsim,)."""

Stage = Literal["command", "drive", "mjcf", "force", "measurement"]
Where = Literal["axis", "signal", "ball"]
FOLDER_VARIABLE = "EPS_TUNNEL_EFFECTS"


@dataclass(frozen=True)
class Size:
    """How large an axis is relative to the toy servo that bounds are declared for.

    Attributes:
        slides: m for rad, N for N m.
        force: the drive's full torque over 10 N m, or its full force over 10 N; 1 for weaker ones.
        length: a sliding axis's travel, its limits apart, over 6.4 m; 1 for one that turns.
    """

    slides: bool = False
    force: float = 1.0
    length: float = 1.0

    @classmethod
    def of_axis(cls, slides: bool, limits: tuple[float, float], full: float) -> "Size":
        """From an axis's kind, its limits, rad or m, and what its drive gives at most at rest, N m or N."""
        return cls(slides, max(full / 10.0, 1.0), (limits[1] - limits[0]) / 6.4 if slides else 1.0)


# Unit of an axis that turns -> powers of force and length that a number in it grows with.
GROWS = {
    "rad": (0, 1),
    "rad/s": (0, 1),
    "rad/s^2": (0, 1),
    "1/rad": (0, -1),
    "s/rad": (0, -1),
    "N m": (1, 0),
    "N m/rad": (1, -1),
    "N m s/rad": (1, -1),
    "rad/(N m)": (-1, 1),
    "N m/A": (1, 0),
    "kg m": (1, 0),
    "kg m^2": (1, -1),
    "kg": (1, -1),
}
ROOM = 3.0  # times by which the bounds of a search include a stated value
STATED = 1e3  # how many times beyond the bounds of the search a value may be stated that grows with an axis's size


def slide_unit(unit: str) -> str:
    """The unit that a slide joint has where a hinge has `unit`: N for N m, m for rad, kg for kg m^2."""
    for turning, sliding in (("kg m^2", "kg"), ("N m", "N"), ("rad", "m")):
        unit = unit.replace(turning, sliding)
    return unit


@dataclass(frozen=True)
class Parameter:
    """One parameter: bounds of the search, the value at which the effect vanishes, a typical one, why the bounds.

    All of it is declared once, for a servo that turns; `sized` gives it for another axis.

    Attributes:
        off: None where no value of this parameter alone makes the effect vanish (a period, a characteristic speed).
        fixed: "bounds" for those that are the same on any axis, whatever its unit; "unit" for what belongs to the motor
            and not to the axis, or is an angle on any axis as a wave's phase is, and so keeps its unit as well.
        fitted: False for what is stated with an effect and never fitted, as the range that a table covers.
        settled: kept as stated where the effect belongs to the model, and searched only where it may be missing.
        span: a large change of the value, where the bounds lie much further apart than that: a search takes its steps
            in shares of it. 0 for the distance of the bounds.
        begin: values from which a search begins, where it is not to spread them between the bounds.
        choices: the only values that are tried, one for each kind of the same effect; such a value is settled.
        abrupt: whether a small change of it makes something happen or not, so that the misfit jumps.
    """

    name: str
    unit: str
    low: float
    high: float
    off: float | None
    typical: float
    why: str
    fixed: Literal["", "bounds", "unit"] = ""
    fitted: bool = True
    span: float = 0.0
    settled: bool = False
    begin: tuple[float, ...] = ()
    choices: tuple[float, ...] = ()
    abrupt: bool = False

    def __post_init__(self) -> None:
        if not self.low <= self.typical <= self.high or not (self.off is None or self.low <= self.off <= self.high):
            raise InputError(f"Parameter {self.name}: typical and off must lie within [{self.low:g}, {self.high:g}].")
        if not all(self.low <= value <= self.high for value in (*self.begin, *self.choices)):
            raise InputError(f"Parameter {self.name}: begin and choices must lie within [{self.low:g}, {self.high:g}].")
        if self.choices and not (self.settled and self.typical in self.choices):
            raise InputError(
                f"Parameter {self.name}: one with choices must be settled, and its typical value one of them."
            )

    def sized(self, size: Size, stated: float | None = None) -> "Parameter":
        """The same parameter of an axis of this size, in its unit.

        Args:
            stated: value that a model has; bounds that grow with the axis leave room for three times as much, and for
                a third where they have one sign. The true value may lie to either side of it.
        """
        force, length = GROWS.get(self.unit, (0, 0))
        unit = slide_unit(self.unit) if size.slides and self.fixed != "unit" else self.unit
        grows = not self.fixed and bool(force or (length and size.slides))
        times = float(size.force**force * size.length**length) if grows else 1.0
        low, high = times * self.low, times * self.high
        if grows and stated is not None:
            wider = min(low, stated / ROOM, ROOM * stated), max(high, ROOM * stated, stated / ROOM)
            if wider != (low, high) and not self.complaint(size, stated):
                low, high = wider
        off = None if self.off is None else times * self.off
        typical, span = times * self.typical, times * self.span
        begin, choices = (tuple(times * value for value in some) for some in (self.begin, self.choices))
        return replace(self, unit=unit, low=low, high=high, off=off, typical=typical, span=span, begin=begin,
                       choices=choices)  # fmt: skip

    def complaint(self, size: Size, stated: float) -> str:
        """Why a value cannot be stated for an axis of this size; "" if it can.

        What grows with an axis may lie far beyond the bounds of the search, for nothing says how large a rig is;
        only its sign and its order are held against it.
        """
        here = self.sized(size)
        low, high = here.low, here.high
        if not self.fixed and self.unit in GROWS and (GROWS[self.unit][0] or size.slides):
            low, high = low * (STATED if low < 0.0 else 1.0 / STATED), high * STATED
        if math.isfinite(stated) and low <= stated <= high:
            return ""
        return f"must lie within [{low:g}, {high:g}] {here.unit} ({self.why}), got {stated:g}."


class Filter(Protocol):
    """A stream of samples in, the same number out; keeps its state from call to call."""

    def __call__(self, own: Array, every: Array) -> Array:
        """(nsim, K) of this channel from (nsim, K) and, as a command filter, all channels (nsim, K, u)."""


class Controller(Protocol):
    """What a drive's law adds to its control from what it remembers, as an integral does."""

    def sample(self, error: Array) -> Array:
        """(nsim,) added to the actuator's control during the next sample, from target - angle (nsim,) rad now."""

    @property
    def integral(self) -> Array | None:
        """(nsim,) control for each rad s of the error's sum, at most `law.MOST_SUM`, where that is all; roll-outs do
        it in their compiled loop then. Else None.
        """

    def restart(self, which: Array) -> None:
        """Forgets the past of the simulations marked in `which` (nsim,) bool, as when the drive is switched off."""


@shown
@dataclass(frozen=True)
class Effect:
    """One physical effect.

    Attributes:
        name: as in `backlash.x.width`; also the file's name.
        title, physics, equation: for people; physics is one sentence.
        parameters: at their `off` values the effect changes nothing, bit for bit.
        stage: what it changes.
        mark: what it looks like in the data.
        shows: the mark of `labyrinth_sim.marks` that explains most of what it changes.
        confused_with: effects whose data can look the same.
        separated_by: the experiment that distinguishes them.
        where: what it acts on: each axis, each measured position, or the ball.
        needs: "belt", "other_axis", "hinge", "ball"; what the rig must have beyond `where`.
        couples: whether what it does to its axis depends on how the other axes move.
        everywhere: whether it acts on every axis wherever it is stated, as the one supply of all drives does. Stated at
            several axes, each of these has its own, and the first holds for all others.
        contains: rows of own parameter, other effect, its parameter or a number: set like that, it does what that one
            does.
        order: position among effects of the same stage, low first.
        exact: nature has it in one form, as a delay or a tick, so that what it leaves is something else. Of others, as
            friction, no equation is more than near.
        nameless: a free curve: it says over what variable something is missing and not why. A candidate of no search
            unless asked for.
        touches: MuJoCo model fields that `step` writes; set back to their base before every step.
        command: makes the filter of a target (rad).
        error: a law that changes what the drive sees of its error, see `labyrinth_sim.law`.
        spec: changes the structure, whatever the values.
        fields: changes per-simulation fields of the compiled model.
        step: called before every MuJoCo step: a compiled law of one simulation, or a plain function of the whole batch,
            which takes many times as long.
        tables: what a compiled `step` or `error` reads beside its values, see `labyrinth_sim.law.row_of`.
        steps_with: the parameter at whose 0 `step` or `error` has nothing to do, "" if it always has.
        measure: makes the filter of a signal.
        undo: the true value (nsim,) behind a measured one, from which a roll-out starts: a joint that stiction holds
            would keep a wrong start for long.
    """

    name: str
    title: str
    physics: str
    equation: str
    parameters: tuple[Parameter, ...]
    stage: Stage
    mark: str
    shows: str
    confused_with: tuple[str, ...]
    separated_by: str
    where: Where = "axis"
    needs: tuple[str, ...] = ()
    couples: bool = False
    everywhere: bool = False
    contains: tuple[tuple[str, str, str | float], ...] = ()
    order: int = 0
    exact: bool = False
    nameless: bool = False
    touches: tuple[str, ...] = ()
    command: "Callable[[Values, Site, float, Array], Filter | None] | None" = None
    error: "Law | None" = None
    spec: "Callable[[mujoco.MjSpec, Site], None] | None" = None
    fields: "Callable[[Fields, Site, Values], None] | None" = None
    step: "Law | Callable[[Live, Site, Values], None] | None" = None
    tables: "Tables | None" = None
    steps_with: str = ""
    measure: "Callable[[Values, Site, float, Array], Filter | None] | None" = None
    undo: "Callable[[Values, Site, Array], Array] | None" = None

    def __post_init__(self) -> None:
        if self.shows not in MARKS:
            raise InputError(f"Effect {self.name}: {unknown_name('mark', self.shows, MARKS)}")

    @property
    def only_measures(self) -> bool:
        """Whether it changes what is measured and nothing of the motion."""
        return not (self.command or self.error or self.spec or self.fields or self.step)

    def steps_at(self, values: Mapping[str, Any]) -> NDArray[np.bool_]:
        """Whether `step` or `error` has something to do at these values of its parameters, numbers or (nsim,) each."""
        needed = values[self.steps_with] if self.steps_with else 1.0
        return np.asarray(np.not_equal(needed, 0.0) & (self.step is not None or self.error is not None))

    @property
    def main(self) -> Parameter:
        """The parameter by which it vanishes; the first of several."""
        return next(p for p in self.parameters if p.off is not None)

    @property
    def off(self) -> dict[str, float]:
        """Values at which it vanishes; parameters that do not matter then at their typical value."""
        return {p.name: p.typical if p.off is None else p.off for p in self.parameters}

    @property
    def typical(self) -> dict[str, float]:
        return {p.name: p.typical for p in self.parameters}


@shown
@dataclass(frozen=True)
class Drive:
    """One kind of drive.

    Attributes:
        spec: makes the axis's actuator, whatever the values.
        fields: writes the values into the compiled model.
        target: makes the filter of the target (rad), as for a delay; None for none.
        gain: (nsim,) control of the actuator for each radian of the target; None for 1.
        lead: (nsim,) control for each radian by which the target has moved within 10 ms; None for 0. With these two
            alone the controls of a whole roll-out are known beforehand, and MuJoCo steps it without a stop.
        controller: makes what the law remembers, given the values and the sample time in s; None where it remembers
            nothing.
        by_duty: whether it sets the motor's duty, so that less voltage means less of everything; else it regulates the
            torque, and less voltage means less at most.
        full: N m or N that it gives at most at rest, by its values; None where it is not known.
        free: parameters that a calibration fits by default, `joint.armature` being the shaft's; empty for
            all.
        identified_by_effort: also free if no effort of the axis is compared; an effort would determine them.
        uncertain: those that data sheets give roughly, if at all; a diagnosis refits them along with the free ones.
        loose: free ones of which what is stated gives the order of magnitude; a diagnosis holds them loosely.
    """

    name: str
    title: str
    physics: str
    equation: str
    parameters: tuple[Parameter, ...]
    spec: "Callable[[mujoco.MjSpec, Site], None]"
    fields: "Callable[[Fields, Site, Values], None]"
    full: Callable[[Mapping[str, float]], float] | None = None
    by_duty: bool = False
    target: "Callable[[Values, Site, float, Array], Filter | None] | None" = None
    gain: "Callable[[Values], Array] | None" = None
    lead: "Callable[[Values], Array] | None" = None
    controller: "Callable[[Values, float], Controller | None] | None" = None
    free: tuple[str, ...] = ()
    identified_by_effort: tuple[str, ...] = ()
    uncertain: tuple[str, ...] = ()
    loose: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        known = [p.name for p in self.parameters]
        fitted = (*self.free, *self.identified_by_effort, *self.uncertain, *self.loose)
        wrong = [unknown_name("parameter", name, known) for name in fitted if name not in (*known, "joint.armature")]
        if wrong:
            raise InputError([f"Drive {self.name}, free: {text}" for text in wrong])


def effects(folder: Path | str | None = None) -> dict[str, Effect]:
    """Every effect by name: the library's, then entry points `labyrinth_sim.effects`, then those of a folder.

    Args:
        folder: of the user's effect files; $EPS_TUNNEL_EFFECTS where None.

    Raises:
        InputError: a file that does not load, declares no EFFECT, or takes a name that is taken.
    """
    return _library("labyrinth_sim.effects", "EFFECT", Effect, folder or os.environ.get(FOLDER_VARIABLE))


def rivals(name: str, library: Mapping[str, Effect] | None = None) -> frozenset[str]:
    """Effects that one can be mistaken for, whichever of the two declares it.

    Raises:
        InputError: unknown name.
    """
    known = effects() if library is None else library
    own: Effect = named("effect", name, known)
    return frozenset(own.confused_with) | {other.name for other in known.values() if name in other.confused_with}


def drives(folder: Path | str | None = None) -> dict[str, Drive]:
    """Every kind of drive by name; found as effects are, in `drives/` and entry points `labyrinth_sim.drives`."""
    return _library("labyrinth_sim.drives", "DRIVE", Drive, folder or os.environ.get("EPS_TUNNEL_DRIVES"))


def named(kind: str, name: str, library: Mapping[str, Any]) -> Any:
    """An entry of a library. Raises InputError that lists the valid names."""
    if name not in library:
        raise InputError(unknown_name(kind, name, library))
    return library[name]


def _library(
    package: str, symbol: str, kind: "type[Effect] | type[Drive]", folder: Path | str | None
) -> dict[str, Any]:
    declared: dict[str, Any] = {}
    complaints: list[str] = []
    for where, item in _declared(package, symbol, folder, complaints):
        if not isinstance(item, kind):
            complaints.append(f"{where}: expected {symbol} = {kind.__name__}(...), got {type(item).__name__}.")
        elif item.name in declared and declared[item.name] is not item:
            complaints.append(f"{where}: the name '{item.name}' is taken; choose another.")
        else:
            declared[item.name] = item
    if complaints:
        raise InputError(complaints)
    return dict(sorted(declared.items()))


def _declared(
    package: str, symbol: str, folder: Path | str | None, complaints: list[str]
) -> Iterator[tuple[str, object]]:
    own = importlib.import_module(package)
    for info in pkgutil.iter_modules(own.__path__):
        yield info.name, getattr(importlib.import_module(f"{package}.{info.name}"), symbol, None)
    for point in _entry_points(package, tuple(sys.path)):
        try:
            yield point.value, point.load()
        except Exception as error:  # whatever a foreign module raises while it loads
            complaints.append(f"Entry point {point.value} does not load: {error}")
    if not folder:
        return
    if not Path(folder).is_dir():
        complaints.append(f"{folder} is no folder; name the folder that holds your effect files.")
        return
    for file in sorted(Path(folder).glob("[!_]*.py")):
        try:
            yield str(file), getattr(_load(file), symbol, None)
        except Exception as error:  # whatever the user's file raises while it loads
            complaints.append(f"{file} does not load: {type(error).__name__}: {error}")


@cache
def _entry_points(group: str, path: tuple[str, ...]) -> tuple[importlib.metadata.EntryPoint, ...]:
    """Those of a group that packages on a search path declare; to look through all of them takes long."""
    return tuple(importlib.metadata.entry_points(group=group))


_LOADED: dict[tuple[Path, int], ModuleType] = {}


def _load(file: Path) -> ModuleType:
    key = (file.resolve(), file.stat().st_mtime_ns)
    if key not in _LOADED:
        spec = importlib.util.spec_from_file_location(f"labyrinth_sim_user_{file.stem}", file)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        _LOADED[key] = module
    return _LOADED[key]
