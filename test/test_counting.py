# SPDX-License-Identifier: Apache-2.0
"""How the benchmark of the diagnosis counts: verdicts made up, figures known."""

import sys
from math import log
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

from counting import (
    calibration,
    calibration_by_chance,
    drop_vs_true_form,
    figures,
    flat,
    is_true,
    log_score,
    median,
    reliability,
    wilson,
)


def case(kind, truth, verdict, hypotheses, stated=(), effects=(), visibility=10.0, **more):
    return {
        "kind": kind, "truth": truth, "verdict": verdict, "set": hypotheses, "stated": list(stated), "seconds": 1.0,
        "effects": list(effects), "visibility": visibility, "leaves": visibility, **more,
    }  # fmt: skip


def named(truth, said, p=0.9, **more):
    return case("single", truth, "effect", {said: p, "none": 1 - p}, [said], [said], **more)


def test_a_single_effect_is_right_undecided_or_wrong():
    records = [
        named("a.x", "a.x"),
        named("a.x", "b.x"),
        case("single", "a.x", "undecided", {"a.x": 0.5, "b.x": 0.5}, ["a.x", "b.x"]),
        case("single", "a.x", "undecided", {"c.x": 0.5, "b.x": 0.5}, ["c.x", "b.x"]),
        case("single", "a.x", "unknown", {"unknown": 0.9, "a.x": 0.1}, ["unknown"]),
        case("single", "a.x", "complete", {"none": 0.9, "a.x": 0.1}, ["none"]),
        case("single", "a.x", "failed", {}),
        named("a.x", "b.x", visibility=2.9),
    ]
    records[1]["leaves"] = 1.1  # the drive's values, refitted, take it up
    found = figures(records)
    assert found["refitted_visible_right"].n == 6
    assert found["refitted_visible_right"].value == pytest.approx(1 / 6)
    assert found["refitted_visible_undecided"].value == pytest.approx(1 / 6)
    assert found["refitted_visible_wrong"].value == pytest.approx(4 / 6)
    assert found["visible_right"].n == 7
    assert found["visible_right"].value == pytest.approx(1 / 7)
    assert found["visible_undecided"].value == pytest.approx(1 / 7)
    assert found["visible_wrong"].value == pytest.approx(5 / 7)
    assert found["visible_misnamed"].value == pytest.approx(1 / 7)
    assert found["failed"].value == pytest.approx(1 / 8)


def test_a_library_effect_that_no_listed_hypothesis_names_was_overlooked():
    given = {"unknown": 0.6, "overlooked": 0.25, "a.x": 0.15}
    records = [
        case("pair", "a.x + b.y", "unknown", given),
        case("single", "a.x", "unknown", given),
        case("outside", "unknown", "unknown", given),
    ]
    assert [is_true(r, "overlooked") for r in records] == [True, False, False]
    assert [log_score(r) for r in records] == pytest.approx([log(0.25), log(0.15), log(0.6)])


def test_what_is_missing_imitates_the_effects_named_if_none_of_them_is_true():
    given = {"a.x": 0.7, "imitated": 0.2, "none": 0.1}
    records = [
        case("single", "a.x", "effect", given),
        case("single", "b.x", "effect", given),
        case("outside", "unknown", "effect", given),
        case("healthy", "none", "effect", given, visibility=0.0),
    ]
    assert [is_true(r, "imitated") for r in records] == [False, True, True, False]
    assert [log_score(r) for r in records] == pytest.approx([log(0.7), log(0.2), log(0.2), log(0.1)])


def test_both_of_a_pair_and_nothing_else():
    both = {"a.x + b.y": 1.0}
    records = [
        case("pair", "a.x + b.y", "effect", both, effects=["b.y", "a.x"]),
        case("pair", "a.x + b.y", "effect", both, effects=["a.x"]),
        case("pair", "a.x + b.y", "effect", both, effects=["a.x", "b.y", "c.x"]),
        case("pair", "a.x + b.y", "undecided", both, stated=["b.y + a.x", "a.x"]),
    ]
    assert figures(records)["pair_both"].value == pytest.approx(1 / 4)
    records += [case("pair", "a.x + b.y", "effect", both, effects=["a.x"], visibility=2.0)]  # one of them hardly shows
    assert figures(records)["pair_both"].n == 4
    assert figures(records)["pair_both_of_all"].value == pytest.approx(1 / 5)


def test_a_form_that_is_two_effects_laws_is_right_under_both_names():
    """Bristles are what the library calls LuGre friction, and friction all the same."""
    records = [named("a.x", said, as_true=["b.x"]) for said in ("a.x", "b.x", "c.x")]
    records += [case("single", "a.x", "undecided", {"c.x": 0.5, "b.x": 0.5}, ["c.x", "b.x"], as_true=["b.x"])]
    found = figures(records)
    assert found["visible_right"].value == pytest.approx(2 / 4)
    assert found["visible_undecided"].value == pytest.approx(1 / 4)


