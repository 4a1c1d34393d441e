# SPDX-License-Identifier: Apache-2.0
"""Laws of cross-validation, ranking and verdict that need no roll-out."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rank_cases import FOLDS, SAMPLES, hypothesis

from eps_tunnel_analysis.diagnose import rank as rank_module
from eps_tunnel_analysis.diagnose.axes import axis_verdict
from eps_tunnel_analysis.diagnose.axis import AxisDiagnosis
from eps_tunnel_analysis.diagnose.axis_search import AxisPart, joined
from eps_tunnel_analysis.diagnose.base_values import Bases
from eps_tunnel_analysis.diagnose.candidates import library
from eps_tunnel_analysis.diagnose.contained import with_fewer_again
from eps_tunnel_analysis.diagnose.rank import (
    NONE,
    UNKNOWN,
    Hypothesis,
    Ranked,
    Ranking,
    independent,
    itself,
    left_out,
    rank,
    smallest_set,
)
from eps_tunnel_analysis.diagnose.refits import Refit
from eps_tunnel_analysis.diagnose.sets import inexact_share, lacks_more
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from labyrinth_sim.model import load_model

COSTS = st.floats(0.05, 1e4)
SAME = 0.02  # what a probability may change by where nothing of meaning has changed


# ---- residuals made for the purpose: of each hypothesis the same noise, larger or smaller


def smooth_noise(samples: int, seed: int, correlated: int = 15) -> np.ndarray:
    """(samples,) of mean square 1, whose neighbours are alike."""
    white = np.random.default_rng(seed).standard_normal(samples + 4 * correlated)
    window = np.exp(-0.5 * (np.arange(-2 * correlated, 2 * correlated) / (0.5 * correlated)) ** 2)
    found = np.convolve(white, window, mode="same")[2 * correlated : 2 * correlated + samples]
    return found / np.sqrt(np.mean(found**2))


def probabilities(
    costs: dict[tuple[str, ...], float], residuals: np.ndarray | None = None, folds: np.ndarray | None = None,
    blocks: np.ndarray | None = None, **options: Any,
) -> dict[str, float]:  # fmt: skip
    """Of hypotheses by what each leaves; the base is ()."""
    unit = smooth_noise(SAMPLES, 0) if residuals is None else residuals
    where = np.arange(len(unit)) * FOLDS // len(unit) if folds is None else folds
    runs = np.zeros(len(unit), dtype=np.int64) if blocks is None else blocks
    made = {effects: hypothesis(effects, np.sqrt(cost) * unit) for effects, cost in costs.items()}
    base = made.pop(())
    options = {"tried": 10} | options
    return rank(base, list(made.values()), where, runs, **options).probabilities


def numbered(costs: Sequence[float]) -> dict[tuple[str, ...], float]:
    return {(f"e{i}.x",): cost for i, cost in enumerate(costs)}


#: A truth and a rival between which the recordings lean but do not decide.
OPEN = {(): 30.0, ("true.x",): 1.0, ("rival.x",): 1.2}


def test_the_recordings_of_these_tests_lean_but_do_not_decide() -> None:
    found = probabilities(OPEN)
    assert 0.55 < found["true.x"] < 0.95 and found["rival.x"] > 0.04


@given(COSTS, st.lists(COSTS, min_size=0, max_size=6), st.booleans(), st.booleans(), st.floats(0.0, 100.0))
def test_probabilities_sum_to_one(base: float, costs: list[float], floor: bool, drifts: bool, level: float) -> None:
    found = probabilities({(): base, **numbered(costs)}, floor=floor, drifts=drifts, level=level)
    assert sum(found.values()) == pytest.approx(1.0)
    assert min(found.values()) >= -1e-12


@given(COSTS, st.lists(COSTS, min_size=2, max_size=5, unique=True), st.randoms())
def test_the_order_of_candidates_does_not_matter(base: float, costs: list[float], random: Any) -> None:
    given_order = list(numbered(costs).items())
    mixed = list(given_order)
    random.shuffle(mixed)
    one, other = (probabilities({(): base, **dict(order)}) for order in (given_order, mixed))
    assert one == pytest.approx(other)


def test_a_play_cut_into_two_bags_says_the_same() -> None:
    cut = np.repeat([0, 1], SAMPLES // 2)
    assert probabilities(OPEN, blocks=cut) == pytest.approx(probabilities(OPEN), abs=SAME)


def test_stretches_that_are_numbered_otherwise_say_the_same() -> None:
    folds = np.arange(SAMPLES) * FOLDS // SAMPLES
    assert probabilities(OPEN, folds=7 * folds + 3) == pytest.approx(probabilities(OPEN), abs=1e-12)


@pytest.mark.parametrize("finer", [2, 4])
def test_denser_samples_of_the_same_motion_say_the_same(finer: int) -> None:
    coarse = smooth_noise(SAMPLES, 0)
    time = np.arange(SAMPLES)
    dense = np.interp(np.arange(finer * SAMPLES) / finer, time, coarse)
    dense /= np.sqrt(np.mean(dense**2))
    assert probabilities(OPEN, dense) == pytest.approx(probabilities(OPEN, coarse), abs=SAME)


def test_an_axis_the_other_way_round_says_the_same() -> None:
    assert probabilities(OPEN, -smooth_noise(SAMPLES, 0)) == probabilities(OPEN)


@pytest.mark.parametrize("rival", [1.05, 1.2, 1.6])
@pytest.mark.parametrize("base", [4.0, 30.0, 400.0])
def test_more_of_the_same_never_makes_it_less_sure_of_the_truth(base: float, rival: float) -> None:
    before = 0.0
    for times in (1, 2, 4):
        unit = np.tile(smooth_noise(SAMPLES, 0), times)
        found = probabilities(
            {(): base, ("true.x",): 1.0, ("rival.x",): rival}, unit,
            np.arange(len(unit)) * FOLDS // SAMPLES, np.arange(len(unit)) // SAMPLES,
        )["true.x"]  # fmt: skip
        assert found >= before - SAME
        before = found


@pytest.mark.parametrize("costs", [{(): 30.0, ("a.x",): 1.0, ("b.x",): 8.0}, {(): 0.8, ("a.x",): 0.79}, {(): 30.0}])
def test_a_signal_that_nothing_concerns_changes_nothing_of_what_is_clear(costs: dict[tuple[str, ...], float]) -> None:
    unit, other = smooth_noise(SAMPLES, 0), smooth_noise(SAMPLES, 1)
    folds = np.arange(SAMPLES) * FOLDS // SAMPLES
    alone = probabilities(costs, unit)
    both = [hypothesis(effects, np.concatenate([np.sqrt(cost) * unit, other])) for effects, cost in costs.items()]
    beside = rank(both[0], both[1:], np.tile(folds, 2), np.repeat([0, 1], SAMPLES), 10).probabilities
    assert beside == pytest.approx(alone, abs=SAME)


# ---- what the probabilities say


def test_a_base_within_the_noise_lacks_nothing() -> None:
    assert probabilities({(): 1.0, ("a.x",): 0.97})[NONE] > 0.9


def test_of_a_rig_that_leaves_little_an_effect_is_missing_only_if_it_predicts_more() -> None:
    """A fit of more values always leaves less; whether it also knows the rest of the motion, it must show."""
    folds, runs = np.repeat(np.arange(FOLDS), SAMPLES // FOLDS), np.zeros(SAMPLES, dtype=np.int64)
    noise = smooth_noise(SAMPLES, 3)
    base, fits = hypothesis((), 1.2 * noise), hypothesis(("a.x",), 0.6 * noise)
    assert rank(base, [fits], folds, runs, 10).probabilities[NONE] < 0.5
    found = rank(base, [replace(fits, left_out=1.25 * noise)], folds, runs, 10).probabilities
    assert found[NONE] > 0.9 and found[UNKNOWN] < 0.1
    strong = rank(hypothesis((), 5.0 * noise), [replace(fits, left_out=6.0 * noise)], folds, runs, 10)
    assert strong.probabilities[NONE] < 0.01, "far beyond the noise something is missing in any case"


def test_the_gate_lies_between_a_healthy_rig_and_what_shows() -> None:
    """In floors, whatever the settings say: of 1.3 little is missing; 2, of which an effect leaves 1, are no noise."""
    healthy, lacking = (probabilities({(): base, ("a.x",): 1.0})[NONE] for base in (1.3, 2.0))
    assert lacking < 0.1 < 0.5 < healthy


def test_what_explains_all_is_named_and_what_explains_half_is_not() -> None:
    named = probabilities({(): 100.0, **numbered([0.9, 60.0])})
    assert max(named, key=lambda n: named[n]) == "e0.x"
    half = probabilities({(): 100.0, **numbered([50.0, 60.0])})
    assert max(half, key=lambda n: half[n]) == UNKNOWN


def test_without_any_candidate_a_misfit_is_unknown() -> None:
    assert probabilities({(): 10.0})[UNKNOWN] > 0.95


@given(st.floats(10.0, 1e4), COSTS, COSTS)
def test_what_a_better_fit_leaves_is_never_more_unknown(base: float, a: float, b: float) -> None:
    low, high = sorted((min(a, base), min(b, base)))
    better, worse = (probabilities({(): base, ("a.x",): cost})[UNKNOWN] for cost in (low, high))
    assert better <= worse + 1e-9


@pytest.mark.parametrize("tried", [1, 10, 100])
def test_an_effect_more_pays_for_the_many_that_it_was_chosen_from(tried: int) -> None:
    costs = {(): 50.0, ("a.x",): 6.0, ("a.x", "b.x"): 1.0, ("a.x", "c.x"): 1.0}
    found = probabilities({(): 50.0, ("a.x",): 1.0, ("b.x", "c.x"): 1.0}, tried=tried)
    worth = rank_module.independent(smooth_noise(SAMPLES, 0), np.zeros(SAMPLES, dtype=np.int64))
    assert found["a.x"] / found["b.x + c.x"] == pytest.approx(tried * np.sqrt(worth), rel=0.01)
    assert probabilities(costs, tried=tried)["a.x + b.x"] == pytest.approx(0.5, abs=0.1)


def test_an_effect_is_named_instead_of_one_that_it_contains_where_it_explains_more() -> None:
    unit = smooth_noise(SAMPLES, 0)
    costs = {(): 50.0, ("a.x",): 4.0, ("b.x",): 1.0}
    base, narrow, wide = (hypothesis(effects, np.sqrt(cost) * unit) for effects, cost in costs.items())
    wide = replace(wide, contains=(frozenset(["a.x"]),), refit=replace(wide.refit, free=narrow.refit.free + 1))
    close = hypothesis(("a.x",), np.sqrt(1.2) * unit)
    folds, runs = np.arange(SAMPLES) * FOLDS // SAMPLES, np.zeros(SAMPLES, dtype=np.int64)
    assert rank(base, [narrow, wide], folds, runs, 10).marginals["b.x"] > 0.9
    assert rank(base, [close, wide], folds, runs, 10).marginals["a.x"] > 0.7


def test_of_two_forms_of_an_effect_that_explain_alike_the_number_of_values_decides() -> None:
    """A hidden effect has the general form as often as the simple one, and often nothing shows the difference."""
    unit = smooth_noise(SAMPLES, 0)
    base, narrow, wide = (hypothesis(e, np.sqrt(c) * unit) for e, c in (((), 50.0), (("a.x",), 2.0), (("b.x",), 1.9)))
    wide = replace(wide, contains=(frozenset(["a.x"]),), refit=replace(wide.refit, free=narrow.refit.free + 1))
    folds, runs = np.arange(SAMPLES) * FOLDS // SAMPLES, np.zeros(SAMPLES, dtype=np.int64)
    found = rank(base, [narrow, wide], folds, runs, 10).marginals
    worth = rank_module.independent(unit, runs)
    assert found["a.x"] / found["b.x"] == pytest.approx(np.sqrt(worth), rel=0.15)


def test_a_general_form_that_leaves_noise_is_named_instead_of_a_simple_one_that_leaves_more() -> None:
    """However much there was to explain: what a further value explains to the noise is no other effect's form."""
    unit = smooth_noise(SAMPLES, 0)
    folds, runs = np.arange(SAMPLES) * FOLDS // SAMPLES, np.zeros(SAMPLES, dtype=np.int64)

    def general(left: float, left_by_simple: float) -> float:
        costs = {(): 900.0, ("a.x",): left_by_simple, ("b.x",): left}
        base, narrow, wide = (hypothesis(effects, np.sqrt(cost) * unit) for effects, cost in costs.items())
        wide = replace(wide, contains=(frozenset(["a.x"]),), refit=replace(wide.refit, free=narrow.refit.free + 1))
        return rank(base, [narrow, wide], folds, runs, 10).marginals["b.x"]

    assert general(1.0, 3.5) > 0.9
    assert general(1.0, 1.3) < 0.2, "a healthy rig leaves as much"
    assert general(4.0, 6.5) < 0.2, "neither form is right"


