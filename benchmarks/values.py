# SPDX-License-Identifier: Apache-2.0
"""Whether stated intervals of fitted values hold the truth, and what a designed play is worth.

    python benchmarks/values.py --cases 200 --seed 100000 --named --json out.json

Each case draws a rig: gain, D and delay of a drive, three commands, five trials of each with sensor noise, ticks and
starts that differ. Once the model has all that the rig has; once the rig has one more effect of the library, and its
strength is drawn too. A delay of the commands is excluded there, because it adds to the drive's own and cannot be
separated from it. The rigs are made by the library's own physics, so that true values exist at all; the noise is not
the model's.

    interval_coverage           share of values whose 95 % interval holds the truth
    interval_coverage_missing   the same if the model lacks an effect
    interval_coverage_named     the same of the drive's values and the effect's, once the effect is added (--named)
    repeat_agreement            share of pairs of recordings of one rig whose values agree within their intervals
    width_ratio_designed        half-widths after a play that `next-experiment --for values` designs, over those after
                                excite_12s, which moves as long; geometric mean over values and rigs

Seeds below 100000 are for tuning.
"""

import argparse
import json
import multiprocessing
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from counting import Figure, Record, flat, rate

from eps_tunnel_analysis.calibration.calibrate import Fit, Settings, calibrate
from eps_tunnel_analysis.diagnose.addition import add_effects
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.sequence import Command, Hold, Ramp, Step, Triangle
from eps_tunnel_analysis.sequence_file import find_sequence
from eps_tunnel_analysis.values.value_experiment import value_experiment
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.simulate import simulate_batch
from labyrinth_sim.trials import Trials

FREE = ("drive.x.p", "drive.x.d", "drive.x.delay")
START = (17.0, 0.2, 0.02)
DRAWN = ((12.0, 22.0), (-0.6, 0.9), (0.008, 0.035))
STRENGTH = (0.15, 0.6)  # of an effect's typical one
INDISTINGUISHABLE = ("command_delay",)
SIGNALS = ("motor_x", "board_x")
TRIALS, RATE, STEPS = 5, 100.0, 5
NOISE, TICK, SPREAD = 3e-4, 0.00153, 2e-4  # rad
REPEATED, DESIGNED = 0.2, 0.05  # rigs for each case
QUICK = (2, 1, 1)  # cases, and rigs of the other two


def drawn(rng: np.random.Generator, missing: bool) -> tuple[dict[str, float], str, Model]:
    """True values, the effect that the model lacks ("" for none), and the rig."""
    truth = {name: float(rng.uniform(*bounds)) for name, bounds in zip(FREE, DRAWN, strict=True)}
    rig = load_model("labyrinth_mx64").with_values(truth)
    if not missing:
        return truth, "", rig
    options = [
        (e, place) for e in rig.registry.effects.values() for place in rig.places(e)
        if not e.nameless and e.name not in INDISTINGUISHABLE and place in ("x", *SIGNALS) and "ball" not in e.needs
    ]  # fmt: skip
    effect, place = options[int(rng.integers(len(options)))]
    rig = rig.with_effect(effect, place)
    infos, share = rig.parameters(), rng.uniform(*STRENGTH)
    weaker = {}
    for p in effect.parameters:
        info = infos[f"{effect.name}.{place}.{p.name}"]
        if info.off is not None:
            weaker[info.name] = info.off + share * (info.value - info.off)
    return truth, f"{effect.name}.{place}", rig.with_values(weaker)


def commands(rng: np.random.Generator) -> list[Command]:
    """Three of 2.6 s on one axis."""
    three = []
    for number in range(3):
        size, frequency = np.radians(rng.uniform(1.5, 3.5)), float(rng.uniform(1.0, 2.5))
        shapes = (Hold(0.2), Step(0.5, size), Step(0.4, -size / 2), Triangle(0.8, size / 2, frequency), Ramp(0.4, size),
                  Step(0.3, 0.0))  # fmt: skip
        three.append(Command(str(number), ("motor_x", "motor_y"), (0.0, 0.0), (shapes, (Hold(2.6),))))
    return three


