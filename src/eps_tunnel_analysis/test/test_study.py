# SPDX-License-Identifier: Apache-2.0
"""The short way in Python does what the commands do, and its values fit a screen."""

import json
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from command_line import ENVIRONMENT, eps_tunnel
from small_recordings import record, write_rig

import eps_tunnel_analysis as eps
from eps_tunnel_analysis.alikeness import AgainstItself
from labyrinth_sim.errors import InputError

LINES, COLUMNS = 45, 140  # of a screen


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """model.yaml of an arm, and in real/ two trials of one with dry friction besides."""
    folder = tmp_path_factory.mktemp("study")
    model = eps.load_model(write_rig(folder))
    (folder / "real").mkdir()
    for trial in range(2):
        record(model.with_effect("coulomb_friction", "a"), folder / "real" / f"trial_{trial}", seed=trial)
    return folder


@pytest.fixture(scope="module")
def study(folder: Path) -> Any:
    return eps.load(folder / "real", model=folder / "model.yaml", candidates=["coulomb_friction"])


@pytest.fixture(scope="module")
def why(study: Any) -> Any:
    return study.diagnose()


@pytest.fixture(scope="module")
def fit(study: Any) -> Any:
    return study.calibrate(free=["drive.a.stiffness", "drive.a.damping"], budget=10)


def test_the_import_waits_for_what_it_names() -> None:
    told = subprocess.run(
        [sys.executable, "-c", "import eps_tunnel_analysis as eps, sys; print({'numpy', 'mujoco'} & set(sys.modules)); "
         "eps.load; print('mujoco' in sys.modules)"], capture_output=True, text=True, env=ENVIRONMENT, check=True,
    )  # fmt: skip
    assert told.stdout.split() == ["set()", "True"]


@pytest.mark.parametrize("name", eps.__all__)
def test_every_public_name_is_there(name: str) -> None:
    assert getattr(eps, name).__name__ == name
    assert name in dir(eps)


def test_another_name_is_none() -> None:
    with pytest.raises(AttributeError, match="no attribute 'lod'"):
        eps.lod  # noqa: B018


def test_the_gap_is_that_of_the_command(folder: Path, study: Any) -> None:
    told = eps_tunnel("compare", "--real", folder / "real", "--model", folder / "model.yaml", "--json")
    assert json.loads(told.stdout) == json.loads(json.dumps(study.compare().to_json()))


def test_the_gap_says_how_far_and_shows_where(study: Any) -> None:
    gap = study.compare(ks=[1, 3])
    assert list(gap.alikeness) == [1, 3]
    assert gap.error == pytest.approx(gap.comparison.errors[0].command_error)
    assert repr(gap).startswith("Gap of 2 real trials to m: error arm ")
    assert "itself" not in repr(gap), "two trials do not tell it"
    third = replace(gap.comparison, against_itself=(AgainstItself(1.0, {"arm": 0.5}, 0.5),))
    assert repr(replace(gap, comparison=third)).endswith(" alike at k = 1; the rig against itself reaches 50.00 %")
    assert "k = 3" in str(gap)
    assert "<svg" in gap._repr_html_()


def test_simulated_bags_stand_for_a_model(folder: Path, study: Any) -> None:
    gap = eps.load(folder / "real", simulated=folder / "real" / "trial_0", signals=["arm"]).compare()
    assert gap.model is None
    assert gap.error < study.compare().error / 10


def test_a_value_that_is_known_of_some_bags_is_used(folder: Path, study: Any) -> None:
    known = {"*trial_*": {"drive.a.stiffness": 4.0}}
    gap = eps.load(folder / "real", model=folder / "model.yaml", known=known).compare()
    assert ("known of these bags", "drive.a.stiffness 4") in gap.facts
    assert gap.error != study.compare().error


def test_all_that_is_wrong_is_said_at_once(folder: Path) -> None:
    with pytest.raises(InputError) as refused:
        eps.load([folder / "reel", folder / "real"], model="labirynth")
    assert "reel: no such bag or folder" in str(refused.value)
    assert "'labyrinth'" in str(refused.value)
    with pytest.raises(InputError, match="coulomb_friction"):
        eps.load(folder / "real", model=folder / "model.yaml", candidates=["colomb_friction"])
    with pytest.raises(InputError, match="simulated="):
        eps.load(folder / "real").compare()
    with pytest.raises(InputError, match="Name a model"):
        eps.load(folder / "real").diagnose()


