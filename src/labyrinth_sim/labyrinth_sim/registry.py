# SPDX-License-Identifier: Apache-2.0
"""The effects and drives that a run knows: the library's, those of installed packages, and those of a user's folder."""

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from labyrinth_sim.effect import FOLDER_VARIABLE, Drive, Effect, drives, effects, named, rivals
from labyrinth_sim.errors import InputError, unknown_name
from labyrinth_sim.shown import shown


@shown
@dataclass(frozen=True)
class Registry:
    """Effects and drives by name, made once for a run and handed down with the model.

    Attributes:
        folder: with the user's own effects, None where there is none; a command that is run next needs it too.
    """

    effects: Mapping[str, Effect]
    drives: Mapping[str, Drive]
    folder: Path | None = None

    @classmethod
    def load(cls, folder: Path | str | None = None) -> "Registry":
        """Finds all there are.

        Args:
            folder: of the user's effect files; $EPS_TUNNEL_EFFECTS where None.

        Raises:
            InputError: a file that does not load, declares no EFFECT, or takes a name that is taken.
        """
        chosen = folder or os.environ.get(FOLDER_VARIABLE) or None
        return cls(effects(chosen), drives(), Path(chosen) if chosen else None)

    def __reduce__(self) -> tuple[Callable[..., "Registry"], tuple[Path | None]]:
        # Functions of a user's file cannot be pickled; where the file is can be.
        return Registry.load, (self.folder,)

    def effect(self, effect: str | Effect) -> Effect:
        """An effect by name; a declaration is itself. Raises InputError that lists the valid names."""
        return effect if isinstance(effect, Effect) else named("effect", effect, self.effects)

    def check(self, names: Iterable[str]) -> None:
        """Raises InputError that lists all unknown names of effects; a place may follow each, as in `backlash.x`."""
        effects = [name.partition(".")[0] for name in names]
        unknown = [unknown_name("effect", name, self.effects) for name in effects if name not in self.effects]
        if unknown:
            raise InputError(unknown)

    def drive(self, name: str) -> Drive:
        """A kind of drive by name. Raises InputError that lists the valid names."""
        kind: Drive = named("drive", name, self.drives)
        return kind

    def rivals(self, name: str) -> frozenset[str]:
        """Effects that one can be mistaken for, whichever of the two declares it. Raises InputError: unknown name."""
        return rivals(name, self.effects)
