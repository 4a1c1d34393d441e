# SPDX-License-Identifier: Apache-2.0
"""Laws of the optimisers, on a servo step whose answer is known in closed form."""

import struct
from pathlib import Path

import numpy as np
import pytest

from eps_tunnel_analysis.fit.differences import jacobian, moved
from eps_tunnel_analysis.fit.evaluations import Evaluations, Journal
from eps_tunnel_analysis.fit.intervals import combination, intervals
from eps_tunnel_analysis.fit.methods import CmaEs, EvolutionStrategy, GaussNewton
from eps_tunnel_analysis.fit.problem import CommandError, Dissimilarity, Problem
from labyrinth_sim.errors import InputError

TIME = np.arange(200) * 0.01
TRUE = np.array([0.8, 0.15, 0.03])  # gain, time constant s, delay s
LOW, HIGH = np.array([0.0, 0.01, 0.0]), np.array([2.0, 0.6, 0.1])


def step_response(values):
    """(n, 3) gain, time constant, delay -> (n, T)."""
    gain, constant, delay = (values[:, i, None] for i in range(3))
    return gain * (1.0 - np.exp(-np.maximum(TIME - delay, 0.0) / constant))


def problem(measured=None, fitness=None, start=(0.2, 0.5, 0.09)) -> Problem:
    measured = step_response(TRUE[None])[0] if measured is None else measured
    return Problem(
        names=("gain", "constant", "delay"),
        units=("1", "s", "s"),
        low=LOW,
        high=HIGH,
        start=np.array(start),
        residuals=lambda values: np.asfortranarray(step_response(values) - measured),  # as the simulator's may lie
        fitness=fitness or CommandError(np.full(TIME.size, 1.0 / TIME.size)),
        blocks=np.zeros(TIME.size),
    )


METHODS = [
    EvolutionStrategy(generations=60),
    CmaEs(budget=1500),
    GaussNewton(),
]


@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.name)
def test_a_known_truth_is_recovered(method) -> None:
    evaluations = Evaluations(problem())
    method.run(evaluations, np.random.default_rng(1))
    assert np.allclose(evaluations.problem.from_unit(evaluations.best), TRUE, rtol=0.02, atol=1e-3)


@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.name)
def test_the_same_seed_gives_the_same_answer(method) -> None:
    results = []
    for _ in range(2):
        evaluations = Evaluations(problem())
        method.run(evaluations, np.random.default_rng(3))
        results.append((evaluations.count, evaluations.best_fitness, *evaluations.best))
    assert results[0] == results[1]


def test_the_strategy_of_the_paper_takes_15001_evaluations() -> None:
    assert EvolutionStrategy().budget == 15001
    evaluations = Evaluations(problem())
    short = EvolutionStrategy(generations=3)
    short.run(evaluations, np.random.default_rng(0))
    assert evaluations.count == short.budget == 301


@pytest.mark.parametrize("lost", [0, 3, 40])
@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.name)
def test_a_run_cut_off_resumes_to_the_same_answer(method, lost, tmp_path: Path) -> None:
    whole = Evaluations(problem())
    method.run(whole, np.random.default_rng(5))

    class Cut(Exception):
        pass

    def stop(count: int, _: float) -> None:
        if count > whole.count // 2:
            raise Cut

    path = tmp_path / "fit.journal"
    with Journal(path, "a") as journal, pytest.raises(Cut):
        method.run(Evaluations(problem(), journal, stop), np.random.default_rng(5))
    whole_file = path.read_bytes()
    path.write_bytes(whole_file[: len(whole_file) - lost])  # the crash came in the middle of a record
    asked = []
    base = problem()

    def counted(values):
        asked.append(len(values))
        return base.residuals(values)

    again_problem = Problem(**{**base.__dict__, "residuals": counted})
    with Journal(path, "a") as journal:
        again = Evaluations(again_problem, journal)
        method.run(again, np.random.default_rng(5))
    assert (again.count, again.best_fitness) == (whole.count, whole.best_fitness)
    assert np.array_equal(again.best, whole.best)
    assert sum(asked) < 0.6 * whole.count


def test_a_journal_that_broke_off_before_its_first_answer_is_begun_anew(tmp_path: Path) -> None:
    Journal(tmp_path / "j", "seed 1").close()
    head = (tmp_path / "j").read_bytes()
    for size in (0, 5, len(head) - 1):
        (tmp_path / "j").write_bytes(head[:size])
        Journal(tmp_path / "j", "seed 1").close()
        assert (tmp_path / "j").read_bytes() == head


