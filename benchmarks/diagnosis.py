# SPDX-License-Identifier: Apache-2.0
"""How often a diagnosis names what a rig has and its model lacks.

    python benchmarks/diagnosis.py --cases 1000 --seed 100000 --json out.json

Each case draws a new rig: its kind, drive law, true values, sensors, commands, noise and timing, and what is
wrong with it, in one of several forms and at any strength (benchmarks/drawn_rigs). Its physics imports nothing of the
model's, and what is judged are bags. Seeds below 100000 are for tuning; a reported run must not use them.

`--study old` takes the cases on the emulated testbed instead: one rig, three strengths. There seeds 9000 to 9999 were
used to choose the diagnosis's numbers.

With --visible a drawn case in which something is wrong is judged only if all of it shows at over 3 times the floor,
which is known before anything is diagnosed. Rates of what shows and of healthy rigs mean the same; the figures of
probabilities are then of those cases.

An interrupted run keeps its results: the JSON file is rewritten after each case, and --continue resumes the run.
With --scheduler each case is a task of a Dask cluster, whose machines have this repository at the same path.
"""

import argparse
import importlib
import json
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from datetime import date
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import testbed_cases
from counting import VISIBLE, Record, confusion, figures, flat, reliability
from drawn_rigs.cases import draw
from drawn_rigs.reading import Model, Play, add_effects, diagnose, loaded
from drawn_rigs.rigs import PLANTS

from eps_tunnel_analysis.fit.cluster import connected, each
from eps_tunnel_analysis.sequence_file import find_sequence
from labyrinth_sim.errors import InputError

HERE = Path(__file__).resolve().parent
TUNING = {"drawn": (0, 99_999), "old": (9000, 9999)}
AGAIN = 50_000_000  # added to a seed for the noise of the experiment that a diagnosis proposes


def judge_drawn(seed: int, threads: int, rig: str | None, visible: bool = False) -> Record:
    """One drawn case from its bags to the verdict; only "passed_over" if what is wrong should show and does not."""
    with tempfile.TemporaryDirectory() as folder:
        case = draw(seed, Path(folder), rig)
        if visible and case.hidden and case.visibility <= VISIBLE:
            return {"seed": seed, "passed_over": True}
        model, plays = loaded(case.model, case.bags)
        record = case.to_json()
        record["visibility"] = case.visibility
        # What is left out of the library is still known to the model.
        known = case.kind in ("single", "pair", "left_out")
        form = [hidden["names"][0] for hidden in record["hidden"]] if known else []
        return record | _said(model, plays, seed, threads, form, case.only)


def judge_testbed(seed: int, threads: int, rig: str | None, visible: bool = False) -> Record:
    """One case on the emulated testbed; what the refitted base leaves stands for its visibility."""
    kind, hidden, model = testbed_cases.draw(seed)
    config = testbed_cases.rig(hidden)
    plays = [testbed_cases.play(config, find_sequence("excite_12s").commands[0], seed)]
    truth = testbed_cases.truth_of(kind, hidden)
    record: Record = {"seed": seed, "kind": kind, "truth": truth, "strength": hidden[0].strength if hidden else ""}
    form = truth.split(" + ") if kind in ("single", "pair") else []
    record |= _said(model, plays, seed, threads, form, None, proposes=True)
    record["visibility"] = record["leaves"]
    experiment = record.pop("experiment", None)
    if experiment is not None:
        more = [*plays, testbed_cases.play(config, experiment, seed + AGAIN)]
        again = diagnose(model, more, seed=seed, nthread=threads, experiments=False).verdict
        record["after_experiment"] = {"verdict": again.verdict, "effects": list(again.effects)}
    return record


def _said(
    model: Model, plays: Sequence[Play], seed: int, threads: int, form: Sequence[str], only: Sequence[str] | None,
    proposes: bool = False,
) -> Record:  # fmt: skip
    """The diagnosis, and what the true form, if it has a name, would leave, fitted on its own."""
    started = time.monotonic()
    try:
        diagnosis = diagnose(model, plays, seed=seed, only=only, nthread=threads, experiments=proposes)
    except Exception as error:  # a case that crashes the diagnosis is a result, and the others still run
        return {"verdict": "failed", "effects": [], "stated": [], "set": {}, "leaves": 0.0, "held_out": None,
                "error": f"{type(error).__name__}: {error}", "seconds": time.monotonic() - started}  # fmt: skip
    v = diagnosis.verdict
    record: Record = {
        "verdict": v.verdict,
        "effects": list(v.effects),
        "stated": list(v.stated),
        "set": dict(v.set),
        "leaves": float(np.sqrt(max(before for before, _ in v.floor.values()))),
        "held_out": [v.before.held_out, v.after.held_out],
        "seconds": v.seconds,
        "evaluations": v.evaluations,
    }
    if proposes and diagnosis.experiment is not None:
        record["experiment"] = diagnosis.experiment.command
    if form:
        try:
            record["true_form"] = add_effects(model, plays, form, threads).after.held_out
        except Exception as error:  # as above
            record["true_form_error"] = f"{type(error).__name__}: {error}"
    return record


STUDIES = {"drawn": judge_drawn, "old": judge_testbed}


def judge_elsewhere(seed: int, folder: str, study: str, **settings: Any) -> Record:
    """One case on a worker of a cluster, which finds the studies in `folder`."""
    if folder not in sys.path:
        sys.path.insert(0, folder)
    record: Record = importlib.import_module("diagnosis").STUDIES[study](seed, **settings)
    return record


