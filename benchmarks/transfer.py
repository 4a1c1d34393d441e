# SPDX-License-Identifier: Apache-2.0
"""Does a smaller gap mean a better transfer? Controllers tuned in graded models, judged on the emulated rig.

    python benchmarks/transfer.py --json out.json --svg out.svg

The rig has backlash, dry friction and a load out of balance on one axis. Models go from textbook values over wrong
gains to calibrated ones, some with the effects that the rig has, some with others that lower the error for the wrong
reason. In each, CMA-ES (pycma) tunes a feed-forward of five values so that the board follows a path with quick
reversals; then the rig plays it. Models are calibrated by one command and judged by a recording of another, which no
fit has seen.

    spearman            figure -> rank correlation with the rig's cost and its 95 % interval (bootstrap over models);
                        of alikeness, which falls as cost rises, with its sign turned; of the recording held out, and,
                        where the name says "fitted", of the one that models were calibrated by
    spearman_gap        the same with what the rig's cost is above the model's own
    rmse_spearman       that of the error on the recording held out, for comparison; rmse_fitted_spearman on the other
    floors_spearman     that of the mean square over the noise floor, likewise; floors_fitted_spearman

Two things of the question are not asked here: feedback from the board's sensor, and the ball.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cma
import numpy as np
import testbed_cases
from numpy.typing import NDArray
from scipy.stats import spearmanr

from eps_tunnel_analysis.alikeness import KS
from eps_tunnel_analysis.calibration.calibrate import Settings, calibrate
from eps_tunnel_analysis.compare import compare
from eps_tunnel_analysis.diagnose.evidence import Evidence, play_evidence
from eps_tunnel_analysis.fit.methods import GaussNewton
from eps_tunnel_analysis.sequence import Command, Hold, Ramp, Step, Triangle
from eps_tunnel_analysis.simulated import Play, roll_out
from labyrinth_hw.testbed.hidden import TestbedConfig, hide
from labyrinth_hw.testbed.offline import run_offline
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.simulate import simulate_batch

Array = NDArray[np.float64]
RATE, TIMESTEP = 100.0, 0.0025  # Hz, s
SIGNALS = ("motor_x", "board_x")
RIGHT = ("backlash.x", "coulomb_friction.x", "gravity_load.x")
WRONG = ("sensor_lag.board_x", "return_spring.x", "viscous_friction.x", "gain_error.x", "dead_band.x")
DRIVE = ("drive.x.p", "drive.x.d", "drive.x.delay")
LOW = np.array([0.8, 0.0, -0.002, -0.015, -0.015])
HIGH = np.array([1.3, 0.12, 0.004, 0.02, 0.015])
"""gain, lead s, rad per rad/s^2, rad with the sign of the speed, offset rad"""
SLOW = 0.05  # rad/s, about which the sign of the speed turns
GENERATIONS, POPULATION = 25, 12
BUDGET = 150  # evaluations of each calibration
DRAWS = 1000


@dataclass(frozen=True)
class GradedModel:
    """A model and how it came about."""

    name: str
    model: Model


def rig() -> TestbedConfig:
    """What is to be modelled."""
    return testbed_cases.rig((
        hide("backlash", "x", values={"play": 0.008}),
        hide("coulomb_friction", "x", values={"coulomb": 0.12}),
        hide("gravity_load", "x", values={"gravity_moment": 0.12}),
    ))  # fmt: skip


def fitted_command() -> Command:
    """The one by which models are calibrated."""
    d = np.radians
    shapes = (Hold(0.3), Step(0.6, d(3.0)), Step(0.6, d(-2.5)), Ramp(0.9, d(2.0)), Triangle(1.6, d(1.5), 1.25),
              Step(0.5, d(-1.0)), Step(0.5, 0.0))  # fmt: skip
    return Command("fitted", ("motor_x", "motor_y"), (0.0, 0.0), (shapes, (Hold(5.0),)))


def judged_command() -> Command:
    """The one by which they are judged: other angles, speeds and order, within the range of the first."""
    d = np.radians
    shapes = (Hold(0.3), Triangle(2.0, d(2.2), 0.75), Step(0.5, d(1.2)), Ramp(0.7, d(-2.8)), Step(0.6, d(0.6)),
              Step(0.6, d(-1.6)), Step(0.6, 0.0))  # fmt: skip
    return Command("judged", ("motor_x", "motor_y"), (0.0, 0.0), (shapes, (Hold(5.3),)))


def recorded(command: Command, seed: int) -> Play:
    """A command as the rig plays it."""
    play = testbed_cases.play(rig(), command, seed)
    return Play(play.name, play.trials.select(SIGNALS))


def models(play: Play, quick: bool, budget: int) -> Iterator[GradedModel]:
    """Graded models: by textbook, with wrong gains, calibrated, with right and with wrong effects."""
    known = load_model("labyrinth_mx64")
    given = [GradedModel("standard", load_model("labyrinth")), GradedModel("data sheet", known)]
    for p, delay in ((6.0, 0.02), (12.0, 0.0), (12.0, 0.04), (25.0, 0.02), (17.0, 0.05)):
        given.append(GradedModel(f"P {p:g}, delay {delay:g}", known.with_values({DRIVE[0]: p, DRIVE[2]: delay})))
    yield from given[:3] if quick else given
    sets = ((), *((name,) for name in (*RIGHT, *WRONG)), RIGHT[:2], RIGHT[1:], RIGHT, WRONG[:2])
    for effects in ((), RIGHT[:1], RIGHT) if quick else sets:
        model, free = known, list(DRIVE)
        for name in effects:
            effect, place = name.split(".")
            model = model.with_effect(effect, place)
            free += [f"{name}.{p.name}" for p in model.registry.effect(effect).parameters if p.fitted]
        method = GaussNewton(scouts=24, starts=2, polish=40)
        fit = calibrate(model, free, [play], Settings(method=method, signals=SIGNALS, budget=budget, nthread=1))
        yield GradedModel(" + ".join(("calibrated", *effects)), model.with_values(fit.values))


def path() -> tuple[Array, Callable[[Array], tuple[Array, Array, Array]]]:
    """(T,) s, and the board's angle, speed and acceleration at given times, rad."""
    sines = ((np.radians(2.2), 0.55, 0.0), (np.radians(1.0), 1.3, 0.7), (np.radians(0.4), 2.6, 1.9))

    def at(t: Array) -> tuple[Array, Array, Array]:
        ramp = np.clip(t / 0.5, 0.0, 1.0)
        terms = [(a, 2 * np.pi * f, 2 * np.pi * f * t + phase) for a, f, phase in sines]
        return (
            ramp * sum(a * np.sin(x) for a, _, x in terms),
            ramp * sum(a * w * np.cos(x) for a, w, x in terms),
            ramp * sum(-a * w * w * np.sin(x) for a, w, x in terms),
        )

    return np.arange(600) / RATE, at


