# SPDX-License-Identifier: Apache-2.0
"""The live figures are those of the whole trials, in whatever order the messages come."""

import math
import re
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from eps_tunnel_analysis.alikeness import LEAST_TRIALS
from eps_tunnel_analysis.compare import compare
from eps_tunnel_analysis.live import Figures, LiveGap, StampCounts
from eps_tunnel_analysis.recording.recording import Phase, TrialMark
from eps_tunnel_analysis.stamped import interpolate
from labyrinth_sim.errors import InputError
from labyrinth_sim.trials import Array, Trials

SIGNALS = ("motor_x", "motor_y")
RATE, DURATION, MAX_GAP = 100.0, 0.6, 0.1
TIME = np.arange(round(DURATION * RATE) + 1) / RATE
SECOND = 1_000_000_000


@dataclass(frozen=True)
class Played:
    """Messages of one run: (arrival s, side, kind, stamp ns, content); what whole trials would be, by side."""

    messages: list[tuple[float, str, str, int, object]]
    trials: dict[str, Array]


def mark(stamp: int, phase: Phase, trial: int, digest: str = "abc") -> TrialMark:
    return TrialMark(stamp, "/side/trial", phase, trial, "some", digest, DURATION)


def played(seed: int, count: int, delay: float, hole: bool = False) -> Played:
    """`count` trials on both sides, measured at uneven times, every topic delayed by up to `delay` s."""
    random = np.random.default_rng(seed)
    messages: list[tuple[float, str, str, int, object]] = []
    trials: dict[str, Array] = {}
    for side in ("real", "sim"):
        starts = [round((10 + 2 * i) * SECOND) + int(random.integers(0, 9_000_000)) for i in range(count)]
        stamps = np.cumsum(random.integers(8_000_000, 12_000_000, size=int((2 * count + 3) * 100)))
        stamps = stamps + round(8.5 * SECOND)
        if hole:
            stamps = stamps[(stamps < starts[0] + 0.2 * SECOND) | (stamps > starts[0] + 0.4 * SECOND)]
        values = np.cumsum(random.normal(size=(len(stamps), 2)), axis=0) * 1e-3
        late = {kind: random.uniform(0, delay) for kind in ("state", "mark")}
        messages += [
            (s / SECOND + late["state"], side, "state", int(s), v) for s, v in zip(stamps, values, strict=True)
        ]
        for number, start in enumerate(starts):
            for phase, at in (("start", start), ("end", start + round(DURATION * SECOND))):
                messages.append((at / SECOND + late["mark"], side, "mark", at, mark(at, phase, number)))  # type: ignore[arg-type]
        grids = [start + np.round(TIME * 1e9).astype(np.int64) for start in starts]
        trials[side] = np.array([[interpolate(stamps, column, grid, MAX_GAP) for column in values.T] for grid in grids])
    return Played(
        sorted(messages, key=lambda message: message[0]), {k: v.transpose(0, 2, 1) for k, v in trials.items()}
    )


def feed(gap: LiveGap, run: Played) -> list[int]:
    """How many samples were judged with each message."""
    judged = []
    for _, side, kind, stamp, content in run.messages:
        if kind == "state":
            batches = gap.add(side, "joint_states", SIGNALS, stamp, np.asarray(content))
        elif content.phase == "start":  # type: ignore[attr-defined]
            batches = gap.start(side, content)  # type: ignore[arg-type]
        else:
            gap.end(side, content)  # type: ignore[arg-type]
            batches = []
        judged.append(sum(len(batch.real.time) for batch in batches))
    return judged


def offline(run: Played, smoothed: bool) -> Figures:
    sides = [
        Trials(TIME, SIGNALS, ("rad", "rad"), values, (), np.empty((len(values), len(TIME), 0)))
        for values in (run.trials["real"], run.trials["sim"])
    ]
    result = compare(*sides, smoothed=smoothed)
    shares = np.array([[a.shares[name] for a in result.alikeness] for name in SIGNALS])
    joint = np.array([a.joint for a in result.alikeness])
    rig = result.against_itself
    itself = np.array([[a.shares[name] for a in rig] for name in SIGNALS]) if rig else np.full(shares.shape, np.nan)
    itself_joint = np.array([a.joint for a in rig]) if rig else np.full(joint.shape, np.nan)
    ks = tuple(a.k_real for a in result.alikeness)
    return Figures("some", SIGNALS, ks, shares, joint, 0, sides[0].count, True, itself, itself_joint)


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.floats(0, 0.9), st.booleans(), st.booleans())
@example(0, 3, 0.75, False, False)
def test_at_the_end_the_live_figures_are_those_of_the_whole_trials(
    seed: int, count: int, delay: float, hole: bool, smoothed: bool
) -> None:
    run = played(seed, count, delay, hole)
    gap = LiveGap(smoothed=smoothed)
    feed(gap, run)
    live, expected = gap.figures(), offline(run, smoothed)
    assert live is not None
    assert live.complete
    assert (live.trials, live.signals, live.command) == (count, SIGNALS, "some")
    np.testing.assert_array_equal(live.shares, expected.shares)
    np.testing.assert_array_equal(live.joint, expected.joint)
    np.testing.assert_array_equal(live.itself, expected.itself)
    np.testing.assert_array_equal(live.itself_joint, expected.itself_joint)
    assert live.yardstick == (count >= LEAST_TRIALS)


