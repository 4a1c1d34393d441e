# SPDX-License-Identifier: Apache-2.0
"""Does a smaller gap mean a better transfer? Controllers tuned in graded models, judged on the emulated rig.

    python benchmarks/transfer.py --json out.json --svg out.svg

The rig has backlash, dry friction and a load out of balance on one axis. Models go from textbook values over wrong
gains to calibrated ones, some with the effects that the rig has, some with others that lower the error for the wrong
reason. In each, CMA-ES (pycma) tunes a controller for each task of `transfer_tasks`; then the rig runs it. Models are
calibrated by one command and judged by a recording of another, which no fit has seen; `transfer_figures` tells the
figures.

    spearman            figure -> rank correlation with the rig's cost and its 95 % interval (bootstrap over models),
                        mean over the tasks; of alikeness, which falls as cost rises, with its sign turned
    above_rmse          by how much a figure's correlation is above that of the RMSE, and its interval
    spearman_gap        the same with what the rig's cost is above the model's own
    spearman_distance   the same with how far apart the two are, whichever is higher
    spearman_together   with the geometric mean of a model's costs of all tasks; a figure of each task by its mean rank
    tasks               the first three for each task alone; the cost of the same controller tuned on the rig itself;
                        the probes; how well one tuning's costs on the rig rank another's
    rmse_spearman       that of the error on the recording held out; rmse_fitted_spearman on the other
    floors_spearman     that of the mean square over the noise floor, likewise; floors_fitted_spearman
    best                the figure with the highest correlation

The file is written anew after every step, with the correlations of the tasks that are through. A run that was cut off
goes on with `--resume`, after the last task that was through.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cma
import numpy as np
import testbed_cases
from scipy.stats import rankdata
from transfer_figures import (
    SIGNALS,
    Probes,
    correlation,
    difference,
    figures_of_probes,
    figures_of_recordings,
    probes_of,
    repeatability,
)
from transfer_tasks import TASKS
from transfer_tasks.task import TRIALS, Array, Task, in_model, on_rig, play

from eps_tunnel_analysis.calibration.calibrate import Settings, calibrate
from eps_tunnel_analysis.fit.methods import GaussNewton
from eps_tunnel_analysis.recorded_play import Play
from eps_tunnel_analysis.sequence import Command, Hold, Ramp, Step, Triangle
from labyrinth_hw.testbed.hidden import TestbedConfig, hide
from labyrinth_sim.model import Model, load_model

RIGHT = ("backlash.x", "coulomb_friction.x", "gravity_load.x")
STRENGTHS = ("backlash.x.width", "coulomb_friction.x.torque", "gravity_load.x.moment")
BIASED = ("sensor_bias.motor_x", "sensor_bias.board_x")  # what a load out of balance looks like to the sensors
WRONG = (("viscous_friction.x",), ("dead_band.x",), ("sensor_lag.board_x", "return_spring.x"), BIASED,
         (*BIASED, "dead_band.x"))  # fmt: skip
DRIVE = ("drive.x.p", "drive.x.d", "drive.x.delay")
POPULATION, TUNINGS = 12, 2
SPREAD = 0.2  # share of the bounds, of the first generation
BUDGET = 150  # evaluations of each calibration
PROBES = 20  # of each task
TARGETS: dict[str, Callable[[float, float], float]] = {
    "spearman": lambda on_rig, in_model: on_rig,
    "spearman_gap": lambda on_rig, in_model: on_rig - in_model,
    "spearman_distance": lambda on_rig, in_model: abs(on_rig - in_model),
}
SHOWN = ("alikeness k=3", "rmse", "floors", "probes' track")


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
    whole = testbed_cases.play(rig(), command, seed)
    return Play(whole.name, whole.trials.select(SIGNALS))


def models(recording: Play, quick: bool, budget: int) -> Iterator[GradedModel]:
    """Graded models: by textbook, with wrong gains, calibrated, with right and with wrong effects."""
    known = load_model("labyrinth_mx64")
    yield GradedModel("standard", load_model("labyrinth"))
    yield GradedModel("data sheet", known)
    for p, delay in ((6.0, 0.02),) if quick else ((6.0, 0.02), (12.0, 0.04), (25.0, 0.02)):
        yield GradedModel(f"P {p:g}, delay {delay:g}", known.with_values({DRIVE[0]: p, DRIVE[2]: delay}))
    sets = ((), *WRONG, *((name,) for name in RIGHT), RIGHT[:2], RIGHT[::2], RIGHT[1:], RIGHT)
    for effects in ((), RIGHT[:1], RIGHT) if quick else sets:
        model, free = known, list(DRIVE)
        for name in effects:
            effect, place = name.split(".")
            model = model.with_effect(effect, place)
            free += [f"{name}.{p.name}" for p in model.registry.effect(effect).parameters if p.fitted]
        method = GaussNewton(starts=2)
        fit = calibrate(model, free, [recording], Settings(method=method, signals=SIGNALS, budget=budget, nthread=1))
        model = model.with_values(fit.values)
        yield GradedModel(" + ".join(("calibrated", *effects)), model)
    if not quick:  # of the last, which has all that is right
        for factor in (0.5, 1.5):
            scaled = {n: factor * model.values()[n] for n in STRENGTHS}
            yield GradedModel(f"right effects, {factor:g} of each", model.with_values(scaled))


def tuned(task: Task, cost: Callable[[Array], Array], seed: int, generations: int) -> tuple[Array, float]:
    """(v,) the controller of the least cost, and that; `cost` takes (n, v) and gives (n,)."""
    options = {"bounds": [0.0, 1.0], "popsize": POPULATION, "seed": seed, "verbose": -9, "maxiter": generations}
    search = cma.CMAEvolutionStrategy(task.begin, SPREAD, options)
    while not search.stop():
        candidates = search.ask()
        search.tell(candidates, cost(task.of_shares(np.array(candidates))).tolist())
    return task.of_shares(np.array(search.result.xbest)), float(search.result.fbest)


def tuned_on_rig(task: Task, seed: int, generations: int) -> float:
    """Cost of the controller that is tuned on the rig itself: what a perfect model would reach."""
    values, _ = tuned(task, lambda v: on_rig(task, play(task, rig(), v, task.repeats, seed)), seed, generations)
    return float(on_rig(task, play(task, rig(), values[None], TRIALS, seed + 1))[0])


def summary(records: Sequence[dict[str, Any]], extra: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Correlations over the models, of each task that is through with all of them and in the mean."""
    through = [t.name for t in TASKS if records and all("on_rig" in r["tasks"].get(t.name, {}) for r in records)]
    content: dict[str, Any] = {"tasks": extra, "models": list(records)}
    if not through:
        return content
    names = [*records[0]["figures"], *records[0]["tasks"][through[0]]["figures"]]
    ranks: dict[str, dict[str, dict[str, list[float]]]] = {}
    for word, target in TARGETS.items():
        columns: dict[str, tuple[list[Array], list[Array]]] = {n: ([], []) for n in names}
        for task in through:
            own = [r["figures"] | r["tasks"][task] | r["tasks"][task]["figures"] for r in records]
            for name in names:
                columns[name][0].append(np.array([o[name] for o in own]))
                columns[name][1].append(np.array([target(o["on_rig"], o["in_model"]) for o in own]))
        ranks[word] = {"": {n: correlation(*columns[n]) for n in names}}
        if word == "spearman":
            above = {n: difference(x, columns["rmse"][0], y) for n, (x, y) in columns.items()}
        for i, task in enumerate(through):
            ranks[word][task] = {n: correlation(x[i : i + 1], y[i : i + 1]) for n, (x, y) in columns.items()}
    costs = np.log([[r["tasks"][t]["on_rig"] for r in records] for t in through]).mean(axis=0)
    ranks["together"] = {
        "": {n: correlation([rankdata(x, axis=1).mean(axis=0)], [costs]) for n, (x, _) in columns.items()}
    }
    content["tasks"] = {
        n: own | ({w: ranks[w][n] for w in TARGETS} if n in through else {}) for n, own in extra.items()
    }
    spearman = ranks["spearman"][""]
    return content | {
        "spearman": spearman, "above_rmse": above, **{w: ranks[w][""] for w in TARGETS if w != "spearman"},
        "spearman_together": ranks["together"][""],
        **{f"{n}{w}_spearman": spearman[(n + w).replace("_", " ")]
           for n in ("rmse", "floors") for w in ("", "_fitted")},
        "best": max(names, key=lambda n: np.nan_to_num(spearman[n][0], nan=-1.0)),
    }  # fmt: skip


