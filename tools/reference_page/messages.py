# SPDX-License-Identifier: Apache-2.0
"""Messages, services and actions, from the files of labyrinth_msgs."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from reference_page.tables import code, table

ROOT = Path(__file__).resolve().parents[2]
MSGS = ROOT / "src" / "labyrinth_msgs"
PARTS = {"msg": ("",), "srv": ("request", "response"), "action": ("goal", "result", "feedback")}
LINE = re.compile(r"^(?P<kind>[\w/\[\]<=]+)\s+(?P<name>\w+)\s*(=\s*(?P<value>[^#]*?))?\s*(#\s*(?P<text>.*))?$")


@dataclass(frozen=True)
class Field:
    """A field or, with a value, a constant. `part`: index of the part of a service or action."""

    part: int
    kind: str
    name: str
    value: str
    text: str


def files(kind: str) -> list[Path]:
    """Every definition of a kind: msg, srv or action."""
    return sorted((MSGS / kind).glob(f"*.{kind}"))


def fields(file: Path) -> Iterator[Field]:
    """The fields of a definition, in order."""
    part = 0
    for line in file.read_text(encoding="utf-8").splitlines():
        if line.strip() == "---":
            part += 1
        elif match := LINE.match(line):
            yield Field(part, match["kind"], match["name"], (match["value"] or "").strip(), match["text"] or "")


def about(file: Path) -> str:
    """What the comment at the head of a definition says."""
    lines = []
    for line in file.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.lstrip("# "))
    return " ".join(lines)


def section() -> str:
    """All definitions."""
    parts = ["## Messages, services, actions\n"]
    for kind, names in PARTS.items():
        for file in files(kind):
            parts.append(f"### `labyrinth_msgs/{kind}/{file.stem}`\n\n{about(file)}\n")
            every = list(fields(file))
            for index, name in enumerate(names):
                own = [f for f in every if f.part == index]
                rows = [(code(f"{f.name} = {f.value}" if f.value else f.name), code(f.kind), f.text) for f in own]
                if name and rows:
                    parts.append(f"{name.capitalize()}:\n")
                parts.append(table(("field", "type", "meaning [unit]"), rows))
    return "\n".join(part for part in parts if part)
