# SPDX-License-Identifier: Apache-2.0
"""How often a diagnosis names what is hidden in the emulated testbed, whose physics shares no line with the effects.

Realities are drawn from the seed: single effects (weak, medium, strong), pairs of strong ones, nothing, and things
outside the library; always with wrong drive values, noise, quantisation and jittering stamps; 5 trials of excite_12s.

    python benchmarks/diagnosis.py --cases 200 --seed 100000 --json out.json

Seeds 9000 to 9999 were used to choose the numbers in diagnose/calibration.py; a reported run must not touch them.
A benchmark that is cut off keeps what it has: the JSON file is written anew after each case, and --continue goes on.
"""

import argparse
import json
import multiprocessing
import os
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eps_tunnel_analysis.cli.folder import write_anew
from eps_tunnel_analysis.diagnose.addition import add_effects
from eps_tunnel_analysis.diagnose.calibration import CALIBRATION
from eps_tunnel_analysis.diagnose.diagnose import Diagnosis, diagnose
from eps_tunnel_analysis.plays import Play
from eps_tunnel_analysis.sequence import Command
from eps_tunnel_analysis.sequence_file import find_sequence
from labyrinth_hw.testbed.effects import EFFECTS, STRENGTHS
from labyrinth_hw.testbed.hidden import SENSORS, Hidden, TestbedConfig, hide, load_testbed
from labyrinth_hw.testbed.offline import Run, run_offline
from labyrinth_sim.model import Model, load_model
from labyrinth_sim.trials import Trials

TRIALS = 5
RATE = 100.0
SIGNALS = ("motor_x", "motor_y", "board_x", "board_y", "motor_x_effort", "motor_y_effort")
STALL = 6.0  # N m, the data sheet of the servo that the testbed emulates
STRONG = 3.0  # times the noise floor, root mean square
KINDS = {"single": 0.55, "pair": 0.15, "none": 0.15, "outside": 0.15}


def draw(seed: int) -> tuple[str, tuple[Hidden, ...], Model]:
    """Kind of case, what is hidden, and a model with wrong drive values."""
    rng = np.random.default_rng([seed, 5])
    kind = str(rng.choice(list(KINDS), p=list(KINDS.values())))
    known = [n for n, e in EFFECTS.items() if e.known and not e.ball]
    outside = [n for n, e in EFFECTS.items() if not e.known]
    hidden: tuple[Hidden, ...] = ()
    if kind == "single":
        hidden = (_hidden(rng, str(rng.choice(known)), str(rng.choice(STRENGTHS))),)
    elif kind == "pair":
        names = rng.choice(known, 2, replace=False)
        hidden = tuple(_hidden(rng, str(n), "strong") for n in names)
    elif kind == "outside":
        hidden = (_hidden(rng, str(rng.choice(outside)), str(rng.choice(STRENGTHS[1:]))),)
    wrong = {}
    for axis in "xy":
        wrong[f"drive.{axis}.p"] = rng.uniform(15.0, 25.0)
        wrong[f"drive.{axis}.d"] = rng.uniform(-2.0, 2.0)
        wrong[f"drive.{axis}.delay"] = rng.uniform(0.01, 0.045)
        wrong[f"drive.{axis}.torque"] = STALL * rng.uniform(0.9, 1.1)
    return kind, hidden, load_model("labyrinth_manual").with_values(wrong, "wrong on purpose")


def _hidden(rng: np.random.Generator, name: str, strength: str) -> Hidden:
    axis = str(rng.choice(SENSORS if EFFECTS[name].sensor else ("x", "y")))
    return hide(name, axis, strength, sign=int(rng.choice([-1, 1])))


def rig(hidden: tuple[Hidden, ...]) -> TestbedConfig:
    """The healthy rig with these things wrong."""
    healthy = load_testbed("healthy")
    reality = healthy.reality
    for item in hidden:
        reality = item.applied(reality)
    return replace(healthy, reality=reality, hidden=hidden)