def finished(
    content: dict[str, Any], setting: dict[str, Any]
) -> dict[str, tuple[dict[str, Any], list[dict[str, Any]]]]:
    """Task -> what is told of it, and its result for each model, of the tasks that are through in an earlier run.

    Raises:
        ValueError: the earlier run had other settings.
    """
    other = {n: content.get(n) for n, value in setting.items() if content.get(n) != value}
    if other:
        raise ValueError(f"The earlier run had {other}, this one has {setting}.")
    found = {}
    for name, told in content["tasks"].items():
        own = [r["tasks"].get(name, {}) for r in content["models"]]
        if own and all("on_rig" in o for o in own):
            found[name] = {n: v for n, v in told.items() if n not in TARGETS}, own
    return found


def tables(content: dict[str, Any]) -> str:
    """What was found, for the terminal and the page."""
    per, rows = content["tasks"], content["models"]
    names = [t.name for t in TASKS]
    wide = "".join(f"{n:>21s}" for n in names)
    units = ", ".join(f"{t.name} in {t.unit}" for t in TASKS)
    lines = [f"Cost on the rig, and in the model in brackets; {units}:", "", f"{'':34s}" + wide]
    if all("tuned_on_rig" in per[n] for n in names):
        best = "".join(f"{t.scale * per[t.name]['tuned_on_rig']:13.2f}{'':8s}" for t in TASKS)
        lines.append(f"{'tuned on the rig itself':34s}" + best)
    for r in rows:
        own = [(t.scale * r["tasks"][t.name]["on_rig"], t.scale * r["tasks"][t.name]["in_model"]) for t in TASKS]
        lines.append(f"{short(r['model']):34s}" + "".join(f"{a:13.2f} {f'({b:.2f})':7s}" for a, b in own))
    if all("repeatability" in per[n] for n in names):
        lines.append(f"{'one tuning ranks another':34s}" + "".join(
            f"{per[n]['repeatability']:13.2f}{'':8s}" for n in names))  # fmt: skip
    titles = ("the cost on the rig", "what that is above the model's own", "how far it is from the model's own")
    for word, title in zip(TARGETS, titles, strict=True):
        together = content["spearman_together"] if word == "spearman" else {}
        last = f"{'together':>10s}  above rmse" if together else ""
        lines += ["", f"Spearman's correlation with {title}, over {len(rows)} models:", "",
                  f"{'':17s}{'mean':>6s}  {'95 %':15s}" + wide + last]  # fmt: skip
        for name, (value, low, high) in content[word].items():
            own_ranks = "".join(f"{per[n][word][name][0]:21.2f}" for n in names)
            also = f"{together[name][0]:10.2f}" if together else ""
            if together:
                also += "  {:5.2f}, {:.2f} to {:.2f}".format(*content["above_rmse"][name])
            lines.append(f"{name:17s}{value:6.2f}  {f'{low:.2f} to {high:.2f}':15s}{own_ranks}{also}")
    return "\n".join(lines)


