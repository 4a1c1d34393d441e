# SPDX-License-Identifier: Apache-2.0
"""The whole page."""

import ast
from collections.abc import Iterator
from pathlib import Path

from reference_page import messages, nodes
from reference_page.command_lines import eps_tunnel_section, executable_section
from reference_page.tables import code, table

ROOT = Path(__file__).resolve().parents[2]
INTRODUCTION = """# Reference

Made by `python tools/reference_page` from the code; do not edit. Effects and drives: [effects.md](effects.md). What the
files in `config/` hold is said in the files themselves.

NS is `/real` or `/sim`. Units are SI unless a name says otherwise (`_deg`).
"""


def page() -> str:
    """docs/reference.md."""
    parts = [INTRODUCTION, eps_tunnel_section(), "## Programs of `ros2 run`\n", *programs(), "## Nodes\n"]
    for package in nodes.PACKAGES:
        for name, file in nodes.executables(package).items():
            parts.append(nodes.section(package, name, file))
    parts += ["## Launch files\n", *launch_files(), messages.section()]
    return "\n".join(part for part in parts if part).rstrip() + "\n"


def programs() -> Iterator[str]:
    """Programs with options of their own, beside eps-tunnel."""
    import importlib

    from labyrinth_hw.links import default_link_dir

    for package in nodes.PACKAGES:
        for name, file in nodes.executables(package).items():
            if name == "eps_tunnel":
                continue
            module = importlib.import_module(".".join(file.relative_to(ROOT / "src" / package).with_suffix("").parts))
            make = getattr(module, "parser", None)
            if name == "testbed":
                from labyrinth_hw.testbed.command_line import parser as make
            if make is not None:
                text = executable_section(f"ros2 run {package} {name}", make())
                # The folder depends on the machine.
                yield text.replace(str(default_link_dir()), "$LABYRINTH_TESTBED_DIR, else in the user's runtime folder")


def launch_files() -> Iterator[str]:
    """Arguments of the launch files, read off their source."""
    for file in sorted((ROOT / "src").glob("*/launch/*.launch.py")):
        rows = []
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "DeclareLaunchArgument" and node.args:
                if isinstance(node.args[0], ast.Constant):
                    said = {k.arg: ast.literal_eval(k.value) for k in node.keywords}
                    rows.append((code(str(node.args[0].value)), said["description"], code(said["default_value"])))
            elif isinstance(node, ast.AnnAssign) and getattr(node.target, "id", "") == "ARGUMENTS":
                assert isinstance(node.value, ast.Dict)
                for key, value in zip(node.value.keys, node.value.values, strict=True):
                    assert isinstance(key, ast.Constant) and isinstance(value, ast.Tuple)
                    default, text = value.elts
                    told = default.value if isinstance(default, ast.Constant) else "the installed config/nodes file"
                    rows.append((code(str(key.value)), ast.literal_eval(text), code(str(told))))
        package, name = file.parts[-3], file.name
        yield f"### `ros2 launch {package} {name}`\n\n{table(('argument', 'meaning', 'default'), rows)}"


def main() -> None:
    """Writes docs/reference.md."""
    (ROOT / "docs" / "reference.md").write_text(page(), encoding="utf-8")
