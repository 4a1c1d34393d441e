# SPDX-License-Identifier: Apache-2.0
"""Options of the command lines, from their argparse parsers."""

import argparse
from collections.abc import Iterable, Iterator

from reference_page.tables import code, table

READING = "reading bags"  # a group of options that several commands share


def eps_tunnel_section() -> str:
    """Every command of `eps-tunnel`."""
    from eps_tunnel_analysis.cli.main import parser

    commands = subparsers(parser())
    shared = [name for name, command in commands.items() if group(command, READING)]
    parts = [
        "## `eps-tunnel COMMAND`\n",
        "Also `ros2 run eps_tunnel_analysis eps_tunnel COMMAND`. Exit codes: 0 done; 1 the work failed; 2 bad input, "
        "explained on stderr; 130 Ctrl-C. With `--json` stdout holds the result only; progress goes to stderr.\n",
        f"### Options for reading bags\n\nThe same for {', '.join(map(code, shared))}.\n",
        options(group(commands[shared[0]], READING)),
    ]
    for name, command in commands.items():
        note = " The options above belong to it, too." if name in shared else ""
        parts.append(f"### `eps-tunnel {name}`\n\n{command.description}{note}\n")
        in_group = group(command, READING)
        parts.append(options(a for a in command._actions if a not in in_group))
    return "\n".join(parts)


def executable_section(title: str, parser: argparse.ArgumentParser) -> str:
    """One program of `ros2 run`, its subcommands included."""
    about = parser.description or ""
    parts = [f"### `{title}`\n\n{about[:1].upper()}{about[1:]}\n"]
    below = subparsers(parser)
    parts.append(options(parser._actions))
    for name, command in below.items():
        parts.append(f"`{title} {name}`: {help_of_subcommand(parser, name)}\n\n{options(command._actions)}")
    return "\n".join(parts)


def options(actions: Iterable[argparse.Action]) -> str:
    """A table of options."""
    return table(("option", "meaning"), map(row, filter(is_shown, actions)))


def is_shown(action: argparse.Action) -> bool:
    """Whether an action is an option that a user chooses."""
    hidden = (argparse._HelpAction, argparse._VersionAction, argparse._SubParsersAction)
    return not isinstance(action, hidden) and action.help is not argparse.SUPPRESS


def row(action: argparse.Action) -> tuple[str, str]:
    """Option with its value; meaning and default."""
    words = list(value_words(action))
    names = ", ".join(action.option_strings)
    title = " ".join(filter(None, (names, *words)))
    given = {**vars(action), "prog": ""}
    text = (action.help or "") % given
    if action.required and action.option_strings:
        text += " (required)"
    if action.default not in (None, False, argparse.SUPPRESS, []) and "default" not in text:
        text += f" (default: {action.default})"
    return code(title), text


def value_words(action: argparse.Action) -> Iterator[str]:
    """How the option's value is written."""
    if action.nargs == 0:
        return
    shown = action.metavar or (
        "{" + ",".join(map(str, action.choices)) + "}" if action.choices else action.dest.upper().replace("_", "-")
    )
    name = shown if isinstance(shown, str) else " ".join(shown)
    yield {"+": f"{name} ...", "*": f"[{name} ...]", "?": f"[{name}]"}.get(str(action.nargs), name)


def group(parser: argparse.ArgumentParser, title: str) -> list[argparse.Action]:
    """The actions of an argument group."""
    return [a for g in parser._action_groups if g.title == title for a in g._group_actions]


def subparsers(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """Parsers of the subcommands by name."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}


def help_of_subcommand(parser: argparse.ArgumentParser, name: str) -> str:
    """The line for a subcommand in its parent's help."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return next((str(a.help) for a in action._choices_actions if a.dest == name), "")
    return ""