def test_of_two_that_explain_alike_the_one_whose_values_are_near_what_is_stated_is_likelier() -> None:
    unit = smooth_noise(SAMPLES, 0)
    base, near, far = (hypothesis(e, np.sqrt(c) * unit) for e, c in (((), 50.0), (("a.x",), 1.0), (("b.x",), 1.0)))
    folds, runs = np.arange(SAMPLES) * FOLDS // SAMPLES, np.zeros(SAMPLES, dtype=np.int64)
    found = rank(base, [near, replace(far, strain=9.0)], folds, runs, 10).marginals
    assert found["a.x"] / found["b.x"] == pytest.approx(np.exp(4.5), rel=0.05)


def test_what_fits_is_no_unknown_though_it_predicts_a_motion_that_is_made_once_badly() -> None:
    unit = smooth_noise(SAMPLES, 0)
    base, right, other = (hypothesis(e, np.sqrt(c) * unit) for e, c in (((), 50.0), (("a.x",), 1.0), (("b.x",), 1.0)))
    folds, runs = np.arange(SAMPLES) * FOLDS // SAMPLES, np.zeros(SAMPLES, dtype=np.int64)
    badly = [replace(right, left_out=2.0 * unit), replace(other, left_out=3.0 * unit)]
    found = rank(base, badly, folds, runs, 10)
    assert found.unknown < 0.05
    assert found.marginals["a.x"] > 0.9  # which predicts it less badly


