# SPDX-License-Identifier: Apache-2.0
"""Parses `ros2 COMMAND VERB ...`, runs the verb and turns its outcome into an exit code.

A command is a module; its verbs are functions marked with `@verb(arguments...)`, named like the verb.
"""

import argparse
import importlib
import signal
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

COMMANDS = ("action", "interface", "launch", "lifecycle", "node", "param", "pkg", "run", "service", "topic")

# What the real ros2 has besides: command -> its verbs; no verbs: the whole command.
ELSEWHERE = {
    "action": ("find", "type"),
    "bag": (),
    "component": (),
    "control": (),
    "daemon": (),
    "doctor": (),
    "interface": ("package", "packages", "proto"),
    "multicast": (),
    "param": ("delete",),
    "pkg": ("create", "xml"),
    "plugin": (),
    "security": (),
    "service": ("echo", "find", "info"),
    "topic": ("bw", "delay", "find"),
    "wtf": (),
}
MEANWHILE = {
    "bag": "`eps-tunnel replay BAG` plays a bag; the action /play_sequence records one.",
    "daemon": "No daemon is needed here: every command discovers for itself.",
}
STAND_IN = "a stand-in for the `ros2` of ROS 2, which PyPI does not have"


@dataclass(frozen=True)
class Argument:
    """What argparse's add_argument takes."""

    names: tuple[str, ...]
    options: dict[str, Any]


@dataclass(frozen=True)
class Verb:
    call: Callable[[argparse.Namespace], int | str | None]
    arguments: tuple[Argument, ...]

    @property
    def about(self) -> str:
        return (self.call.__doc__ or "").splitlines()[0]


VERBS: dict[str, dict[str, Verb]] = {}


def argument(*names: str, **options: Any) -> Argument:
    return Argument(names, options)


def flag(*names: str, **options: Any) -> Argument:
    return Argument(names, {"action": "store_true", **options})


def verb(*arguments: Argument) -> Callable[[Any], Any]:
    """Marks a function as the verb of its name, of the command that its module is named after.

    It returns None or 0 for success, an exit code, or text: an error for stderr, with exit code 1.
    """

    def register(call: Any) -> Any:
        VERBS.setdefault(call.__module__.rpartition(".")[2], {})[call.__name__.strip("_")] = Verb(call, arguments)
        return call

    return register


def lacking() -> str:
    """What the real ros2 has besides, in one sentence."""
    whole = ", ".join(name for name, verbs in ELSEWHERE.items() if not verbs)
    single = "; ".join(f"{name} {', '.join(verbs)}" for name, verbs in ELSEWHERE.items() if verbs)
    return f"The real one has more options, and besides: {whole}; {single}."


def parser() -> argparse.ArgumentParser:
    for name in COMMANDS:
        importlib.import_module(f"ros2_standin.{name}")
    top = argparse.ArgumentParser(prog="ros2", description=f"This is {STAND_IN}. {lacking()}")
    commands = top.add_subparsers(title="Commands", metavar="COMMAND")
    for name in COMMANDS:
        verbs = VERBS[name]
        about = f"{name} {', '.join(verbs)}" if name not in verbs else verbs[name].about
        sub = commands.add_parser(name, help=about, description=f"{about}. This is {STAND_IN}.")
        sub.set_defaults(call=None, help=sub.print_help)
        if name in verbs:  # a command that is its own verb, such as run
            _fill(sub, verbs[name])
            continue
        choices = sub.add_subparsers(title="Verbs", metavar="VERB")
        for word, entry in verbs.items():
            _fill(choices.add_parser(word, help=entry.about, description=entry.about), entry)
    return top


def _fill(into: argparse.ArgumentParser, entry: Verb) -> None:
    into.set_defaults(call=entry.call)
    for given in entry.arguments:
        into.add_argument(*given.names, **given.options)


def main(argv: Sequence[str] | None = None) -> int | str | None:
    arguments = list(sys.argv[1:] if argv is None else argv)
    command, word = (*arguments, "", "")[:2]
    if command in ELSEWHERE and (word in ELSEWHERE[command] or not ELSEWHERE[command]):
        print(
            f"ros2: this is {STAND_IN}, and it has no `{command}{f' {word}' if ELSEWHERE[command] else ''}`. Install "
            f"ROS 2 and source its setup file; its ros2 goes before this one. {MEANWHILE.get(command, '')}".rstrip(),
            file=sys.stderr,
        )
        return 2
    top = parser()
    parsed = top.parse_args(arguments)
    call = getattr(parsed, "call", None)
    if call is None:
        getattr(parsed, "help", top.print_help)()
        return 0
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    return _outcome(call, parsed)


def _outcome(call: Callable[[argparse.Namespace], int | str | None], parsed: argparse.Namespace) -> int | str | None:
    from rclpy.executors import ExternalShutdownException

    try:
        return call(parsed)
    except KeyboardInterrupt:
        return int(signal.SIGINT)
    except ExternalShutdownException:
        return int(signal.SIGTERM)
    except BrokenPipeError:
        # `ros2 topic list | head -1`: the reader is gone, so there is nothing left to do.
        sys.stdout = None  # type: ignore[assignment]
        return 0
    except RuntimeError as error:
        return str(error)
