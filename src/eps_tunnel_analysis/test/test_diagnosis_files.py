# SPDX-License-Identifier: Apache-2.0
"""What a diagnosis writes and shows, on a sledge whose guide rubs: its model, labels, and lengths told as lengths."""

from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from small_recordings import record, write_rig

from eps_tunnel_analysis.diagnose.axes import Diagnosis
from eps_tunnel_analysis.loop.reason import DiagnosisOptions, DiagnosisRun, diagnose_recorded
from eps_tunnel_analysis.report.pictures import answer_picture, left_over_picture
from eps_tunnel_analysis.report.reports import Findings, write_diagnosis
from labyrinth_sim.model import load_model

EFFECT = "coulomb_friction.a"


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Findings:
    """Three recordings of a sledge with friction, and the diagnosis of the model that has none."""
    folder = tmp_path_factory.mktemp("sledge")
    model = load_model(write_rig(folder, slides=True))
    rubbing = model.with_effect("coulomb_friction", "a").with_values({"coulomb_friction.a.torque": 0.8})
    bags = [record(rubbing, folder / f"run{seed}", seed=seed) for seed in range(3)]
    options = DiagnosisOptions(candidates=("coulomb_friction",), threads=1)
    found = diagnose_recorded(options.recorded(model, bags), options, DiagnosisRun())
    assert found.diagnosis.verdict.effects == (EFFECT,)
    return found


def undecided(found: Findings) -> Findings:
    """The same, said to be undecided."""
    verdict = replace(found.diagnosis.verdict, verdict="undecided", stated=(EFFECT, "none"))
    return replace(found, diagnosis=replace(found.diagnosis, verdict=verdict))


def written(found: Findings, folder: Path) -> tuple[dict[str, object], str]:
    """The model's file and the report."""
    folder.mkdir()
    write_diagnosis(folder, folder, found, [Path("bags")], "m")
    return yaml.safe_load((folder / "model.yaml").read_text()), (folder / "report.html").read_text()


def test_the_model_of_an_undecided_diagnosis_is_the_given_one_refitted(found: Findings, tmp_path: Path) -> None:
    named, _ = written(found, tmp_path / "named")
    assert [use["name"] for use in named["effects"]] == ["coulomb_friction"]  # type: ignore[attr-defined]
    open_, _ = written(undecided(found), tmp_path / "open")
    assert open_["effects"] == []
    base = found.diagnosis.base_model.values()
    assert load_model(tmp_path / "open" / "model.yaml").values() == pytest.approx(base)
    assert base != found.recorded.model.values()


def labels(diagnosis: Diagnosis) -> set[str]:
    pictures = answer_picture(diagnosis), left_over_picture(diagnosis)
    return {text for p in pictures for axes in p.axes for text in axes.get_legend_handles_labels()[1]}


def test_a_picture_of_an_undecided_diagnosis_names_nothing(found: Findings, tmp_path: Path) -> None:
    assert "with what is named" in labels(found.diagnosis)
    assert "with the likeliest" in labels(undecided(found).diagnosis)
    assert "with what is named" not in labels(undecided(found).diagnosis)
    assert "arm with the likeliest</h3>" in written(undecided(found), tmp_path / "open")[1]
    assert "arm after</h3>" in written(found, tmp_path / "named")[1]
