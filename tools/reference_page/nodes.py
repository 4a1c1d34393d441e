# SPDX-License-Identifier: Apache-2.0
"""Parameters, topics, services and actions of the nodes, read off their source without running them."""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from reference_page.tables import code, table

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("labyrinth_hw", "labyrinth_sim", "eps_tunnel_analysis")
DECLARE = ("parameter", "_declare", "number")  # the nodes' own names for declaring a parameter
ENDS = {
    "create_publisher": "publishes",
    "create_subscription": "listens to",
    "create_service": "serves",
    "create_client": "calls",
    "ActionServer": "serves the action",
    "OneGoal": "serves the action",
    "ActionClient": "calls the action",
}
NAMESPACE = {"prefix", "name", "self.name", "side"}  # variables that hold real or sim
UNIT = re.compile(r"\s*\[([^\]]*)\]$")


@dataclass(frozen=True)
class Parameter:
    """A parameter as declared, in the words of the source; `changes`: whether it may be set while the node runs."""

    name: str
    default: str
    unit: str
    bounds: str
    text: str
    changes: bool


@dataclass(frozen=True)
class End:
    """One end of a topic, service or action. `kind`: PACKAGE/KIND/NAME of the type."""

    how: str
    name: str
    kind: str


@cache
def targets(package: str) -> dict[str, tuple[str, str]]:
    """Executable -> module and function, as setup.py declares it; NAME_start only announces NAME_node."""
    for node in ast.walk(parsed(ROOT / "src" / package / "setup.py")):
        if isinstance(node, ast.Dict):
            for key, value in zip(node.keys, node.values, strict=True):
                if isinstance(key, ast.Constant) and key.value == "console_scripts":
                    lines = [line.replace(" ", "").replace("_start:", "_node:") for line in ast.literal_eval(value)]
                    pairs = [line.split("=") for line in lines]
                    return {name: (target.split(":")[0], target.split(":")[1]) for name, target in pairs}
    return {}


def executables(package: str) -> dict[str, Path]:
    """Executable -> source file."""
    return {name: file_of(module) for name, (module, _) in targets(package).items()}


def file_of(module: str) -> Path:
    """The source file of a module of ours."""
    return ROOT / "src" / module.split(".")[0] / (module.replace(".", "/") + ".py")


@cache
def with_neighbours(file: Path) -> tuple[Path, ...]:
    """A node's file and those in its folder that it imports, directly or not."""
    known, queue = [file], [file]
    while queue:
        for node in ast.walk(parsed(queue.pop())):
            if isinstance(node, ast.ImportFrom) and node.module and ".nodes." in node.module:
                other = file_of(node.module)
                if other.is_file() and other not in known:
                    known.append(other)
                    queue.append(other)
    return tuple(known)


@cache
def parsed(file: Path) -> ast.Module:
    return ast.parse(file.read_text(encoding="utf-8"))


def parameters(file: Path) -> list[Parameter]:
    """Parameters that a node declares, by name."""
    found: dict[str, Parameter] = {}
    called = {_called(node) for node in ast.walk(parsed(file)) if isinstance(node, ast.Call)}
    for source in with_neighbours(file):
        # What a helper in another file declares counts only for those who call the helper.
        roots = [parsed(source)] if source == file else [f for f in _functions(source) if f.name in called]
        for node in (n for root in roots for n in ast.walk(root)):
            if isinstance(node, ast.Call) and _called(node) in DECLARE and len(node.args) >= 3:
                name = node.args[0]
                if isinstance(name, ast.Constant) and isinstance(name.value, str):
                    found.setdefault(name.value, _parameter(name.value, node))
    return sorted(found.values(), key=lambda p: p.name)


def _functions(source: Path) -> list[ast.FunctionDef]:
    return [node for node in ast.walk(parsed(source)) if isinstance(node, ast.FunctionDef)]


def _called(node: ast.Call) -> str:
    return node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")


