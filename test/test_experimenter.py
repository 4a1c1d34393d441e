# SPDX-License-Identifier: Apache-2.0
"""The experimenter's loop on an emulated rig that needs no real time: same physics, bags and models, no clock."""

import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from short_sequence import SHORT

from eps_tunnel_analysis.loop.experimenter import Ending, Experimenter, Plan, judged
from eps_tunnel_analysis.loop.gap import Bags, RigFailed
from eps_tunnel_analysis.loop.notebook import Notebook
from eps_tunnel_analysis.loop.reason import DiagnosisOptions
from eps_tunnel_analysis.sequence_file import find_sequence
from labyrinth_hw.testbed.bags import write_bag
from labyrinth_hw.testbed.hidden import load_testbed
from labyrinth_hw.testbed.offline import Run, run_offline
from labyrinth_sim.model import load_model
from labyrinth_sim.registry import Registry
from labyrinth_sim.simulate import simulate

FEW = ("gravity_load", "return_spring")
# So close to one angle that a spring pulls as a load does.
ONE_ANGLE = """
description: Around one angle.
initial_deg: {motor_x: 3, motor_y: 0}
command:
  motor_x:
    - hold: {lasts_s: 0.2}
    - step: {to_deg: 3.2, lasts_s: 0.3}
    - step: {to_deg: 2.8, lasts_s: 0.3}
    - ramp: {to_deg: 3.1, lasts_s: 0.3}
    - step: {to_deg: 3, lasts_s: 0.4}
  motor_y:
    - hold: {lasts_s: 1.5}
"""
LIMIT = np.radians(5.0)


class OfflineRig:
    """The emulated rig and its simulation, stepped as fast as they can be."""

    def __init__(self, *effects: str, model: str = "labyrinth_manual", breaks_at: int = 0) -> None:
        self._config, self._model = load_testbed("healthy", effects), load_model(model)
        self._breaks_at = breaks_at
        self.played: list[str] = []
        self.loaded: list[str] = []
        self.told: list[str] = []

    def play(self, sequence: str, trials: int, folder: Path) -> Bags:
        self.played.append(sequence)
        if len(self.played) == self._breaks_at:
            raise KeyboardInterrupt
        command = find_sequence(sequence).commands[0]
        assert max(np.abs(command.sample(100.0)[1]).max(axis=0)) <= LIMIT
        time, targets = command.sample(100.0)
        real = run_offline(self._config, time, targets, trials, len(self.played))
        simulated = simulate(self._model, time, targets, {})
        names = [[f"{part}_{axis}" for axis in "xy"] for part in ("motor", "board")]
        motor, board = (
            np.stack([simulated.values[..., simulated.index(n)] for n in pair], axis=-1)[:1] for pair in names
        )
        sim = Run(time[None], motor, 0 * motor, 0 * motor, board, time, targets, None, np.array([-1]))
        bags = [write_bag(folder / f"{command.name}_{side}", run, command.name, command.hash, f"/{side}")
                for side, run in (("real", real), ("sim", sim))]  # fmt: skip
        return Bags((bags[0],), (bags[1],))

    def load(self, model: Path) -> None:
        self._model = load_model(model)
        self.loaded.append(model.name)

    def limit(self) -> float:
        return float(LIMIT)

    def publish(self, content: Mapping[str, Any], report: Path) -> None:
        assert report.exists()
        self.told.append(content["verdict"])


def ended(
    rig: OfflineRig,
    folder: Path,
    candidates: tuple[str, ...] = FEW,
    timing: float = 0.01,
    sequence: str = SHORT,
    **plan: Any,
) -> Ending:
    (folder / "short.yaml").write_text(sequence)
    given = Plan(
        "labyrinth_manual", str(folder / "short.yaml"), 3, search=DiagnosisOptions(candidates, timing=timing), **plan
    )
    notebook = Notebook(folder, "Test")
    return notebook.keep(Experimenter(given, folder, rig).steps(), lambda _: None)


def notebook(folder: Path) -> str:
    """The notebook's text; every file that it links to must be there."""
    text = (folder / "notebook.md").read_text()
    for file in re.findall(r"\]\(([^)]+)\)", text):
        assert (folder / file).exists(), file
    return text


@pytest.mark.study
def test_a_hidden_effect_is_added_and_the_loop_ends_at_the_noise(tmp_path: Path) -> None:
    rig = OfflineRig("gravity_load.x=medium")
    ending = ended(rig, tmp_path)
    assert (ending.verdict, ending.effects) == ("complete", ("gravity_load.x",))
    assert rig.told == ["effect", "complete"]
    assert rig.loaded == ["model_1.yaml", "model_2.yaml"]
    assert [use.effect.name for use in load_model(ending.model).effects] == ["gravity_load"]
    before, after = (stair.error for stair in ending.steps)
    assert after < 0.5 * before
    text = notebook(tmp_path)
    headings = re.findall(r"^## \d+\. (.*)$", text, re.MULTILINE)
    assert [h.split(":")[0].split(" ")[0] for h in headings] == [
        "Played", "Diagnosis", "Added", "Played", "Diagnosis", "The"
    ]  # fmt: skip
    assert text.count(".png)") >= 6
    assert json.loads((tmp_path / "staircase.json").read_text())["verdict"] == "complete"


@pytest.mark.study
def test_what_no_effect_describes_ends_the_loop_as_unknown_with_a_law_that_another_command_confirms(
    tmp_path: Path,
) -> None:
    rig = OfflineRig("cogging.x=strong")
    ending = ended(rig, tmp_path, ("gravity_load",))
    assert (ending.verdict, ending.effects) == ("unknown", ())
    text = notebook(tmp_path)
    assert "what no known effect explains" in text
    assert [Path(played).stem for played in rig.played] == ["short", "visit_angle_x"]
    assert ending.proposal is not None and ending.proposal.confirmation is not None
    assert ending.proposal.confirmation.holds and "Confirmed on another command" in ending.sentence
    assert "Proposed law: confirmed" in text and "proposed_effect.py" in text
    content = json.loads((tmp_path / "staircase.json").read_text())
    assert content["proposed_effect"]["confirmed"] is True
    assert (Path(content["proposed_in"]) / "proposed_effect.py").exists()


