# SPDX-License-Identifier: Apache-2.0
"""The order in which sets of effects are tried, with descents that are told beforehand what they find."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from fit_cases import made_by, part_search, search_on_x, step

from eps_tunnel_analysis.diagnose import sets as sets_module
from eps_tunnel_analysis.diagnose.base_values import sensed_joints
from eps_tunnel_analysis.diagnose.candidates import starts
from eps_tunnel_analysis.diagnose.contained import general_refits, nested_refits
from eps_tunnel_analysis.diagnose.rank import worst_floors
from eps_tunnel_analysis.diagnose.refits import Job, Refit, TrialPoint, with_best_share
from eps_tunnel_analysis.diagnose.search import FEW_STARTS, HOPELESS, Search
from eps_tunnel_analysis.diagnose.sets import refitted_sets, rival_refits, settled, started_again
from eps_tunnel_analysis.diagnose.settings import SETTINGS
from eps_tunnel_analysis.recorded_play import Play
from labyrinth_sim.model import load_model

FRICTION, GAIN, TICK, WAVES = "direction_friction.x", "gain_error.x", "command_quantisation.x", "positioning_error.x"
LIMIT, PROFILE = "rate_limit.x", "motion_profile.x"  # the second contains the first
LOAD, BY_POWER = "load_friction.x", "directional_load_friction.x"  # so does this one, with two values for one
EFFECTS = tuple(name.partition(".")[0] for name in (FRICTION, GAIN, TICK, WAVES, LIMIT, PROFILE, LOAD, BY_POWER))
SHORT = 0.02  # share by which a descent was stopped before it was there

Found = Callable[..., Refit]


@pytest.fixture(scope="module")
def search() -> Search:
    return search_on_x(EFFECTS)


@pytest.fixture
def found(search: Search) -> Found:
    def leaves(cost: float, *effects: str) -> Refit:
        residuals = np.full(len(search.used), np.sqrt(cost))
        return Refit(effects, search.start, residuals, cost, 3 + len(effects), True)

    return leaves


def told(monkeypatch: pytest.MonkeyPatch, **answers: Any) -> None:
    """Each function of the search answers as given; others find nothing and change nothing."""
    nothing = {
        "stated_jobs": lambda *_: [],
        "far_along_valley": lambda *_: [],
        "better_base": lambda _, base, *__: base,
        "begun": lambda *_: [],
        "tick_refits": lambda *_: [],
        "rival_refits": lambda *_: [],
        "general_refits": lambda *_: [],
        "refined": lambda _, *unchanged: unchanged,
        "started_again": lambda _, base, refits, __: (base, refits),
        "nested_refits": lambda _, *unchanged: unchanged,
        "with_fewer_again": lambda _, *unchanged: unchanged,
        "settled": lambda _, *unchanged: unchanged,
    }
    for name, answer in (nothing | answers).items():
        monkeypatch.setattr(sets_module, name, answer)


def growing(grown: list[tuple[str, ...]], answers: dict[tuple[str, ...], list[Refit]]) -> Callable[..., list[Refit]]:
    """What is refitted on top of each set of effects; `grown` takes these sets."""

    def next_refits(_: Search, on: Sequence[Refit], *__: object, **___: object) -> list[Refit]:
        grown.append(on[0].effects)
        return answers.get(on[0].effects, [])

    return next_refits


def test_pairs_grow_from_the_best_effect_though_a_tick_was_found_beside_another(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch
) -> None:
    grown: list[tuple[str, ...]] = []
    answers = {(): [found(20.0, FRICTION), found(30.0, WAVES)], (FRICTION,): [found(1.0, FRICTION, GAIN)]}
    told(monkeypatch, next_refits=growing(grown, answers), tick_refits=lambda *_: [found(5.0, TICK, WAVES)])
    _, refits = refitted_sets(search, found(100.0))
    assert grown == [(), (FRICTION,)]
    assert min(refits, key=lambda r: r.cost).effects == (FRICTION, GAIN)


def test_a_tick_beside_an_effect_is_what_triples_grow_from_where_it_is_the_best_pair(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch
) -> None:
    grown: list[tuple[str, ...]] = []
    answers = {(): [found(20.0, FRICTION), found(30.0, WAVES)]}
    told(monkeypatch, next_refits=growing(grown, answers), tick_refits=lambda *_: [found(5.0, TICK, WAVES)])
    refitted_sets(search, found(30.0))
    assert grown == [(), (FRICTION,), (TICK, WAVES)]


def test_triples_grow_only_from_a_pair_that_is_needed_or_leaves_nearly_nothing(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 10,000 floors a further effect may take 3 % for the first one's form, unless it ends at the noise."""
    cases = ((FRICTION, False, 9.0, 2), (FRICTION, True, 9.0, 3), (FRICTION, False, 2.0, 3), (TICK, False, 9.0, 3))
    for first, exhaustive, left, tried in cases:  # a tick has one form only, and leaves a tenth of that
        grown: list[tuple[str, ...]] = []
        answers = {(): [found(50.0, first)], (first,): [found(left, first, GAIN)]}
        monkeypatch.setattr(search, "exhaustive", exhaustive)
        told(monkeypatch, next_refits=growing(grown, answers), event_refits=lambda *_: [])
        refitted_sets(search, found(10_000.0))
        assert len(grown) == tried, (first, exhaustive, left, grown)


