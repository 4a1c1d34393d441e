# SPDX-License-Identifier: Apache-2.0
"""Laws of the tunnel, equations 1 to 3 and 12."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tunnel_cases import literal_smooth, literal_tunnel, make_trials, trials

from eps_tunnel_analysis.tunnel import build_tunnel, smooth
from labyrinth_sim.errors import InputError


def test_three_trials_by_hand():
    tunnel = build_tunnel(make_trials([[[1.0], [0.0]], [[2.0], [0.0]], [[6.0], [3.0]]]))
    assert tunnel.mean[:, 0].tolist() == [3.0, 1.0]
    assert tunnel.lower[:, 0].tolist() == [-2.0, -1.0]
    assert tunnel.upper[:, 0].tolist() == [3.0, 2.0]
    assert tunnel.trials == 3
    assert tunnel.seen.tolist() == [[3], [3]]


def test_smoothing_by_hand_at_an_end_and_in_the_middle():
    spread = np.zeros(13)
    spread[6] = 11.0  # two trials at +-11: lower -11, upper 11 at one sample
    tunnel = smooth(build_tunnel(make_trials(np.stack([spread, -spread])[:, :, None])))
    upper = tunnel.upper[:, 0]
    assert upper[0] == 0  # samples 0..5 are in reach
    assert upper[1] == pytest.approx(11 / 7)  # samples 0..6 exist in reach
    assert upper[6] == pytest.approx(1.0)  # all eleven
    assert np.array_equal(tunnel.lower, -tunnel.upper)


@given(trials(holes=True))
def test_equals_the_equations_written_out(t):
    tunnel, smoothed = build_tunnel(t), smooth(build_tunnel(t))
    for result, literal in ((tunnel, literal_tunnel(t.values)), (smoothed, literal_smooth(literal_tunnel(t.values)))):
        for n, row in enumerate(literal):
            for j, expected in enumerate(row):
                got = (result.mean[n, j], result.lower[n, j], result.upper[n, j])
                expected = (np.nan,) * 3 if expected is None else expected
                assert got == pytest.approx(expected, rel=1e-12, abs=1e-12, nan_ok=True)


@given(trials(holes=True), st.randoms(use_true_random=False))
def test_the_order_of_the_trials_changes_no_bit(t, random):
    order = list(range(t.count))
    random.shuffle(order)
    a, b = build_tunnel(t), build_tunnel(make_trials(t.values[order]))
    for name in ("mean", "lower", "upper", "seen"):
        assert np.array_equal(getattr(a, name), getattr(b, name), equal_nan=True)


@given(trials(), st.sampled_from([0.25, 0.5, 2.0, 8.0, -1.0, -4.0]))
def test_scaling_a_signal_scales_its_tunnel(t, factor):
    a, b = build_tunnel(t), build_tunnel(make_trials(t.values * factor))
    low, high = (a.lower, a.upper) if factor > 0 else (a.upper, a.lower)
    for got, expected in ((b.mean, a.mean), (b.lower, low), (b.upper, high)):
        assert np.allclose(got, expected * factor, rtol=1e-9, atol=1e-12)


@given(trials(), st.floats(-100, 100))
def test_shifting_a_signal_shifts_the_mean_only(t, shift):
    a, b = build_tunnel(t), build_tunnel(make_trials(t.values + shift))
    assert np.allclose(b.mean, a.mean + shift, atol=1e-11)
    assert np.allclose(b.lower, a.lower, atol=1e-11)
    assert np.allclose(b.upper, a.upper, atol=1e-11)


@given(trials(p=1), st.integers(1, 7))
def test_one_trial_however_often_gives_a_width_of_exactly_zero(t, repeats):
    tunnel = build_tunnel(make_trials(np.repeat(t.values, repeats, axis=0)))
    for width in (tunnel.lower, tunnel.upper, smooth(tunnel).lower, smooth(tunnel).upper):
        assert not np.any(width)
    assert np.array_equal(tunnel.mean, t.values[0])


@given(trials(holes=True))
def test_every_trial_and_the_mean_lie_inside(t):
    tunnel = build_tunnel(t)
    seen = tunnel.seen > 0
    assert np.all(tunnel.lower[seen] <= 0)
    assert np.all(tunnel.upper[seen] >= 0)
    deviation = t.values - tunnel.mean
    assert np.all(np.isnan(deviation) | ((deviation >= tunnel.lower) & (deviation <= tunnel.upper)))


@given(trials(holes=True))
def test_a_sample_is_nan_exactly_where_no_trial_saw_it(t):
    tunnel = build_tunnel(t)
    assert np.array_equal(tunnel.seen, np.isfinite(t.values).sum(axis=0))
    for array in (tunnel.mean, tunnel.lower, tunnel.upper, smooth(tunnel).lower, smooth(tunnel).upper):
        assert np.array_equal(np.isnan(array), tunnel.seen == 0)


@given(trials())
def test_more_trials_never_narrow_the_extremes(t):
    few, all_ = build_tunnel(make_trials(t.values[:1])), build_tunnel(t)
    low_few, high_few = few.bounds()
    low, high = all_.bounds()
    assert np.all(low <= low_few + 1e-11)
    assert np.all(high >= high_few - 1e-11)


@given(trials(), st.integers(0, 20))
def test_smoothing_keeps_the_sign_the_mean_and_the_largest_width(t, half_width):
    tunnel = build_tunnel(t)
    smoothed = smooth(tunnel, half_width)
    assert np.all(smoothed.lower <= 0)
    assert np.all(smoothed.upper >= 0)
    assert np.array_equal(smoothed.mean, tunnel.mean)
    assert smoothed.smoothed
    assert np.all(smoothed.upper.max(axis=0) <= tunnel.upper.max(axis=0) * (1 + 1e-12))


@given(trials(), st.floats(1, 10))
def test_smoothing_keeps_the_order_of_two_tunnels(t, wider):
    """Deviations times `wider` everywhere stay the wider ones after smoothing."""
    narrow = build_tunnel(t)
    wide = build_tunnel(make_trials(narrow.mean + (t.values - narrow.mean) * wider))
    assert np.all(smooth(wide).upper >= smooth(narrow).upper - 1e-9)
    assert np.all(smooth(wide).lower <= smooth(narrow).lower + 1e-9)


@given(trials(holes=True))
def test_smoothing_over_no_neighbours_changes_nothing(t):
    tunnel = build_tunnel(t)
    assert np.array_equal(smooth(tunnel, 0).upper, tunnel.upper, equal_nan=True)


def test_smoothing_twice_is_refused():
    tunnel = smooth(build_tunnel(make_trials(np.zeros((2, 5, 1)))))
    with pytest.raises(InputError, match="smoothed already"):
        smooth(tunnel)


def test_arrays_are_locked():
    tunnel = build_tunnel(make_trials(np.zeros((2, 5, 1))))
    with pytest.raises(ValueError, match="read-only"):
        tunnel.mean[0, 0] = 1


def test_an_unknown_signal_lists_the_known_ones():
    with pytest.raises(InputError, match="Available signal names: a, b"):
        build_tunnel(make_trials(np.zeros((1, 3, 2)))).index("motor_x")