def test_a_false_alarm_is_all_that_says_something_is_missing():
    def healthy(verdict, *stated):
        return case("healthy", "none", verdict, {"none": 0.5, "a.x": 0.5}, stated, visibility=0.0)

    records = [
        healthy("complete", "none"),
        healthy("undecided", "none", "a.x"),
        healthy("undecided", "a.x", "b.x"),
        healthy("unknown", "unknown"),
        healthy("effect", "a.x"),
    ]
    found = figures(records)
    assert found["false_alarm"].value == pytest.approx(3 / 5)
    assert found["false_alarm_named"].value == pytest.approx(1 / 5)
    assert found["false_alarm_upper95"].value == wilson(3, 5)[1]


def test_unknown_is_the_answer_where_the_library_lacks_the_truth():
    records = [
        case(kind, "unknown", verdict, {"unknown": 0.6, "a.x": 0.4}, visibility=v)
        for kind in ("outside", "left_out")
        for verdict, v in (("unknown", 5.0), ("effect", 5.0), ("complete", 0.5))
    ]
    found = figures(records)
    assert (found["unknown_found"].value, found["unknown_found"].n) == (0.5, 4)
    assert found["unknown_found_outside"].n == found["unknown_found_left_out"].n == 2


def test_wilson_as_published():
    assert wilson(0, 32)[1] == pytest.approx(0.107, abs=5e-4)
    assert wilson(5, 10) == pytest.approx((0.2366, 0.7634), abs=5e-4)


def test_calibration_of_what_is_sure_and_of_what_nobody_sees():
    sure = [named("a.x", "a.x", p=0.97)] * 8 + [named("a.x", "b.x", p=0.97)] * 2
    found = figures(sure)
    assert found["stated_above_95_wrong"].value == pytest.approx(0.2)
    assert calibration(sure).value == pytest.approx(0.17)
    (row,) = reliability(sure)
    assert (row["n"], row["true"]) == (10, 0.8)
    unseen = case("single", "a.x", "complete", {"none": 0.9, "a.x": 0.1}, ["none"], visibility=0.5)
    seen = dict(unseen, visibility=2.0)
    assert calibration([unseen]).value == pytest.approx(0.1)
    assert calibration([seen]).value == pytest.approx(0.9)


def test_few_cases_have_a_calibration_error_though_every_probability_is_right() -> None:
    few, many = ([named("a.x", "a.x", p=0.8)] * n for n in (10, 1000))
    assert 0.06 < calibration_by_chance(few).value < 0.14  # .1 in the mean for 10 draws of .8
    assert calibration_by_chance(many).value < 0.02
    assert calibration_by_chance([]).value is None


def test_what_is_visible_of_a_pair_is_true():
    shown = {"effect": "a", "place": "x", "also": ["c"], "visibility": 9.0}
    unseen = {"effect": "b", "place": "y", "also": [], "visibility": 0.5}
    pair = case("pair", "a.x + b.y", "effect", {"c.x": 0.97}, effects=["c.x"], visibility=0.5, hidden=[shown, unseen])
    assert figures([pair])["stated_above_95_wrong"].value == 0.0
    plain = dict(pair, hidden=[shown, dict(unseen, visibility=1.5)], visibility=1.5)
    assert figures([plain])["stated_above_95_wrong"].value == 1.0
    nothing = dict(pair, set={"none": 0.97}, hidden=[dict(shown, visibility=0.4), unseen])
    assert figures([nothing])["stated_above_95_wrong"].value == 0.0


def test_the_fall_is_over_that_of_the_true_form():
    assert drop_vs_true_form(named("a.x", "a.x", held_out=[1.0, 0.4], true_form=0.2)) == pytest.approx(0.75)
    assert drop_vs_true_form(named("a.x", "a.x", held_out=[1.0, 0.9], true_form=0.95)) is None
    assert drop_vs_true_form(named("a.x", "a.x", held_out=[1.0, 0.9])) is None
    assert drop_vs_true_form(named("a.x", "a.x", held_out=[1.0, 0.4], true_form=0.2, visibility=1.0)) is None


def test_what_is_left_out_may_be_imitated_by_another_effect():
    def left_out(said, after, true_form=0.2):
        return {**named("unknown", said), "kind": "left_out", "held_out": [1.0, after], "true_form": true_form}

    unnamed = case("left_out", "unknown", "unknown", {"unknown": 1.0}, held_out=[0.2, 0.2], true_form=0.2)
    records = [left_out("b.x", 0.203), left_out("b.x", 0.3), unnamed, left_out("b.x", 0.1, None)]
    found = figures(records)["unknown_as_good_as_true_form"]
    assert (found.value, found.n) == (pytest.approx(1 / 3), 3)
    assert drop_vs_true_form(records[0]) is None


def test_every_key_comes_with_its_count_and_interval():
    content = flat(figures([named("a.x", "a.x", held_out=[1.0, 0.4], true_form=0.2)]))
    keys = (
        *("visible_right", "visible_undecided", "visible_wrong", "false_alarm", "false_alarm_upper95"),
        *("unknown_found", "pair_both", "calibration_error", "stated_above_95_wrong", "drop_vs_true_form"),
        *("median_seconds", "log_score"),
    )
    for key in keys:
        assert {key, f"{key}_n", f"{key}_interval"} <= set(content)
    assert content["false_alarm"] is None and content["false_alarm_n"] == 0
    assert median([3.0, 1.0, 2.0]).value == 2.0