def short(model: str) -> str:
    """A model's name without what all of its kind have."""
    for long, word in (("calibrated + ", "+ "), (".motor_x + sensor_bias.board_x", "es"), (".board_x", ""), (".x", ""),
                       ("_friction", ""), ("_load", ""), ("_", " ")):  # fmt: skip
        model = model.replace(long, word)
    return model


def write_picture(records: Sequence[dict[str, Any]], names: Sequence[str], file: Path) -> None:
    """The rig's cost of each task, a row, over each figure, a column."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    from eps_tunnel_analysis.report.values_pictures import save_svg

    figure = Figure(figsize=(2.4 * len(names), 2.1 * len(TASKS)), layout="constrained")
    for row, task in zip(figure.subplots(len(TASKS), len(names), sharey="row"), TASKS, strict=True):
        own = [r["tasks"][task.name] for r in records]
        costs = [task.scale * o["on_rig"] for o in own]
        for axes, name in zip(row, names, strict=True):
            shown = [abs((r["figures"] | o["figures"])[name]) for r, o in zip(records, own, strict=True)]
            axes.plot(shown, costs, "o", ms=4)
            axes.set_xlabel(name, fontsize=8)
            if max(costs) > 3.0 * min(costs):
                axes.set_yscale("log")
            if min(shown) > 0.0 and not name.startswith("alikeness"):
                axes.set_xscale("log")
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_minor_formatter(NullFormatter())
        row[0].set_ylabel(f"{task.name}, {task.unit}", fontsize=8)
    save_svg(figure, file)


def main() -> None:
    """Runs the study and prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=100_000)
    parser.add_argument("--quick", action="store_true", help="six models and short searches")
    parser.add_argument("--budget", type=int, default=BUDGET, help="evaluations of each calibration (default: 150)")
    parser.add_argument("--generations", type=int, help="of each tuning (default: the task's own)")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--resume", action="store_true", help="go on with what the file of --json has")
    parser.add_argument("--svg", type=Path, help="draw the rig's cost over some figures")
    given = parser.parse_args()
    budget, generations, tunings, count = given.budget, given.generations, TUNINGS, PROBES
    if given.quick:
        budget, generations, tunings, count = 120, 1, 1, 4
    started, seed, records = time.monotonic(), given.seed, list[dict[str, Any]]()
    setting = {"quick": given.quick, "seed": seed, "budget": budget, "generations": generations,
               "tunings": tunings, "probes": count}  # fmt: skip
    before = finished(json.loads(given.json.read_text(encoding="utf-8")), setting) if given.resume else {}
    recording, held = recorded(fitted_command(), seed), recorded(judged_command(), seed + 2)
    left = [t for t in TASKS if t.name not in before]
    probes: dict[str, Probes] = {t.name: probes_of(t, rig(), count, seed + 3) for t in left}
    extra: dict[str, dict[str, Any]] = {n: told for n, (told, _) in before.items()}
    extra |= {n: {"probes": p.costs.tolist()} for n, p in probes.items()}

    def write() -> dict[str, Any]:
        content = setting | {"seconds": round(time.monotonic() - started)} | summary(records, extra)
        if given.json:
            given.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        return content

    graded = list[Model]()
    for each in models(recording, given.quick, budget):
        figures = figures_of_recordings(each.model, recording, held)
        values = {n: v for n, v in each.model.values().items() if n.startswith(("drive.x.", *RIGHT, *sum(WRONG, ())))}
        graded.append(each.model)
        records.append({"model": each.name, "values": values, "figures": figures, "tasks": {}})
        print(f"{time.monotonic() - started:5.0f} s  {each.name}: RMSE {1e3 * figures['rmse']:.2f} mrad, half of the "
              f"samples alike at k = {figures['k half']:.3g}", flush=True)  # fmt: skip
    for name, (_, results) in before.items():
        for record, result in zip(records, results, strict=True):
            record["tasks"][name] = result
    for task in left:
        most = generations or task.generations
        if not given.quick:
            extra[task.name]["tuned_on_rig"] = tuned_on_rig(task, seed, most)
        for record, model in zip(records, graded, strict=True):
            found = [tuned(task, partial(in_model, task, model, seed=seed + n), seed + n, most)
                     for n in range(tunings)]  # fmt: skip
            own = float(np.mean([cost for _, cost in found]))
            record["tasks"][task.name] = {
                "controllers": [values.tolist() for values, _ in found],
                "in_model": own,
                "figures": {"own cost": own, **figures_of_probes(model, probes[task.name])},
            }
        best = np.array([r["tasks"][task.name]["controllers"] for r in records])
        judged = on_rig(task, play(task, rig(), best.reshape(-1, best.shape[2]), TRIALS, seed + 1))
        for record, costs in zip(records, judged.reshape(best.shape[:2]), strict=True):
            record["tasks"][task.name] |= {"on_rig": float(costs.mean()), "on_rig_each": costs.tolist()}
        extra[task.name]["repeatability"] = repeatability(judged.reshape(best.shape[:2]))
        write()
        print(f"{time.monotonic() - started:5.0f} s  {task.name}: done", flush=True)
    content = write()
    print("\n" + tables(content))
    if given.svg:
        write_picture(records, SHOWN, given.svg)


if __name__ == "__main__":
    main()
