# SPDX-License-Identifier: Apache-2.0
"""Laws of the side-by-side descent."""

import numpy as np
import pytest

from eps_tunnel_analysis.fit import lockstep
from eps_tunnel_analysis.fit.lockstep import Race, descend

TIME = np.linspace(0.0, 2.0, 300)


def response(z):
    """(n, 3) -> (n, T): amplitude, decay and an offset."""
    return z[:, :1] * np.exp(-4.0 * z[:, 1:2] * TIME) + 0.2 * z[:, 2:3]


TRUTH = np.array([0.7, 0.3, 0.5])
MEASURED = response(TRUTH[None])[0]


def residuals(z, owners):
    return response(z) - MEASURED


def test_every_problem_reaches_the_truth_when_all_is_free() -> None:
    starts = np.random.default_rng(0).random((5, 3))
    found = descend(residuals, starts, np.ones((5, 3), bool), rounds=30, tolerance=1e-12)
    assert np.allclose(found.z, TRUTH, atol=1e-4)


def test_what_is_not_free_stays() -> None:
    starts = np.full((2, 3), 0.4)
    free = np.array([[True, True, False], [True, False, False]])
    found = descend(residuals, starts, free, rounds=20)
    assert (found.z[~free] == 0.4).all()
    assert found.cost[0] < found.cost[1]


def test_a_problem_does_not_depend_on_its_neighbours() -> None:
    starts = np.random.default_rng(1).random((4, 3))
    free = np.ones((4, 3), bool)
    together = descend(residuals, starts, free)
    for b in range(4):
        alone = descend(residuals, starts[b : b + 1], free[:1])
        assert np.array_equal(alone.z[0], together.z[b])


def test_bounds_hold_and_a_truth_beyond_them_ends_at_the_bound() -> None:
    outside = response(np.array([[1.3, 0.3, 0.5]]))[0]
    found = descend(lambda z, o: response(z) - outside, np.full((1, 3), 0.5), np.ones((1, 3), bool), rounds=30)
    assert (found.z >= 0).all()
    assert (found.z <= 1).all()
    assert found.z[0, 0] == 1.0


def test_a_value_reaches_a_truth_far_beyond_its_span_within_a_wider_box() -> None:
    outside = response(np.array([[4.3, 0.3, 0.5]]))[0]
    found = descend(
        lambda z, o: response(z) - outside, np.full((1, 3), 0.5), np.ones((1, 3), bool), 60, tolerance=1e-12,
        width=np.array([5.0, 1.0, 1.0]),
    )  # fmt: skip
    assert np.allclose(found.z, [4.3, 0.3, 0.5], atol=1e-3)


def test_at_a_minimum_a_descent_rests_at_once() -> None:
    """No damping promises more than none: where the slopes promise nothing, none other is tried."""
    above = np.random.default_rng(2).standard_normal(len(TIME))

    def never_met(z, owners):
        return response(z) - MEASURED - above

    free = np.ones((1, 3), bool)
    lowest = descend(never_met, np.full((1, 3), 0.4), free, rounds=60, tolerance=1e-12)
    again = descend(never_met, lowest.z, free, rounds=60)
    assert again.converged[0] and np.array_equal(again.z, lowest.z)
    slopes, dampings = 3, len(lockstep.DAMPINGS)
    assert again.evaluations == 1 + slopes + dampings


def test_a_diverged_neighbourhood_does_not_poison_the_rest() -> None:
    def partly(z, owners):
        answer = residuals(z, owners)
        answer[owners == 1] = np.nan
        return answer

    found = descend(partly, np.full((2, 3), 0.4), np.ones((2, 3), bool), rounds=30, tolerance=1e-12)
    assert np.allclose(found.z[0], TRUTH, atol=1e-4)
    assert np.isinf(found.cost[1])
    assert not found.converged[1]


def test_of_problems_that_meet_only_the_best_goes_on() -> None:
    starts = np.array([[0.6, 0.4, 0.5], [0.1, 0.9, 0.1], [0.1, 0.9, 0.1]])
    free = np.array([[True, True, True], [True, True, True], [True, True, False]])
    rows: list[int] = []

    def counted(z, owners):
        rows.extend(owners.tolist())
        return 30.0 * residuals(z, owners)

    apart = descend(counted, starts, free, rounds=30, tolerance=1e-12)
    alone = [rows.count(b) for b in range(3)]
    rows.clear()
    met = descend(counted, starts, free, rounds=30, tolerance=1e-12, near=0.1)
    assert met.cost.min() == apart.cost.min() < 1e-12
    assert sorted(rows.count(b) < alone[b] for b in range(2)) == [False, True]
    assert rows.count(2) == alone[2]  # it moves other values, so it is another model


