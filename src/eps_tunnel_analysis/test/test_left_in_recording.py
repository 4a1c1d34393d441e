# SPDX-License-Identifier: Apache-2.0
"""Whether anything is left is a fact of the recording, however unevenly it is spread over it."""

from dataclasses import replace

import numpy as np

from eps_tunnel_analysis.diagnose.candidates import library
from eps_tunnel_analysis.diagnose.rank import UNKNOWN, Hypothesis, rank
from eps_tunnel_analysis.diagnose.refits import Refit
from labyrinth_sim.model import load_model

SAMPLES, FOLDS, FEW = 1200, 16, 150


def unknown(left: float, base: float = 5.0) -> float:
    """Probability that something is left where an effect leaves noise on one signal, and so much on another that is
    compared in two stretches only, all of it in one of them.
    """
    rng = np.random.default_rng(0)
    often = rng.standard_normal(SAMPLES)
    seldom = np.where(np.arange(2 * FEW) < FEW, rng.standard_normal(2 * FEW), 0.0)
    seldom *= np.sqrt(left / np.mean(seldom**2))
    residuals = np.concatenate([often, seldom])
    signals = np.repeat([0, 1], [SAMPLES, 2 * FEW])
    folds = np.concatenate([np.arange(SAMPLES) * FOLDS // SAMPLES, np.repeat([2, 9], FEW)])

    def one(effects: tuple[str, ...], cost: float) -> Hypothesis:
        values = np.sqrt(cost) * residuals
        refit = Refit(effects, np.zeros(1), values, float(np.mean(values**2)), 3 + len(effects), True)
        return Hypothesis(refit, values)

    found = rank(one((), base), [one(("true.x",), 1.0)], folds, signals, tried=10, signals=signals)
    return found.probabilities[UNKNOWN]


def test_what_leaves_noise_leaves_nothing_though_most_of_it_is_in_one_stretch() -> None:
    assert unknown(1.1) < 0.05


def test_what_leaves_more_than_a_healthy_rig_does_leaves_something_wherever_it_is() -> None:
    assert unknown(4.0) > 0.95


def named(left: dict[tuple[str, ...], float], by_events: bool = False) -> dict[str, float]:
    """Probabilities of sets of effects that leave so much of 20,000 floors, all of them by events or none."""
    noise = np.random.default_rng(0).standard_normal(SAMPLES)
    noise /= np.sqrt(np.mean(noise**2))
    folds, runs = np.arange(SAMPLES) * FOLDS // SAMPLES, np.zeros(SAMPLES, dtype=np.int64)

    def one(effects: tuple[str, ...], cost: float) -> Hypothesis:
        values = np.sqrt(cost) * noise
        return Hypothesis(
            Refit(effects, np.zeros(1), values, cost, 3 + len(effects), True), values, by_events=by_events
        )

    return rank(one((), 20_000.0), [one(*item) for item in left.items()], folds, runs, tried=10).probabilities


def test_what_still_shows_is_left_however_large_the_misfit_was() -> None:
    assert named({("a.x",): 7.0})["a.x"] > 0.9
    assert named({("a.x",): 45.0})[UNKNOWN] > 0.99
    assert named({("a.x",): 45.0, ("a.x", "b.x"): 1.0})["a.x + b.x"] > 0.99


def test_an_event_that_comes_a_little_early_leaves_much() -> None:
    assert named({("a.x",): 45.0}, by_events=True)["a.x"] > 0.99


def test_effects_that_act_by_events_are_known_by_their_declaration() -> None:
    model = load_model("labyrinth_manual")
    whole = library(model, ())
    assert whole.by_events(["backlash.x", "duty_cut_back.x"])
    assert not whole.by_events(["backlash.x"]) and not whole.by_events()
    assert replace(whole, base=("duty_cut_back.x.time",)).by_events()