def test_an_effect_more_that_explains_next_to_nothing_is_not_named() -> None:
    found = probabilities({(): 50.0, ("a.x",): 1.2, ("a.x", "b.x"): 1.0}, tried=1)
    assert found["a.x"] > 0.9


@pytest.mark.parametrize(("base", "best"), [(0.9, 0.85), (80.0, 0.9), (80.0, 60.0)])
def test_where_trials_drift_something_unknown_is_missing(base: float, best: float) -> None:
    found = probabilities({(): base, ("a.x",): best, ("b.x",): 1.1 * best}, drifts=True)
    assert found[UNKNOWN] >= SETTINGS.odd - 1e-12


def test_without_a_floor_the_base_is_one_among_the_others_unless_it_leaves_far_more_than_the_sensors_noise() -> None:
    alike = probabilities({(): 1.2, ("a.x",): 1.198}, floor=False)
    assert alike[UNKNOWN] < 0.05 and alike[NONE] > 0.5
    poor = probabilities({(): 50.0, ("a.x",): 49.9}, floor=False)
    assert poor[UNKNOWN] > 0.5 > poor[NONE]
    told = probabilities({(): 50.0, ("a.x",): 5.0}, floor=False)
    assert told["a.x"] > 0.9


ALIKE = np.where(np.arange(SAMPLES) % 2, 1.0, -1.0)
"""Residuals of which every stretch leaves the same, however stretches are drawn"""


