# SPDX-License-Identifier: Apache-2.0
"""Every block of docs/python.md is run, one after the other in one folder, or what its comment names instead."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from doc_blocks import blocks
from doc_commands import check

PAGE = "docs/python.md"
NOTEBOOK = "(gap, why, fit, tunnel)"  # whose values a notebook shows as tables


def run(command: str, folder: Path) -> None:
    done = subprocess.run(["bash", "-c", command], cwd=folder, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"


@pytest.mark.study
def test_every_block_of_the_page_works(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for block in blocks(PAGE):
        instead = block.how.removeprefix("instead ") if block.how.startswith("instead ") else ""
        assert instead or not block.how or block.how.startswith("skip, "), (
            f"{block.name}: unknown comment '{block.how}'"
        )
        if block.language == "python":
            code = compile("\n".join(block.lines), block.name, "exec")
            exec(compile(instead, block.name, "exec") if instead else code, names)
        elif not block.how.startswith("skip, "):
            assert block.language == "console", f"{block.name}: console or python"
            for command, _ in block.commands():
                check(command)
                run(instead or command, tmp_path)
    assert all(value._repr_html_() for value in eval(NOTEBOOK, names))
    assert names["better"].path is None
    written = {file.name for file in tmp_path.iterdir()}
    assert {"gap.svg", "gap", "why", "better.yaml", "fitted.yaml", "fitted.fit.json"} <= written
    assert "Alikeness" in capsys.readouterr().out