def play(config: TestbedConfig, command: Command, seed: int) -> Play:
    """A command played on an emulated rig, brought onto the grid as bags are."""
    times, targets = command.sample(RATE)
    run = run_offline(config, times, targets, TRIALS, seed)
    values = np.stack([_on_grid(run, i, times) for i in range(TRIALS)])
    commands = np.tile(targets, (TRIALS, 1, 1))
    trials = Trials(times, SIGNALS, ("rad",) * 4 + ("N m",) * 2, values, ("motor_x", "motor_y"), commands)
    return Play(command.name, trials)


def _on_grid(run: Run, trial: int, times: NDArray[np.float64]) -> NDArray[np.float64]:
    raw = np.concatenate([run.motor[trial], run.board[trial], run.effort[trial]], axis=1)
    return np.column_stack([np.interp(times, run.stamps[trial], column) for column in raw.T])


def judge(seed: int, threads: int) -> dict[str, Any]:
    """One case from drawing to verdict."""
    kind, hidden, model = draw(seed)
    config = rig(hidden)
    plays = [play(config, find_sequence("excite_12s").commands[0], seed)]
    found = diagnose(model, plays, seed=seed, nthread=threads)
    v = found.verdict
    truth = truth_of(kind, hidden)
    record: dict[str, Any] = {
        "seed": seed,
        "kind": kind,
        "truth": truth,
        "strength": hidden[0].strength if hidden else "",
        "shows": float(np.sqrt(max(before for before, _ in v.floor.values()))),
        "verdict": v.verdict,
        "effects": list(v.effects),
        "stated": list(v.stated),
        "top": dict(list(v.set.items())[:6]),
        "probability_of_truth": v.set.get(truth, 0.0),
        "held_out": [v.before.held_out, v.after.held_out],
        "seconds": v.seconds,
        "evaluations": v.evaluations,
    }
    if kind in ("single", "pair"):
        record["oracle"] = _oracle(found, model, plays, truth, threads)
    if found.experiment is not None:
        more = [*plays, play(config, found.experiment.command, seed + 50_000_000)]
        again = diagnose(model, more, seed=seed, nthread=threads, experiments=False).verdict
        record["after_experiment"] = {"verdict": again.verdict, "effects": list(again.effects)}
    return record


def _judged(seeds: Sequence[int], threads: int, workers: int) -> Iterator[dict[str, Any]]:
    """Cases as they are done; a case's answer does not depend on the workers."""
    if workers == 1:
        yield from (judge(seed, threads) for seed in seeds)
        return
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        for done in as_completed([pool.submit(judge, seed, threads) for seed in seeds]):
            yield done.result()


def truth_of(kind: str, hidden: tuple[Hidden, ...]) -> str:
    """The hypothesis that is true, as a verdict's set names it."""
    if kind in ("none", "outside"):
        return {"none": "none", "outside": "unknown"}[kind]
    return " + ".join(sorted(item.name for item in hidden))


def _oracle(found: Diagnosis, model: Model, plays: list[Play], truth: str, threads: int) -> float:
    """Held-out error that fitting the true form reaches."""
    if " + ".join(sorted(found.verdict.effects)) == truth:
        return found.verdict.after.held_out
    return add_effects(model, plays, truth.split(" + "), threads).after.held_out


def figures(records: list[dict[str, Any]]) -> dict[str, float | None]:
    """The table of keys; None where no case speaks to one."""
    single = [r for r in records if r["kind"] == "single"]
    true = [r for r in records if "oracle" in r and r["held_out"][0] - r["oracle"] > 0.1 * r["held_out"][0]]
    drops = [(r["held_out"][0] - r["held_out"][1]) / (r["held_out"][0] - r["oracle"]) for r in true]
    tried = [r for r in records if "after_experiment" in r]
    return {
        "top1_strong": _mean([right(r) for r in single if r["shows"] > STRONG]),
        "top1_all": _mean([right(r) for r in single]),
        "pair_both": _mean([float(set(r["effects"]) == set(r["truth"].split(" + "))) for r in records
                            if r["kind"] == "pair"]),
        "false_alarm": _mean([float(r["verdict"] == "effect") for r in records if r["kind"] == "none"]),
        "unknown_found": _mean([float("unknown" in r["stated"]) for r in records if r["kind"] == "outside"]),
        "coverage_90": _mean([float(r["truth"] in r["stated"]) for r in records]),
        "drop_vs_oracle": float(np.median(drops)) if drops else None,
        "decided_after_experiment": _mean([float(_decided(r)) for r in tried]),
        "median_seconds": float(np.median([r["seconds"] for r in records])) if records else None,
    }  # fmt: skip


