# SPDX-License-Identifier: Apache-2.0
"""The whole page."""

import importlib
import inspect
from collections.abc import Iterator
from pathlib import Path

from labyrinth_hw.devices import default_link_dir
from reference_page import messages, nodes, thresholds
from reference_page.command_lines import eps_tunnel_section, executable_section
from reference_page.tables import code, table
from ros2_standin.launch import DeclareLaunchArgument, description_of

ROOT = Path(__file__).resolve().parents[2]
INTRODUCTION = """# Reference

Made by `python tools/reference_page` from the code; do not edit. Effects and drives: [effects.md](effects.md). The
files in `config/` are explained in the files themselves.

NS is `real` or `sim`; a name without a leading `/` lies in the node's namespace.
Units are SI unless a name says otherwise (`_deg`).
"""


def page() -> str:
    """docs/reference.md."""
    parts = [INTRODUCTION, eps_tunnel_section(), "## Programs of `ros2 run`\n", *programs(), "## Nodes\n"]
    for package in nodes.PACKAGES:
        for name, file in nodes.executables(package).items():
            parts.append(nodes.section(package, name, file))
    parts += ["## Launch files\n", *(launch_section(*key, given) for key, given in launch_files().items())]
    parts += [messages.section(), thresholds.section()]
    return "\n".join(part for part in parts if part).rstrip() + "\n"


def programs() -> Iterator[str]:
    """Programs with options of their own, beside eps-tunnel."""
    # What stands here depends on the machine.
    folder = "$LABYRINTH_TESTBED_DIR, else in the user's runtime folder"
    for package in nodes.PACKAGES:
        for name, (module, function) in nodes.targets(package).items():
            if name == "eps_tunnel":
                continue
            # The parser is where the entry point's function is defined, which may be elsewhere than its name says.
            home = inspect.getmodule(getattr(importlib.import_module(module), function))
            if make := getattr(home, "parser", None):
                yield executable_section(f"ros2 run {package} {name}", make()).replace(str(default_link_dir()), folder)


def launch_files() -> dict[tuple[str, str], list[DeclareLaunchArgument]]:
    """Package and name of each launch file -> the arguments that it declares."""
    return {
        (file.parts[-3], file.name): [e for e in description_of(file) if isinstance(e, DeclareLaunchArgument)]
        for file in sorted((ROOT / "src").glob("*/launch/*.launch.py"))
    }


def launch_section(package: str, name: str, arguments: list[DeclareLaunchArgument]) -> str:
    """One launch file."""
    rows = []
    for given in arguments:
        default = given.default if isinstance(given.default, str) else "the installed config/nodes file"
        rows.append((code(given.name), given.description, code(default)))
    return f"### `ros2 launch {package} {name}`\n\n{table(('argument', 'meaning', 'default'), rows)}"


def main() -> None:
    """Writes docs/reference.md."""
    (ROOT / "docs" / "reference.md").write_text(page(), encoding="utf-8")