@pytest.mark.parametrize("early", [("real",), ("sim",), ("real", "sim")])
@pytest.mark.parametrize("count", [1, 3])
def test_a_trial_whose_marks_come_before_the_first_samples_counts(early: tuple[str, ...], count: int) -> None:
    run, gap = played(7, count, 0.0), LiveGap()
    first = [m for m in run.messages if m[2] == "mark" and m[1] in early and m[4].trial == 0]  # type: ignore[attr-defined]
    feed(gap, Played([*first, *(m for m in run.messages if m not in first)], run.trials))
    live, expected = gap.figures(), offline(run, True)
    assert live is not None
    assert (live.trials, live.complete) == (count, True)
    np.testing.assert_array_equal(live.shares, expected.shares)


def test_a_trial_whose_beginning_was_not_measured_does_not_count() -> None:
    run, gap = played(8, 2, 0.0), LiveGap()
    unseen = [m for m in run.messages if not (m[2] == "state" and m[3] < 10.2 * SECOND)]
    feed(gap, Played(unseen, run.trials))
    live = gap.figures()
    kept = {side: values[[1]] for side, values in run.trials.items()}
    assert live is not None
    assert (live.trials, live.complete) == (1, True)
    np.testing.assert_array_equal(live.shares, offline(Played([], kept), True).shares)


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 2**32 - 1))
def test_each_sample_of_a_trial_is_judged_once_and_as_soon_as_both_sides_have_it(seed: int) -> None:
    run = played(seed, 2, 0.0)
    judged = feed(LiveGap(), run)
    assert sum(judged) == 2 * len(TIME)
    # A measurement every 10 ms on either side: no sample has to wait for more than a few of them.
    assert max(judged) <= 4


def test_an_aborted_trial_does_not_count() -> None:
    run, gap = played(1, 2, 0.0), LiveGap()
    cut = next(i for i, m in enumerate(run.messages) if m[2] == "mark" and m[4].trial == 1) + 30  # type: ignore[attr-defined]
    feed(gap, Played(run.messages[:cut], run.trials))
    figures = gap.figures()
    assert figures is not None
    assert not figures.complete
    for side in ("real", "sim"):
        gap.abort(side)
    after, first = gap.figures(), LiveGap()
    feed(first, played(1, 2, 0.0).__class__([m for m in run.messages[:cut] if m[3] < 11.5 * SECOND], run.trials))
    before = first.figures()
    assert after is not None
    assert before is not None
    assert after.trials == 1
    np.testing.assert_array_equal(after.shares, before.shares)