def right(r: dict[str, Any]) -> float:
    """1 for an effect named right, 1/2 for a set of two that holds the truth, else 0."""
    if r["verdict"] == "effect":
        return float(" + ".join(sorted(r["effects"])) == r["truth"])
    return 0.5 if r["verdict"] == "undecided" and r["truth"] in r["stated"] and len(r["stated"]) <= 2 else 0.0


def _decided(r: dict[str, Any]) -> bool:
    again = r["after_experiment"]
    if r["truth"] == "none":
        return bool(again["verdict"] == "complete")
    if r["truth"] == "unknown":
        return bool(again["verdict"] == "unknown")
    return again["verdict"] == "effect" and " + ".join(sorted(again["effects"])) == r["truth"]


def _mean(values: list[float]) -> float | None:
    return float(np.mean(values)) if values else None


def confusion(records: list[dict[str, Any]]) -> list[tuple[str, str, int]]:
    """What was hidden, what was said, how often."""

    def said(r: dict[str, Any]) -> str:
        return " + ".join(sorted(r["effects"])) if r["verdict"] == "effect" else str(r["verdict"])

    def bare(name: str) -> str:
        return " + ".join(part.partition(".")[0] for part in name.split(" + "))

    pairs = Counter((bare(r["truth"]), bare(said(r))) for r in records)
    return sorted((a, b, n) for (a, b), n in pairs.items())


def main() -> None:
    """Runs the cases and prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=12)
    parser.add_argument("--seed", type=int, default=100_000, help="of the first case; the others follow")
    parser.add_argument("--threads", type=int, default=0, help="of each case; 0 for one per CPU")
    parser.add_argument("--workers", type=int, default=1, help="cases side by side; the seconds are then no measure")
    parser.add_argument("--json", type=Path)
    parser.add_argument(
        "--continue",
        dest="goes_on",
        action="store_true",
        help="keep the cases that --json holds, made by the same code",
    )
    arguments = parser.parse_args()
    low, high = CALIBRATION.seeds
    if arguments.seed <= high and arguments.seed + arguments.cases > low:
        print(f"Note: seeds {low} to {high} were used to choose the calibration; these figures flatter it.")
    records: list[dict[str, Any]] = []
    if arguments.goes_on:
        if not arguments.json or not arguments.json.exists():
            parser.error(f"--continue needs the file of an earlier run; --json says {arguments.json}.")
        records = json.loads(arguments.json.read_text(encoding="utf-8"))["cases"]
    started = time.monotonic()
    done = {r["seed"] for r in records}
    seeds = [seed for seed in range(arguments.seed, arguments.seed + arguments.cases) if seed not in done]
    for record in _judged(seeds, arguments.threads, arguments.workers):
        records.append(record)
        records.sort(key=lambda r: r["seed"])
        print(f"{record['seed']} {record['truth']} ({record['strength'] or '-'}, {record['shows']:.1f} x floor) -> "
              f"{record['verdict']} {', '.join(record['stated'])} [{record['seconds']:.0f} s]", flush=True)  # fmt: skip
        if arguments.json:
            threads = arguments.threads or os.cpu_count()
            content = {"seed": arguments.seed, "date": str(date.today()), "threads": threads,
                       "workers": arguments.workers, "figures": figures(records), "cases": records}  # fmt: skip
            write_anew(arguments.json, json.dumps(content, indent=1) + "\n")
    print(f"\n{len(records)} cases in {time.monotonic() - started:.0f} s")
    for key, value in figures(records).items():
        print(f"{key:26s}{'-' if value is None else f'{value:.3f}'}")
    print("\nhidden -> said")
    for truth, said, count in confusion(records):
        print(f"{truth:50s}{said:50s}{count}")


if __name__ == "__main__":
    main()