def play(rig: Model, command: Command, rng: np.random.Generator) -> Play:
    """A command played on a rig: noise on every reading, ticks of the encoder, a different start for each trial."""
    time_, targets = command.sample(RATE)
    count = (len(time_) - 1) * STEPS + 1
    start = SPREAD * rng.standard_normal(TRIALS)
    result = simulate_batch(
        rig, (), np.empty((1, 0)), np.arange(count) / (RATE * STEPS),
        np.tile(np.repeat(targets, STEPS, axis=0)[:count], (TRIALS, 1, 1)), {"motor_x": start, "board_x": start},
        signals=SIGNALS, timestep=1 / (RATE * STEPS), nthread=1,
    )  # fmt: skip
    values = result.values[0][:, ::STEPS] + NOISE * rng.standard_normal((TRIALS, len(time_), len(SIGNALS)))
    values[:, :, 0] = np.round(values[:, :, 0] / TICK) * TICK
    trials = Trials(time_, SIGNALS, ("rad", "rad"), values, command.channels, np.tile(targets, (TRIALS, 1, 1)))
    return Play(command.name, trials)


def fitted(plays: Sequence[Play]) -> Fit:
    """A model that knows neither the values nor the effect, fitted as `calibrate` fits by default."""
    start = load_model("labyrinth_mx64").with_values(dict(zip(FREE, START, strict=True)))
    return calibrate(start, FREE, plays, Settings(signals=SIGNALS, nthread=1))


def coverage_case(job: tuple[int, bool]) -> Record:
    """Which intervals of one rig hold the truth."""
    seed, missing = job
    rng = np.random.default_rng([seed, int(missing)])
    truth, effect, rig = drawn(rng, missing)
    fit = fitted([play(rig, c, rng) for c in commands(rng)])
    values = [
        {"name": p.name, "truth": truth[p.name], "value": p.value, "half_width": p.half_width,
         "held": bool(abs(p.value - truth[p.name]) <= p.half_width)}
        for p in fit.parameters
    ]  # fmt: skip
    return {"seed": seed, "missing": effect, "values": values}


def named_case(seed: int) -> Record:
    """Which intervals of one rig hold the truth once the effect that the model lacked is added."""
    rng = np.random.default_rng([seed, 1])  # the rigs of `coverage_case` that lack one
    truth, effect, rig = drawn(rng, True)
    plays = [play(rig, c, rng) for c in commands(rng)]
    start = load_model("labyrinth_mx64").with_values(dict(zip(FREE, START, strict=True)))
    added = add_effects(start, plays, [effect], nthread=1)
    true = {n: v for n, v in rig.values().items() if n in truth or n.startswith(f"{effect}.")}
    values = [
        {"name": n, "truth": v, "value": added.values[n], "interval": list(added.intervals[n]),
         "held": bool(added.intervals[n][0] <= v <= added.intervals[n][1])}
        for n, v in true.items() if n in added.intervals
    ]  # fmt: skip
    return {"seed": seed, "missing": effect, "values": values}


def repeat_case(seed: int) -> Record:
    """Whether three recordings of the same rig agree."""
    rng = np.random.default_rng([seed, 2])
    _, _, rig = drawn(rng, False)
    played = commands(rng)
    fits = [fitted([play(rig, c, rng) for c in played]) for _ in range(3)]
    pairs = [
        {"name": a.name, "agree": bool(abs(a.value - b.value) <= np.hypot(a.half_width, b.half_width))}
        for i, j in ((0, 1), (0, 2), (1, 2))
        for a, b in zip(fits[i].parameters, fits[j].parameters, strict=True)
    ]
    return {"seed": seed, "pairs": pairs}