def commands_of(values: Array) -> Array:
    """(n, T, 2) rad of n feed-forwards (n, 5)."""
    t, at = path()
    found = np.zeros((len(values), len(t), 2))
    for row, (gain, lead, inertia, friction, offset) in enumerate(values):
        angle, speed, acceleration = at(t + lead)
        found[row, :, 0] = gain * angle + inertia * acceleration + friction * np.tanh(speed / SLOW) + offset
    return np.clip(found, -0.13, 0.13)


def cost_of(board: Array) -> Array:
    """(n,) root mean square distance of boards (n, T) from the path, rad."""
    t, at = path()
    return np.asarray(np.sqrt(np.mean((board - at(t)[0]) ** 2, axis=1)))


def tuned(model: Model, seed: int, generations: int) -> tuple[Array, float]:
    """(5,) the feed-forward that follows best in the model, and its cost there."""
    t, _ = path()

    def cost(z: Array) -> Array:
        targets = commands_of(LOW + z * (HIGH - LOW))
        answer = simulate_batch(
            model, (), np.empty((1, 0)), t, targets, {}, signals=("board_x",), timestep=TIMESTEP, nthread=1
        )
        return np.nan_to_num(cost_of(answer.values[0, :, :, 0]), nan=1.0)

    start = (np.array([1.0, 0.03, 0.0, 0.0, 0.0]) - LOW) / (HIGH - LOW)
    options = {"bounds": [0.0, 1.0], "popsize": POPULATION, "seed": seed, "verbose": -9, "maxiter": generations}
    search = cma.CMAEvolutionStrategy(start, 0.2, options)
    while not search.stop():
        candidates = search.ask()
        search.tell(candidates, cost(np.array(candidates)).tolist())
    best = np.clip(search.result.xbest, 0.0, 1.0)
    return LOW + best * (HIGH - LOW), float(search.result.fbest)


def on_rig(values: Array, seed: int) -> float:
    """Cost of a feed-forward on the rig, rad: mean over its trials, by the potentiometer."""
    t, _ = path()
    run = run_offline(rig(), t, commands_of(values[None])[0], testbed_cases.TRIALS, seed)
    board = np.stack([np.interp(t, s, b[:, 0]) for s, b in zip(run.stamps, run.board, strict=True)])
    return float(cost_of(board).mean())


def judged_figures(model: Model, fitted: Play, held: Play) -> dict[str, float]:
    """Figures of a model on a recording that was not fitted, and RMSE and floors on the one that was beside them."""
    seen = figures_of(model, fitted)
    return figures_of(model, held) | {f"{name} fitted": seen[name] for name in ("rmse", "floors")}