def test_a_free_curve_that_explains_clearly_more_makes_it_unknown() -> None:
    folds, blocks = np.arange(SAMPLES) * FOLDS // SAMPLES, np.zeros(SAMPLES, dtype=np.int64)
    base, named = (hypothesis(e, np.sqrt(c) * ALIKE) for e, c in (((), 5.0), (("a.x",), 1.5)))
    near, far = (hypothesis(("curve.x",), np.sqrt(c) * ALIKE) for c in (1.3, 0.5))
    without, beside, behind = (rank(base, [named], folds, blocks, 10, curves) for curves in ([], [near], [far]))
    assert without.unknown < 0.4 and beside.unknown == pytest.approx(without.unknown, abs=SAME)
    assert behind.unknown > 0.9
    assert (without.unknown_but, beside.unknown_but, behind.unknown_but) == (None, None, "curve.x")


def test_a_sum_of_effects_leaves_nothing_for_its_forms_where_one_free_curve_does_without() -> None:
    folds, blocks = np.arange(SAMPLES) * FOLDS // SAMPLES, np.zeros(SAMPLES, dtype=np.int64)
    base, one, two = (
        hypothesis(e, np.sqrt(c) * ALIKE) for e, c in (((), 101.0), (("a.x",), 3.5), (("a.x", "b.x"), 3.5))
    )
    poor, good = (hypothesis(("curve.x",), np.sqrt(c) * ALIKE) for c in (3.0, 0.5))

    def said(named: Hypothesis, curves: Sequence[Hypothesis]) -> Ranking:
        return rank(base, [named], folds, blocks, 10, curves)

    for curves in ([], [poor]):
        assert said(two, curves).probabilities["a.x + b.x"] > 0.9
    beside = said(two, [good])
    assert beside.unknown > 0.99 and beside.unknown_but == "curve.x"
    # The right effect in another form leaves as much, and a curve may follow that.
    assert said(one, [good]).probabilities["a.x"] > 0.9 and said(one, [good]).unknown_but is None
    within = hypothesis(("a.x", "b.x"), np.sqrt(1.1) * ALIKE)
    assert said(within, [good]).probabilities["a.x + b.x"] > 0.9


