# SPDX-License-Identifier: Apache-2.0
"""Evidence and refits on short plays of the labyrinth: laws that need roll-outs."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from fit_cases import FREE, made_by, part_search, plays, refit, start
from fit_cases import WHOLE_DELAY as TRUTH

from eps_tunnel_analysis.diagnose import base_values as base_values_module
from eps_tunnel_analysis.diagnose import named_intervals as intervals_module
from eps_tunnel_analysis.diagnose.axes import with_refits
from eps_tunnel_analysis.diagnose.axis import AxisDiagnosis
from eps_tunnel_analysis.diagnose.base_values import along_valley, base_from, better_base
from eps_tunnel_analysis.diagnose.command_response import command_response, on_commands
from eps_tunnel_analysis.diagnose.contained import nested_refits
from eps_tunnel_analysis.diagnose.evidence import Evidence, Residuals, play_evidence
from eps_tunnel_analysis.diagnose.experiment import menu, was_played
from eps_tunnel_analysis.diagnose.named_intervals import named_intervals
from eps_tunnel_analysis.diagnose.rank import worst_floors
from eps_tunnel_analysis.diagnose.refits import Job, Refit
from eps_tunnel_analysis.diagnose.roll_outs import STANDS
from eps_tunnel_analysis.diagnose.search import Search
from eps_tunnel_analysis.diagnose.sets import begun, next_refits, refined, rival_refits, stated_jobs, tick_refits
from eps_tunnel_analysis.diagnose.ticks import tick_points
from eps_tunnel_analysis.diagnose.waves import PERIODS_TRIED, likely_waves
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.stamped import StampedTrial, stamped_from_grid
from labyrinth_sim.trials import Trials

SIGNALS = ("motor_x", "board_x")
FRICTIONS = ("load_friction", "directional_load_friction")  # the second contains the first


@pytest.fixture(scope="module")
def recorded() -> list[Play]:
    return plays((3.0, -2.0), TRUTH)


def evidence_of(recorded: list[Play], step: float = 0.002) -> Evidence:
    model = start().with_values(TRUTH)
    return Evidence(model, FREE, [play_evidence(model, p, SIGNALS) for p in recorded], SIGNALS, step, 1)


def misfit(evidence: Evidence, **moved: float) -> float:
    values = {**TRUTH, **{name.replace("_", "."): value for name, value in moved.items()}}
    return float(np.mean((evidence(np.array(list(values.values()))) / evidence.floor) ** 2))


def test_the_model_that_made_the_trials_leaves_the_noise_and_another_leaves_more(recorded: list[Play]) -> None:
    evidence = evidence_of(recorded)
    assert 0.4 < misfit(evidence) < 2.0
    assert misfit(evidence, drive_x_p=15.0) > 5.0
    assert misfit(evidence, drive_x_delay=0.036) > 5.0


def test_the_order_of_the_trials_does_not_matter(recorded: list[Play]) -> None:
    def turned(trials: Trials) -> Trials:
        return replace(trials, values=trials.values[::-1], commands=trials.commands[::-1])

    one, other = evidence_of(recorded), evidence_of([replace(p, trials=turned(p.trials)) for p in recorded])
    assert other.mean == pytest.approx(one.mean, abs=1e-12)
    assert other.floor == pytest.approx(one.floor, rel=1e-9)
    assert misfit(other) == pytest.approx(misfit(one), rel=1e-6)


def test_what_is_derived_from_evidence_rolls_out_as_widely_as_it_does(recorded: list[Play]) -> None:
    model, calls = start().with_values(TRUTH), []

    def spread(alone: Residuals) -> Residuals:
        def elsewhere(table: np.ndarray) -> np.ndarray:
            calls.append(len(table))
            return alone(table)

        return elsewhere

    seen = [play_evidence(model, p, SIGNALS) for p in recorded]
    evidence = Evidence(model, FREE, seen, SIGNALS, 0.005, 1, spread)
    truth = np.array([list(TRUTH.values())] * 2)
    here = evidence(truth)
    others = (evidence.less(0.0 * here[0]), evidence.of(model), evidence.started([{}, {}]), evidence.finer())
    for number, other in enumerate(others, start=1):
        assert other.nthread == 1
        there = other(truth)
        assert len(calls) == number + 1, "it was rolled out on this machine alone"
        assert np.array_equal(there, here) or number == len(others)
    sent = others[0].__getstate__()
    assert (sent["nthread"], sent["spread"]) == (0, None)  # a worker has its own cores, and shares with nobody


def test_a_command_that_was_recorded_is_known_as_such(recorded: list[Play]) -> None:
    offered = menu(start(), "x")
    command = offered["steps_x_40"]
    time, targets = command.sample(100.0)
    late = np.maximum(np.arange(len(time)) - 1, 0)  # a sample late, as a player may be
    played = Play("steps", made_by(start(), targets[late]))
    evidence = evidence_of([*recorded, played])
    assert [name for name, other in offered.items() if was_played(evidence, other)] == ["steps_x_40"]
    assert not was_played(evidence_of(recorded), command)


def test_trials_on_clocks_of_their_own_say_the_same(recorded: list[Play]) -> None:
    def late(play: Play) -> Play:
        moved: list[StampedTrial] = [
            trial.shifted(by) for trial, by in zip(stamped_from_grid(play.trials), (0.004, -0.003, -0.001), strict=True)
        ]
        return replace(play, stamped=tuple(moved))

    even, uneven = evidence_of(recorded), evidence_of([late(p) for p in recorded])
    assert misfit(uneven) == pytest.approx(misfit(even), rel=0.05)


def test_stretches_of_time_are_the_same_for_all_signals_of_a_play(recorded: list[Play]) -> None:
    evidence = evidence_of(recorded)
    folds = evidence.fold(0.2)
    assert len(np.unique(folds)) == 2 * 3
    for block in np.unique(evidence.blocks):
        assert (np.diff(folds[evidence.blocks == block]) >= 0).all()
    motor, board = (folds[evidence.blocks == block] for block in (0, 1))
    assert np.array_equal(motor, board)
    assert not set(folds[evidence.blocks < 2]) & set(folds[evidence.blocks >= 2])


# ---- what is stated


def test_a_base_that_lies_at_its_bound_leaves_the_rest_to_an_effect(recorded: list[Play]) -> None:
    model = start().with_values({**TRUTH, "drive.x.delay": 0.02})  # of 0.03
    search = part_search(model, recorded, ("command_delay", "sensor_bias"))
    delay = np.array(search.library.names) == "drive.x.delay"
    search.high = np.where(delay, 0.02, search.high)
    search.firmness = np.where(delay, 0.0, 1.0)
    search = search.as_stated()
    base = search.at(search.start, refit(search, (), 1.0))
    late, biased = (
        min(p.promised for p in search.trial_points([base], [search.library.find(name)]))
        for name in ("command_delay.x", "sensor_bias.board_x")
    )
    assert late < 0.7 * biased


def test_effects_are_tried_beside_values_as_stated_where_the_base_strays_from_them(recorded: list[Play]) -> None:
    model = start().with_values(TRUTH).with_effect("viscous_friction", "x", {"damping": 0.05}, "data sheet")
    search = part_search(model, recorded, ("command_delay", "sensor_bias"))
    column = search.library.base.index("viscous_friction.x.damping")
    assert stated_jobs(search, refit(search, (), 1.0)) == []
    strayed = search.start.copy()
    strayed[column] *= 3.0
    jobs = stated_jobs(search, replace(refit(search, (), 1.0), values=strayed))
    assert jobs
    assert all(values[column] == search.start[column] for _, values in jobs)


def test_a_direction_that_moves_only_some_values_leads_along_the_valley(
    recorded: list[Play], monkeypatch: pytest.MonkeyPatch
) -> None:
    search = part_search(start().with_values(TRUTH), recorded)
    here = refit(search, (), 1.0)
    free = search.fitted(here)[: len(search.library.base) - search.library.rough]
    here.values[free[0]] = search.low[free[0]]  # rests at its bound, and has no part in the direction
    slopes = np.zeros((len(search.used), len(search.fitted(here))))
    slopes[: len(free), : len(free)] = np.diag([2.0] * (len(free) - 1) + [1.0])
    monkeypatch.setattr(search, "jacobian", lambda _: slopes)
    for point in along_valley(search, here):
        assert np.all((search.low <= point) & (point <= search.high))
        assert np.flatnonzero(point != here.values).tolist() == [free[-1]]


# ---- sets that contain others


@pytest.fixture
def search(recorded: list[Play]) -> Search:
    return part_search(start().with_values(TRUTH), recorded, FRICTIONS)


@pytest.mark.parametrize(
    ("smaller", "larger", "worse"),
    [
        ((), ("load_friction.x",), True),
        (("load_friction.x",), ("load_friction.x", "directional_load_friction.x"), True),
        (("load_friction.x",), ("directional_load_friction.x",), True),  # the effect itself contains it
        (("directional_load_friction.x",), ("load_friction.x",), False),
    ],
)
def test_a_set_that_fits_worse_than_one_it_contains_has_not_converged(
    search: Search, monkeypatch: pytest.MonkeyPatch, smaller: tuple[str, ...], larger: tuple[str, ...], worse: bool
) -> None:
    monkeypatch.setattr(search, "judged", lambda jobs, rounds: [])  # no descent helps
    base = refit(search, (), 2.0 if not smaller else 9.0)
    _, found = nested_refits(search, base, [refit(search, e, c) for e, c in ((smaller, 2.0), (larger, 4.0)) if e])
    assert {r.effects: r.converged for r in found}[larger] is not worse
    _, near = nested_refits(search, base, [refit(search, e, c) for e, c in ((smaller, 2.0), (larger, 2.0)) if e])
    assert all(r.converged for r in near)


def test_an_effect_is_contained_only_without_what_the_other_one_cannot_do(
    search: Search, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(search, "judged", lambda jobs, rounds: [])
    narrow, wide = (search.library.find(name + ".x") for name in FRICTIONS)
    rows = tuple(row for row in wide.effect.contains if row[0] != "bearings")
    less = replace(wide, effect=replace(wide.effect, contains=rows))
    for own, bearings, converged in ((less, 0.0, False), (less, 0.0005, False), (less, 0.2, True), (wide, 0.2, False)):
        search.library = replace(search.library, candidates=(narrow, own))  # the second is off, within what shows
        smaller = refit(search, (narrow.name,), 2.0, share=0.1)
        smaller.values[search.columns(narrow)[1]] = bearings
        _, found = nested_refits(search, refit(search, (), 9.0), [smaller, refit(search, (wide.name,), 4.0)])
        assert {r.effects: r.converged for r in found}[(wide.name,)] is converged


def test_it_is_started_again_from_the_one_that_it_contains(search: Search) -> None:
    base = search.judged([((), search.start)], 2)[0]
    stuck = refit(search, ("load_friction.x",), 100.0 * base.cost, share=0.5)
    _, (found,) = nested_refits(search, base, [stuck])
    assert found.converged
    assert found.cost < 1.02 * base.cost


def test_a_set_is_tried_again_at_the_base_values_of_a_better_one_that_has_an_effect_more(
    search: Search, monkeypatch: pytest.MonkeyPatch
) -> None:
    search.library = replace(search.library, candidates=(*search.library.candidates[:2],))
    one, other = (c.name for c in search.library.candidates)
    jobs: list[Job] = []
    monkeypatch.setattr(search, "judged", lambda given, rounds: jobs.extend(given) or [])
    monkeypatch.setattr(search, "refit", lambda given, rounds: [refit(search, (), 2.0) for _ in given])
    stuck, both = refit(search, (one,), 4.0, share=0.3), refit(search, (one, other), 1.0)
    both.values[:] = 0.5 * (search.low + search.high)
    nested_refits(search, refit(search, (), 9.0), [stuck, both])
    fitted = {tuple(c.name for c in candidates): values for candidates, values in jobs}
    assert set(fitted) >= {(one,), (other,)}
    gone = search.columns(search.library.find(other))
    assert np.array_equal(fitted[(one,)][gone], search.start[gone])
    kept = np.setdiff1d(np.arange(len(search.start)), gone)
    assert np.array_equal(fitted[(one,)][kept], both.values[kept])


def test_a_set_that_leaves_far_more_without_one_of_its_effects_is_not_judged_without_it(
    search: Search, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = search.library.candidates[0].name
    judged: list[Job] = []
    monkeypatch.setattr(search, "judged", lambda given, rounds: judged.extend(given) or [])
    for left, many in ((4.0, 1), (6.0, 0)):
        judged.clear()
        monkeypatch.setattr(search, "refit", lambda given, rounds, left=left: [refit(search, (), left) for _ in given])
        nested_refits(search, refit(search, (), 9.0), [refit(search, (name,), 1.0)])
        assert [candidates for candidates, _ in judged].count(()) == many


def test_the_base_is_tried_again_at_the_values_that_it_has_beside_an_effect(search: Search) -> None:
    right = search.judged([((), search.start)], 2)[0]
    beside = refit(search, ("load_friction.x",), 1.1 * right.cost, share=0.01)
    beside.values[: len(search.library.base)] = right.values[: len(search.library.base)]
    base, _ = nested_refits(search, refit(search, (), 100.0 * right.cost), [beside])
    assert base.effects == ()
    assert base.cost < 1.02 * right.cost


@pytest.mark.parametrize("shorter", [False, True])
def test_where_the_base_needs_shorter_steps_all_of_its_valleys_are_judged_by_these(
    search: Search, monkeypatch: pytest.MonkeyPatch, shorter: bool
) -> None:
    valleys = [refit(search, (), 0.9, p=1.0), refit(search, (), 0.5, p=2.0)]
    judged: list[int] = []

    def judge(jobs: list[Job], rounds: int) -> list[Refit]:
        judged.append(len(jobs))
        return [next(r for r in valleys if np.array_equal(r.values, values)) for _, values in jobs]

    monkeypatch.setattr(base_values_module, "_in_valleys", lambda search, points, first: valleys)
    monkeypatch.setattr(search, "refine_at", lambda values: shorter)
    monkeypatch.setattr(search, "judged", judge)
    assert base_from(search, [r.values for r in valleys]) is valleys[shorter]
    assert judged == [1 + shorter]


@pytest.mark.parametrize(("best", "left", "again"), [(60.0, 100.0, True), (1.0, 100.0, False), (1.0, 50.0, True)])
def test_another_valley_of_a_hopeless_base_counts_only_if_it_is_deeper(
    search: Search, monkeypatch: pytest.MonkeyPatch, best: float, left: float, again: bool
) -> None:
    begun: list[int] = []
    base, elsewhere = refit(search, (), 100.0), refit(search, (), left)
    elsewhere.values[0] += 0.5 * search.spans[0]
    monkeypatch.setattr(search, "refit", lambda jobs, rounds, rough: [elsewhere for _ in jobs])
    monkeypatch.setattr(base_values_module, "base_from", lambda search, points: begun.append(len(points)) or elsewhere)
    better = better_base(search, base, [elsewhere.values], best)
    assert begun == ([1] if again else [])
    assert better is (elsewhere if again and left < base.cost else base)


def test_in_the_end_values_make_up_for_the_steps_that_the_model_makes(search: Search) -> None:
    truth = np.array([TRUTH.get(name, value) for name, value in zip(search.library.names, search.start, strict=True)])
    made = search.levels["own"](truth[None])[0]
    search.levels = {level: e.less(made) for level, e in search.levels.items()}  # it was this that made the trials
    limit = search.judged([((), truth)], 8)[0]
    run = search.as_run(limit)
    first, last = (np.mean(search.residuals(r.values[None], "own") ** 2) for r in (limit, run))
    assert last < 0.2 * first
    assert search.levels["own"].shortest == pytest.approx(0.002, rel=0.2)
    assert not search.levels["own"].extrapolate


@pytest.mark.parametrize(("gain", "nearest_first"), [(0.05, True), (0.15, False)])
def test_of_valleys_that_steps_cannot_tell_apart_the_nearest_counts_and_all_are_in_the_interval(
    recorded: list[Play], monkeypatch: pytest.MonkeyPatch, gain: float, nearest_first: bool
) -> None:
    model = start().with_values(TRUTH)
    search = part_search(model, recorded)
    here = search.judged([((), search.start)], 8)[0]
    p, delay = (search.library.names.index(f"drive.x.{name}") for name in ("p", "delay"))

    def elsewhere(column: int, by: float, more: float) -> Refit:
        values = here.values.copy()
        values[column] += by
        return replace(here, values=values, cost=here.objective + more, held=0.0)

    lower, beside, worse = elsewhere(p, 3.0, -gain), elsewhere(delay, -0.005, 0.04), elsewhere(delay, 0.015, 1.0)
    monkeypatch.setattr(search, "as_run", lambda _: here)
    monkeypatch.setattr(search, "refit", lambda *_, **__: [worse, beside, lower])
    monkeypatch.setattr(intervals_module, "_half_widths", lambda _, refit, columns: np.full(len(columns), 1e-4))
    monkeypatch.setattr(intervals_module, "chance", lambda *_: 0.0)
    first, second = (here, lower) if nearest_first else (lower, here)
    assert search.valleys(here) == (first, second, beside, worse)
    axis = cast(AxisDiagnosis, SimpleNamespace(search=search, part=search, acting=lambda _: here))
    final = with_refits(model, [axis], (), final=True)
    assert final.values()["drive.x.p"] == pytest.approx(first.values[p])
    found = named_intervals([axis], (), final)
    assert found["drive.x.p"][1] == pytest.approx(lower.values[p], abs=0.1) and found["drive.x.p"][1] > lower.values[p]
    assert (found["drive.x.p"][0] < here.values[p]) == nearest_first
    assert (found["drive.x.delay"][0] < beside.values[delay]) == nearest_first
    assert found["drive.x.delay"][1] < worse.values[delay] - 0.01


def test_other_valleys_are_looked_for_far_away_within_the_bounds(recorded: list[Play]) -> None:
    search = part_search(start().with_values(TRUTH), recorded)
    here = search.judged([((), search.start)], 8)[0]
    found = search.valleys(here)
    assert len(found) == 5 and search.valleys(here) is found
    assert all((search.low <= r.values).all() and (r.values <= search.high).all() for r in found)
    assert sorted(r.objective for r in found[1:]) == [r.objective for r in found[1:]]
    assert found[0].objective <= min(r.objective for r in found) + STANDS


def test_a_value_that_moves_nothing_may_be_anything(recorded: list[Play], monkeypatch: pytest.MonkeyPatch) -> None:
    model = start().with_values(TRUTH)
    search = part_search(model, recorded)
    here = search.judged([((), search.start)], 8)[0]
    column = search.fitted(here).index(search.library.names.index("drive.x.d"))
    slopes = 1e3 * np.random.default_rng(0).standard_normal(search.jacobian(here).shape)
    slopes[:, column] = 0.0
    monkeypatch.setattr(search, "valleys", lambda _: (here,))
    monkeypatch.setattr(search, "jacobian", lambda _: slopes)
    found = named_intervals([cast(AxisDiagnosis, SimpleNamespace(search=search, acting=lambda _: here))], (), model)
    info = model.parameters()["drive.x.d"]
    assert found["drive.x.d"] == (info.low, info.high)
    assert np.ptp(found["drive.x.p"]) < 0.1


def test_where_the_best_needs_shorter_steps_what_is_near_it_is_judged_anew(
    search: Search, monkeypatch: pytest.MonkeyPatch
) -> None:
    base = search.judged([((), search.start)], 4)[0]
    good = search.judged([((search.library.find("load_friction.x"),), base.values)], 4)[0]
    far = refit(search, ("directional_load_friction.x",), 50.0 * max(good.cost, 1.0))
    assert not search.refine_at(good.values)
    assert refined(search, base, [good, far]) == (base, [good, far])
    shorter = search.levels["exact"].finer()

    def refine_at(values: np.ndarray) -> bool:
        search.levels["exact"] = shorter
        return True

    monkeypatch.setattr(search, "refine_at", refine_at)
    again, found = refined(search, base, [replace(good, converged=True), far])
    assert [r.effects for r in found] == [good.effects, far.effects]
    assert found[0].converged  # which says that no set within it fits better, and not how its last descent ended
    assert not refined(search, base, [replace(good, converged=False), far])[1][0].converged
    assert found[1] is far
    for new in (again, found[0]):
        there = shorter(new.values[None])[0, search.used] / search.scale
        assert np.allclose(new.residuals, there, atol=1e-9)


def test_an_effect_of_several_values_is_fitted_from_several_of_its_own(recorded: list[Play]) -> None:
    search = part_search(start(), recorded, ("gravity_load", "stribeck_friction"))
    fitted: list[Job] = []
    search.best_of = lambda jobs, rounds: fitted.extend(jobs) or []  # type: ignore[assignment]
    base = search.refit([((), search.start)], 0)[0]
    next_refits(search, [base])
    from_where = {c.name: [tuple(v[search.columns(c)]) for (o,), v in fitted if o is c] for (c,), _ in fitted}
    assert len(from_where["gravity_load.x"]) == 1
    assert len(set(from_where["stribeck_friction.x"])) == 3


LEVELS = np.repeat(np.append(0.0, np.radians(np.random.default_rng(2).uniform(-10.0, 10.0, 29))), 15)
SWEEP = 0.17 * np.sin(np.arange(450) * 0.02)  # rad; so slow that it shows little of a response by itself


def test_the_linear_response_to_a_rounded_command_is_nearly_what_a_roll_out_shows() -> None:
    model = start().with_values(TRUTH)
    trials = [Play("levels", made_by(model, np.column_stack([LEVELS, 0.0 * LEVELS])))]
    search = part_search(model, trials, ("command_quantisation",))
    base = search.refit([((), search.start)], 0)[0]
    axis = model.rig.axes[0]
    rows = np.flatnonzero(np.isin(search.signal, [search.evidence.signals.index(n) for n in axis.positions]))
    search.settle_at(base)
    shown = np.column_stack([[0.05, 0.04, 0.025, 0.017, 0.012], np.zeros(5)])  # others than are asked about
    answer = command_response(search, base, on_commands(search, base, search.library.candidates)[0], rows, shown)
    commands = np.unique(search.evidence.commands[0][:, 0])
    for tick, cut in ((0.02, 0.0), (0.03, 0.5)):
        rounded = search.start.copy()
        rounded[search.columns(search.library.candidates[0])] = (tick, cut)
        change = (search.residuals(rounded[None])[0] - search.residuals(search.start[None])[0])[rows]
        linear = answer @ (tick * np.round(commands / tick - cut) - commands)
        assert np.sqrt(np.mean((linear - change) ** 2)) < 0.3 * np.sqrt(np.mean(change**2))


def test_the_tick_of_a_slow_sweep_is_the_likeliest() -> None:
    model, tick = start().with_values(TRUTH), 0.0128
    truth = model.with_effect("command_quantisation", "x", {"tick": tick})
    trials = [Play("sweep", made_by(truth, np.column_stack([SWEEP, 0.0 * SWEEP])))]
    search = part_search(model, trials, ("command_quantisation",))
    base = search.refit([((), search.start)], 4)[0]
    best = tick_points(search, [base], 1.1)[0]
    column = search.library.names.index("command_quantisation.x.tick")
    assert best.values[column] == pytest.approx(tick, rel=0.25 * tick / np.abs(SWEEP).max())


def test_the_period_of_an_uneven_servo_is_the_likeliest_where_a_ladder_misses_it() -> None:
    model, period = start().with_values(TRUTH), 0.0517
    uneven = {"amplitude": 0.002, "period": period, "phase": 1.1, "seen": 0.0}
    truth = model.with_effect("positioning_error", "x", uneven)
    trials = [Play("sweep", made_by(truth, np.column_stack([SWEEP, 0.0 * SWEEP])))]
    search = part_search(model, trials, ("positioning_error",))
    base = search.refit([((), search.start)], 4)[0]
    search.settle_at(base)
    (wave,) = on_commands(search, base, search.library.candidates)
    begun = likely_waves(search, base, wave)
    likely = search.trial_points([base], [wave.candidate], {wave.candidate.name: begun})
    ladder = search.trial_points([base], [wave.candidate])
    columns = search.columns(wave.candidate)
    assert likely[0].values[columns[1]] == pytest.approx(period, rel=0.25 * period / np.ptp(SWEEP))
    assert [np.sum(begun[:, 3] == seen) for seen in (0.0, 1.0)] == [PERIODS_TRIED, PERIODS_TRIED], (
        "of targets, and of the sensor"
    )
    assert likely[0].promised < 0.5 * ladder[0].promised
    assert next_refits(search, [base])[0].values[columns] == pytest.approx([*uneven.values()], abs=0.1)


@pytest.mark.study
def test_a_tick_of_which_a_command_spans_many_is_found_where_a_ladder_misses_it() -> None:
    levels = np.radians(np.random.default_rng(0).uniform(-10.0, 10.0, 20))
    targets = np.repeat(np.append(0.0, levels[1:]), 20)
    tick, model = np.abs(targets).max() / 97.3, start().with_values(TRUTH)
    truth = model.with_effect("command_quantisation", "x", {"tick": tick})
    trials = [Play("levels", made_by(truth, np.column_stack([targets, 0.0 * targets])))]
    search = part_search(model, trials, ("command_quantisation",))
    column = search.library.names.index("command_quantisation.x.tick")
    at = search.start.copy()
    at[column] = tick
    search.levels = {level: e.less(e(at[None])[0]) for level, e in search.levels.items()}  # it was this that made them
    base = search.refit([((), search.start)], 4)[0]
    (found,) = tick_refits(search, [base], 1.1)
    assert found.values[column] == pytest.approx(tick, rel=0.25 / 97.3)
    assert found.cost < 0.2 * base.cost
    assert next_refits(search, [base])[0].cost < 1.1 * found.cost
    ladder = search.trial_points([base], search.library.candidates)
    assert ladder[0].promised > 0.2 * base.cost, "this test needs no ticks of its own"
    assert not tick_refits(search, [found], 0.0), "it has a tick"
    assert not tick_refits(search, [base], 1.1 * worst_floors(base.residuals, search.signal)), "it leaves little"


def test_a_set_starts_within_its_bounds_though_what_it_contains_goes_further(recorded: list[Play]) -> None:
    search = part_search(start(), recorded, ("coulomb_friction", "stribeck_friction"))
    fitted: list[np.ndarray] = []
    search.judged = lambda jobs, rounds: fitted.extend(values for _, values in jobs) or []  # type: ignore[assignment]
    speed = search.library.names.index("stribeck_friction.x.speed")
    search.high[speed] = 0.5 * search.high[speed]  # as on an axis that is small
    small = refit(search, ("coulomb_friction.x",), 1.0, torque=0.2)
    nested_refits(search, refit(search, (), 9.0), [small, refit(search, ("stribeck_friction.x",), 4.0)])
    assert fitted and all(np.all((search.low <= v) & (v <= search.high)) for v in fitted)


def test_a_refit_does_not_depend_on_how_far_away_a_bound_lies(recorded: list[Play]) -> None:
    def refitted(high: float) -> tuple[Search, Refit]:
        search = part_search(start().with_effect("backlash", "x"), recorded)
        column = search.library.names.index("backlash.x.width")
        search.high[column] = high
        return search, search.refit([((), search.start)], 6)[0]

    (near, one), (_, other) = refitted(0.06), refitted(0.4)
    assert (near.spans <= near.high - near.low).all()
    assert other.values == pytest.approx(one.values, rel=1e-9, abs=1e-12)
    assert one.steps == pytest.approx(other.steps)


def test_a_drives_value_is_mistaken_for_no_effect(search: Search) -> None:
    first, *rest = search.library.candidates
    value = replace(first, effect=replace(first.effect, name="drive.x"))
    search.library = replace(search.library, candidates=(value, *rest))
    assert rival_refits(search, refit(search, (value.name,), 1.0), []) == []


@pytest.mark.study
def test_a_tick_is_found_beside_an_effect_whose_own_fit_hides_it() -> None:
    levels = np.radians(np.random.default_rng(2).uniform(-10.0, 10.0, 8))
    targets = np.repeat(np.append(0.0, levels[1:]), 40)
    tick, model = np.abs(targets).max() / 20.6, start().with_values(TRUTH)
    truth = model.with_effect("command_quantisation", "x", {"tick": tick})
    truth = truth.with_effect("dead_band", "x", {"half_width": 0.5 * tick, "jump": 0.0})
    trials = [Play("levels", made_by(truth, np.column_stack([targets, 0.0 * targets])))]
    search = part_search(model, trials, ("command_quantisation", "dead_band"))
    base = search.refit([((), search.start)], 6)[0]
    single = next_refits(search, [base])
    (found,) = tick_refits(search, begun(search, base, single), 1.1)
    assert set(found.effects) == {"command_quantisation.x", "dead_band.x"}
    column = search.library.names.index("command_quantisation.x.tick")
    assert found.values[column] == pytest.approx(tick, rel=0.25 / 20.6)
    assert found.cost < 0.05 * min(r.cost for r in (*single, *tick_refits(search, [base, single[0]], 1.1)))
