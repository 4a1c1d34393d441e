# SPDX-License-Identifier: Apache-2.0
"""The check of the recordings opens every report, whoever asked for it, and is in the JSON and on the terminal."""

import json
import re
from html import unescape
from pathlib import Path

import pytest
from command_line import eps_tunnel
from small_recordings import record, write_rig

import eps_tunnel_analysis as eps
from eps_tunnel_analysis.loop.reason import DiagnosisOptions, diagnose_bags
from labyrinth_sim.model import load_model

FEW = "With fewer than 5 trials the tunnel's width is rough"
EXCITES = "Effects of axis a that these commands excite. identifiable: coulomb_friction.a."


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Path]]:
    """A model's file and three recordings, the commands of which its rig does not allow."""
    folder = tmp_path_factory.mktemp("first")
    file = write_rig(folder)
    bags = [record(load_model(file), folder / f"run{seed}", seed=seed) for seed in range(3)]
    rig = folder / "rig.yaml"
    rig.write_text(re.sub(r"limits:\n  *- -0.5\n  *- 0.5", "limits: [-0.2, 0.2]", rig.read_text()))
    assert load_model(file).rig.axes[0].limits == (-0.2, 0.2)
    return file, bags


def titles(report: Path) -> list[str]:
    return re.findall("<h2>(.*?)</h2>", report.read_text())


def section(report: Path) -> str:
    """The text on the recordings."""
    found = re.search('<section id="what-the-recordings-can-identify">(.*?)</section>', report.read_text(), re.DOTALL)
    assert found
    return unescape(found[1])


def alike(report: Path) -> set[str]:
    """What the staircase of error says of alikeness."""
    return set(re.findall('<td data-label="alike, k = 1" class="number">(.*?)</td>', report.read_text()))


def opens(report: Path) -> bool:
    return titles(report)[:2] == ["At a glance", "What the recordings can identify"]


def test_a_diagnosis_tells_the_check_first_on_terminal_page_and_in_json(
    made: tuple[Path, list[Path]], tmp_path: Path
) -> None:
    file, bags = made
    done = eps_tunnel("diagnose", "--real", *bags, "--model", file, "--candidates", "coulomb_friction", "--threads", 1,
                      "--out", tmp_path / "why")  # fmt: skip
    assert done.returncode == 0, done.stderr
    content = json.loads((tmp_path / "why" / "diagnosis.json").read_text())
    assert content["check"]["excited"] and any(one["serious"] for one in content["check"]["data"])
    page = tmp_path / "why" / "report.html"
    assert opens(page), titles(page)
    told = section(page)
    shown, _, folded = told.partition("<details>")
    assert "beyond the axis's limits" in shown and "<summary>Other findings" in folded
    assert FEW in folded and EXCITES in folded
    assert done.stdout.index("! Command arm goes from") < done.stdout.index(EXCITES) < done.stdout.index("Report:")


@pytest.mark.study
def test_the_shared_path_of_page_node_and_loop_has_the_same_check(
    made: tuple[Path, list[Path]], tmp_path: Path
) -> None:
    file, bags = made
    options = DiagnosisOptions(("coulomb_friction",), threads=1)
    reason = diagnose_bags(str(file), bags, tmp_path / "why", options)
    assert opens(reason.report) and EXCITES in section(reason.report)
    assert all(cell.endswith(" %") for cell in alike(reason.report))
    assert reason.content["check"]["excited"]
    study = eps.load(bags, file, candidates=["coulomb_friction"], threads=1)
    assert EXCITES in section(study.diagnose(progress=False).save(tmp_path / "study"))


def test_a_value_below_its_bounds_is_checked_and_diagnosed(tmp_path: Path) -> None:
    file = write_rig(tmp_path, slides=True)
    assert load_model(file).parameters()["joint.arm.armature"].value == 0.0
    bag = record(load_model(file), tmp_path / "run")
    options = DiagnosisOptions(("coulomb_friction",), threads=1)
    reason = diagnose_bags(str(file), [bag], tmp_path / "why", options)
    assert "identifiable" in section(reason.report)
    assert alike(reason.report) == {"–"}, "the tunnel of one trial has no width"


def test_a_comparison_opens_with_what_the_recordings_are_like(made: tuple[Path, list[Path]], tmp_path: Path) -> None:
    file, bags = made
    for words in (("--model", file), ("--sim", bags[0])):
        folder = tmp_path / words[0]
        done = eps_tunnel("compare", "--real", *bags, *words, "--out", folder)
        assert done.returncode == 0, done.stderr
        told = section(folder / "report.html")
        assert opens(folder / "report.html") and FEW in told
        assert "command arm: 100 Hz" in told and "arm_effort" not in told
        assert ("beyond the axis's limits" in told) == (words[0] == "--model")