def test_a_torn_tail_is_no_answer(tmp_path: Path) -> None:
    asked, answer = np.ones((1, 2)), np.full((1, 3), 0.5)
    with Journal(tmp_path / "j", "seed 1") as journal:
        journal.add(asked, answer)
    head = (tmp_path / "j").read_bytes()
    with Journal(tmp_path / "j", "seed 1") as journal:
        assert np.array_equal(journal.recall(asked), answer)
        journal.add(2 * asked, answer)
    whole = (tmp_path / "j").read_bytes()
    record = whole[len(head) :]
    half, minus, zeros = len(record) // 2, struct.pack("<q", -1), bytes(len(record))
    for tail in (record[:half], record[:half] + zeros[half:], zeros, record[:16] + minus + record[24:], b"junk" * 20):
        (tmp_path / "j").write_bytes(head + tail)
        with Journal(tmp_path / "j", "seed 1") as journal:
            assert np.array_equal(journal.recall(asked), answer)
            assert journal.recall(2 * asked) is None
            journal.add(2 * asked, answer)
        assert (tmp_path / "j").read_bytes() == whole


def test_a_journal_of_another_run_is_refused(tmp_path: Path) -> None:
    Journal(tmp_path / "j", "seed 1").close()
    with pytest.raises(InputError, match="another run"):
        Journal(tmp_path / "j", "seed 2")


def test_a_diverged_rollout_loses_and_the_rest_go_on() -> None:
    base = problem()

    def sometimes_nan(values):
        residuals = base.residuals(values)
        residuals[values[:, 1] > 0.4] = np.nan
        return residuals

    evaluations = Evaluations(Problem(**{**base.__dict__, "residuals": sometimes_nan}))
    GaussNewton().run(evaluations, np.random.default_rng(0))
    assert np.allclose(evaluations.problem.from_unit(evaluations.best), TRUE, rtol=0.02, atol=1e-3)


def test_bad_bounds_are_all_told_at_once() -> None:
    with pytest.raises(InputError) as caught:
        Problem(**{**problem().__dict__, "start": np.array([5.0, 5.0, 0.0])})
    assert len(caught.value.complaints) == 2


def test_no_rounding_leads_out_of_the_bounds() -> None:
    rng = np.random.default_rng(0)
    low, high = -np.sort(rng.uniform(0.01, 10.0, (2, 500)), axis=0)[::-1]
    names = tuple(str(i) for i in range(500))
    many = Problem(**{**problem().__dict__, "names": names, "units": names, "low": low, "high": high, "start": high})
    assert (many.from_unit(np.ones(500)) <= high).all() and (many.from_unit(np.zeros(500)) >= low).all()
    assert (low + (high - low) > high).any(), "rounding alone does"


def test_dissimilarity_is_lowest_at_the_truth_and_slopes_towards_it() -> None:
    fitness = Dissimilarity(np.full(TIME.size, 0.01), np.full(TIME.size, 0.01))
    gains = np.linspace(0.8, 1.6, 9)
    values = np.column_stack([gains, np.full(9, 0.15), np.full(9, 0.03)])
    assert (np.diff(fitness(problem().residuals(values))) > 0).all()


def test_intervals_cover_under_correlated_noise_where_the_textbook_fails() -> None:
    rng = np.random.default_rng(7)
    time = np.arange(400) * 0.01
    jac = np.column_stack([np.ones_like(time), np.sin(2 * np.pi * 0.5 * time)])
    truth = np.array([0.3, 0.7])
    covered = textbook = 0
    runs = 200
    for _ in range(runs):
        noise = np.zeros(time.size)
        for i in range(1, time.size):
            noise[i] = 0.9 * noise[i - 1] + 0.1 * rng.standard_normal()
        fitted, *_ = np.linalg.lstsq(jac, jac @ truth + noise, rcond=None)
        residuals = jac @ fitted - (jac @ truth + noise)
        covered += abs(fitted[0] - truth[0]) <= intervals(jac, residuals, np.zeros(time.size)).half_width[0]
        naive = 1.96 * residuals.std() / np.sqrt(time.size)
        textbook += abs(fitted[0] - truth[0]) <= naive
    assert 0.85 <= covered / runs <= 0.99
    assert textbook / runs < 0.6


def test_a_trade_off_is_told_as_a_combination() -> None:
    rng = np.random.default_rng(0)
    one = rng.standard_normal(300)
    jac = np.column_stack([one, one, rng.standard_normal(300)])
    found = intervals(jac, 0.01 * rng.standard_normal(300), np.zeros(300))
    assert len(found.loose) == 1
    text = combination(found.loose[0], ("p", "d", "delay"))
    assert "0.71 p" in text
    assert "0.71 d" in text
    assert "delay" not in text


def test_jacobian_is_the_difference_quotient() -> None:
    assert np.allclose(jacobian(np.zeros(3), np.array([[1.0, 2, 3]]), np.array([0.5])), [[2.0], [4], [6]])


def test_points_of_a_jacobian_stay_in_the_box() -> None:
    points, steps = moved(np.array([0.5, 1.0, 0.2]), np.array([0.1, 0.2, 0.3]), np.array([1, 2]))
    assert np.allclose(points, [[0.5, 0.8, 0.2], [0.5, 1.0, 0.5]])
    assert np.allclose(steps, [-0.2, 0.3])
