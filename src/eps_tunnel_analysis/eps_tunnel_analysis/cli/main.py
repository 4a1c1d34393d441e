# SPDX-License-Identifier: Apache-2.0
"""eps-tunnel COMMAND: finds the commands, parses, runs, and turns errors into words and exit codes; completes for TAB.

0: done. 2: bad input, explained on stderr. 130: Ctrl-C. 141: the reader of our output is gone.
"""

import argparse
import importlib
import os
import pkgutil
import sys
from collections.abc import Callable, Iterable, Sequence
from importlib import metadata, util
from pathlib import Path
from typing import Any, Protocol, cast

from eps_tunnel_analysis import cli
from eps_tunnel_analysis.outputs import version
from eps_tunnel_analysis.processes import INTERRUPTED
from labyrinth_sim.config import names
from labyrinth_sim.errors import InputError

DONE, BAD_INPUT, PIPE_CLOSED = 0, 2, 141
DESCRIPTION = """\
How far a simulation is from a real rig, where, and which physical effect the model lacks.
Reads rosbag2 recordings; needs no ROS."""
ASKED = "_ARGCOMPLETE"
EFFECTS = "labyrinth_sim.effects"
Completer = Callable[..., Iterable[str]]


class CommandModule(Protocol):
    """What the module of a command declares."""

    NAME: str
    HELP: str
    add_arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int | None]


def commands() -> dict[str, CommandModule]:
    """Every command by name, in alphabetical order."""
    modules = [importlib.import_module(f"{cli.__name__}.{m.name}") for m in pkgutil.iter_modules(cli.__path__)
               if not m.name.startswith("_")]  # fmt: skip
    return {
        m.NAME: cast(CommandModule, m) for m in sorted((m for m in modules if hasattr(m, "NAME")), key=lambda m: m.NAME)
    }


def parser() -> argparse.ArgumentParser:
    """The whole command line."""
    top = argparse.ArgumentParser(
        "eps-tunnel",
        description=DESCRIPTION,
        epilog="eps-tunnel COMMAND --help explains each.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("--version", action="version", version=f"eps-tunnel {version()}")
    subparsers = top.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, command in commands().items():
        sub = subparsers.add_parser(
            name,
            help=command.HELP,
            description=command.HELP,
            epilog=getattr(command, "EPILOG", None),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        command.add_arguments(sub)
        sub.set_defaults(run=command.run)
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command and returns its exit code."""
    name = "eps-tunnel"
    try:
        line = parser()
        complete(line)
        arguments = line.parse_args(argv)
        name = f"{name} {arguments.command}"
        code = arguments.run(arguments)
        sys.stdout.flush()
        return int(code or DONE)
    except InputError as error:
        for complaint in error.complaints:
            print(f"{name}: {complaint}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print(f"{name}: interrupted.", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # keeps Python's own flush at exit quiet
        return PIPE_CLOSED
    except MemoryError:
        print(f"{name}: out of memory. Take fewer or shorter recordings, or a lower --rate.", file=sys.stderr)
        return BAD_INPUT
    except RecursionError:
        print(f"{name}: an input is nested too deeply to be read. Look for a damaged file.", file=sys.stderr)
        return BAD_INPUT
    except OSError as error:
        file = f"{error.filename}: " if error.filename else ""
        print(f"{name}: {file}{error.strerror or error}", file=sys.stderr)
        _give_up_output()
        return BAD_INPUT


def _give_up_output() -> None:
    """Discards what stdout could not take, as on a full disk; otherwise Python would try again at exit and complain."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def complete(parser: argparse.ArgumentParser) -> None:
    """Answers a completion request of the shell and ends the process, if there is one.

    On TAB, commands and options are completed, and names of effects, models, rigs, sequences. The shell asks
    by starting the program with `_ARGCOMPLETE` set, at every TAB: nothing slow is imported, no effect loaded.
    """
    if ASKED not in os.environ:
        return
    import argcomplete

    for command in _subparsers(parser).values():
        for action in command._actions:
            if completer := _completer(action):
                action.completer = completer  # type: ignore[attr-defined]
    argcomplete.autocomplete(parser)


def _completer(action: argparse.Action) -> Completer | None:
    """Completer for an option or a positional argument, by its name."""
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
    """Names of effects, which are those of their files; with a dot where a place follows, as in `add-effect`."""
    names: set[str] = set()
    spec = util.find_spec(EFFECTS)
    if spec is not None:
        names |= {module.name for module in pkgutil.iter_modules(spec.submodule_search_locations)}
    names |= {point.name for point in metadata.entry_points(group=EFFECTS)}
    folder = getattr(parsed_args, "effects", None) or os.environ.get("EPS_TUNNEL_EFFECTS")
    if folder:
        names |= {file.stem for file in Path(folder).glob("[!_]*.py")}
    dot = "." if getattr(parsed_args, "command", "") == "add-effect" else ""
    return sorted(f"{name}{dot}" for name in names if name.startswith(prefix))


def _subparsers(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    return {
        name: sub
        for action in parser._actions
        if isinstance(action, argparse._SubParsersAction)
        for name, sub in action.choices.items()
    }


if __name__ == "__main__":
    sys.exit(main())
