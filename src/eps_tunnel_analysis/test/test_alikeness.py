# SPDX-License-Identifier: Apache-2.0
"""Laws of the alikeness, equations 4 to 7 and 13."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from tunnel_cases import literal_margin, literal_tunnel, make_trials, pairs, trials

from eps_tunnel_analysis.alikeness import alikeness, alikeness_over_k, rig_against_itself
from eps_tunnel_analysis.tunnel import build_tunnel, smooth
from labyrinth_sim.errors import InputError

factors = st.floats(0, 10)


def tunnels(pair):
    return build_tunnel(pair[0]), build_tunnel(pair[1])


def column(*values):
    """Trials with one signal from lists of samples, one list a trial."""
    return make_trials(np.array(values, dtype=float)[:, :, None])


def test_four_samples_by_hand():
    real = build_tunnel(column([-1, -1, -1, -1], [1, 1, 1, 1]))  # mean 0, from -1 to 1
    sim = build_tunnel(column([0, 1, 1.5, 3]))
    assert alikeness(real, sim).alike[:, 0].tolist() == [True, True, False, False]
    assert alikeness(real, sim).shares == {"a": 0.5}
    assert [a.joint for a in alikeness_over_k(real, sim, (1, 2, 3))] == [0.5, 0.75, 1.0]


def test_two_wide_tunnels_that_touch_are_alike():
    real, sim = build_tunnel(column([-1.0], [1.0])), build_tunnel(column([1.0], [3.0]))
    assert alikeness(real, sim).joint == 1
    assert alikeness(real, build_tunnel(column([1.5], [3.5]))).joint == 0
    assert alikeness(real, build_tunnel(column([1.5], [3.5])), k_real=1.5).joint == 1
    assert alikeness(real, build_tunnel(column([1.5], [3.5])), k_sim=1.5).joint == 1


def test_joint_needs_every_signal_at_the_same_sample():
    real = build_tunnel(make_trials(np.zeros((1, 4, 2))))
    sim = build_tunnel(make_trials([[[0, 9], [9, 0], [0, 0], [9, 9]]]))
    result = alikeness(real, sim)
    assert result.shares == {"a": 0.5, "b": 0.5}
    assert result.joint == 0.25


def test_unseen_samples_are_left_out_and_counted():
    nan = math.nan
    real, sim = build_tunnel(column([0, nan, 0, 0, nan])), build_tunnel(column([0, 0, nan, 5, nan]))
    result = alikeness(real, sim)
    assert result.seen[:, 0].tolist() == [True, False, False, True, False]
    assert result.shares == {"a": 0.5}
    assert result.unseen == {"a": 3}
    assert result.joint_unseen == 3


def test_a_signal_never_seen_has_no_share():
    real = build_tunnel(column([math.nan, math.nan]))
    assert math.isnan(alikeness(real, real).shares["a"])
    assert math.isnan(alikeness(real, real).joint)


def test_spans_are_the_runs_outside_and_end_at_unseen_samples():
    nan = math.nan
    real, sim = build_tunnel(column([0.0] * 8)), build_tunnel(column([9, 0, 9, 9, nan, 9, 0, 0]))
    spans = alikeness(real, sim).spans("a")
    assert [s.samples for s in spans] == [1, 2, 1]
    assert [(s.start, s.end) for s in spans] == [
        (0.0, pytest.approx(0.01)),
        (pytest.approx(0.02), pytest.approx(0.04)),
        (pytest.approx(0.05), pytest.approx(0.06)),
    ]
    assert alikeness(real, sim).spans() == tuple(type(s)("jointly", s.start, s.end, s.samples) for s in spans)


@given(pairs(holes=True), factors, factors)
def test_equals_equation_6_written_out(pair, k_real, k_sim):
    real, sim = (literal_tunnel(t.values) for t in pair)
    result = alikeness(*tunnels(pair), k_real, k_sim)
    for n, (row_real, row_sim) in enumerate(zip(real, sim, strict=True)):
        for j, (r, s) in enumerate(zip(row_real, row_sim, strict=True)):
            assert result.seen[n, j] == (r is not None and s is not None)
            if not result.seen[n, j]:
                assert not result.alike[n, j]
            elif abs(margin := literal_margin(r, s, k_real, k_sim)) > 1e-9:  # at a tie rounding decides
                assert result.alike[n, j] == (margin > 0)


@given(pairs())
def test_at_k_1_it_says_whether_the_intervals_intersect(pair):
    real, sim = tunnels(pair)
    (low_r, high_r), (low_s, high_s) = real.bounds(), sim.bounds()
    overlap = np.minimum(high_r, high_s) - np.maximum(low_r, low_s)
    clear = np.abs(overlap) > 1e-9
    assert np.array_equal(alikeness(real, sim).alike[clear], (overlap >= 0)[clear])


@given(trials(), st.data())
def test_with_a_deterministic_simulation_it_is_equation_13(t, data):
    sim = data.draw(trials(shape=t.values.shape[1:], p=1))
    k = data.draw(factors)
    real = smooth(build_tunnel(t))
    low, high = k * real.lower, k * real.upper
    apart = sim.values[0] - real.mean
    expected = (low <= apart) & (apart <= high)
    clear = (np.abs(apart - low) > 1e-9) & (np.abs(apart - high) > 1e-9)
    assert np.array_equal(alikeness(real, build_tunnel(sim), k, 1.0).alike[clear], expected[clear])


@given(trials(holes=True), factors, factors, st.booleans())
def test_a_simulation_equal_to_reality_is_alike_everywhere(t, k_real, k_sim, smoothed):
    tunnel = smooth(build_tunnel(t)) if smoothed else build_tunnel(t)
    assume((tunnel.seen > 0).all(axis=1).any())
    result = alikeness(tunnel, tunnel, k_real, k_sim)
    assert result.joint == 1
    assert all(share == 1 for share in result.shares.values())


@given(trials(holes=False), st.data())
def test_each_real_trial_is_alike_to_the_tunnel_it_helped_to_make(t, data):
    i = data.draw(st.integers(0, t.count - 1))
    assert alikeness(build_tunnel(t), build_tunnel(make_trials(t.values[i : i + 1]))).joint == 1


@given(pairs(), st.lists(factors, min_size=2, max_size=6))
def test_k_is_monotone(pair, ks):
    results = alikeness_over_k(*tunnels(pair), sorted(ks))
    for narrow, wide in itertools.pairwise(results):
        assert np.all(wide.alike | ~narrow.alike)
        assert wide.joint >= narrow.joint


@given(pairs(holes=True), factors, factors)
def test_swapping_the_sides_with_their_factors_changes_nothing(pair, k_real, k_sim):
    real, sim = tunnels(pair)
    there, back = alikeness(real, sim, k_real, k_sim), alikeness(sim, real, k_sim, k_real)
    assert np.array_equal(there.alike, back.alike)
    assert np.array_equal(there.seen, back.seen)


@given(pairs(), factors, st.randoms(use_true_random=False))
def test_the_order_of_the_trials_changes_nothing(pair, k, random):
    order = list(range(pair[0].count))
    random.shuffle(order)
    shuffled = make_trials(pair[0].values[order]), pair[1]
    assert np.array_equal(alikeness(*tunnels(pair), k).alike, alikeness(*tunnels(shuffled), k).alike)


@given(pairs(), st.sampled_from([0.001, 0.3, 7.0, -2.0]), st.floats(-50, 50), factors)
def test_scaling_and_shifting_both_sides_changes_nothing(pair, factor, shift, k):
    """Another unit or another zero gives the same alikeness, away from exact ties."""
    moved = tuple(make_trials(t.values * factor + shift) for t in pair)
    literal = [literal_tunnel(t.values) for t in pair]
    before, after = alikeness(*tunnels(pair), k), alikeness(*tunnels(moved), k)
    for n in range(before.alike.shape[0]):
        for j in range(before.alike.shape[1]):
            if abs(literal_margin(literal[0][n][j], literal[1][n][j], k, 1.0)) > 1e-6:
                assert before.alike[n, j] == after.alike[n, j]


@given(st.floats(-100, 100), st.floats(0, 100))
def test_rounding_alone_never_separates_a_mean_from_its_own_value(value, width):
    """Two trials, width above and below: their mean is the value, but for the last bits."""
    real, sim = build_tunnel(column([value - width], [value + width])), build_tunnel(column([value]))
    assert alikeness(real, sim, k_real=0).joint == 1


def test_a_mean_that_rounding_moved_is_still_alike():
    real = build_tunnel(column([0.1], [0.2], [0.3]))
    assert real.mean[0, 0] != 0.2  # 0.20000000000000004
    assert alikeness(real, build_tunnel(column([0.2])), k_real=0).joint == 1


def test_a_difference_that_a_sensor_can_see_is_never_taken_for_rounding():
    real, sim = build_tunnel(column([1.0] * 3)), build_tunnel(column([1.0, 1.0 + 1e-12, 1.0 - 1e-12]))
    assert alikeness(real, sim, 5, 5).alike[:, 0].tolist() == [True, False, False]


@pytest.mark.parametrize("k", [-1.0, math.nan, math.inf])
def test_a_senseless_factor_is_refused(k):
    tunnel = build_tunnel(column([0.0]))
    with pytest.raises(InputError, match="k_real"):
        alikeness(tunnel, tunnel, k_real=k)
    with pytest.raises(InputError, match="k_sim"):
        alikeness(tunnel, tunnel, k_sim=k)


def test_other_signals_units_or_times_are_refused():
    a = build_tunnel(make_trials(np.zeros((1, 4, 1))))
    with pytest.raises(InputError, match="same signals"):
        alikeness(a, build_tunnel(make_trials(np.zeros((1, 4, 2)))))
    with pytest.raises(InputError, match="same units"):
        alikeness(a, build_tunnel(make_trials(np.zeros((1, 4, 1)), unit="m")))
    with pytest.raises(InputError, match=r"real has 4 samples from 0 to 0\.03 s, simulation 5 samples"):
        alikeness(a, build_tunnel(make_trials(np.zeros((1, 5, 1)))))


def test_the_rig_against_itself_is_each_trial_in_the_tunnel_of_the_others():
    values = np.zeros((4, 3, 1))
    values[:, 0, 0] = [0, 1, 2, 3]  # trials 0 and 3 are outside what the others span, whatever k = 1
    values[:, 1, 0] = [5, 5, 5, 5]
    values[:, 2, 0] = [0, 0, 0, 1]  # the others of trial 3 have no width
    (one,) = rig_against_itself(make_trials(values), (1.0,), smoothed=False)
    assert one.k_real == 1
    assert one.shares["a"] == pytest.approx(np.mean([2 / 3, 1, 1, 1 / 3]))
    assert one.joint == one.shares["a"]


def test_jointly_the_rig_against_itself_is_no_better_than_in_any_signal():
    values = np.random.default_rng(2).normal(size=(5, 400, 3))
    found = rig_against_itself(make_trials(values), (1.0, 2.0), smoothed=False)
    for one in found:
        assert one.joint < min(one.shares.values())
    # A further draw lies between the extremes of four others three times in five.
    assert found[0].shares["b"] == pytest.approx(0.6, abs=0.05)
    assert found[0].joint < found[1].joint


@given(trials(max_p=5, holes=True))
def test_a_tunnel_of_one_or_two_trials_tells_nothing_of_the_rig_itself(some):
    assert bool(rig_against_itself(some, (1.0,))) == (some.count > 2)