def test_the_numbers_by_which_it_is_decided_mean_what_they_say() -> None:
    """Each by an example at the very edge, where odds are even; `width` by odds of 10 to 1."""
    s = SETTINGS

    def said(costs: dict[tuple[str, ...], float], **options: Any) -> dict[str, float]:
        return probabilities(costs, ALIKE, **options)

    even = s.healthy * np.exp(2.0 * s.width)
    assert said({(): even})[NONE] == pytest.approx(0.5, abs=1e-6)
    assert said({(): 1.35 * even})[UNKNOWN] == pytest.approx(10 / 11, abs=0.01)
    assert said({(): 101.0, ("a.x",): s.healthy + 100.0 * s.form})["a.x"] == pytest.approx(0.5, abs=1e-3)
    assert said({(): 1.0, ("a.x",): 0.99}, drifts=True)[UNKNOWN] == pytest.approx(s.odd, abs=0.01)
    for base in (9.0, 101.0):
        least = max(s.material, s.share * (base - 1.0))
        costs = np.array([[least + 2.5, 2.5]])  # more than noise, where forms count
        sets = [hypothesis(effects, np.ones(8)) for effects in (("a.x",), ("a.x", "b.x"))]
        needed = rank_module._needed(sets, np.array([base]), costs, np.array([base - 1.0]), np.ones(2), 1.0)
        assert needed == pytest.approx(np.array([[1.0, 0.5]]))
    assert rank_module._curve_room(101.0, 1.0) == pytest.approx(max(s.material, 100.0 * s.curve))
    assert smallest_set({"a": s.coverage, "b": 1.0 - s.coverage}, s.coverage) == ("a",)


def test_an_effect_that_takes_away_none_of_what_is_left_is_no_rival_of_one_that_does() -> None:
    sets = [hypothesis((name,), np.ones(8)) for name in ("a.x", "b.x", "c.x")]
    left = np.array([[1.1, 2.1, 2.2]])
    needed = rank_module._needed(sets, np.array([2.1]), left, np.array([1.1]), np.ones(3), 1.0)
    assert needed[0, 0] > 0.95 and needed[0, 1:].max() < 1e-6


def test_what_is_sure_but_far_below_the_noise_is_not_named_though_no_trial_was_repeated() -> None:
    costs = {(): 0.87, ("a.x",): 0.77}
    long = smooth_noise(20 * SAMPLES, 0)
    assert probabilities(costs, long, floor=False)[NONE] > 0.9
    assert probabilities({(): 2.9, ("a.x",): 1.9}, long, floor=False)["a.x"] > 0.9


def test_what_an_effect_of_one_form_leaves_is_something_else() -> None:
    """A hundredth of the misfit may be the form of friction; a delay has one form, so there it is a second effect."""
    unit = smooth_noise(SAMPLES, 0, 5)
    folds = np.arange(SAMPLES) * FOLDS // SAMPLES

    def said(inexact: float, pair: float) -> dict[str, float]:
        left = {("a.x",): (4.0, inexact), ("a.x", "b.x"): (pair, 0.02)}
        sets = [replace(hypothesis(e, np.sqrt(cost) * unit), inexact=share) for e, (cost, share) in left.items()]
        base = hypothesis((), np.sqrt(200.0) * unit)
        return rank(base, sets, folds, np.zeros(SAMPLES, dtype=np.int64), 10).probabilities

    assert said(0.0, 2.5)["a.x"] < 0.1 and said(1.0, 2.5)["a.x"] > 0.6
    for inexact in (0.0, 1.0):
        assert said(inexact, 1.0)["a.x + b.x"] > 0.9, "an error of a form does not end at the noise"


def test_the_form_of_an_effect_counts_for_what_that_effect_explains() -> None:
    exact = {"delay.x": True, "tick.x": True, "friction.x": False}
    found = {name: SimpleNamespace(effect=SimpleNamespace(exact=is_exact)) for name, is_exact in exact.items()}
    search: Any = SimpleNamespace(library=SimpleNamespace(find=found.__getitem__))
    left = {
        (): 101.0,
        ("delay.x",): 41.0,
        ("friction.x",): 91.0,
        ("delay.x", "friction.x"): 1.0,
        ("delay.x", "tick.x"): 2.0,
    }
    base, *refits = (Refit(names, np.zeros(1), np.zeros(8), cost, 3, True) for names, cost in left.items())
    shares = {refit.effects: inexact_share(search, base, refit, refits) for refit in refits}
    assert shares[("delay.x",)] == shares[("delay.x", "tick.x")] == 0.0
    assert shares[("friction.x",)] == 1.0
    assert shares[("delay.x", "friction.x")] == pytest.approx(0.4), "beside the delay it explains 40, alone 10"


