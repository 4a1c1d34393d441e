# SPDX-License-Identifier: Apache-2.0
"""How the benchmark of proposed laws counts: records made up, figures known; and what it draws."""

import json
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

import diagnosis
import law
from drawn_rigs.cases import draw
from drawn_rigs.reading import Dependence, floors_on, loaded
from drawn_rigs.true_forms import UNITS, true_form
from law import figures

from labyrinth_sim.model import load_model
from labyrinth_sim.simulate import simulate


def case(effect="cogging", curve="curve_angle", visibility=10.0, period=0.0, other=None, also=(), **more):
    said = {"axis": "x", "curve": curve, "period": period * 1.01 or None, "kind": "formula", "ties": []}
    said |= {"other_command": other} if other else {}
    hidden = {"effect": effect, "place": "x", "period": period, "also": also}
    return {"kind": "outside", "visibility": visibility, "hidden": [hidden], "proposal": said, "base_on_own": 9.0,
            "verdict": "unknown", **more}  # fmt: skip


def test_a_variable_is_right_wrong_or_not_said():
    silent = case() | {"proposal": None, "base_on_own": 1.0}
    tied = case("quadratic_drag", "curve_angle")
    tied["proposal"]["ties"] = ["curve_speed"]
    found = figures([case(), case(curve="curve_speed"), silent, tied, case(visibility=1.0), case("loose_mount", "")])
    assert (found["variable_right"], found["variable_right_n"]) == (pytest.approx(1 / 4), 4)
    assert (found["variable_right_shown"], found["variable_right_shown_n"]) == (pytest.approx(1 / 3), 3)
    assert found["variable_among_shown"] == pytest.approx(2 / 3)
    bent = (
        case("coulomb_friction", "curve_reversal"),
        case("coulomb_friction", "curve_reversal", also=["lugre_friction"]),
    )
    assert [figures([one])["variable_right"] for one in bent] == [0.0, 1.0], "a form that is literally that of another"


def test_a_command_is_no_angle_and_a_pair_is_neither_of_the_two():
    known = ("x", 0.9, (0.8, 1.0), 0.1, True)
    named = [law._named(Dependence(name, "curve_angle", *known, pair=" and " in name))
             for name in ("angle", "command", "angle and speed")]  # fmt: skip
    assert named == ["curve_angle", "command", "pair"]


def test_half_of_the_true_form_is_counted_on_the_other_command():
    records = [
        case(other=[9.0, 4.0], base_on_other=9.0),
        case(other=[9.0, 6.0], base_on_other=9.0),
        case(base_on_other=9.0),  # nothing proposed
        case(base_on_other=1.5),  # nothing to take away there
        case(other=[9.0, 6.5], base_on_other=9.0, true_on_other=4.4, kind="left_out"),
        case(other=[9.0, 6.5], base_on_other=9.0, true_on_other=8.0, kind="left_out"),  # the true form does not hold
    ]
    found = figures(records)
    assert (found["half_of_true_form"], found["half_of_true_form_n"]) == (pytest.approx(2 / 4), 4)


def test_healthy_rigs_and_periods():
    quiet = {"kind": "healthy", "visibility": 0.0, "hidden": [], "verdict": "complete", "proposal": None}
    loud = quiet | {"proposal": {"axis": "x", "kind": "curve"}}
    found = figures([quiet, loud, quiet, case(period=0.3)])
    assert (found["healthy_silent"], found["healthy_silent_n"]) == (pytest.approx(2 / 3), 3)
    assert found["period_error"] == pytest.approx(0.01) and found["period_right"] == 1.0
    assert found["failed"] == 0.0


@pytest.mark.study
def test_a_case_is_the_same_with_another_command_and_the_effect_can_be_chosen(tmp_path):
    plain, fresh = draw(325, tmp_path / "a", kind="outside"), draw(325, tmp_path / "b", kind="outside", fresh=True)
    assert plain.hidden == fresh.hidden and not plain.fresh and fresh.fresh
    assert all(bag.exists() for bag in fresh.fresh)
    assert draw(325, tmp_path / "c", kind="outside", effect="tight_places").hidden[0].effect == "tight_places"


