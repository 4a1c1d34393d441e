# SPDX-License-Identifier: Apache-2.0
"""One module a command; each has NAME, a first docstring line for the help, and add_arguments(parser)."""

import argparse
from collections.abc import Callable
from typing import Any

Verb = Callable[[argparse.Namespace], Any]


def add_verbs(
    parser: argparse.ArgumentParser, command: str, verbs: dict[str, tuple[Verb, Callable[..., None]]]
) -> None:
    """Subcommands of one command: name -> (function to call, function that adds its arguments)."""
    listing = "\n".join(f"{name:<12} {(call.__doc__ or '').splitlines()[0]}" for name, (call, _) in verbs.items())
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    choices = parser.add_subparsers(
        title="Commands", description=listing, metavar=f"Call `ros2 {command} <command> -h` for more detailed usage."
    )
    for name, (call, add_arguments) in verbs.items():
        sub = choices.add_parser(name, description=(call.__doc__ or "").splitlines()[0])
        sub.set_defaults(call=call)
        add_arguments(sub)