def test_more_is_sought_beyond_the_noise_and_of_a_single_trial_beyond_twice_that() -> None:
    search: Any = SimpleNamespace(signal=np.zeros(SAMPLES, dtype=np.int64))

    def lacks(cost: float, floor: bool) -> bool:
        best = Refit(("load.x",), np.zeros(1), np.full(SAMPLES, np.sqrt(cost)), cost, 3, True)
        return lacks_more(search, best, floor=floor)

    close = SETTINGS.close * SETTINGS.healthy
    assert [lacks(times * close, True) for times in (0.9, 1.1, 1.9, 2.1)] == [False, True, True, True]
    assert [lacks(times * close, False) for times in (0.9, 1.1, 1.9, 2.1)] == [False, False, False, True]


def test_an_effect_that_fits_better_with_the_values_of_a_pair_starts_again_there() -> None:
    """The drive's one value, 0 or 1, lies in a valley that only the pair has left; tick and play are the others."""
    columns = {"tick.x": [1], "play.x": [2]}
    candidates = {name: SimpleNamespace(name=name, place="", effect=SimpleNamespace(contains=())) for name in columns}

    def residuals(values: np.ndarray, level: str) -> np.ndarray:
        drive, tick = values[:, 0], values[:, 1]
        return np.repeat(np.sqrt(1.0 + 0.9 * (1.0 - drive) + 20.0 * (1.0 - tick))[:, None], SAMPLES, axis=1)

    def refit(names: tuple[str, ...], drive: float, *, converged: bool = True) -> Refit:
        values = np.array([drive, "tick.x" in names, "play.x" in names], dtype=float)
        left = residuals(values[None], "exact")[0]
        return Refit(names, values, left, float(np.mean(left**2)), 3, converged)

    begun: list[tuple[str, ...]] = []

    def judged(jobs: Sequence[tuple[Any, np.ndarray]], rounds: int) -> list[Refit]:
        begun.extend(tuple(c.name for c in kept) for kept, _ in jobs)
        return [refit(tuple(c.name for c in kept), float(v[0]), converged=False) for kept, v in jobs]

    library = SimpleNamespace(find=candidates.__getitem__, of=lambda names: tuple(candidates[n] for n in names))
    search: Any = SimpleNamespace(
        library=library, columns=lambda candidate: columns[candidate.name], residuals=residuals, judged=judged,
        start=np.zeros(3), within=lambda values: values, held_at=lambda values: 0.0,
    )  # fmt: skip
    pair = refit(("tick.x", "play.x"), 1.0)
    base, refits = with_fewer_again(search, refit((), 1.0), [refit(("tick.x",), 0.0), pair])
    assert begun == [("tick.x",)], "of what was never tried, and of the base, which lies there, none"
    assert {r.effects: r.cost for r in refits} == pytest.approx({("tick.x",): 1.0, pair.effects: 1.0})
    assert not base.effects
    assert all(r.converged for r in refits)


def test_correlated_residuals_are_worth_fewer_samples() -> None:
    white = np.random.default_rng(2).standard_normal(1000)
    blocks = np.zeros(1000, dtype=np.int64)
    assert independent(smooth_noise(1000, 2), blocks) < 0.2 * independent(white, blocks)


# ---- what is left out


def linear(seed: int, samples: int = 240, values: int = 4) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(R, k) Jacobian of which one column acts in the first stretch alone, (R,) folds, (R,) true answers."""
    rng = np.random.default_rng(seed)
    folds = np.arange(samples) * 8 // samples
    jacobian = rng.standard_normal((samples, values))
    jacobian[:, 0] *= np.where(folds == 0, 1.0, 0.3)
    return jacobian, folds, jacobian @ rng.standard_normal(values)


def refitted(jacobian: np.ndarray, data: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(R,) residuals of the values that fit best where each sample has a weight."""
    root = np.sqrt(weights)
    found = np.linalg.lstsq(jacobian * root[:, None], data * root, rcond=None)[0]
    return jacobian @ found - data


WIDE = np.full(4, np.inf), np.full(4, np.inf)


