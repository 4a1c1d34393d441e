# SPDX-License-Identifier: Apache-2.0
"""What a diagnosis writes and shows, on a sledge whose guide rubs: its model, labels, and lengths told as lengths."""

from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from small_recordings import record, write_rig

from eps_tunnel_analysis.diagnose.addition import addition_of
from eps_tunnel_analysis.diagnose.axes import Diagnosis
from eps_tunnel_analysis.diagnose.falls import fall_sentences
from eps_tunnel_analysis.diagnose.verdict import Errors, PlayError
from eps_tunnel_analysis.loop.experimenter import Added, Ending, Stair
from eps_tunnel_analysis.loop.notebook import Notebook, addition_page, ending_page
from eps_tunnel_analysis.loop.reason import DiagnosisOptions, DiagnosisRun, Reason, diagnose_recorded
from eps_tunnel_analysis.report.pictures import answer_picture, left_over_picture, staircase_picture
from eps_tunnel_analysis.report.reports import Findings, was_fitted, write_diagnosis
from eps_tunnel_analysis.terminal import print_verdict, text_of
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


def test_a_model_knows_the_recordings_of_the_diagnosis_that_it_comes_from(found: Findings, tmp_path: Path) -> None:
    written(found, tmp_path / "named")
    bags = [bag for bag, _ in found.recorded.bags]
    options = DiagnosisOptions(candidates=("coulomb_friction",), threads=1)
    file = tmp_path / "named" / "model.yaml"
    assert not was_fitted(found.recorded)
    again = options.recorded(file, bags)
    assert was_fitted(again)
    assert not was_fitted(options.recorded(file, bags[:2]))
    verdict = diagnose_recorded(again, options, DiagnosisRun()).diagnosis.verdict
    assert verdict.verdict == "complete"
    anew = replace(again, model=replace(again.model, provenance={}))
    assert verdict.evaluations < diagnose_recorded(anew, options, DiagnosisRun()).diagnosis.verdict.evaluations


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


def test_what_a_sledge_is_off_by_is_a_length_in_terminal_and_report(found: Findings, tmp_path: Path) -> None:
    v = found.diagnosis.verdict
    # Two recordings, one of which got worse.
    given, refitted, after = (
        (PlayError("one", False, e), PlayError("other", False, o))
        for e, o in ((0.004, 0.001), (0.003, 0.001), (0.001, 0.002))
    )
    two = replace(found.diagnosis, verdict=replace(v, plays=(given, refitted, after)))
    printed = text_of(lambda out: print_verdict(two.verdict, (), out, "m"))
    _, page = written(replace(found, diagnosis=two), tmp_path / "why")
    for text in (printed, page):
        assert "Worse than the model as given on 1 of 2 recordings: other (fitted), 1 mm as given, 2 mm now." in text
        assert "Alikeness at k = 1" in text
        assert " deg" not in text
    assert "Error of each recording" in printed and "+100%" in printed


def test_what_a_sledge_is_off_by_is_a_length_in_a_notebook(found: Findings, tmp_path: Path) -> None:
    addition = addition_of(found.diagnosis, (EFFECT,), found.recorded.plays)
    assert [one.unit for one in addition.recordings] == ["m"]
    assert any("Alikeness" in line for line in addition.sentences)
    notebook, model = Notebook(tmp_path, "A sledge"), tmp_path / "m.yaml"
    pages = addition_page(Added(addition, "friction", "", model), notebook)
    reason = Reason(found.diagnosis, found.recorded, {}, tmp_path)
    stairs = (Stair("as given", error=0.004, alikeness=0.1, repeats=0.001),)
    pages += ending_page(Ending("effect", "It lacks friction.", (EFFECT,), (), model, stairs, reason), notebook)
    text = "\n".join(pages)
    assert "| as given | 4 mm |" in text
    assert " mm" in pages[2] and " deg" not in text
    assert staircase_picture([("as given", 0.004)], 0.001, "m").axes[0].get_ylabel() == "error E in mm"


def test_of_the_ball_no_recording_is_told() -> None:
    three = (Errors(0.004, 0.004, 0.1), Errors(0.003, 0.003, 0.1), Errors(0.001, 0.001, 0.5))
    worse = tuple((PlayError("one", False, e), PlayError("other", False, e)) for e in (0.01, 0.01, 0.02))
    sledge, ball = (fall_sentences(three, worse, "m", ball=rolls) for rolls in (False, True))
    assert sledge[0].startswith("Worse than") and len(sledge) == 4
    assert len(ball) == 2 and not any("Alikeness" in line or "Worse" in line for line in ball)
    assert fall_sentences(three, worse, "m") == ball


def test_an_error_that_is_left_never_fell_by_all_of_it() -> None:
    three = tuple(Errors(error, error, 0.1) for error in (0.01, 0.005, 1e-5))
    one = tuple((PlayError("one", False, e.error),) for e in three)
    fitted = fall_sentences((three[0], three[1], three[2]), one)[0]
    assert "over 99% lower than that of the model as given" in fitted and "100%" not in fitted