def judged(
    study: str, seeds: Sequence[int], workers: int, scheduler: str | None = None, **settings: Any
) -> Iterator[Record]:
    """Cases as they are done; a case's answer does not depend on the workers. `settings` are those of a judge."""
    if scheduler is not None:
        there = partial(judge_elsewhere, folder=str(HERE), study=study, **settings)
        with connected(scheduler) as client:
            yield from each(client, there, seeds)
        return
    judge = partial(STUDIES[study], **settings)
    if workers == 1:
        yield from map(judge, seeds)
        return
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
        for done in as_completed([pool.submit(judge, seed) for seed in seeds]):
            yield done.result()


def write(file: Path, content: dict[str, Any]) -> None:
    """Writes all of it or nothing."""
    beside = file.with_name(f".{file.name}.{os.getpid()}")
    beside.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    beside.replace(file)


def earlier(file: Path, settings: dict[str, Any]) -> tuple[list[Record], list[int]]:
    """The records of an interrupted run, and the seeds that it passed over.

    Raises:
        SystemExit: there is none, or it ran with other settings.
    """
    if not file.is_file():
        raise SystemExit(f"--continue needs the file of an earlier run; {file} does not exist.")
    content: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    other = {key: content.get(key) for key in settings if content.get(key) != settings[key]}
    if other:
        raise SystemExit(f"{file} is of a run with {other}; this one has {settings}. Name another file.")
    return content["cases"], content.get("passed_over", [])


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=12)
    parser.add_argument("--seed", type=int, default=100_000, help="of the first case; the others follow")
    parser.add_argument("--study", choices=list(STUDIES), default="drawn")
    parser.add_argument("--rig", choices=list(PLANTS), help="this kind of rig only; drawn cases only")
    parser.add_argument("--visible", action="store_true", help="judge only what shows, and healthy rigs")
    parser.add_argument("--threads", type=int, default=0, help="of each case; 0 for one per CPU")
    parser.add_argument("--workers", type=int, default=1, help="cases side by side; their seconds then mean little")
    parser.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="Dask scheduler whose workers do the cases")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--continue", dest="goes_on", action="store_true", help="keep the cases that --json holds")
    given = parser.parse_args()
    if given.goes_on and not given.json:
        parser.error("--continue needs --json with the file of an earlier run.")
    if given.scheduler and given.workers != 1:
        parser.error("--workers is for this machine; a scheduler has its own workers.")
    if given.rig and given.study != "drawn":
        parser.error("--rig chooses among drawn rigs; the old study has one rig.")
    if given.visible and given.study != "drawn":
        parser.error("--visible chooses among drawn cases; of the old study's it is not known before.")
    return given


def main() -> None:
    """Runs the cases and prints the tables."""
    given = arguments()
    low, high = TUNING[given.study]
    if given.seed <= high and given.seed + given.cases > low:
        print(f"Note: seeds {low} to {high} are for tuning; these figures flatter the diagnosis.")
    settings = {"study": given.study, "rig": given.rig, "seed": given.seed, "visible": given.visible}
    records, passed_over = earlier(given.json, settings) if given.goes_on else ([], [])
    done = {*passed_over, *(r["seed"] for r in records)}
    seeds = [seed for seed in range(given.seed, given.seed + given.cases) if seed not in done]
    started = time.monotonic()
    threads = given.threads or int(given.scheduler is not None)  # a worker has its share of its machine's cores
    of_a_case = {"threads": threads, "rig": given.rig, "visible": given.visible}
    cases = judged(given.study, seeds, given.workers, given.scheduler, **of_a_case)
    for number, record in enumerate(cases, start=1):
        rest = (time.monotonic() - started) / number * (len(seeds) - number)
        said = f"[{number}/{len(seeds)}, {rest / 60:.0f} min left] {record['seed']}"
        if record.get("passed_over"):
            passed_over = sorted([*passed_over, record["seed"]])
            print(f"{said} does not show", flush=True)
        else:
            records = sorted([*records, record], key=lambda r: r["seed"])
            print(f"{said} {record['kind']} {record['truth']} ({record['visibility']:.1f} x floor) -> "
                  f"{record['verdict']} {', '.join(record['stated'])} [{record['seconds']:.0f} s]",
                  flush=True)  # fmt: skip
        if given.json:
            write(given.json, {
                **settings, "date": str(date.today()), "threads": given.threads or os.cpu_count(),
                "workers": given.workers, "figures": flat(figures(records)), "reliability": reliability(records),
                "passed_over": passed_over, "cases": records,
            })  # fmt: skip
    print(f"\n{len(records)} cases in {time.monotonic() - started:.0f} s")
    for key, figure in figures(records).items():
        value = "-" if figure.value is None else f"{figure.value:.3f}"
        interval = "" if figure.interval is None else f"{figure.interval[0]:.3f} to {figure.interval[1]:.3f}"
        print(f"{key:26s}{value:10s}{interval:20s}({figure.n})")
    print("\nstated     true       cases")
    for row in reliability(records):
        print(f"{row['stated']:<11.3f}{row['true']:<11.3f}{row['n']}")
    print("\nhidden -> said")
    for truth, said, count in confusion(records):
        print(f"{truth:50s}{said:50s}{count}")


if __name__ == "__main__":
    try:
        main()
    except InputError as error:  # no scheduler answers
        raise SystemExit(str(error)) from None