def figures_of(model: Model, play: Play) -> dict[str, float]:
    """What the comparison with a recording says of a model; all rise as it gets worse."""
    shown = compare(play.trials, roll_out(model, play), KS, signals=SIGNALS)
    found = {f"alikeness k={a.k_real:g}": -a.joint for a in shown.alikeness}
    found["rmse"] = float(np.sqrt(np.mean([e.rms**2 for e in shown.errors])))
    found["error"] = float(np.mean([e.command_error for e in shown.errors]))
    evidence = Evidence(model, (), [play_evidence(model, play, SIGNALS)], SIGNALS, TIMESTEP, 1)
    squares = (evidence(np.empty((1, 0)))[0] / evidence.floor) ** 2
    found["floors"] = float(np.mean(squares))
    found["remaining"] = max(float(np.mean(squares[evidence.blocks == i])) for i in range(len(SIGNALS)))
    return found


def correlation(x: Sequence[float], y: Sequence[float]) -> list[float]:
    """Spearman's rank correlation and its 95 % interval by bootstrap."""
    a, b = np.array(x), np.array(y)
    rng, draws = np.random.default_rng(0), []
    while len(draws) < DRAWS:
        which = rng.integers(len(a), size=len(a))
        if np.ptp(a[which]) > 0.0 and np.ptp(b[which]) > 0.0:
            draws.append(float(spearmanr(a[which], b[which]).statistic))
    low, high = np.quantile(draws, (0.025, 0.975))
    value = float(spearmanr(a, b).statistic) if np.ptp(a) > 0.0 else float("nan")
    return [value, float(low), float(high)]


def write_picture(records: Sequence[dict[str, Any]], names: Sequence[str], file: Path) -> None:
    """The rig's cost over each figure."""
    from matplotlib.figure import Figure

    from eps_tunnel_analysis.report.values_pictures import save_svg

    figure = Figure(figsize=(2.4 * len(names), 2.8), layout="constrained")
    for axes, name in zip(figure.subplots(1, len(names), sharey=True), names, strict=True):
        axes.plot([abs(r["figures"][name]) for r in records], [1000 * r["on_rig"] for r in records], "o", ms=4)
        axes.set_xlabel(name)
        if min(abs(r["figures"][name]) for r in records) > 0.0:
            axes.set_xscale("log")
    figure.axes[0].set_ylabel("cost on the rig, mrad")
    save_svg(figure, file)


def main() -> None:
    """Runs the study and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=100_000)
    parser.add_argument("--quick", action="store_true", help="six models and short searches")
    parser.add_argument("--budget", type=int, default=BUDGET, help="evaluations of each calibration (default: 150)")
    parser.add_argument("--generations", type=int, default=GENERATIONS, help="of each tuning (default: 25)")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--svg", type=Path, help="draw the rig's cost over some figures")
    given = parser.parse_args()
    started, play = time.monotonic(), recorded(fitted_command(), given.seed)
    held = recorded(judged_command(), given.seed + 2)
    records: list[dict[str, Any]] = []
    budget, generations = (60, 6) if given.quick else (given.budget, given.generations)
    for graded in models(play, given.quick, budget):
        values, in_model = tuned(graded.model, given.seed % 2**31, generations)
        figures = judged_figures(graded.model, play, held)
        records.append({"model": graded.name, "in_model": in_model, "on_rig": on_rig(values, given.seed + 1),
                        "controller": values.tolist(), "figures": figures})  # fmt: skip
        r = records[-1]
        print(f"{r['model']:45s} in the model {1e3 * in_model:6.2f}, on the rig {1e3 * r['on_rig']:6.2f} mrad, RMSE "
              f"{1e3 * r['figures']['rmse']:6.2f} mrad, k = 3 {-r['figures']['alikeness k=3']:.3f}, floors "
              f"{r['figures']['floors']:.3g}", flush=True)  # fmt: skip
        if given.json:
            given.json.write_text(json.dumps({"models": records}, indent=1) + "\n", encoding="utf-8")
    names = list(records[0]["figures"])
    columns = {n: [r["figures"][n] for r in records] for n in names}
    spearman = {n: correlation(columns[n], [r["on_rig"] for r in records]) for n in names}
    gap = {n: correlation(columns[n], [r["on_rig"] - r["in_model"] for r in records]) for n in names}
    print(f"\n{len(records)} models in {time.monotonic() - started:.0f} s\n")
    print(f"{'figure':16s}{'rig':>8s}  {'95 %':16s}{'rig - model':>12s}")
    for name in names:
        value, low, high = spearman[name]
        print(f"{name:16s}{value:8.3f}  {f'{low:.2f} to {high:.2f}':16s}{gap[name][0]:12.3f}")
    if given.json:
        content = {
            "spearman": spearman, "spearman_gap": gap,
            **{f"{n}{w}_spearman": spearman[(n + w).replace("_", " ")]
               for n in ("rmse", "floors") for w in ("", "_fitted")},
            "quick": given.quick, "seed": given.seed, "models": records,
        }  # fmt: skip
        given.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    if given.svg:
        write_picture(records, ("alikeness k=3", "rmse", "floors", "remaining"), given.svg)


if __name__ == "__main__":
    main()
