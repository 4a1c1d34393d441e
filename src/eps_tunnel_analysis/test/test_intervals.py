# SPDX-License-Identifier: Apache-2.0
"""Intervals of fitted values: what they hold, with correlated residuals and with an effect missing."""

from dataclasses import replace

import numpy as np
import pytest
from fit_cases import TRUTH, made_by, start, step

from eps_tunnel_analysis.calibration.calibrate import Fit, Settings, calibrate
from eps_tunnel_analysis.fit.intervals import intervals, trade_offs, widened
from eps_tunnel_analysis.fit.methods import GaussNewton
from eps_tunnel_analysis.recorded_play import Play

QUICK = GaussNewton(scouts=4, starts=1, passes=0)
P = ("drive.x.p",)


def correlated(rng: np.random.Generator, size: int, memory: float = 0.9) -> np.ndarray:
    """Noise of deviation 1 that remembers."""
    white = rng.standard_normal(size + 200) * np.sqrt(1.0 - memory**2)
    found = np.zeros(size + 200)
    for i in range(1, len(found)):
        found[i] = memory * found[i - 1] + white[i]
    return found[200:]


def test_a_line_through_correlated_noise_is_held_by_the_stated_share() -> None:
    """Slopes are as smooth as a motion's, so that noise that remembers does harm."""
    rng, size = np.random.default_rng(0), 400
    t = np.linspace(0.0, 1.0, size)
    slopes = np.column_stack([np.sin(3.0 * t), np.cos(5.0 * t)])
    blocks, held = np.zeros(size), []
    for _ in range(200):
        noise = correlated(rng, size)
        best = np.linalg.lstsq(slopes, noise, rcond=None)[0]
        found = intervals(slopes, noise - slopes @ best, blocks)
        held.append(np.abs(best) <= found.half_width)  # the truth is 0
    assert 0.88 <= np.mean(held) <= 0.99


def test_the_covariance_adds_up_over_blocks_and_never_across() -> None:
    rng = np.random.default_rng(1)
    slopes, noise = rng.standard_normal((100, 1)), rng.standard_normal(100)
    one = intervals(slopes, noise, np.zeros(100))
    apart = intervals(slopes, noise, np.arange(100.0))  # every sample by itself: nothing to be correlated with
    textbook = np.mean(noise**2) / float(slopes[:, 0] @ slopes[:, 0])
    assert apart.lag <= 200 and one.covariance.shape == (1, 1)
    assert apart.covariance[0, 0] == pytest.approx(textbook, rel=0.05)


def test_values_that_trade_off_are_told_by_what_is_known_of_both() -> None:
    rng = np.random.default_rng(2)
    both = rng.standard_normal(500)
    slopes = np.column_stack([both, 0.5 * both + 0.01 * rng.standard_normal(500)])
    found = intervals(slopes, 0.1 * rng.standard_normal(500), np.zeros(500))
    (said,) = trade_offs(found, np.array([4.0, 6.0]), np.array([1.0, 2.0]), ("a", "b"))
    # Residuals follow a + 0.5 b / 2, with b in shares of 2.
    assert said.startswith("a and b trade off: a + 0.25 b = 5.5 ±")
    half = float(said.split("±")[1].split()[0])
    assert half < 0.1 * found.half_width[0]
    alone = replace(found, covariance=np.diag(np.diag(found.covariance)))
    assert trade_offs(alone, np.array([4.0, 6.0]), np.array([1.0, 2.0]), ("a", "b")) == []


def fit(recorded: Play) -> Fit:
    model = start().with_values({**TRUTH, "drive.x.p": 16.0})
    return calibrate(model, P, [recorded], Settings(method=QUICK, nthread=1, signals=("motor_x", "board_x")))


def test_a_missing_effect_widens_the_interval_until_it_holds_the_truth() -> None:
    rig = start().with_values(TRUTH)
    healthy = fit(Play("", made_by(rig, step(3.0))))
    lacking = fit(Play("", made_by(rig.with_effect("gain_error", "x", {"share": 0.03}), step(3.0))))
    (well,), (shifted,) = healthy.parameters, lacking.parameters
    assert abs(well.value - TRUTH["drive.x.p"]) <= well.half_width < 0.3
    assert abs(shifted.value - TRUTH["drive.x.p"]) > 3 * well.half_width, "the effect does shift the value"
    assert abs(shifted.value - TRUTH["drive.x.p"]) <= shifted.half_width
    assert any("missing effect would have shifted" in w for w in lacking.warnings)
    assert not any("missing effect" in w for w in healthy.warnings)


def test_values_that_trade_off_are_told_where_an_effect_is_missing_too(monkeypatch) -> None:
    """What is known of both together is worth most where neither is known well."""
    monkeypatch.setattr("eps_tunnel_analysis.fit.intervals.TRADE_OFF", 0.7)
    rig = start().with_values(TRUTH).with_effect("gain_error", "x", {"share": 0.03})
    settings = Settings(method=QUICK, nthread=1, signals=("motor_x", "board_x"))
    recorded = Play("", made_by(rig, step(3.0)))
    told = calibrate(start().with_values(TRUTH), ("drive.x.d", "drive.x.delay"), [recorded], settings).warnings
    assert any("missing effect would have shifted" in w for w in told)
    assert any("trade off" in w and "is known better than either" in w for w in told), told


def test_a_combination_that_a_missing_effect_shifts_is_not_known_better() -> None:
    rng = np.random.default_rng(2)
    both = rng.standard_normal(500)
    slopes = np.column_stack([both, 0.5 * both + 0.01 * rng.standard_normal(500)])
    found = intervals(slopes, 0.1 * rng.standard_normal(500), np.zeros(500))
    values, span = np.array([4.0, 6.0]), np.array([1.0, 2.0])

    def half(*shift: float) -> float | None:
        shifts = np.array([shift])
        wide = widened(found, np.abs(shifts).max(axis=0))
        said = trade_offs(wide, values, span, ("a", "b"), shifts)
        return float(said[0].split("±")[1].split()[0]) if said else None

    (alone,) = trade_offs(found, values, span, ("a", "b"))
    along, across = half(1.0, -2.0), half(1.0, 2.0)
    assert along == pytest.approx(float(alone.split("±")[1].split()[0]), rel=0.2), "a + 0.25 b stays where it is"
    assert across is None
    slightly = half(0.01, 0.0)
    assert slightly is not None and slightly > 0.0196
