# SPDX-License-Identifier: Apache-2.0
"""What a shell offers behind TAB, asked as a shell asks."""

import subprocess
import sys
from pathlib import Path

import pytest
from command_line import ENVIRONMENT

SLOW = ("numpy", "mujoco", "numba", "matplotlib", "pydantic")


@pytest.fixture
def behind_tab(tmp_path: Path):
    """The words offered behind a line, and what was imported for them."""

    def ask(line: str, **variables: str) -> tuple[set[str], str]:
        answer = tmp_path / "answer"
        environment = {**ENVIRONMENT, "_ARGCOMPLETE": "1", "_ARGCOMPLETE_IFS": "\n", "COMP_LINE": line, **variables}
        environment |= {"COMP_POINT": str(len(line)), "_ARGCOMPLETE_STDOUT_FILENAME": str(answer)}
        program = [sys.executable, "-X", "importtime", "-m", "eps_tunnel_analysis.cli"]
        done = subprocess.run(program, env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr
        return {word.strip() for word in answer.read_text(encoding="utf-8").split("\n")}, done.stderr

    return ask


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("eps-tunnel ca", {"calibrate"}),
        ("eps-tunnel compare --cut", {"--cut-to-shortest"}),
        ("eps-tunnel calibrate --method ga", {"gauss-newton"}),
        ("eps-tunnel diagnose --candidates backl", {"backlash"}),
        ("eps-tunnel effects gravi", {"gravity_load"}),
        ("eps-tunnel add-effect gravi", {"gravity_load."}),
        ("eps-tunnel compare --model labyrinth_mx", {"labyrinth_mx64"}),
        ("eps-tunnel compare --rig two_l", {"two_link_arm"}),
        ("eps-tunnel sequences excite_1", {"excite_12s"}),
    ],
)
def test_names_are_offered_and_nothing_slow_is_imported(behind_tab, line: str, offered: set[str]) -> None:
    words, imported = behind_tab(line)
    assert offered <= words
    assert all(word.startswith(line.split()[-1]) for word in words)
    modules = {told.split("|")[-1].strip() for told in imported.splitlines()}
    assert "argcomplete" in modules
    assert not modules & set(SLOW)


def test_a_models_file_is_offered_beside_the_names(behind_tab, tmp_path: Path) -> None:
    (tmp_path / "labyrinth_of_mine.yaml").touch()
    words, _ = behind_tab("eps-tunnel compare --model labyrinth_")
    assert {"labyrinth_of_mine.yaml", "labyrinth_mx64"} <= words


def test_effects_of_ones_own_are_offered(behind_tab, tmp_path: Path) -> None:
    own = tmp_path / "own"
    own.mkdir()
    (own / "sticky_belt.py").touch()
    (own / "_helper.py").touch()
    for words, _ in (
        behind_tab(f"eps-tunnel diagnose --effects {own} --candidates stic"),
        behind_tab("eps-tunnel diagnose --candidates stic", EPS_TUNNEL_EFFECTS=str(own)),
    ):
        assert words == {"sticky_belt"}
