# SPDX-License-Identifier: Apache-2.0
"""What a shell offers behind TAB: commands and options by themselves, and names of effects, models, rigs, sequences.

A shell asks by starting the program with `_ARGCOMPLETE` set, at every TAB: nothing slow is imported, no effect loaded.
"""

import argparse
import os
import pkgutil
from collections.abc import Callable, Iterable
from importlib import metadata, util
from pathlib import Path
from typing import Any

from labyrinth_sim.config import names

ASKED = "_ARGCOMPLETE"
EFFECTS = "labyrinth_sim.effects"
Completer = Callable[..., Iterable[str]]


def complete(parser: argparse.ArgumentParser) -> None:
    """Answers the shell and ends the process, where it is a shell that asks."""
    if ASKED not in os.environ:
        return
    import argcomplete

    for command in _subparsers(parser).values():
        for action in command._actions:
            if completer := _completer(action):
                action.completer = completer  # type: ignore[attr-defined]
    argcomplete.autocomplete(parser)


def _completer(action: argparse.Action) -> Completer | None:
    """By the name of an option, or of what stands alone."""
    return {
        "--model": _named("models"),
        "--rig": _named("rigs"),
        "--candidates": effect_names,
        "names": effect_names,
        "name": _named("sequences"),
    }.get(action.option_strings[0] if action.option_strings else action.dest)


def _named(kind: str) -> Completer:
    """Files of the configuration by name, and files by path."""

    def offered(prefix: str, **given: Any) -> list[str]:
        from argcomplete.completers import FilesCompleter

        return [*(name for name in names(kind) if name.startswith(prefix)), *FilesCompleter()(prefix)]

    return offered


def effect_names(prefix: str, parsed_args: argparse.Namespace, **given: Any) -> list[str]:
    """Names of effects, which are those of their files; before a place, as `add-effect` wants it, with a dot."""
    found: set[str] = set()
    spec = util.find_spec(EFFECTS)
    if spec is not None:
        found |= {module.name for module in pkgutil.iter_modules(spec.submodule_search_locations)}
    found |= {point.name for point in metadata.entry_points(group=EFFECTS)}
    folder = getattr(parsed_args, "effects", None) or os.environ.get("EPS_TUNNEL_EFFECTS")
    if folder:
        found |= {file.stem for file in Path(folder).glob("[!_]*.py")}
    dot = "." if getattr(parsed_args, "command", "") == "add-effect" else ""
    return sorted(f"{name}{dot}" for name in found if name.startswith(prefix))


def _subparsers(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    return {
        name: sub
        for action in parser._actions
        if isinstance(action, argparse._SubParsersAction)
        for name, sub in action.choices.items()
    }