@pytest.mark.parametrize("known", [True, False])
def test_what_is_best_only_in_the_end_has_rivals_too(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch, known: bool
) -> None:
    asked: list[tuple[str, ...]] = []

    def rivals(_: Search, best: Refit, __: object) -> list[Refit]:
        asked.append(best.effects)
        return [found(1.0, FRICTION, GAIN)] if best.effects == (FRICTION, WAVES) else []

    told(
        monkeypatch,
        next_refits=lambda *_, **__: [found(20.0, FRICTION)],
        rival_refits=rivals,
        nested_refits=lambda _, base, refits: (base, refits if known else [*refits, found(1.1, FRICTION, WAVES)]),
    )
    _, refits = refitted_sets(search, found(100.0), most=1)
    assert asked == ([(FRICTION,)] if known else [(FRICTION,), (FRICTION, WAVES)])
    assert ((FRICTION, GAIN) in [r.effects for r in refits]) is not known


def test_what_the_rivals_of_the_last_set_led_to_has_rivals_too(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = {(FRICTION,): (WAVES, TICK), (WAVES, TICK): (WAVES, GAIN), (WAVES, GAIN): (FRICTION, GAIN)}
    asked: list[tuple[str, ...]] = []

    def rivals(_: Search, best: Refit, __: object) -> list[Refit]:
        asked.append(best.effects)
        return [found(1.1 - 0.1 * len(asked), *answers[best.effects])] if best.effects in answers else []

    told(monkeypatch, next_refits=lambda *_, **__: [found(20.0, FRICTION)], rival_refits=rivals)
    _, refits = refitted_sets(search, found(100.0))
    assert asked == [(FRICTION,), (WAVES, TICK), (WAVES, GAIN), (FRICTION, GAIN)]
    assert min(refits, key=lambda r: r.cost).effects == (FRICTION, GAIN)


@pytest.mark.parametrize(
    ("others", "exhaustive", "by_any"),
    [((), False, False), ((), True, False), ((TICK,), False, True), ((TICK, WAVES), False, False),
     ((TICK, WAVES), True, True)],
)  # fmt: skip
def test_any_effect_may_replace_one_of_two_and_only_a_rival_one_alone_or_one_of_three(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch, others: tuple[str, ...], exhaustive: bool,
    by_any: bool,
) -> None:  # fmt: skip
    looked: set[str] = set()
    monkeypatch.setattr(search, "exhaustive", exhaustive)
    monkeypatch.setattr(
        search, "trial_points", lambda _, candidates, *__: looked.update(c.name for c in candidates) or []
    )
    rival_refits(search, found(3.0, FRICTION, *others), [])
    quick = {c.name for c in search.library.candidates if len(starts(c)) <= FEW_STARTS}
    assert GAIN in quick and WAVES not in quick
    assert LOAD in looked and (quick - {FRICTION} <= looked) is by_any


def test_a_rival_that_does_most_by_itself_is_tried_though_the_drive_might_do_as_much_with_any(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch
) -> None:
    last = sorted(search.library.candidates, key=lambda c: c.name == GAIN)
    points = [TrialPoint(c, search.start, 0.9 + 0.01 * i, 0, 1.0 if c.name == GAIN else 200.0 + i)
              for i, c in enumerate(last)]  # fmt: skip
    tried: list[Job] = []
    monkeypatch.setattr(
        search, "trial_points", lambda _, candidates, *__: [p for p in points if p.candidate in candidates]
    )
    monkeypatch.setattr(search, "best_of", lambda jobs, *_: tried.extend(jobs) or [])
    rival_refits(search, found(3.0, FRICTION, TICK), [])
    named = [tuple(c.name for c in fitted) for fitted, _ in tried]
    assert {(FRICTION, GAIN), (TICK, GAIN)} <= set(named)
    assert len(named) == len(set(named)) < 2 * (len(last) - 2)


@pytest.mark.parametrize(
    ("left", "promised", "exhaustive", "fitted"),
    [(1.5, 4.4, False, True), (1.5, 4.6, False, False), (1.5, 4.6, True, True), (3.0, 40.0, False, True)],
)
def test_beside_noise_a_rival_that_promises_no_more_than_what_is_given_up_leaves_is_not_fitted(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch, left: float, promised: float, exhaustive: bool,
    fitted: bool,
) -> None:  # fmt: skip
    tried: list[Job] = []
    monkeypatch.setattr(search, "exhaustive", exhaustive)
    monkeypatch.setattr(search, "best_of", lambda jobs, *_: tried.extend(jobs) or [])
    point = partial(TrialPoint, values=search.start, promised=promised, on=0, alone=promised)
    monkeypatch.setattr(search, "trial_points", lambda _, candidates, *__: [point(c) for c in candidates])
    rival_refits(search, found(left, FRICTION), [found(50.0, LOAD)])
    assert bool(tried) is fitted


@pytest.mark.parametrize(
    ("cost", "exhaustive", "goes_on"), [(9.0, False, False), (9.0, True, True), (5.0, False, True)]
)
def test_where_nothing_explains_what_is_missing_nothing_is_tried_beside_it(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch, cost: float, exhaustive: bool, goes_on: bool
) -> None:
    replaced: list[tuple[str, ...]] = []
    rested: list[Refit] = []

    def at_rest(_: Search, base: Refit, refits: Sequence[Refit]) -> tuple[Refit, Sequence[Refit]]:
        rested.append(base)
        return base, refits

    monkeypatch.setattr(search, "exhaustive", exhaustive)
    told(monkeypatch, next_refits=lambda *_, **__: [found(cost, FRICTION)], event_refits=lambda *_: [], settled=at_rest,
         rival_refits=lambda _, best, __: replaced.append(best.effects) or [])  # fmt: skip
    refitted_sets(search, found(10.0))
    assert bool(replaced) is bool(rested) is goes_on
    rested.clear()
    refitted_sets(search, found(10.0), floor=False)
    assert rested, "of single trials, what explains a little may be all"


@pytest.mark.parametrize(("cost", "looked"), [(1.1, False), (1.5, True), (9.0, False)])
def test_a_set_that_leaves_little_more_than_noise_is_tried_far_along_its_valley_before_more_is_added(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch, cost: float, looked: bool
) -> None:
    grown: list[tuple[str, ...]] = []
    far: list[tuple[str, ...]] = []

    def far_along_valley(_: Search, refit: Refit) -> list[Refit]:
        far.append(refit.effects)
        return [found(0.8, FRICTION)]

    told(monkeypatch, next_refits=growing(grown, {(): [found(cost, FRICTION)]}), far_along_valley=far_along_valley,
         event_refits=lambda *_: [])  # fmt: skip
    _, refits = refitted_sets(search, found(100.0))
    assert far == ([(FRICTION,)] if looked else [])
    assert grown == ([(), (FRICTION,)] if cost == 9.0 else [()])
    assert refits[0].cost == (0.8 if looked else cost)


def test_what_a_change_promises_is_what_its_best_share_leaves() -> None:
    left = with_best_share(np.array([1.0, 2.0]), np.array([[-1.0, 0.0], [-2.0, 0.0], [1.0, 0.0], [0.0, -0.5]]))
    assert left == pytest.approx([4.0, 4.0, 5.0, 3.25])


@pytest.mark.parametrize(
    ("limit", "profile", "tried"),
    [
        (3.0, None, True),
        (3.0, 2.9, True),  # it only imitates the limit
        (3.0, 1.0, False),
        (1.0, None, False),  # nothing is left
    ],
)
def test_a_general_form_starts_from_the_simple_ones_value_with_many_of_its_own(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch, limit: float, profile: float | None, tried: bool
) -> None:
    given: list[Job] = []
    monkeypatch.setattr(search, "best_of", lambda jobs, *_: given.extend(jobs) or [])
    values = search.start.copy()
    values[search.library.names.index("rate_limit.x.rate")] = 0.7
    refits = [replace(found(limit, FRICTION, LIMIT), values=values)]
    refits += [found(profile, FRICTION, PROFILE)] if profile else []
    general_refits(search, refits)
    assert bool(given) is tried
    speed, acceleration = (search.library.names.index(f"{PROFILE}.{name}") for name in ("speed", "acceleration"))
    off = search.columns(search.library.find(LIMIT))
    for candidates, point in given:
        assert [c.name for c in candidates] == [FRICTION, PROFILE]
        assert point[speed] == 0.7 and np.array_equal(point[off], search.start[off])
    assert len({float(point[acceleration]) for _, point in given}) == (3 if tried else 0)


@pytest.mark.parametrize(("alone", "again"), [(4.0, True), (None, True), (1.2, False)])
def test_a_simple_form_starts_from_what_the_general_one_found(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch, alone: float | None, again: bool
) -> None:
    given: list[Job] = []
    monkeypatch.setattr(search, "refit", lambda jobs, _: [found(9.0) for _ in jobs])  # long steps mislead
    monkeypatch.setattr(search, "judged", lambda jobs, _: given.extend(jobs) or [])
    values, names = search.start.copy(), search.library.names
    values[0] -= 0.1 * search.spans[0]  # another valley of the drive's
    for name, value in (("driving", 0.02), ("driven", 0.04)):
        values[names.index(f"{BY_POWER}.{name}")] = value
    refits = [replace(found(1.0, GAIN, BY_POWER), values=values)] + ([found(alone, GAIN, LOAD)] if alone else [])
    nested_refits(search, found(100.0), refits)
    simple = [point for candidates, point in given if [c.name for c in candidates] == [GAIN, LOAD]]
    assert bool(simple) is again
    for point in simple:
        assert point[0] == values[0]
        assert point[names.index(f"{LOAD}.share")] == pytest.approx(0.03)
        assert (point[search.columns(search.library.find(BY_POWER))] == 0.0).all()


def test_what_is_near_the_best_in_the_end_is_descended_until_it_rests(search: Search, found: Found) -> None:
    away = search.start.copy()
    away[0] += 0.1 * search.spans[0]
    base, stopped = search.refit([(search.library.of(effects), away) for effects in ((), (LOAD,))], 0, "exact")
    far = found(100.0 * base.cost, FRICTION)
    again, (rested, unchanged) = settled(search, base, [stopped, far])
    assert (rested.effects, unchanged) == ((LOAD,), far)
    assert stopped.cost > 1.5
    assert max(again.cost, rested.cost) < 1.05


def test_a_play_begins_anew_where_the_best_set_puts_it_if_that_leaves_more_than_noise(found: Found) -> None:
    """Stiction holds the joint where the play begins for most of it."""
    model = load_model("labyrinth_manual").with_effect("coulomb_friction", "x", {"torque": 0.4})
    commands = np.vstack([np.zeros((100, 2)), step(3.0, samples=61)])
    recorded = [Play("late", made_by(model, commands))]
    search = part_search(model, recorded, ("gain_error", "load_friction"))
    exact = search.levels["exact"]
    off = {name: 2.0 * exact.start_noise(0, joint[0]) for joint in sensed_joints(search) for name in joint}
    search.levels = {level: evidence.started([off]) for level, evidence in search.levels.items()}
    gain, far = search.refit([(search.library.of([GAIN]), search.start)], 6, "exact")[0], found(200.0, LOAD)
    far = replace(far, values=search.start, residuals=np.full(len(search.used), 9.0))
    base = replace(far, effects=())
    left = worst_floors(gain.residuals, search.signal)
    for allowed in (1.01 * left / SETTINGS.close, SETTINGS.healthy):
        begun = search.levels["exact"].initial
        _, (best, *_) = started_again(search, base, [gain, far], allowed)
        assert (search.levels["exact"].initial is begun) == (best is gain) == (allowed != SETTINGS.healthy)
    assert 2.0 * worst_floors(best.residuals, search.signal) < left > 2.0


def test_a_set_near_the_best_starts_again_from_the_base_values_of_the_best(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch
) -> None:
    size, asked = len(search.library.base), []

    def refit(jobs: Sequence[Job], *_: object) -> list[Refit]:
        asked.append(jobs)
        names = [tuple(c.name for c in candidates) for candidates, _ in jobs]
        better = len(asked) > 1  # which the other one's base values lead to
        return [replace(found(0.8 if better and n == (LOAD,) else 1.2, *n), values=jobs[0][1]) for n in names]

    monkeypatch.setattr(search, "refit", refit)
    there, away = search.start.copy(), search.start.copy()
    away[0] += 0.1 * search.spans[0]
    best, other = replace(found(1.0, GAIN), values=there), replace(found(1.1, LOAD), values=away)
    far = replace(found(50.0, FRICTION), values=away)
    _, refits = settled(search, found(50.0), [best, other, far])
    assert {r.effects: r.cost for r in refits} == {(LOAD,): 0.8, (GAIN,): 1.0, (FRICTION,): 50.0}
    (first, again) = asked
    assert [point[0] for _, point in first] == [there[0], away[0]]
    assert [point[0] for _, point in again] == [away[0], there[0]], "each from the other's"
    assert np.array_equal(again[1][1][size:], other.values[size:]), "its effects' values are its own"


def test_a_base_that_was_stopped_short_rests_before_anything_is_looked_for(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch
) -> None:
    grown: list[tuple[str, ...]] = []
    told(monkeypatch, next_refits=growing(grown, {}), settled=settled)
    stopped = search.at(search.start * np.where(np.arange(search.start.size) == 0, 1.0 + SHORT, 1.0), found(1.0))
    assert SETTINGS.close < worst_floors(stopped.residuals, search.signal) / SETTINGS.healthy < 2.0
    base, refits = refitted_sets(search, stopped)
    assert not refits and not grown
    assert worst_floors(base.residuals, search.signal) < SETTINGS.close * SETTINGS.healthy


@pytest.mark.parametrize(("cost", "rested"), [(1.0, 0), (2.0, 1), (20.0, 0)])
def test_only_a_base_that_leaves_a_little_is_descended_further_by_itself(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch, cost: float, rested: int
) -> None:
    alone = []

    def at_rest(_: Search, base: Refit, refits: Sequence[Refit]) -> tuple[Refit, Sequence[Refit]]:
        alone.extend([base] * (not refits))
        return base, refits

    told(monkeypatch, next_refits=lambda *_, **__: [found(0.9, GAIN)], settled=at_rest)
    refitted_sets(search, found(cost))
    assert len(alone) == rested


@pytest.mark.parametrize(("cost", "exhaustive", "sought"), [(3.0, False, True), (1.4, False, False), (1.4, True, True)])
def test_events_are_looked_for_only_where_more_is_left_than_a_healthy_rig_leaves(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch, cost: float, exhaustive: bool, sought: bool
) -> None:
    asked: list[tuple[str, ...]] = []

    def event_refits(_: Search, on: Sequence[Refit], __: float) -> list[Refit]:
        asked.extend(refit.effects for refit in on)
        return []

    answers = {(): [found(cost, FRICTION)]}
    told(monkeypatch, next_refits=growing([], answers), event_refits=event_refits)
    monkeypatch.setattr(search, "exhaustive", exhaustive)
    refitted_sets(search, found(3.5))
    assert asked == ([(), (FRICTION,)] if sought else [])


@pytest.mark.parametrize(("left", "exhaustive", "times"), [(20.0, False, 2), (2.0, False, 0), (2.0, True, 2)])
def test_where_an_effect_leaves_little_more_begins_with_its_own_values_only(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch, left: float, exhaustive: bool, times: int
) -> None:
    begun: list[Refit] = []
    answers = {(): [found(left, FRICTION)], (FRICTION,): [found(1.9, FRICTION, GAIN)]}
    monkeypatch.setattr(search, "exhaustive", exhaustive)
    told(monkeypatch, next_refits=growing([], answers), event_refits=lambda *_: [],
         begun=lambda _, base, refits: begun.append(base) or [])  # fmt: skip
    refitted_sets(search, found(100.0))
    assert len(begun) == times


def test_ticks_that_promise_more_than_is_given_up_are_not_descended(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch
) -> None:
    most: list[float] = []
    told(monkeypatch, event_refits=lambda *_: [], tick_refits=lambda *given: most.append(given[-1]) or [])
    for left, exhaustive in ((20.0, False), (1.4, False), (1.4, True)):  # far from the noise, a promise says too little
        monkeypatch.setattr(sets_module, "next_refits", growing([], {(): [found(left, FRICTION)]}))
        monkeypatch.setattr(search, "exhaustive", exhaustive)
        refitted_sets(search, found(100.0))
    assert most == [np.inf, HOPELESS * 1.4, np.inf]
    monkeypatch.undo()
    (tick,) = (c for c in search.library.candidates if c.name == TICK)
    points = [TrialPoint(tick, search.start, promised, 0, promised) for promised in (2.0, 5.0)]
    monkeypatch.setattr(sets_module, "tick_points", lambda *_: points)
    tried: list[int] = []
    monkeypatch.setattr(search, "best_of", lambda jobs, _: tried.append(len(jobs)) or [])
    for limit in (1.0, 3.0, np.inf):
        sets_module.tick_refits(search, [found(9.0)], 1.6, limit)
    assert tried == [1, 2]


@pytest.mark.parametrize(("more", "exhaustive", "rests"), [(0.9, False, False), (0.9, True, True), (0.2, False, True)])
def test_a_set_that_adds_nothing_is_not_descended_to_rest(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch, more: float, exhaustive: bool, rests: bool
) -> None:
    asked: list[tuple[str, ...]] = []

    def refit(jobs: Sequence[Job], *_: object) -> list[Refit]:
        asked.extend(tuple(c.name for c in candidates) for candidates, _ in jobs)
        return [found(1.0, *(c.name for c in candidates)) for candidates, _ in jobs]

    monkeypatch.setattr(search, "exhaustive", exhaustive)
    monkeypatch.setattr(search, "refit", refit)
    settled(search, found(50.0), [found(1.0, GAIN), found(more, GAIN, LOAD), found(1.2, FRICTION)])
    assert {(GAIN,), (FRICTION,)} <= set(asked) and ((GAIN, LOAD) in asked) is rests


@pytest.mark.parametrize(("exhaustive", "starts_from"), [(False, [-0.1]), (True, [-0.1, -0.05])])
def test_a_set_that_fits_worse_than_several_starts_again_from_the_best_of_them(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch, exhaustive: bool, starts_from: list[float]
) -> None:
    given: list[Job] = []
    monkeypatch.setattr(search, "exhaustive", exhaustive)
    monkeypatch.setattr(search, "refit", lambda jobs, _: [found(99.0) for _ in jobs])  # none does without an effect
    monkeypatch.setattr(search, "judged", lambda jobs, _: given.extend(jobs) or [])
    column = 0  # of the drive, by which one sees where a start comes from
    alone = []
    for cost, name, share in ((5.0, GAIN, -0.05), (3.0, FRICTION, -0.1)):
        values = search.start.copy()
        values[column] += share * search.spans[column]
        alone.append(replace(found(cost, name), values=values))
    nested_refits(search, found(50.0), [*alone, found(9.0, FRICTION, GAIN)])
    pairs = [point[column] for candidates, point in given if len(candidates) == 2]
    assert [(p - search.start[column]) / search.spans[column] for p in pairs] == pytest.approx(starts_from)


ADDING = pytest.mark.parametrize(
    ("alone", "exhaustive", "tried"), [(3.4, False, False), (3.4, True, True), (3.6, False, True)]
)


@ADDING
def test_a_set_that_adds_nothing_has_no_general_forms(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch, alone: float, exhaustive: bool, tried: bool
) -> None:
    given: list[Job] = []
    monkeypatch.setattr(search, "exhaustive", exhaustive)
    monkeypatch.setattr(search, "best_of", lambda jobs, *_: given.extend(jobs) or [])
    general_refits(search, [found(3.0, FRICTION, LIMIT), found(alone, FRICTION)])
    assert bool(given) is tried


@ADDING
def test_a_set_that_adds_nothing_is_not_judged_again_in_another_pose(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch, alone: float, exhaustive: bool, tried: bool
) -> None:
    asked: list[tuple[str, ...]] = []
    rows = {(FRICTION, GAIN): 3.0, (FRICTION,): alone, (): 50.0}

    def judged(jobs: Sequence[Job], _: int) -> list[Refit]:
        asked.extend(tuple(c.name for c in candidates) for candidates, _ in jobs)
        return [found(1.0, *(c.name for c in candidates)) for candidates, _ in jobs]

    refits = [found(cost, *effects) for effects, cost in rows.items()]
    monkeypatch.setattr(search, "exhaustive", exhaustive)
    monkeypatch.setattr(search, "settle_start", lambda *_: None)
    monkeypatch.setattr(search, "judged", judged)
    monkeypatch.setattr(search, "settle_at", lambda *_: None)
    monkeypatch.setattr(
        search, "residuals", lambda *_: np.array([refits[2].residuals, *(r.residuals for r in refits[:2])])
    )
    started_again(search, refits[2], refits[:2], 1.6)
    assert (FRICTION,) in asked and ((FRICTION, GAIN) in asked) is tried


@pytest.mark.parametrize(("pair", "exhaustive", "tried"), [(4.0, False, True), (8.0, False, False), (8.0, True, True)])
def test_of_two_effects_rivals_are_tried_only_if_the_second_explains_something(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch, pair: float, exhaustive: bool, tried: bool
) -> None:
    asked: list[tuple[str, ...]] = []
    answers = {(): [found(9.0, FRICTION)], (FRICTION,): [found(pair, FRICTION, GAIN)]}
    monkeypatch.setattr(search, "exhaustive", exhaustive)
    told(monkeypatch, next_refits=growing([], answers), event_refits=lambda *_: [],
         rival_refits=lambda _, best, __: asked.append(best.effects) or [])  # fmt: skip
    refitted_sets(search, found(50.0))
    assert ((FRICTION, GAIN) in asked) is tried


@pytest.mark.parametrize(("left", "times"), [(4.0, 2), (1.1, 1)])
@pytest.mark.parametrize("late", [False, True])
def test_where_effects_only_led_to_a_better_base_they_are_sought_again_from_it(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch, left: float, times: int, late: bool
) -> None:
    """If it still leaves something; what was found first says nothing about that."""
    base, better, on = found(200.0), found(left), []

    def next_refits(_: Search, points: Sequence[Refit], *__: object, **___: object) -> list[Refit]:
        if points[0].effects:
            return []
        on.append(points[0].cost)
        return [found(left, LOAD)] if points[0] is base else [found(0.9, FRICTION)]

    def led(_: Search, start: Refit, refits: Any, *__: object) -> Any:
        if late:
            return (better, [found(left, LOAD)]) if start is base else (start, refits)
        return better

    told(monkeypatch, next_refits=next_refits, event_refits=lambda *_: [],
         **{"nested_refits" if late else "better_base": led})  # fmt: skip
    monkeypatch.setattr(sets_module, "_rested", lambda _, base, __: base)
    _, refits = refitted_sets(search, base)
    assert on == [200.0, left][:times]
    assert ((FRICTION,) in [r.effects for r in refits]) is (times == 2)
    assert (LOAD,) in [r.effects for r in refits]


def test_pairs_grow_from_an_effect_that_fits_only_once_it_was_started_again(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch
) -> None:
    grown: list[tuple[str, ...]] = []
    answers = {(): [found(30.0, FRICTION)], (FRICTION,): [found(1.0, FRICTION, GAIN)]}

    def nested(_: Search, base: Refit, refits: Sequence[Refit]) -> tuple[Refit, list[Refit]]:
        return base, [found(5.0, *r.effects) if r.effects == (FRICTION,) else r for r in refits]

    told(monkeypatch, next_refits=growing(grown, answers), nested_refits=nested, event_refits=lambda *_: [])
    _, refits = refitted_sets(search, found(29.0), floor=False)
    assert grown == [(), (FRICTION,)]
    assert {r.effects: r.cost for r in refits} == {(FRICTION,): 5.0, (FRICTION, GAIN): 1.0}


@pytest.mark.parametrize(("left", "tried"), [(5.0, [(), (FRICTION,)]), (2.0, [()])])
def test_a_further_effect_is_sought_where_a_single_trial_s_first_leaves_more_than_twice_the_noise(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch, left: float, tried: list[tuple[str, ...]]
) -> None:
    grown: list[tuple[str, ...]] = []
    answers = {(): [found(left, FRICTION)], (FRICTION,): [found(1.0, FRICTION, GAIN)]}
    told(monkeypatch, next_refits=growing(grown, answers), event_refits=lambda *_: [])
    refitted_sets(search, found(300.0), floor=False)
    assert grown == tried, "however much its form may leave of 300 floors"


def test_pairs_that_were_looked_for_are_not_looked_for_again(
    search: Search, found: Found, monkeypatch: pytest.MonkeyPatch
) -> None:
    grown: list[tuple[str, ...]] = []
    told(monkeypatch, next_refits=growing(grown, {(): [found(5.0, FRICTION)]}), event_refits=lambda *_: [])
    refitted_sets(search, found(300.0))
    assert grown == [(), (FRICTION,)], "with nothing found"
