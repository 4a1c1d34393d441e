# SPDX-License-Identifier: Apache-2.0
"""What the file of an effect or a drive declares, and how such files are found.

A hook works on all simulations of a batch at once: every parameter it gets is an array (nsim,). An effect has the hooks
that it needs and leaves the others None.
"""

import importlib
import importlib.metadata
import importlib.util
import os
import pkgutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal, Protocol

from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.marks import MARKS
from labyrinth_sim.trials import Array

if TYPE_CHECKING:
    import mujoco

    from labyrinth_sim.live import Fields, Live
    from labyrinth_sim.site import Site

Values = Mapping[str, Array]
"""Parameter name -> (nsim,)."""

Stage = Literal["command", "drive", "mjcf", "force", "measurement"]
Where = Literal["axis", "signal", "ball"]
FOLDER_VARIABLE = "EPS_TUNNEL_EFFECTS"


@dataclass(frozen=True)
class Parameter:
    """One parameter: bounds of the search, the value at which the effect vanishes, a typical one, why the bounds.

    `off` is None where no value of this parameter alone makes the effect vanish (a period, a characteristic speed).
    """

    name: str
    unit: str
    low: float
    high: float
    off: float | None
    typical: float
    why: str

    def __post_init__(self) -> None:
        if not self.low <= self.typical <= self.high or not (self.off is None or self.low <= self.off <= self.high):
            raise InputError(f"Parameter {self.name}: typical and off must lie within [{self.low:g}, {self.high:g}].")


class Filter(Protocol):
    """A stream of samples in, the same number out; keeps its state from call to call."""

    def __call__(self, own: Array, every: Array) -> Array:
        """(nsim, K) of this channel from (nsim, K) and, as a command filter, all channels (nsim, K, u)."""


class Controller(Protocol):
    """What a drive's law does between its samples and at each of them; the rest of it is MuJoCo's actuator."""

    def sample(self, error: Array) -> None:
        """Once a sample, with target - angle (nsim,) rad."""

    def __call__(self, target: Array) -> Array:
        """Actuator control (nsim,) while the drive sees this target (nsim,) rad."""

    def restart(self, which: Array) -> None:
        """Forgets the past of the simulations marked in `which` (nsim,) bool, as when the drive is switched off."""


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
        separated_by: the experiment that tells them apart.
        where: what it acts on: each axis, each measured position, or the ball.
        needs: "belt", "other_axis"; what the rig must have beyond `where`.
        couples: whether what it does to its axis depends on how the other axes move.
        order: position among effects of the same stage, low first.
        touches: MuJoCo model fields that `step` writes; set back to their base before every step.
        command: makes the filter of a target (rad).
        error: what the drive sees of its error (rad).
        spec: changes the structure, whatever the values.
        fields: changes per-simulation fields of the compiled model.
        step: called before every MuJoCo step.
        measure: makes the filter of a signal.
        undo: the true value (nsim,) behind a measured one, where a roll-out must not start from what is seen.
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
    order: int = 0
    touches: tuple[str, ...] = ()
    command: "Callable[[Values, Site, float, Array], Filter | None] | None" = None
    error: "Callable[[Values, Array], Array] | None" = None
    spec: "Callable[[mujoco.MjSpec, Site], None] | None" = None
    fields: "Callable[[Fields, Site, Values], None] | None" = None
    step: "Callable[[Live, Site, Values], None] | None" = None
    measure: "Callable[[Values, Site, float, Array], Filter | None] | None" = None
    undo: "Callable[[Values, Site, Array], Array] | None" = None

    def __post_init__(self) -> None:
        if self.shows not in MARKS:
            raise InputError(f"Effect {self.name}: {unknown_name('mark', self.shows, MARKS)}")

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


@dataclass(frozen=True)
class Drive:
    """One kind of drive.

    Attributes:
        spec: makes the axis's actuator, whatever the values.
        fields: writes the values into the compiled model.
        target: makes the filter of the target (rad), as for a delay; None for none.
        controller: makes what MuJoCo's actuator cannot do of the law; None where it does it all and its control is the
            target.
        supply: scales the axis's strength while stepping, as a sagging supply does: gets (nsim,) of the full voltage,
            and (nsim,) signed share of it that back-EMF takes.
        strength: model fields that `supply` writes.
        free: parameters that a calibration fits unless told otherwise, `joint.armature` being the shaft's; empty for
            all.
    """

    name: str
    title: str
    physics: str
    equation: str
    parameters: tuple[Parameter, ...]
    spec: "Callable[[mujoco.MjSpec, Site], None]"
    fields: "Callable[[Fields, Site, Values], None]"
    supply: "Callable[[Live, Site, Array, Array], None]"
    strength: tuple[str, ...] = ("actuator_forcerange",)
    target: "Callable[[Values, Site, float, Array], Filter | None] | None" = None
    controller: "Callable[[Values, float], Controller] | None" = None
    free: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        known = [p.name for p in self.parameters]
        wrong = [unknown_name("parameter", name, known) for name in self.free if name not in (*known, "joint.armature")]
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
    found: dict[str, Any] = {}
    complaints: list[str] = []
    for where, item in _declared(package, symbol, folder, complaints):
        if not isinstance(item, kind):
            complaints.append(f"{where}: expected {symbol} = {kind.__name__}(...), got {type(item).__name__}.")
        elif item.name in found and found[item.name] is not item:
            complaints.append(f"{where}: the name '{item.name}' is taken; choose another.")
        else:
            found[item.name] = item
    if complaints:
        raise InputError(complaints)
    return dict(sorted(found.items()))


def _declared(
    package: str, symbol: str, folder: Path | str | None, complaints: list[str]
) -> Iterator[tuple[str, object]]:
    own = importlib.import_module(package)
    for info in pkgutil.iter_modules(own.__path__):
        yield info.name, getattr(importlib.import_module(f"{package}.{info.name}"), symbol, None)
    for point in importlib.metadata.entry_points(group=package):
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