@pytest.mark.study
def test_trials_that_came_at_uneven_times_are_played_once_more_before_anything_is_called_unknown(
    tmp_path: Path,
) -> None:
    class Disturbed(OfflineRig):
        """A computer that is busy during the first play."""

        def play(self, sequence: str, trials: int, folder: Path) -> Bags:
            self._config = load_testbed("healthy", () if self.played else ("irregular_commands.x=strong",))
            return super().play(sequence, trials, folder)

    rig = Disturbed()
    ending = ended(rig, tmp_path, FEW[:1])
    assert rig.told == ["unknown", "complete"]
    assert (ending.verdict, len(ending.steps), len(rig.played)) == ("complete", 1, 2)
    assert "early or late" in notebook(tmp_path)
    assert len(json.loads((tmp_path / "diagnosis_2" / "diagnosis.json").read_text())["sources"]) == 1


@pytest.mark.study
def test_a_rig_that_is_always_uneven_is_unknown(tmp_path: Path) -> None:
    rig = OfflineRig("irregular_commands.x=strong")
    assert ended(rig, tmp_path, FEW[:1]).verdict == "unknown"
    assert rig.told == ["unknown", "unknown"]


def test_uneven_timing_that_is_known_of_a_rig_is_told_and_not_held_against_it(tmp_path: Path) -> None:
    rig = OfflineRig("irregular_commands.x=weak")
    assert ended(rig, tmp_path, FEW[:1], timing=0.05).verdict == "complete"
    assert (rig.told, len(rig.played)) == (["complete"], 1)
    assert "early or late" in notebook(tmp_path)


@pytest.mark.study
def test_an_undecided_diagnosis_is_followed_by_the_experiment_it_proposes(tmp_path: Path) -> None:
    rig = OfflineRig("gravity_load.x=weak")
    ending = ended(rig, tmp_path, sequence=ONE_ANGLE, most_steps=0)
    first, *between, last = rig.told
    assert (first, last) == ("undecided", "effect"), "choose rivals that only the short sequence does not tell apart"
    assert set(between) <= {"undecided"}
    assert len(between) <= 1, "an experiment that decides nothing is no experiment"
    for number, played in enumerate(rig.played[1:], start=1):
        proposed = json.loads((tmp_path / f"diagnosis_{number}" / "diagnosis.json").read_text())["next_experiment"]
        assert Path(played).stem == proposed
        assert (tmp_path / f"{proposed}.yaml").exists()
    assert "to decide" in notebook(tmp_path)
    again = json.loads((tmp_path / f"diagnosis_{len(rig.told)}" / "diagnosis.json").read_text())
    assert len(again["sources"]) == len(rig.told)
    assert again["effects"] == ["gravity_load.x"]
    assert ending.verdict == "step limit"


@pytest.mark.study
def test_the_step_limit_ends_the_loop(tmp_path: Path) -> None:
    rig = OfflineRig("gravity_load.x=strong")
    ending = ended(rig, tmp_path, ("gravity_load",), most_steps=0)
    assert (ending.verdict, ending.effects, len(ending.steps)) == ("step limit", (), 1)
    assert load_model(ending.model).effects == ()


def test_ctrl_c_leaves_the_notebook_whole(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        ended(OfflineRig("gravity_load.x=medium", breaks_at=2), tmp_path, FEW[:1])
    text = notebook(tmp_path)
    assert "gravity load" in text
    assert "Interrupted" in text
    assert not list(tmp_path.glob(".*"))


def test_a_rig_that_fails_is_written_down(tmp_path: Path) -> None:
    class Broken(OfflineRig):
        def play(self, sequence: str, trials: int, folder: Path) -> Bags:
            raise RigFailed("the belt came off")

    with pytest.raises(RigFailed):
        ended(Broken(), tmp_path)
    assert "the belt came off" in notebook(tmp_path)


@pytest.mark.parametrize(
    ("axis", "known", "effects", "verdict", "stated", "said"),
    [
        ("x", True, ["backlash.x"], "complete", ["none"], "Right."),
        ("x", True, ["backlash.y"], "complete", ["none"], "That was not found."),
        ("both", True, ["backlash.y", "backlash.x"], "effect", [], "Right."),
        ("x", False, [], "unknown", ["unknown"], "Right: the verdict was 'unknown'."),
        ("x", True, [], "undecided", ["none", "backlash.x"], "It is one of the 2 hypotheses"),
        ("x", True, [], "complete", ["none"], "That was not found."),
        (
            "x",
            True,
            ["gain_error.y", "backlash.x"],
            "complete",
            ["none"],
            "It was found; also named: gain error",
        ),
        ("x", True, ["backlash.x"], "undecided", ["none", "gain_error.y"], "It was found; it is not decided"),
        ("x", True, [], "undecided", ["backlash.x + gain_error.y", "unknown"], "It was found; it is not decided"),
        ("x", True, [], "undecided", ["gain_error.y", "unknown"], "That was not found."),
    ],
)
def test_a_verdict_is_judged_by_what_was_hidden(
    axis: str, known: bool, effects: list[str], verdict: str, stated: list[str], said: str
) -> None:
    hidden = [{"effect": "backlash", "axis": axis, "strength": "strong", "known": known}]
    assert judged(hidden, effects, verdict, stated, Registry.load()).startswith(said)
