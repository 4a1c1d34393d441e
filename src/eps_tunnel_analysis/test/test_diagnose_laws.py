# SPDX-License-Identifier: Apache-2.0
"""Laws of noise floor, gate, ranking, verdict and experiment that need no roll-out."""

import itertools
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from eps_tunnel_analysis.diagnose.bases import Bases
from eps_tunnel_analysis.diagnose.calibration import CALIBRATION
from eps_tunnel_analysis.diagnose.candidates import library, starts
from eps_tunnel_analysis.diagnose.experiment import Experiment, Harsh, chosen, harshness, left_after_fit
from eps_tunnel_analysis.diagnose.gate import complete, independent, unexplained
from eps_tunnel_analysis.diagnose.menu import menu
from eps_tunnel_analysis.diagnose.noise import noise_floor
from eps_tunnel_analysis.diagnose.rank import NONE, UNKNOWN, joint, name_of, rank, smallest_set
from eps_tunnel_analysis.diagnose.refit import Refit
from eps_tunnel_analysis.diagnose.verdict import decide, sentence
from eps_tunnel_analysis.sequence_file import parse_sequence
from labyrinth_sim.errors import InputError
from labyrinth_sim.model import load_model
from labyrinth_sim.trials import Trials

COSTS = st.floats(0.05, 1e4)


def refit(effects: tuple[str, ...], cost: float, own: int = 1) -> Refit:
    return Refit(effects, np.zeros(1), np.zeros(1), cost, cost, cost, 3 + own * len(effects), True)


def probabilities(base: float, costs: list[float], independent: float = 100.0) -> dict[str, float]:
    refits = [refit((f"e{i}.x",), cost) for i, cost in enumerate(costs)]
    ranked, unknown = rank(refit((), base), refits, independent, len(costs))
    return {r.name: r.probability for r in ranked} | {UNKNOWN: unknown}


def trials(values: np.ndarray) -> Trials:
    p, t, _ = values.shape
    return Trials(np.arange(t) / 100.0, ("a",), ("rad",), values, (), np.empty((p, t, 0)))


@given(COSTS, st.lists(COSTS, min_size=1, max_size=6), st.floats(5.0, 2000.0))
def test_probabilities_sum_to_one(base: float, costs: list[float], independent: float) -> None:
    found = probabilities(base, costs, independent)
    assert sum(found.values()) == pytest.approx(1.0)
    assert min(found.values()) >= 0.0


@given(COSTS, st.lists(COSTS, min_size=2, max_size=5, unique=True), st.randoms())
def test_the_order_of_candidates_does_not_matter(base: float, costs: list[float], random: object) -> None:
    refits = [refit((f"e{i}.x",), cost) for i, cost in enumerate(costs)]
    mixed = list(refits)
    random.shuffle(mixed)  # type: ignore[attr-defined]
    (one, unknown), (other, same) = (rank(refit((), base), r, 80.0, 30) for r in (refits, mixed))
    assert [r.effects for r in one] == [r.effects for r in other]
    assert [r.probability for r in one] == pytest.approx([r.probability for r in other])
    assert unknown == pytest.approx(same)


def test_a_base_within_the_noise_lacks_nothing() -> None:
    assert probabilities(0.8 * CALIBRATION.gate, [0.78 * CALIBRATION.gate])[NONE] > 0.9


def test_what_explains_all_is_named_and_what_explains_half_is_not() -> None:
    named = probabilities(100.0, [0.9, 60.0])
    assert max(named, key=lambda n: named[n]) == "e0.x"
    half = probabilities(100.0, [50.0, 60.0])
    assert max(half, key=lambda n: half[n]) == UNKNOWN


@given(COSTS, COSTS)
def test_unexplained_is_monotone_in_what_is_left(a: float, b: float) -> None:
    low, high = sorted((a, b))
    assert unexplained(low, 100.0) <= unexplained(high, 100.0)


@given(COSTS, COSTS)
def test_complete_falls_with_the_misfit(a: float, b: float) -> None:
    low, high = sorted((a, b))
    assert complete(low, low) >= complete(high, high)


def test_a_value_more_is_paid_for() -> None:
    ranked, _ = rank(refit((), 50.0), [refit(("a.x",), 1.0, own=1), refit(("b.x",), 1.0, own=3)], 100.0, 2)
    by_name = {r.name: r.probability for r in ranked}
    assert by_name["a.x"] > by_name["b.x"]