def test_effects_of_ones_own_are_candidates(folder: Path, tmp_path: Path) -> None:
    library = Path(sys.modules["labyrinth_sim"].__path__[0]) / "effects" / "coulomb_friction.py"
    text = library.read_text(encoding="utf-8").replace("coulomb_friction", "dry_rubbing")
    (tmp_path / "dry_rubbing.py").write_text(text, encoding="utf-8")
    own = eps.load(folder / "real", folder / "model.yaml", effects=tmp_path, candidates=["dry_rubbing"])
    assert "dry_rubbing" in own.model.registry.effects
    assert {one.name for one in own.check().excited if one.kind == "effect"} == {"dry_rubbing.a"}


@pytest.mark.study
def test_the_reason_brings_a_better_model(study: Any, why: Any, tmp_path: Path) -> None:
    assert why.verdict.effects == ("coulomb_friction.a",)
    better = study.with_model(why.model).compare()
    assert better.error < study.compare().error / 3
    report = why.save(tmp_path / "why")
    assert report.is_file()
    saved = eps.load_model(tmp_path / "why" / "model.yaml")
    assert saved.values() == why.model.values()
    assert saved.provenance["added"] == ["coulomb_friction.a"]
    with pytest.raises(InputError, match="exists already"):
        why.save(tmp_path / "why")


def test_a_fit_is_saved_with_its_result(fit: Any, tmp_path: Path) -> None:
    file = fit.save(tmp_path / "fitted")
    assert {n: eps.load_model(file).values()[n] for n in fit.values} == fit.values
    result = json.loads(file.with_suffix(".fit.json").read_text(encoding="utf-8"))
    assert list(result)[:2] == ["command", "out"]
    assert result["called"] == "python" or "eps_tunnel_analysis.cli.main" in sys.modules
    with pytest.raises(InputError, match="exists already"):
        fit.save(tmp_path / "fitted")


def test_a_gap_is_saved_once(study: Any, tmp_path: Path) -> None:
    assert study.compare().save(tmp_path / "gap").is_file()
    with pytest.raises(InputError, match="exists already"):
        study.compare().save(tmp_path / "gap")


def test_a_picture_is_drawn_and_saved(study: Any, tmp_path: Path) -> None:
    picture = study.compare().plot()
    assert picture._repr_svg_().startswith("<svg")
    assert picture.save(tmp_path / "gap.svg").read_text(encoding="utf-8").count("<svg") == 1
    assert picture.save(tmp_path / "gap.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InputError, match=r"\.svg, \.png"):
        picture.save(tmp_path / "gap.gif")
    with pytest.raises(InputError, match="cannot be written"):
        picture.save(tmp_path / "missing" / "gap.svg")


def values_within(value: object, seen: set[int]) -> Iterator[object]:
    """The dataclasses that can be reached from a value by its fields, itself among them."""
    if id(value) in seen:
        return
    seen.add(id(value))
    if isinstance(value, Mapping):
        value = tuple(value.values())
    if isinstance(value, tuple | list):
        for entry in value[:20]:
            yield from values_within(entry, seen)
    if is_dataclass(value) and not isinstance(value, type):
        yield value
        for field in fields(value):
            yield from values_within(getattr(value, field.name), seen)


@cache
def screen_lines(text: str) -> int:
    return sum(1 + max(len(line) - 1, 0) // COLUMNS for line in text.splitlines())


def test_every_value_prints_on_a_screen(folder: Path, study: Any, why: Any, fit: Any) -> None:
    gap, recording = study.compare(), eps.read(folder / "real" / "trial_0")
    start = [study, study.sides, study.recorded, gap, why, fit, study.check(), recording, eps.load_model("labyrinth"),
             eps.load_rig("labyrinth"), eps.build_tunnel(study.trials), gap.plot()]  # fmt: skip
    every = list(values_within(start, set()))
    kinds = {type(value).__name__ for value in every}
    wanted = {"Recording", "StampedTopic", "Trials", "Tunnel", "Alikeness", "Comparison", "Diagnosis", "Verdict",
              "AxisDiagnosis", "Model", "Rig", "Registry", "Effect", "Play", "Study", "StudyGap", "StudyReason",
              "StudyFit", "Fit", "Check", "Picture"}  # fmt: skip
    assert wanted <= kinds
    long = {
        type(value).__name__: max(screen_lines(str(value)), screen_lines(repr(value)))
        for value in every
        if max(screen_lines(str(value)), screen_lines(repr(value))) > LINES
    }
    assert long == {}


def test_arrays_print_as_shape_and_unit(study: Any) -> None:
    lines = {line.split()[0]: line for line in str(study.trials).splitlines()[1:]}
    assert "(300,) s, 0 to 2.99" in lines["time"]
    assert "(2, 300, 1)" in lines["values"]
    assert "(2, 300, 1) rad, " in lines["commands"]
    assert "<td" in study.trials._repr_html_()
