# SPDX-License-Identifier: Apache-2.0
"""A value of an effect that lies at a bound is not free, and does not count as one more."""

from dataclasses import replace

import numpy as np
import pytest
from fit_cases import search_on_x
from rank_cases import FOLDS, SAMPLES
from rank_cases import hypothesis as hypothesis_of

from eps_tunnel_analysis.diagnose.axis import hypothesis
from eps_tunnel_analysis.diagnose.rank import Hypothesis, rank
from eps_tunnel_analysis.diagnose.refits import Refit


def leaving(residuals: np.ndarray, effects: tuple[str, ...], free: int, unused: int) -> Hypothesis:
    """A hypothesis that leaves residuals (SAMPLES,); general.x contains simple.x."""
    contains = (frozenset({"simple.x"}),) if effects == ("general.x",) else ()
    return replace(hypothesis_of(effects, residuals, free), contains=contains, unused=unused)


@pytest.mark.parametrize(("slow", "unused"), [(0.0, 1), (0.05, 0)])
def test_friction_that_sets_in_at_once_has_one_value_less(slow: float, unused: int) -> None:
    search = search_on_x(["coulomb_friction"])
    values = search.start.copy()
    values[search.columns(search.library.find("coulomb_friction.x"))] = (0.2, slow)
    bare = Refit((), search.start, np.ones(len(search.used)), 1.0, 5, True)
    found = hypothesis(search, search.at(values, replace(bare, effects=("coulomb_friction.x",), free=7)))
    assert found.unused == unused
    off = replace(found.refit, values=search.start)  # an effect that is switched off still counts as one value
    assert hypothesis(search, off).unused == 1


def test_of_two_forms_that_fit_alike_the_one_with_fewer_free_values_is_likelier() -> None:
    noise = np.random.default_rng(0).standard_normal(SAMPLES)

    def one(effects: tuple[str, ...], size: float, free: int, unused: int = 0) -> Hypothesis:
        return leaving(size * noise, effects, free, unused)

    def simple_of(unused: int, other: str = "general.x", its: int = 0) -> float:
        both = [one(("simple.x",), 1.0, 7, unused), one((other,), 1.0, 7, its)]
        folds = np.arange(SAMPLES) * FOLDS // SAMPLES
        return rank(one((), 10.0, 5), both, folds, np.zeros(SAMPLES, np.int64), tried=10).probabilities["simple.x"]

    assert simple_of(0) == pytest.approx(0.5, abs=0.02)
    assert simple_of(1) > 0.9
    assert simple_of(1, its=2) > 0.99  # with the values at bounds that it has beyond, the general one is the simple one
    assert simple_of(1, "another.x") == pytest.approx(0.5, abs=0.02)  # that one is no form of it


def test_a_general_form_that_leaves_noise_is_no_worse_beside_others_for_having_a_simple_one() -> None:
    """What the simple form leaves is here within what a form of another effect may."""
    noise = np.repeat(np.random.default_rng(0).standard_normal(SAMPLES // 10), 10)
    noise /= np.sqrt(np.mean(noise**2))
    folds = np.arange(SAMPLES) * FOLDS // SAMPLES

    def one(effects: tuple[str, ...], left: float, free: int, unused: int = 0) -> Hypothesis:
        return leaving(np.sqrt(left) * noise, effects, free, unused)

    base, general, other = one((), 110.0, 5), one(("general.x",), 1.1, 7), one(("other.x",), 1.1, 7)
    for simple in ([], [one(("simple.x",), 2.9, 7, unused=1)]):
        found = rank(base, [general, other, *simple], folds, np.zeros(SAMPLES, np.int64), tried=10).probabilities
        assert found["general.x"] == pytest.approx(found["other.x"], rel=0.5)
