# SPDX-License-Identifier: Apache-2.0
"""What tells effects apart that both explain nearly all of a large misfit: an error of a form is a smooth curve."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from rank_cases import FOLDS, SAMPLES, hypothesis

from eps_tunnel_analysis.diagnose.rank import UNKNOWN, Ranking, rank, with_form
from eps_tunnel_analysis.diagnose.settings import SETTINGS


def ranking(
    left: dict[tuple[str, ...], float], contains: tuple[str, str] | None = None, misfit: float = 200.0,
    inexact: float = 1.0, **options: Any,
) -> Ranking:  # fmt: skip
    """Of sets of effects that leave so many floors of `misfit`; the first of `contains` can imitate the second."""
    folds = np.arange(SAMPLES) * FOLDS // SAMPLES
    unit = np.repeat(np.random.default_rng(0).standard_normal(SAMPLES // 10), 10)
    unit /= np.sqrt(np.bincount(folds, unit**2) / np.bincount(folds))[folds]  # no stretch decides by chance
    sets = [
        replace(hypothesis(effects, np.sqrt(cost) * unit, free=4), inexact=inexact) for effects, cost in left.items()
    ]
    if contains is not None:
        general, simple = contains
        sets = [replace(s, contains=(frozenset({simple}),)) if s.refit.effects == (general,) else s for s in sets]
    base = hypothesis((), np.sqrt(misfit) * unit, free=3)
    return rank(base, sets, folds, np.zeros(SAMPLES, dtype=np.int64), tried=10, **options)


def probabilities(*args: Any, **options: Any) -> dict[str, float]:
    return ranking(*args, **options).probabilities


@pytest.mark.parametrize("noise", [0.4, 0.8])
def test_of_two_that_leave_noise_the_better_one_is_likelier_however_much_the_base_leaves(noise: float) -> None:
    found = probabilities({("right.x",): noise, ("twin.x",): 1.5 * noise})
    assert found["right.x"] > 0.95
    equal = probabilities({("right.x",): noise, ("twin.x",): noise})
    assert equal["right.x"] == pytest.approx(equal["twin.x"])


def test_beyond_that_a_form_s_error_counts_by_its_size_and_not_by_every_sample() -> None:
    found = probabilities({("right.x",): 3.0, ("twin.x",): 3.6}, misfit=1000.0)
    assert 0.05 < found["twin.x"] < 0.4


def test_what_another_effect_takes_away_may_be_the_first_one_s_form() -> None:
    found = probabilities({("right.x",): 3.0, ("right.x", "more.x"): 2.2})
    assert found["right.x"] > 0.9


def test_what_another_effect_takes_to_the_noise_is_no_form() -> None:
    found = probabilities({("right.x",): 5.0, ("right.x", "more.x"): 0.9})
    assert found["more.x + right.x"] > 0.9


def test_what_no_effect_explains_is_unknown_though_no_trial_was_repeated() -> None:
    """Surely better than nothing, and far from all: more than its form and a rig without repeats may leave."""
    said = partial(probabilities, misfit=71.0, floor=False)
    assert said({("a.x",): 50.0})[UNKNOWN] > 0.9
    most = SETTINGS.unrepeated * (SETTINGS.healthy + 70.0 * SETTINGS.form)
    assert said({("a.x",): most})["a.x"] == pytest.approx(0.5, abs=1e-3)
    assert said({("a.x",): 0.6 * most})["a.x"] > 0.9


@pytest.mark.parametrize("floor", [True, False])
def test_an_effect_of_one_form_may_leave_what_the_form_of_an_effect_added_before_it_leaves(floor: bool) -> None:
    kept = np.array([SETTINGS.exact])
    most = (1.0 if floor else SETTINGS.unrepeated) * float(with_form(kept, 12.0, 171.0)[0])
    assert most > 10.0 and with_form(kept, 12.0, 0.0)[0] < 2.0

    said = partial(probabilities, {("delay.x",): 0.5 * most}, misfit=4.0 * most, inexact=0.0, floor=floor)
    within, first = said(level=171.0), said(level=0.0)
    assert within["delay.x"] > 0.9
    assert first[UNKNOWN] > 0.5


def test_what_is_explained_of_a_single_trial_is_in_floors_of_its_sensors_too() -> None:
    """Not in units of what the best leaves, of which it would explain all."""
    for floor in (True, False):
        (found,) = (r for r in ranking({("a.x",): 6.0}, misfit=101.0, floor=floor).ranked if r.effects)
        assert found.explained == pytest.approx(0.95, abs=1e-3)


def test_what_a_general_form_takes_away_may_be_the_simple_one_s_form() -> None:
    left = {("general.x",): 1.5, ("simple.x",): 1.9}
    assert probabilities(left)["simple.x"] < 0.1
    assert probabilities(left, ("general.x", "simple.x"))["simple.x"] > 0.4