def honest(jacobian: np.ndarray, data: np.ndarray, folds: np.ndarray, kept: float) -> np.ndarray:
    """(R,) residuals of each stretch by values refitted while it weighs `kept`."""
    found = np.empty(len(data))
    for fold in np.unique(folds):
        here = folds == fold
        found[here] = refitted(jacobian, data, np.where(here, kept, 1.0))[here]
    return found


def test_what_is_left_out_in_full_is_what_an_honest_refit_without_it_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rank_module, "SETTINGS", replace(SETTINGS, kept=0.0))
    jacobian, folds, answers = linear(0)
    data = answers + np.random.default_rng(1).standard_normal(len(answers))
    residuals = refitted(jacobian, data, np.ones(len(data)))
    expected = honest(jacobian, data, folds, 0.0)
    assert left_out(jacobian, residuals, folds, WIDE) == pytest.approx(expected, rel=1e-4, abs=1e-6)
    assert not np.allclose(expected, residuals, atol=1e-3)


def test_values_move_twice_as_far_as_in_an_honest_refit_in_which_the_stretch_weighs_half() -> None:
    """Once for the stretch's own noise, and once more for that of a stretch played anew."""
    jacobian, folds, answers = linear(2)
    data = answers + np.random.default_rng(3).standard_normal(len(answers))
    residuals = refitted(jacobian, data, np.ones(len(data)))
    half = honest(jacobian, data, folds, SETTINGS.kept)
    found = left_out(jacobian, residuals, folds, WIDE)
    assert found - residuals == pytest.approx((half - residuals) / (1.0 - SETTINGS.kept), rel=1e-4, abs=1e-6)


def test_what_is_left_out_is_as_far_off_as_the_same_stretches_played_once_more() -> None:
    fitted, found, anew = [], [], []
    for seed in range(600):
        jacobian, folds, answers = linear(seed, samples=48)
        rng = np.random.default_rng([seed, 1])
        data = answers + rng.standard_normal(len(answers))
        residuals = refitted(jacobian, data, np.ones(len(data)))
        fitted.append(np.mean(residuals**2))
        found.append(np.mean(left_out(jacobian, residuals, folds, WIDE) ** 2))
        anew.append(np.mean((residuals + data - answers - rng.standard_normal(len(answers))) ** 2))
    assert np.mean(found) == pytest.approx(np.mean(anew), rel=0.05)
    assert np.mean(fitted) < 0.9 * np.mean(anew)


def test_no_value_is_left_out_beyond_its_bounds() -> None:
    jacobian, folds, answers = linear(4)
    residuals = refitted(jacobian, answers + 1.0, np.ones(len(answers)))
    nowhere, nothing = (np.zeros(4), np.zeros(4)), (np.empty(0), np.empty(0))
    assert left_out(jacobian, residuals, folds, nowhere) == pytest.approx(residuals)
    assert left_out(np.empty((len(answers), 0)), residuals, folds, nothing) == pytest.approx(residuals)


def test_two_values_that_do_the_same_are_left_out_as_one_though_their_bounds_differ() -> None:
    jacobian, folds, answers = linear(5)
    data = answers + np.random.default_rng(6).standard_normal(len(answers))
    residuals = refitted(jacobian, data, np.ones(len(data)))
    one = left_out(jacobian, residuals, folds, WIDE)
    slightly = 1.0 + 1e-4 * np.random.default_rng(7).standard_normal(len(answers))  # as finite differences see it
    twice = np.column_stack([jacobian, jacobian[:, 0] * slightly])
    room = tuple(np.append(side, 0.2) for side in WIDE)
    assert left_out(twice, residuals, folds, (room[0], room[1])) == pytest.approx(one, abs=0.05)


@pytest.mark.parametrize("by", [-1.0, 1e3])
def test_the_unit_of_a_value_does_not_matter_where_stretches_are_left_out(by: float) -> None:
    jacobian, folds, answers = linear(5)
    residuals = refitted(jacobian, answers + np.sin(np.arange(len(answers))), np.ones(len(answers)))
    one, other = (left_out(jacobian * [unit, 1, 1, 1], residuals, folds, WIDE) for unit in (1.0, by))
    assert other == pytest.approx(one, abs=1e-3)


# ---- several axes