def test_hopeless_problems_are_stopped_early() -> None:
    starts = np.vstack([np.full(3, 0.6), np.full(3, 0.1)])
    asked = []

    def counted(z, owners):
        asked.append(set(owners.tolist()))
        return residuals(z, owners)

    descend(counted, starts, np.ones((2, 3), bool), rounds=10, hopeless=lambda cost: np.array([False, True]))
    assert [1 in owners for owners in asked[:3]] == [True] * 3  # the start and one round of two batches
    assert len(asked) > 3
    assert all(1 not in owners for owners in asked[3:])


def test_what_a_bound_holds_back_the_others_make_up_for_at_once() -> None:
    """Two values that do almost the same, and the first ought to go beyond its bound."""
    slopes = np.array([[1.0, 1.0], [1.0, 1.05]])
    target = slopes @ np.array([1.5, 0.2])
    second = np.linalg.lstsq(slopes[:, 1:], target - slopes[:, 0], rcond=None)[0][0]
    found = descend(lambda z, o: z @ slopes.T - target, np.array([[0.5, 0.5]]), np.ones((1, 2), bool), 2, tolerance=0.0)
    assert found.z[0] == pytest.approx([1.0, second], abs=1e-3)


def test_cheap_slopes_lead_to_the_same_place_and_dear_ones_take_over_where_they_do_not() -> None:
    def off(z, owners):
        return 0.9 * response(z * np.array([1.0, 1.1, 1.0])) + 7.0

    def backwards(z, owners):
        return -residuals(z, owners)

    starts, free = np.full((1, 3), 0.4), np.ones((1, 3), bool)
    asked = []

    def counted(z, owners):
        asked.append(len(z))
        return residuals(z, owners)

    for cheap in (off, backwards):
        found = descend(counted, starts, free, rounds=40, tolerance=1e-12, slopes=cheap)
        assert np.allclose(found.z, TRUTH, atol=1e-3)
    asked.clear()
    descend(counted, starts, free, rounds=3, tolerance=1e-12, slopes=off)
    assert asked == [1, 3, 3, 3]  # the start, and the steps that are tried


@pytest.mark.parametrize("share", [10.0, 0.0])  # steps far too short, and none
def test_a_problem_that_is_to_be_certain_takes_its_own_slopes_once_cheap_ones_mislead_it(share: float) -> None:
    def mislead(z, owners):
        return share * response(z)

    starts, free = np.full((1, 3), 0.4), np.ones((1, 3), bool)

    def left(certain: bool) -> float:
        return float(descend(residuals, starts, free, rounds=8, slopes=mislead, certain=certain).cost[0])

    assert left(certain=True) < 1e-6 * left(certain=False)


def test_a_slope_that_is_rough_close_by_is_taken_from_further_away(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = np.random.default_rng(0)
    directions, target = drawn.standard_normal((60, 3)), np.array([0.3, 0.6, 0.5])
    waves, phases = 400.0 * drawn.standard_normal((60, 3)), drawn.uniform(0.0, 2.0 * np.pi, 60)

    def rough(z, owners):
        return 30.0 * (z - target) @ directions.T + np.sin(z @ waves.T + phases)

    def end() -> float:
        return float(descend(rough, np.full((4, 3), 0.8), np.ones((4, 3), bool), 20, response=0.5).cost.max())

    seen = end()
    monkeypatch.setattr(lockstep, "WIDER", 1.0)
    assert seen < 1.0 and end() > 2.0 * seen


def test_a_descent_far_behind_the_others_or_what_is_known_is_given_up_after_the_first_rounds() -> None:
    costs = np.array([2.0, 3.3, 6.3])
    race, known = Race(2, 3.0), Race(2, 3.0, 1.0)
    assert not race(costs).any()
    assert not known(costs).any()
    assert list(race(costs)) == [False, False, True]
    assert list(known(costs)) == [False, True, True]
