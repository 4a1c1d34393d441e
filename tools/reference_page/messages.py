# SPDX-License-Identifier: Apache-2.0
"""Messages, services and actions, from the files of labyrinth_msgs as ROS's own parser reads them."""

from itertools import takewhile
from pathlib import Path
from typing import Any

from rosidl_adapter.parser import parse_action_file, parse_message_file, parse_service_file

from reference_page.tables import code, table

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = "labyrinth_msgs"
PARTS = {"msg": [""], "srv": ["request", "response"], "action": ["goal", "result", "feedback"]}


def files(kind: str) -> list[Path]:
    """Every definition of a kind: msg, srv or action."""
    return sorted((ROOT / "src" / PACKAGE / kind).glob(f"*.{kind}"))


def parts(file: Path) -> dict[str, Any]:
    """The messages that a definition consists of, by their names in PARTS."""
    if file.suffix == ".msg":
        return {"": parse_message_file(PACKAGE, file)}
    whole = parse_service_file(PACKAGE, file) if file.suffix == ".srv" else parse_action_file(PACKAGE, file)
    return {name: getattr(whole, name) for name in PARTS[file.suffix[1:]]}


def rows(message: Any) -> list[tuple[str, str, str]]:
    """Name, type and meaning with unit of each constant and field."""
    every = [(f"{c.name} = {c.value}", c.type, c.annotations) for c in message.constants]
    every += [(f.name, str(f.type), f.annotations) for f in message.fields]
    return [
        (code(name), code(kind), " ".join([*about.get("comment", ()), *unit(about)])) for name, kind, about in every
    ]


def unit(about: dict[str, Any]) -> list[str]:
    return [f"[{about['unit']}]"] if "unit" in about else []


def section() -> str:
    """All definitions."""
    lines = ["## Messages, services, actions\n"]
    for file in (file for kind in PARTS for file in files(kind)):
        head = takewhile(lambda line: line.startswith("#"), file.read_text(encoding="utf-8").splitlines())
        about = " ".join(line.lstrip("# ") for line in head)
        lines.append(f"### `{PACKAGE}/{file.suffix[1:]}/{file.stem}`\n\n{about}\n")
        for name, message in parts(file).items():
            if name and rows(message):
                lines.append(f"{name.capitalize()}:\n")
            lines.append(table(("field", "type", "meaning [unit]"), rows(message)))
    return "\n".join(filter(None, lines))