def designed_case(seed: int) -> Record:
    """Half-widths after a designed play over those after excite_12s."""
    rng = np.random.default_rng([seed, 3])
    _, _, rig = drawn(rng, False)
    usual = find_sequence("excite_12s").commands[0]
    first = fitted([play(rig, usual, rng)])
    model = load_model("labyrinth_mx64").with_values(first.values)
    plan = value_experiment(model, (), FREE, usual.duration, nthread=1)
    after = fitted([play(rig, plan.command, rng)])
    ratios = {a.name: b.half_width / a.half_width for a, b in zip(first.parameters, after.parameters, strict=True)}
    return {"seed": seed, "seconds": [usual.duration, plan.command.duration], "ratios": ratios}


def figures(records: dict[str, list[Record]]) -> dict[str, Figure]:
    """Every key of the study."""

    def held(of: str) -> Figure:
        return rate([v for r in records[of] for v in r["values"]], lambda v: v["held"])

    logs = [float(np.mean(np.log(list(r["ratios"].values())))) for r in records["designed"]]
    ratio = Figure(None, 0, None)
    if logs:
        draws = np.random.default_rng(0).choice(logs, (1000, len(logs))).mean(axis=1)
        low, high = np.exp(np.quantile(draws, (0.025, 0.975)))
        ratio = Figure(float(np.exp(np.mean(logs))), len(logs), (float(low), float(high)))
    return {
        "interval_coverage": held("complete"),
        "interval_coverage_missing": held("missing"),
        "interval_coverage_named": held("named"),
        "repeat_agreement": rate([p for r in records["repeated"] for p in r["pairs"]], lambda p: p["agree"]),
        "width_ratio_designed": ratio,
    }


def main() -> None:
    """Runs the cases and prints the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--seed", type=int, default=100_000, help="of the first case; the others follow")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="cases side by side")
    parser.add_argument("--named", action="store_true", help="also with the missing effect added, for every case")
    parser.add_argument("--quick", action="store_true", help="a few cases only")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    shares = [max(1, round(share * given.cases)) for share in (REPEATED, DESIGNED)]
    cases, repeated, designed = QUICK if given.quick else (given.cases, *shares)
    seeds = range(given.seed, given.seed + cases)
    jobs: dict[str, tuple[Callable[[Any], Record], Sequence[Any]]] = {
        "complete": (coverage_case, [(s, False) for s in seeds]),
        "missing": (coverage_case, [(s, True) for s in seeds]),
        "named": (named_case, seeds if given.named else ()),
        "repeated": (repeat_case, seeds[:repeated]),
        "designed": (designed_case, seeds[:designed]),
    }
    started = time.monotonic()
    records: dict[str, list[Record]] = {name: [] for name in jobs}
    # All kinds side by side, so that an interrupted run has results of each.
    order = sorted((at / len(todo), name, at) for name, (_, todo) in jobs.items() for at in range(len(todo)))
    with ProcessPoolExecutor(given.workers, multiprocessing.get_context("spawn")) as pool:
        waiting = [(name, pool.submit(jobs[name][0], jobs[name][1][at])) for _, name, at in order]
        for name, one in waiting:
            records[name].append(one.result())
            if given.json:
                measured = flat(figures(records))
                content = {"seed": given.seed, "quick": given.quick, "figures": measured, "cases": records}
                given.json.write_text(json.dumps({**measured, **content}, indent=1) + "\n", encoding="utf-8")
    counts = ", ".join(f"{len(todo)} {name}" for name, (_, todo) in jobs.items() if todo)
    print(f"Rigs: {counts}; {time.monotonic() - started:.0f} s", flush=True)
    for key, figure in figures(records).items():
        value = "-" if figure.value is None else f"{figure.value:.3f}"
        interval = "" if figure.interval is None else f"{figure.interval[0]:.3f} to {figure.interval[1]:.3f}"
        print(f"{key:28s}{value:10s}{interval:20s}({figure.n})")


if __name__ == "__main__":
    main()
