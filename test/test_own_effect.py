# SPDX-License-Identifier: Apache-2.0
"""An effect in a folder of the user's own, from the diagnosis to the comparison by the model that has it."""

import html
import json
import sys
from pathlib import Path

import pytest
import yaml

sys.path.insert(0, str(Path(__file__).parent))

from short_sequence import SHORT

from eps_tunnel_analysis.cli.main import main
from eps_tunnel_analysis.sequence_file import parse_sequence
from labyrinth_hw.testbed.bags import write_bag
from labyrinth_hw.testbed.hidden import load_testbed
from labyrinth_hw.testbed.offline import run_offline

EFFECT = """
from labyrinth_sim.effect import Effect, Parameter


class Shift:
    def __init__(self, by):
        self.by = by

    def __call__(self, own, every):
        return own + self.by[:, None]


EFFECT = Effect(
    name="crooked_mount",
    title="Crooked mount",
    physics="The sensor was screwed on at an angle.",
    equation="angle' = angle + b",
    parameters=(Parameter("angle", "rad", -0.2, 0.2, 0.0, 0.02, "seen by eye"),),
    stage="measurement",
    mark="One signal is shifted by a constant.",
    shows="offset",
    confused_with=(),
    separated_by="Turn the sensor on its mount.",
    where="signal",
    measure=lambda values, site, step, start: Shift(values["angle"]),
)
"""


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    command = parse_sequence(yaml.safe_load(SHORT), "short", "short").commands[0]
    run = run_offline(load_testbed("healthy", ("sensor_bias.x=strong",)), *command.sample(100.0), 3, 0)
    return write_bag(tmp_path_factory.mktemp("own") / "bag", run, "short", command.hash)


@pytest.mark.study
def test_an_effect_of_ones_own_goes_from_the_diagnosis_to_the_comparison(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "effects of mine"
    folder.mkdir()
    (folder / "crooked_mount.py").write_text(EFFECT)
    real, own = ["--real", str(bag)], ["--effects", str(folder)]
    why, better = tmp_path / "why", tmp_path / "better.yaml"
    given = ["--model", "labyrinth_manual", "--candidates", "crooked_mount"]
    assert main(["diagnose", *real, *given, *own, "--out", str(why)]) == 0
    verdict = json.loads((why / "diagnosis.json").read_text())
    (name,) = verdict["effects"]
    assert name.startswith("crooked_mount.")
    assert "crooked mount on" in verdict["sentence"]
    assert f"eps-tunnel compare --real {bag} --effects '{folder}'" in capsys.readouterr().out
    page = html.unescape((why / "report.html").read_text())
    assert "screwed on at an angle" in page
    assert f"--effects '{folder}'" in page
    assert main(["add-effect", name, *real, *given[:2], *own, "--out", str(better)]) == 0
    errors = []
    capsys.readouterr()
    for model in (given[1], str(better), str(why / "model.yaml")):
        assert main(["compare", *real, "--model", model, *own, "--json"]) == 0
        errors.append(sum(e["command_error"] for e in json.loads(capsys.readouterr().out)["errors"]))
    assert errors[1] < 0.5 * errors[0]
    assert errors[2] == pytest.approx(errors[1], rel=0.05)
    for command in (["diagnose", *given], ["compare", "--model", str(better)]):
        assert main([*command, *real, "--out", str(tmp_path / "without")]) == 2
        assert "crooked_mount" in capsys.readouterr().err