def _parameter(name: str, node: ast.Call) -> Parameter:
    text = str(ast.literal_eval(node.args[2]))
    unit = next((m[1] for m in [UNIT.search(text)] if m), "")
    numbers = [ast.unparse(argument) for argument in node.args[3:]]
    changes = any(k.arg == "changes" for k in node.keywords)
    if numbers and not unit and isinstance(node.args[3], ast.Constant) and isinstance(node.args[3].value, str):
        unit, numbers = node.args[3].value, numbers[1:]
    numbers += [ast.unparse(k.value) for k in node.keywords if k.arg in ("low", "high")]
    bounds = f"{numbers[0]} to {numbers[1]}" if len(numbers) == 2 else ""
    text = UNIT.sub("", text)
    return Parameter(
        name, _default(node.args[1]), "" if unit == "-" else unit, bounds, text[0].upper() + text[1:], changes
    )


def _default(node: ast.expr) -> str:
    known = {"list(SIDES)": "['real', 'sim']", "list(KS)": "[1.0, 2.0, 3.0, 4.0, 5.0]"}
    if isinstance(node, ast.Constant):
        return {"": '""', "True": "true", "False": "false"}.get(str(node.value), str(node.value))
    text = known.get(ast.unparse(node), ast.unparse(node))
    return '[""]' if text == "['']" else text


def ends(file: Path) -> list[End]:
    """What a node publishes, hears, serves and calls; without what is named only while it runs, and hidden names."""
    found: dict[End, None] = {}
    for source in with_neighbours(file):
        kinds = imported(source)
        for node in ast.walk(parsed(source)):
            if isinstance(node, ast.Call) and _called(node) in ENDS:
                # What is not a method of the node takes the node first.
                kind, name = node.args[:2] if _called(node).startswith("create_") else node.args[1:3]
                if (topic := _topic(name)) and "/_" not in topic and ast.unparse(kind) in kinds:
                    found[End(ENDS[_called(node)], topic, kinds[ast.unparse(kind)])] = None
    return sorted(found, key=lambda e: (list(ENDS.values()).index(e.how), e.name))


def imported(source: Path) -> dict[str, str]:
    """Local name -> PACKAGE/KIND/NAME of every imported interface."""
    return {
        alias.asname or alias.name: f"{node.module.replace('.', '/')}/{alias.name}"
        for node in ast.walk(parsed(source))
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[-1] in ("msg", "srv", "action")
        for alias in node.names
    }


def _topic(node: ast.expr) -> str:
    if isinstance(node, ast.Constant):
        return str(node.value)
    if not isinstance(node, ast.JoinedStr):
        return ""
    return "".join(_words(node)).replace("/NS", "NS")


def _words(node: ast.JoinedStr) -> Iterator[str]:
    for part in node.values:
        if isinstance(part, ast.FormattedValue):
            name = ast.unparse(part.value)
            key = re.fullmatch(r"topics\['(\w+)'\]", name)
            if key:
                from labyrinth_sim.rig import TOPICS

                yield TOPICS[key[1]]
            else:
                yield "NS" if name in NAMESPACE or name.startswith("given.ns") else name.upper()
        elif isinstance(part, ast.Constant):
            yield str(part.value)


def topics() -> dict[str, str]:
    """Name -> PACKAGE/msg/NAME of every topic that a node publishes or hears; NS stands for real and sim."""
    return {
        end.name: end.kind
        for package in PACKAGES
        for file in executables(package).values()
        for end in ends(file)
        if end.how in ("publishes", "listens to")
    }


def section(package: str, executable: str, file: Path) -> str:
    """One node; empty where the program has neither parameters nor topics."""
    declared, connected = parameters(file), ends(file)
    if not declared:
        return ""
    about = (ast.get_docstring(parsed(file)) or "").split("\n\n")[0]
    rows = [(code(p.name), p.text, p.unit, p.bounds, code(p.default), "yes" if p.changes else "") for p in declared]
    every = table(("parameter", "meaning", "unit", "range", "default", "changes while running"), rows)
    both = table(("", "name", "type"), [(e.how, code(e.name), code(e.kind)) for e in connected])
    return f"### `ros2 run {package} {executable}`\n\n{about}\n\n{every}\n{both}"