def test_samples_that_come_twice_or_out_of_order_change_nothing() -> None:
    run, gap = played(3, 2, 0.0), LiveGap()
    messages = []
    for i, message in enumerate(run.messages):
        messages.append(message)
        if message[2] == "state" and i % 7 == 0:
            messages.append(message)
        if message[2] == "state" and i % 11 == 0:
            messages.append((message[0], message[1], "state", message[3] - 5 * SECOND // 100, np.array([9.0, 9.0])))
    feed(gap, Played(messages, run.trials))
    live, expected = gap.figures(), offline(run, True)
    assert live is not None
    np.testing.assert_array_equal(live.shares, expected.shares)


@pytest.mark.parametrize("duration", [math.nan, math.inf, -5.0, 0.0, 1e7, 1e300])
@pytest.mark.parametrize("early", [False, True])
def test_a_mark_with_a_senseless_length_is_refused_and_the_next_trial_counts(duration: float, early: bool) -> None:
    run, gap = played(3, 1, 0.0), LiveGap()
    if not early:
        for side in ("real", "sim"):
            gap.add(side, "joint_states", SIGNALS, SECOND, np.zeros(2))
    for side in ("real", "sim"):
        with pytest.raises(
            InputError, match=re.escape(f"lasts {duration:g} s; expected more than 0 and at most 20000 s")
        ):
            gap.start(side, replace(mark(SECOND, "start", 7), duration=duration))
    feed(gap, run)
    figures = gap.figures()
    assert figures is not None and (figures.trials, figures.complete) == (1, True)


def test_a_trial_without_end_is_left_out_when_the_next_begins() -> None:
    run, gap = played(4, 3, 0.0), LiveGap()
    lost = [m for m in run.messages if not (m[2] == "mark" and m[4].trial == 1 and m[4].phase == "end")]  # type: ignore[attr-defined]
    feed(gap, Played(lost, run.trials))
    live = gap.figures()
    kept = {side: values[[0, 2]] for side, values in run.trials.items()}
    assert live is not None
    assert live.trials == 2
    np.testing.assert_array_equal(live.shares, offline(Played([], kept), True).shares)


def test_a_simulation_with_another_model_is_judged_by_its_own_trials() -> None:
    run, gap = played(5, 3, 0.0), LiveGap()
    new = next(i for i, m in enumerate(run.messages) if m[3] > 13.5 * SECOND)
    feed(gap, Played(run.messages[:new], run.trials))
    gap.forget("sim")
    assert gap.figures() is None
    feed(gap, Played(run.messages[new:], run.trials))
    live = gap.figures()
    kept = {"real": run.trials["real"], "sim": run.trials["sim"][2:]}
    assert live is not None
    assert live.trials == 3
    np.testing.assert_array_equal(live.shares, offline(Played([], kept), True).shares)


def test_signals_of_one_side_only_are_not_compared() -> None:
    gap = LiveGap()
    for side, names in (("real", ("a", "b", "c")), ("sim", ("b", "d", "a"))):
        for i in range(200):
            gap.add(
                side, "joint_states", names, i * 10_000_000, np.array([1.0, 1.0, np.nan if side == "real" else 1.0])
            )
    for side in ("real", "sim"):
        gap.start(side, mark(1_900_000_000, "start", 0))
        for i in range(200, 300):
            gap.add(side, "joint_states", ("b", "a"), i * 10_000_000, np.ones(2))
    figures = gap.figures()
    assert figures is not None
    assert figures.signals == ("a", "b")


@given(st.lists(st.sampled_from(["on", "lose", "twice", "back"]), min_size=60, max_size=200))
def test_every_mishap_is_counted(events: list[str]) -> None:
    # The usual step must be learned first, then each mishap must be told apart.
    counts, stamp = StampCounts(late_after=0.1), 0
    for _ in range(101):
        stamp += 10_000_000
        assert counts.add(stamp, stamp)
    for event in events:
        if event == "twice":
            assert not counts.add(stamp, stamp)
            continue
        if event == "back":
            assert not counts.add(stamp - 15_000_000, stamp)
            continue
        stamp += 10_000_000 * (3 if event == "lose" else 1)
        assert counts.add(stamp, stamp + (200_000_000 if event == "lose" else 0))
    assert counts.duplicated == events.count("twice")
    assert counts.reordered == events.count("back")
    assert counts.late == events.count("lose")
    if events.count("lose") < 20:  # else three steps are the usual one
        assert counts.lost == 2 * events.count("lose")
    assert counts.received == 101 + len(events)


@pytest.mark.parametrize("jump", [-3600, 3600])
def test_a_clock_that_jumps_is_told_and_followed(jump: int) -> None:
    counts = StampCounts()
    for i in range(100):
        counts.add(4000 * SECOND + i * 10_000_000, 0)
    assert counts.add((4000 + jump) * SECOND, 0)
    assert (counts.clock_jumps, counts.lost, counts.reordered) == (1, 0, 0)
    assert counts.add((4000 + jump) * SECOND + 10_000_000, 0)


def test_reference_trials_count_as_if_they_had_been_played_now() -> None:
    run = played(5, 2, 0.3)
    gap = LiveGap()
    none = np.empty((2, len(TIME), 0))
    gap.refer_to("abc", Trials(TIME, SIGNALS, ("rad", "rad"), run.trials["real"], (), none))
    feed(gap, Played([m for m in run.messages if m[1] == "sim"], run.trials))
    live, expected = gap.figures(), offline(run, True)
    assert live is not None
    assert (live.trials, live.complete) == (2, True)
    np.testing.assert_array_equal(live.shares, expected.shares)
    np.testing.assert_array_equal(live.joint, expected.joint)


@pytest.mark.parametrize("jump", [-9, 3600])
def test_after_a_jump_of_the_clock_the_running_trial_is_left_out_and_the_next_is_judged(jump: int) -> None:
    run, gap = played(6, 3, 0.0), LiveGap()
    middle = next(i for i, m in enumerate(run.messages) if m[2] == "mark" and m[4].trial == 1) + 60  # type: ignore[attr-defined]
    feed(gap, Played(run.messages[:middle], run.trials))
    for side in ("real", "sim"):
        gap.jumped(side)
    moved = []
    for at, side, kind, stamp, content in run.messages[middle:]:
        later = content if kind == "state" else replace(content, stamp=content.stamp + jump * SECOND)  # type: ignore
        moved.append((at, side, kind, stamp + jump * SECOND, later))
    feed(gap, Played(moved, run.trials))
    kept = {side: values[[0, 2]] for side, values in run.trials.items()}
    live = gap.figures()
    assert live is not None
    assert (live.trials, live.complete) == (2, True)
    np.testing.assert_array_equal(live.shares, offline(Played([], kept), True).shares)
