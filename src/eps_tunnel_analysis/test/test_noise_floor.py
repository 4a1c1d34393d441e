# SPDX-License-Identifier: Apache-2.0
"""The noise floor by numbers: white noise, ticks with and without dither, drift, and what does not matter."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from fit_cases import plays
from scipy.signal import lfilter

from eps_tunnel_analysis.diagnose.evidence import play_evidence
from eps_tunnel_analysis.diagnose.noise import SignalNoise, largest_tick, resolution, signal_noise
from eps_tunnel_analysis.stamped import Readings, Series, readings
from labyrinth_sim.model import load_model

STEP, SECONDS, WIDTH = 0.0025, 10.0, 0.01
COUNT = round(SECONDS / STEP) + 1
GRID = STEP * np.arange(COUNT)
SIGMA, TICK = 1e-3, 1e-2
Array = np.ndarray


def motion(time: Array) -> Array:
    return np.sin(2.0 * time)


def bins_of(
    trials: int, seed: int, seen: Callable[[Array, np.random.Generator], Array], jitter: float = 3e-4
) -> tuple[Readings, list[Array]]:
    """Trials of what a sensor says (T,) at these stamps (T,) s."""
    rng = np.random.default_rng(seed)
    even = np.arange(0.005, SECONDS - 0.01, WIDTH)
    stamps = [even + jitter * rng.standard_normal(len(even)) for _ in range(trials)]
    series = [Series(np.sort(time), seen(np.sort(time), rng)) for time in stamps]
    return readings(series, SECONDS, STEP, COUNT, WIDTH), [one.values for one in series]


def noisy(time: Array, rng: np.random.Generator) -> Array:
    return motion(time) + SIGMA * rng.standard_normal(len(time))


def rounded(dither: float) -> Callable[[Array, np.random.Generator], Array]:
    def seen(time: Array, rng: np.random.Generator) -> Array:
        return np.round((motion(time) + dither * rng.standard_normal(len(time))) / TICK) * TICK

    return seen


def middle(noise: SignalNoise) -> float:
    return float(np.median(noise.floor))


@pytest.mark.parametrize("trials", [2, 4, 16])
def test_white_noise_of_the_mean_falls_with_the_root_of_the_trials(trials: int) -> None:
    noise = signal_noise(*bins_of(trials, trials, noisy), WIDTH)
    assert noise.single == pytest.approx(SIGMA, rel=0.1)
    assert middle(noise) == pytest.approx(SIGMA / np.sqrt(trials), rel=0.1)
    assert noise.tick == 0.0


@pytest.mark.parametrize("trials", [2, 3, 8])
def test_white_noise_has_mean_square_one_however_many_samples_of_each_trial_fall_into_a_bin(trials: int) -> None:
    bins, raw = bins_of(trials, trials, noisy, jitter=5e-3)
    assert len(set(bins.counts.sum(axis=0))) > 2, "bins are full by chance"
    noise = signal_noise(bins, raw, WIDTH)
    off = bins.mean - bins.reading @ motion(GRID)
    assert np.mean((off / noise.floor) ** 2) == pytest.approx(1.0, abs=0.12)


def test_rounding_without_noise_is_the_same_in_all_trials_and_does_not_average_out() -> None:
    noise = signal_noise(*bins_of(5, 0, rounded(0.0), jitter=0.0), WIDTH, TICK)
    assert noise.tick == pytest.approx(TICK, rel=0.01)
    assert middle(noise) == pytest.approx(TICK / np.sqrt(12), rel=0.1)


def test_noise_before_the_rounding_lets_it_average_out() -> None:
    dither = 0.6 * TICK
    noise = signal_noise(*bins_of(5, 1, rounded(dither), jitter=0.0), WIDTH, TICK)
    assert middle(noise) == pytest.approx(np.sqrt((dither**2 + TICK**2 / 12) / 5), rel=0.15)
    assert middle(noise) < 0.9 * np.sqrt(dither**2 / 5 + TICK**2 / 12)


def test_a_tick_coarser_than_the_sensor_s_is_something_that_a_model_may_lack() -> None:
    given = bins_of(5, 0, rounded(0.0), jitter=0.0)
    known = middle(signal_noise(*given, WIDTH, TICK))
    fine = signal_noise(*given, WIDTH, TICK / 4)
    assert fine.tick == 0.0
    assert middle(fine) < 0.01 * known


def test_where_trials_drift_apart_the_floor_rises_there_only() -> None:
    apart = iter(np.linspace(-0.05, 0.05, 5))

    def drifting(time: Array, rng: np.random.Generator) -> Array:
        return noisy(time, rng) + next(apart) * np.clip(time - 4.5, 0.0, 1.0)

    noise = signal_noise(*bins_of(5, 2, drifting), WIDTH)
    early, late = noise.floor[noise.time < 4.5], noise.floor[noise.time > 5.5]
    assert np.median(early) == pytest.approx(SIGMA / np.sqrt(5), rel=0.2)
    assert late == pytest.approx(np.full(len(late), np.std(np.linspace(-0.05, 0.05, 5), ddof=1)), rel=0.1)


def test_what_does_not_matter_is_a_share_of_the_motion_and_a_time() -> None:
    given = bins_of(4, 3, lambda time, _: motion(time))
    share = signal_noise(*given, WIDTH, tolerance=0.01)
    size = np.sqrt(np.var(motion(given[0].time)))
    assert share.floor == pytest.approx(np.full(len(share.floor), 0.01 * size), rel=0.02)
    late = signal_noise(*given, WIDTH, timing=0.01)
    moving = np.abs(np.cos(2.0 * late.time)) > 0.5
    mean = 0.01 / np.sqrt(given[0].single.shape[0])  # each trial is early or late by itself
    assert late.floor[moving] == pytest.approx(mean * 2.0 * np.abs(np.cos(2.0 * late.time))[moving], rel=0.05)


def test_noise_that_is_larger_for_a_while_counts_where_it_is() -> None:
    def louder(time: Array, rng: np.random.Generator) -> Array:
        return motion(time) + SIGMA * np.where(time > 5.0, 5.0, 1.0) * rng.standard_normal(len(time))

    noise = signal_noise(*bins_of(6, 3, louder), WIDTH)
    calm, loud = (float(np.median(noise.floor[here])) for here in (noise.time < 4.5, noise.time > 5.5))
    assert calm == pytest.approx(SIGMA / np.sqrt(6), rel=0.15)
    assert loud == pytest.approx(5.0 * SIGMA / np.sqrt(6), rel=0.15)


@pytest.mark.parametrize("by", [3.0, -3.0, 1e3])
def test_a_signal_in_another_unit_or_the_other_way_round_has_its_floor_in_that_unit(by: float) -> None:
    bins, raw = bins_of(5, 4, rounded(0.3 * TICK))
    one = signal_noise(bins, raw, WIDTH, TICK, 0.005, 3e-4)
    scaled = replace(bins, mean=by * bins.mean, single=by * bins.single)
    other = signal_noise(scaled, [by * r for r in raw], WIDTH, abs(by) * TICK, 0.005, 3e-4)
    assert other.floor == pytest.approx(abs(by) * one.floor, rel=1e-6)


def test_the_order_of_trials_does_not_matter() -> None:
    bins, raw = bins_of(5, 5, noisy)
    turned = replace(bins, single=bins.single[::-1], stamps=bins.stamps[::-1], counts=bins.counts[::-1])
    one, other = (signal_noise(b, r, WIDTH) for b, r in ((bins, raw), (turned, raw[::-1])))
    assert other.floor == pytest.approx(one.floor, rel=1e-9)


@pytest.mark.parametrize(
    ("seen", "tick", "jitter"),
    [(noisy, 0.0, 3e-4), (rounded(0.6 * TICK), TICK, 3e-4), (rounded(0.0), TICK, 0.0)],
    ids=["white", "dither", "ticks"],
)
def test_what_a_perfect_model_leaves_has_a_mean_square_of_one(
    seen: Callable[[Array, np.random.Generator], Array], tick: float, jitter: float
) -> None:
    left = []
    for seed in range(8):
        bins, raw = bins_of(5, seed, seen, jitter)
        noise = signal_noise(bins, raw, WIDTH, tick)
        left.append(np.mean(((bins.reading @ motion(GRID) - bins.mean) / noise.floor) ** 2))
    assert np.mean(left) == pytest.approx(1.0, abs=0.15)
    assert np.std(left) < 0.15


@pytest.mark.parametrize("tick", [5e-8, 0.0])
def test_what_is_moved_in_a_sample_at_constant_speed_is_no_tick(tick: float) -> None:
    time = np.arange(0, 4, 0.001)
    position = np.where(time < 2.5, 0.01 * time, 0.025 + 0.005 * np.sin(2.0 * (time - 2.5)))
    position += 1e-7 * np.random.default_rng(1).standard_normal(len(time))
    seen = tick * np.round(position / tick) if tick else position
    assert resolution([seen]) == pytest.approx(tick, rel=1e-3)


def test_ticks_of_a_fast_signal_are_found() -> None:
    """It takes many ticks at a time, so no change is common."""
    time, tick = np.arange(0, 20, 0.02), 2.0 * np.pi / 4096
    angle = 0.4 * np.sin(3.3 * time) + 0.2 * np.sin(1.9 * time)
    seen = np.round(np.degrees(np.round(angle / tick) * tick), 5)  # as text has it
    assert resolution([seen]) == pytest.approx(np.degrees(tick), rel=1e-3)
    assert resolution([np.degrees(angle)]) == 0.0
    assert resolution([np.degrees(angle + 1e-4 * np.random.default_rng(2).standard_normal(len(time)))]) == 0.0


def test_a_smooth_signal_has_no_tick() -> None:
    rng = np.random.default_rng(6)
    assert resolution([noisy(np.arange(0, 10, 0.01), rng)]) == 0.0
    assert resolution([np.zeros(100)]) == 0.0


def test_the_ticks_of_a_slow_quiet_signal_are_found_and_a_constant_speed_has_none() -> None:
    time, tick = np.arange(0, 8, 0.002), 0.00153398
    slow = np.round(0.04 * np.sin(0.8 * time) / tick) * tick  # one tick at a time, at most
    assert resolution([np.round(slow, 9)] * 3) == pytest.approx(tick, rel=1e-3)
    assert resolution([0.03 * time]) == 0.0
    assert resolution([0.5 + np.where(np.arange(1000) % 7 == 0, 1e-16, 0.0)]) == 0.0


def test_readings_of_whole_ticks_are_never_closer_than_one() -> None:
    rng = np.random.default_rng(5)
    seen = 0.2 * np.sin(np.arange(0, 4, 0.01)) + 0.003 * rng.standard_normal(400)
    ticks = 0.01 * np.round(seen / 0.01)
    assert largest_tick([ticks]) == pytest.approx(0.01)
    assert largest_tick([ticks, ticks + 0.0037]) == pytest.approx(0.01), "trials may have different zeros"
    assert largest_tick([ticks + 1e-12 * rng.standard_normal(400)]) == pytest.approx(0.01, rel=1e-6)
    assert largest_tick([seen]) < 0.002
    assert largest_tick([ticks, seen]) < 0.002
    assert largest_tick([np.full(9, 0.3), np.full(9, np.nan)]) == np.inf


def wander(time: Array, rng: np.random.Generator) -> Array:
    """What moves a rig at rest: 3 SIGMA that last a tenth of a second."""
    keep = np.exp(-WIDTH / 0.1)
    moved = lfilter([1.0], [1.0, -2.0 * keep, keep**2], rng.standard_normal(len(time)))
    return np.asarray(3.0 * SIGMA * moved / np.std(moved))


def restless(time: Array, rng: np.random.Generator) -> Array:
    return wander(time, rng) + SIGMA * rng.standard_normal(len(time))


def test_a_single_trial_shows_at_rest_how_well_it_repeats() -> None:
    given = bins_of(1, 7, restless)
    rests = np.ones(len(given[0].time), dtype=bool)
    assert middle(signal_noise(*given, WIDTH)) == pytest.approx(SIGMA, rel=0.2)
    assert 1.5 * SIGMA < middle(signal_noise(*given, WIDTH, still=rests)) < 3.5 * SIGMA, "at least, of 3.2"
    moving = np.arange(len(rests)) > 250  # settles for a while, and rests too shortly for several looks
    assert middle(signal_noise(*given, WIDTH, still=~moving)) == pytest.approx(SIGMA, rel=0.2)
    quiet = bins_of(1, 7, lambda time, rng: 0.05 * np.exp(-time / 3.0) + SIGMA * rng.standard_normal(len(time)))
    assert middle(signal_noise(*quiet, WIDTH, still=rests)) == pytest.approx(SIGMA, rel=0.2)
    several = bins_of(3, 7, restless)
    assert middle(signal_noise(*several, WIDTH, still=rests)) == middle(signal_noise(*several, WIDTH))


def test_what_moves_long_after_a_command_is_noise_and_what_follows_one_is_not() -> None:
    model = load_model("labyrinth")
    (rested,) = plays((3.0,), samples=801, trials=1)
    values = rested.trials.values.copy()
    values[0, :, rested.trials.index("motor_x")] += wander(rested.trials.time, np.random.default_rng(3))

    def floor(turns: float) -> float:
        commands = rested.trials.commands.copy()
        commands[0, :, 1] = 0.01 * np.sign(np.sin(2.0 * np.pi * rested.trials.time * turns))
        play = replace(rested, trials=replace(rested.trials, values=values, commands=commands))
        return middle(play_evidence(model, play, ("motor_x",)).noise[0])

    assert floor(0.0) > 2.0 * floor(1.5)