@pytest.mark.parametrize(("base", "best"), [(0.9, 0.85), (80.0, 0.9), (80.0, 60.0)])
def test_a_drift_is_always_unknown_and_uneven_timing_never_complete(base: float, best: float) -> None:
    refits = [refit(("a.x",), best), refit(("b.x",), 1.1 * best)]
    for drifts in (True, False):
        ranked, unknown = rank(refit((), base), refits, 100.0, 30, drifts=drifts, uneven=not drifts)
        found = {r.name: r.probability for r in ranked} | {UNKNOWN: unknown}
        assert sum(found.values()) == pytest.approx(1.0)
        explained = base > 10.0 and best < 10.0
        assert max(found, key=lambda n: found[n]) == ("a.x" if explained and not drifts else UNKNOWN)


def test_an_axis_is_searched_among_the_others_with_their_refitted_values() -> None:
    model = load_model("labyrinth_manual")
    bases = Bases({"x": {"drive.x.p": 11.0, "drive.x.delay": 0.011}, "y": {"drive.y.p": 12.0}})
    own, among = model.values(), bases.among(model, "x").values()
    assert {name for name in own if among[name] != own[name]} == {"drive.y.p"}
    assert among["drive.y.p"] == 12.0


def test_axes_are_joined_as_products() -> None:
    found = joint([{"a.x": 0.8, NONE: 0.1, UNKNOWN: 0.1}, {"b.y": 0.5, NONE: 0.5}])
    assert sum(found.values()) == pytest.approx(1.0)
    assert found["a.x + b.y"] == pytest.approx(0.4)
    assert found["a.x"] == pytest.approx(0.4)
    assert found[UNKNOWN] == pytest.approx(0.1)


@given(st.lists(st.floats(0.01, 1.0), min_size=1, max_size=6), st.floats(0.5, 0.99))
def test_the_stated_set_is_the_smallest_that_covers(weights: list[float], coverage: float) -> None:
    found = {f"e{i}": w / sum(weights) for i, w in enumerate(weights)}
    stated = smallest_set(found, coverage)
    assert sum(found[n] for n in stated) >= coverage - 1e-9
    for fewer in itertools.combinations(found, len(stated) - 1):
        assert sum(found[n] for n in fewer) < coverage


@pytest.mark.parametrize(
    ("found", "kind", "effects"),
    [
        ({NONE: 0.95, "a.x": 0.05}, "complete", ()),
        ({"a.x": 0.95, UNKNOWN: 0.05}, "effect", ("a.x",)),
        ({"a.x + b.y": 0.95, UNKNOWN: 0.05}, "effect", ("a.x", "b.y")),
        ({"a.x": 0.6, "b.x": 0.4}, "undecided", ("a.x",)),
        ({UNKNOWN: 0.6, "a.x": 0.4}, "unknown", ()),
    ],
)
def test_four_verdicts(found: dict[str, float], kind: str, effects: tuple[str, ...]) -> None:
    said, named, stated = decide(found, 0.9)
    assert (said, named) == (kind, effects)
    assert sentence(said, named, stated, {NONE: 0.0, UNKNOWN: 0.0, **found})


def test_unknown_tells_what_explains_a_part() -> None:
    told = sentence("unknown", (), (UNKNOWN,), {UNKNOWN: 0.97}, partly={"backlash.x": 0.62, "gain_error.y": 0.3})
    assert "backlash (belt slack) on x explains 62% of it and gain error on y explains 30% of it" in told


def test_names_do_not_depend_on_the_order_in_which_effects_were_added() -> None:
    assert name_of(["b.y", "a.x"]) == name_of(["a.x", "b.y"]) == "a.x + b.y"


def test_the_floor_falls_with_more_trials_but_not_below_the_tick() -> None:
    rng = np.random.default_rng(0)
    true = np.sin(np.arange(2000) / 50.0)[None, :, None]
    few, many = (noise_floor(trials(true + 0.01 * rng.standard_normal((p, 2000, 1)))).floor[0] for p in (4, 16))
    assert many == pytest.approx(few / 2, rel=0.1)
    tick = 0.01
    coarse = noise_floor(trials(np.repeat(np.round(true / tick) * tick, 5, axis=0))).floor[0]
    assert coarse == pytest.approx(tick / np.sqrt(12), rel=0.05)


def test_where_trials_drift_apart_the_floor_rises_there_only() -> None:
    rng = np.random.default_rng(1)
    values = 0.001 * rng.standard_normal((5, 1000, 1))
    values[:, 500:, 0] += np.linspace(-0.05, 0.05, 5)[:, None]
    local = noise_floor(trials(values)).local[:, 0]
    assert local[600:].min() > 20 * local[:400].max()


def test_correlated_residuals_are_worth_fewer_samples() -> None:
    rng = np.random.default_rng(2)
    white = rng.standard_normal(1000)
    smooth = np.convolve(white, np.ones(20) / 20, mode="same")
    blocks = np.zeros(1000, dtype=int)
    assert independent(smooth, blocks) < 0.2 * independent(white, blocks)