def test_the_file_has_each_key_at_its_top_with_count_and_interval(tmp_path, monkeypatch):
    records = [case(period=0.3) | {"seed": 100_000, "seconds": 1.0, "proposal": None}]
    monkeypatch.setattr(law, "judged", lambda seeds, given: iter(records))
    monkeypatch.setattr(
        sys, "argv", ["law.py", "--cases", "1", "--seed", "100000", "--json", str(tmp_path / "out.json")]
    )
    law.main()
    content = json.loads((tmp_path / "out.json").read_text())
    for key in ("variable_right", "half_of_true_form", "healthy_silent", "period_error"):
        assert {key, f"{key}_n", f"{key}_interval"} <= set(content)
        assert content[key] == content["figures"][key]
    assert content["variable_right_n"] == 1 and content["seed"] == 100_000


def test_what_does_not_show_is_drawn_and_passed_over_and_not_drawn_again(tmp_path, monkeypatch):
    shows = {100_001: 2.9, 100_002: 3.1}

    def drawn(seed, folder, **chosen):
        own = case(visibility=shows[seed]) | {"seed": seed}
        return SimpleNamespace(hidden=("something",), visibility=shows[seed], to_json=lambda: own)

    judges = {law: partial(law.judge, effect=None), diagnosis: partial(diagnosis.judge_drawn, rig=None)}
    for benchmark, judge in judges.items():
        monkeypatch.setattr(benchmark, "draw", lambda seed, folder, *rig, **chosen: drawn(seed, folder))
        assert judge(100_001, threads=1, visible=True) == {"seed": 100_001, "passed_over": True}
    monkeypatch.setattr(law, "_said", lambda case, threads: {"proposal": None, "verdict": "unknown"})
    out = tmp_path / "out.json"
    monkeypatch.setattr(sys, "argv", f"law.py --cases 2 --seed 100001 --visible --json {out}".split())
    law.main()
    content = json.loads(out.read_text())
    assert content["passed_over"] == [100_001] and [r["seed"] for r in content["cases"]] == [100_002]
    shows.clear()
    monkeypatch.setattr(sys, "argv", [*sys.argv, "--continue"])
    law.main()
    monkeypatch.setattr(sys, "argv", [word for word in sys.argv if word != "--visible"])
    with pytest.raises(SystemExit, match="visible"):
        law.main()


def test_a_true_form_can_be_added_to_a_model_and_is_none_where_there_is_none():
    model, time = load_model("labyrinth_manual"), np.arange(200) * 0.01
    command = 0.2 * np.column_stack([np.sin(4.0 * time), np.cos(3.0 * time)])
    plain = simulate(model, time, command).values
    for name in UNITS:
        effect = true_form(name, 0.3 if name in ("cogging", "tight_places", "eccentric_gear") else 0.0)
        place = "board_x" if effect.where == "signal" else "x"
        off = simulate(model.with_effect(effect, place, effect.off), time, command).values
        assert np.array_equal(off, plain), name
        assert np.abs(simulate(model.with_effect(effect, place), time, command).values - plain).max() > 1e-3, name
    assert true_form("loose_mount", 0.0) is None


@pytest.mark.study
def test_the_true_form_of_what_is_drawn_leaves_hardly_more_than_noise(tmp_path):
    """A pendulum whose motor cogs: seen before, as a case of the report."""
    case = draw(870427, tmp_path, kind="outside", fresh=True)
    model, plays = loaded(case.model, case.bags)
    assert case.hidden[0].effect == "cogging"
    base = law.law_of(model, plays, 1, case.seed)[1]
    true = law._true_form(base, plays, "pendulum", case, 1)
    assert floors_on(true, plays, "pendulum") < 3.0 < 10.0 < floors_on(base, plays, "pendulum")
    assert true.values()["true_cogging.pendulum.period"] == pytest.approx(case.hidden[0].period, rel=0.01)
