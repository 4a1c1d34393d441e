# SPDX-License-Identifier: Apache-2.0
"""Real and simulated trials compared: the laws of error.py and compare.py."""

import json
import math

import numpy as np
import pytest
from hypothesis import given
from tunnel_cases import make_trials, pairs, trials

from eps_tunnel_analysis.compare import compare
from eps_tunnel_analysis.error import command_error, signal_errors
from labyrinth_sim.errors import InputError


def test_equation_10_by_hand():
    real, sim = np.array([0.0, 1.0, 2.0, 3.0]), np.array([0.0, 2.0, 0.0, 3.0])
    step, total = 0.01, 0.04
    assert command_error(real, sim) == pytest.approx((1 + 2) * step / total)
    assert command_error(real, np.array([0, math.nan, 0, 3])) == pytest.approx(2 * step / (3 * step))
    assert math.isnan(command_error(real, np.full(4, math.nan)))


def test_errors_by_hand():
    real = make_trials([[[0.0], [1.0], [0.0]], [[0.0], [3.0], [0.0]]])  # mean 0, 2, 0
    sim = make_trials([[[1.0], [0.0], [1.0]]])
    (e,) = signal_errors(real, sim)
    assert e.command_error == pytest.approx(4 / 3)
    assert e.rms == pytest.approx(math.sqrt(2))
    assert e.bias == 0
    assert e.worst == 2
    assert e.worst_time == 0.01
    assert e.range == 2
    assert e.samples == 3
    assert e.repeat_rms == pytest.approx(math.sqrt(2 / 3))  # squares 1 + 1, three degrees of freedom


def test_one_trial_knows_no_repeatability():
    assert math.isnan(signal_errors(make_trials(np.zeros((1, 4, 1))), make_trials(np.zeros((1, 4, 1))))[0].repeat_rms)


@given(pairs(holes=True))
def test_errors_keep_their_order(pair):
    for e in signal_errors(*pair):
        if e.samples:
            assert abs(e.bias) <= e.command_error * (1 + 1e-9) + 1e-12
            assert e.command_error <= e.rms * (1 + 1e-9) + 1e-12
            assert e.rms <= e.worst * (1 + 1e-9) + 1e-12


@given(trials())
def test_a_simulation_equal_to_reality_is_alike_and_without_error(t):
    c = compare(t, t)
    assert all(a.joint == 1 for a in c.alikeness)
    assert all(e.worst == 0 for e in c.errors)
    assert c.spans == ()


@given(pairs(holes=True))
def test_everything_becomes_json_without_nan(pair):
    content = compare(*pair).to_json()
    assert json.loads(json.dumps(content, allow_nan=False)) == content


def test_factors_are_sorted_and_told_once():
    t = make_trials(np.zeros((2, 5, 1)))
    assert [a.k_real for a in compare(t, t, ks=(3, 1, 3, 2)).alikeness] == [1, 2, 3]


def test_signals_of_one_side_are_left_out_and_told():
    real, sim = make_trials(np.zeros((2, 5, 2))), make_trials(np.zeros((2, 5, 3)))
    c = compare(real, sim)
    assert c.signals == ("a", "b")
    assert "c (simulation only)" in c.notes[0]
    assert compare(real, sim, signals=["b"]).signals == ("b",)
    with pytest.raises(InputError, match=r"Unknown signal 'c'.*Available signal names: a, b"):
        compare(real, sim, signals=["c"])


def test_a_short_tail_is_cut_and_told_a_long_one_refused():
    real = make_trials(np.zeros((2, 130, 1)))
    c = compare(real, make_trials(np.zeros((1, 120, 1))))
    assert len(c.real.time) == 120
    assert "last 0.10 s" in " ".join(c.notes)
    with pytest.raises(InputError, match=r"real ends at 1\.29 s, simulation at 0\.09 s"):
        compare(real, make_trials(np.zeros((1, 10, 1))))


def test_another_step_or_unit_is_refused():
    real = make_trials(np.zeros((2, 50, 1)))
    with pytest.raises(InputError, match=r"real has 0\.01 s, simulation 0\.02 s"):
        compare(real, make_trials(np.zeros((1, 50, 1)), step=0.02))
    with pytest.raises(InputError, match=r"a \(rad, m\)"):
        compare(real, make_trials(np.zeros((1, 50, 1)), unit="m"))


def test_one_real_trial_is_told():
    t = make_trials(np.zeros((1, 5, 1)))
    assert "Only one real trial" in " ".join(compare(t, t).notes)