def test_every_candidate_has_starts_within_its_bounds() -> None:
    found = library(load_model("labyrinth_manual"), ["drive.x.p"])
    assert {"backlash.x", "sensor_gain.board_y"} <= {c.name for c in found.candidates}
    for candidate in found.candidates:
        rows = starts(candidate)
        assert len(rows)
        for column, p in enumerate(candidate.effect.parameters):
            assert (rows[:, column] >= p.low).all() and (rows[:, column] <= p.high).all()


def test_an_effect_in_the_model_is_no_candidate() -> None:
    model = load_model("labyrinth_manual").with_effect("backlash", "x")
    assert "backlash.x" not in {c.name for c in library(model, []).candidates}


def test_an_unknown_effect_is_refused_with_the_names() -> None:
    with pytest.raises(InputError, match="backlash"):
        library(load_model("labyrinth_manual"), [], only=["blacklash"])


def test_every_experiment_can_be_written_read_back_and_played() -> None:
    model = load_model("labyrinth_manual")
    limits = {axis.command: axis.limits for axis in model.rig.axes}
    for name, command in menu(model, "x").items():
        text = Experiment(name, command, ("a.x", "b.x"), 3.0, "Decides.").to_yaml()
        sequence = parse_sequence(yaml.safe_load(text), name, name)
        sequence.check_limits(limits)
        np.testing.assert_allclose(sequence.commands[0].sample(100.0)[1], command.sample(100.0)[1], atol=1e-7)


def test_rivals_differ_by_what_neither_can_be_fitted_to() -> None:
    rng = np.random.default_rng(4)
    truth, rival, way = rng.standard_normal((3, 50))
    stiff = np.array([rival])
    assert left_after_fit(truth, stiff, np.zeros((20, 0))) == pytest.approx(np.sum((truth - rival) ** 2))
    towards = np.array([rival, rival + 0.01 * (truth - rival)])
    assert left_after_fit(truth, towards, np.zeros((20, 1))) == pytest.approx(0.0, abs=1e-12)
    held = left_after_fit(truth, towards, np.full((20, 1), 1e3))  # what the old recordings forbid
    assert held == pytest.approx(np.sum((truth - rival) ** 2), rel=1e-3)
    aside = np.array([rival, rival + way])
    assert 0.0 < left_after_fit(truth, aside, np.zeros((20, 1))) < np.sum((truth - rival) ** 2)


@pytest.mark.parametrize(
    ("offers", "taken"),
    [
        ({"chirp": (1.2, 9.0, True), "triangle": (1.1, 2.0, True), "steps": (8.0, 1.0, False)}, "triangle"),
        ({"chirp": (0.5, 9.0, True), "triangle": (0.4, 2.0, True), "steps": (8.0, 1.0, False)}, "chirp"),
        ({"chirp": (0.1, 9.0, True), "quick": (9.0, 30.0, False), "steps": (1.5, 12.0, False)}, "steps"),
        ({"chirp": (0.1, 9.0, True), "steps": (0.6, 12.0, False)}, "steps"),
        ({"chirp": (0.5, 9.0, True), "triangle": (2.0, 2.0, True, True), "steps": (8.0, 1.0, False)}, "chirp"),
        ({"triangle": (0.1, 2.0, True, True), "steps": (8.0, 1.0, False, True)}, "steps"),
        ({}, None),
    ],
)
def test_a_command_beyond_what_was_recorded_or_into_a_stop_is_chosen_only_where_no_other_decides(
    offers: dict[str, tuple[Any, ...]], taken: str | None
) -> None:
    command = next(iter(menu(load_model("labyrinth_manual"), "x").values()))
    listed = [
        (Experiment(name, command, ("a.x", "b.x"), misfit, ""), Harsh(*harsh))
        for name, (misfit, *harsh) in offers.items()
    ]
    best = chosen(listed)
    assert (best.name if best else None) == taken


def test_how_harsh_a_motion_is_does_not_hang_on_how_often_it_was_sampled() -> None:
    def jerk(rate: float) -> float:
        time = np.arange(0.0, 4.0, 1.0 / rate)
        return harshness(np.where(time < 2.0, 0.0, 0.1)[:, None], time, 3)

    assert jerk(100.0) == pytest.approx(jerk(200.0), rel=0.01)
    time = np.arange(0.0, 10.0, 0.01)
    assert harshness(0.1 * np.sin(5.0 * time)[:, None], time, 2) == pytest.approx(0.1 * 25.0 / np.sqrt(2.0), rel=0.01)