def test_an_axis_is_searched_among_the_others_with_their_refitted_values() -> None:
    model = load_model("labyrinth_manual")
    bases = Bases({"drive.x.p": 11.0, "drive.x.delay": 0.011, "drive.y.p": 12.0})
    x = AxisPart(("x",), ("motor_x",), ("drive.x.p", "drive.x.delay"))
    own, among = model.values(), bases.among(model, [], x)[0].values()
    assert {name for name in own if among[name] != own[name]} == {"drive.y.p"}
    assert among["drive.y.p"] == 12.0


def test_an_axis_within_the_noise_is_not_called_unknown_for_what_another_one_lacks() -> None:
    unit = smooth_noise(2 * SAMPLES, 8)
    elbow = np.arange(2 * SAMPLES) >= SAMPLES
    folds, runs = np.tile(np.arange(SAMPLES) * FOLDS // SAMPLES, 2), elbow.astype(np.int64)
    base = hypothesis((), unit * np.where(elbow, 5.0, 4.0))
    right = hypothesis(("constant_torque.shoulder",), unit * np.where(elbow, 5.0, 1.0))
    all_of_it = rank(base, [right], folds, runs, 10, signals=runs)
    assert all_of_it.unknown > 0.9
    assert rank(base, [right], folds, runs, 10, signals=runs, asked=elbow).unknown > 0.9
    shoulder = rank(base, [right], folds, runs, 10, signals=runs, asked=~elbow)
    assert shoulder.unknown < 0.05
    assert shoulder.marginals["constant_torque.shoulder"] > itself(0.9)


def part_of(axis: str, rough: str) -> AxisPart:
    return AxisPart((axis,), (axis,), (f"drive.{axis}.p", rough), 1)


def test_axes_that_shake_one_another_are_judged_together() -> None:
    parts = [part_of("shoulder", "body.upper_arm.mass"), part_of("elbow", "body.forearm.mass")]
    (both,) = joined(load_model("two_link_arm"), parts)
    assert both.axes == ("shoulder", "elbow")
    assert both.signals == ("shoulder", "elbow")
    assert both.base == ("drive.shoulder.p", "drive.elbow.p", "body.upper_arm.mass", "body.forearm.mass")
    assert both.rough == 2
    assert both.title == "axes shoulder and elbow"


def test_axes_that_do_not_feel_one_another_are_judged_apart_unless_an_effect_couples_them() -> None:
    model = load_model("labyrinth")
    parts = [AxisPart((axis,), (f"motor_{axis}",), (f"drive.{axis}.p",)) for axis in "xy"]
    assert joined(model, parts) == parts
    effect = model.registry.effect("cross_coupling")
    (both,) = joined(model.with_effect(effect, "x", effect.off), parts)
    assert both.axes == ("x", "y")
    assert joined(model, parts[:1]) == parts[:1]


def test_what_is_found_together_is_told_axis_by_axis() -> None:
    lib = library(load_model("two_link_arm"), (), only=["constant_torque", "coulomb_friction"])
    hidden = ("constant_torque.shoulder", "coulomb_friction.elbow")
    sets: list[tuple[str, ...]] = [hidden, hidden[:1], ()]
    ranked = tuple(
        Ranked(effects, p, 1.0, 1.0, 0.8, (0.7, 0.9)) for effects, p in zip(sets, (0.7, 0.2, 0.06), strict=True)
    )
    signals = ("shoulder", "elbow")
    search: Any = SimpleNamespace(library=lib, signal=np.array([0, 0, 1, 1]))
    base = Refit((), np.zeros(0), np.array([3.0, 3.0, 2.0, 2.0]), 6.5, 0, True)
    after = Refit(hidden, np.zeros(0), np.array([1.0, 1.0, 0.5, 0.5]), 0.625, 2, True)
    ranking = Ranking(ranked, 0.04)
    part = AxisPart(("shoulder", "elbow"), signals, ())
    parts = {"elbow": ranking, "shoulder": Ranking(ranked[:1], 0.3)}
    found = AxisDiagnosis(part, search, base, (after,), (), ranking, ranking, parts=parts)
    shoulder, elbow = (axis_verdict(found, name, hidden) for name in part.axes)
    assert shoulder.marginals == {hidden[0]: pytest.approx(itself(0.7))}
    assert elbow.marginals == {hidden[1]: pytest.approx(itself(0.7))}
    assert (shoulder.none, elbow.none) == (0.0, pytest.approx(0.26))
    assert (shoulder.unknown, elbow.unknown) == (0.3, 0.04)
    assert (shoulder.floors, elbow.floors) == ((9.0, 1.0), (4.0, 0.25))
    assert elbow.remaining == {"elbow": 0.25}
    assert found.worst("elbow") == 4.0
