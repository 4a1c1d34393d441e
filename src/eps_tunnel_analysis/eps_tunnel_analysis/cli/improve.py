# SPDX-License-Identifier: Apache-2.0
"""improve: diagnose, add, diagnose again, until nothing more can be named."""

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from eps_tunnel_analysis.cli.diagnosing import add_diagnosis_arguments, progress, write_diagnosis
from eps_tunnel_analysis.cli.folder import new_folder, refuse_existing
from eps_tunnel_analysis.cli.live_arguments import add_live_arguments, improve_live
from eps_tunnel_analysis.cli.plays import load_recorded
from eps_tunnel_analysis.cli.sides import add_bag_arguments, add_model_arguments
from eps_tunnel_analysis.cli.tables import console, table
from labyrinth_sim.errors import InputError

NAME = "improve"
HELP = "Adds what is missing, step by step, until the model is complete or nothing known explains what is left."
EPILOG = """\
examples:
  eps-tunnel improve --real bags/real_* --model labyrinth --out better
  eps-tunnel improve --live --emulated --hide '?' --model labyrinth_mx64 --out notebook
  eps-tunnel improve --live --arm --model my_rig --out notebook

files in --out: step_1/, step_2/ ... with diagnosis.json, report.html and model.yaml each, and staircase.json;
with --live notebook.md and what it links to: bags, gaps, diagnoses, models, and staircase.json."""
MOST_STEPS = 5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_bag_arguments(parser, required=False)
    add_model_arguments(parser)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="new folder for every step")
    parser.add_argument("--candidates", nargs="+", metavar="EFFECT", help="effects to consider (default: all)")
    add_diagnosis_arguments(parser)
    parser.add_argument("--json", action="store_true", help="print staircase.json, and nothing else, to stdout")
    add_live_arguments(parser)


def run(arguments: argparse.Namespace) -> int | None:
    if arguments.live:
        return improve_live(arguments)
    if not arguments.real:
        raise InputError("--real is missing: name the recordings, or play them now by --live.")
    _improve(arguments)
    return None


def _improve(arguments: argparse.Namespace) -> None:
    from eps_tunnel_analysis.diagnose.diagnose import diagnose
    from labyrinth_sim.model import save_model

    refuse_existing(arguments.out)
    recorded = load_recorded(arguments, efforts=True)
    steps: list[dict[str, Any]] = []
    with new_folder(arguments.out) as folder:
        model, once = recorded.model, None
        for number in range(1, MOST_STEPS + 1):
            with progress(arguments.progress) as told:
                found = diagnose(
                    model,
                    recorded.plays,
                    arguments.seed,
                    arguments.candidates,
                    arguments.threads,
                    told,
                    once=once,
                    held=recorded.held,
                )
            step = folder / f"step_{number}"
            step.mkdir()
            write_diagnosis(step, found, replace(recorded, model=model), arguments)
            v = found.verdict
            once = once or {axis: before for axis, (before, _) in v.floor.items()}
            if not steps:
                steps.append({"step": 0, "added": [], **_errors("as_given", v.to_json())})
                steps.append({"step": 0, "added": ["refitted values"], **_errors("before", v.to_json())})
            model = found.model if v.verdict == "effect" else found.base_model
            save_model(model, step / "model.yaml")
            if v.verdict != "effect":
                break
            steps.append({"step": number, "added": list(v.effects), **_errors("after", v.to_json())})
        staircase = {"verdict": v.verdict, "sentence": v.sentence, "steps": steps}
        (folder / "staircase.json").write_text(json.dumps(staircase, indent=1) + "\n", encoding="utf-8")
    if arguments.json:
        json.dump(staircase, sys.stdout, indent=1)
        print()
        return
    out = console()
    columns = {"error": "error, rad", "held_out": "held out, rad", "alikeness": "alikeness"}
    named = ["added", *columns.values(), *(["ball's error, m", "held out, m"] if "ball" in steps[0] else [])]
    rows = [[" + ".join(s["added"]) or "as given", *(f"{s[k]:.3g}" for k in columns)] for s in steps]
    for row, s in zip(rows, steps, strict=True):
        row += [f"{s['ball'][k]:.3g}" for k in ("error", "held_out") if "ball" in s]
    table(out, "Staircase of error", named, rows)
    out.print(staircase["sentence"], soft_wrap=True, markup=False)
    out.print(f"Models: {arguments.out}", soft_wrap=True)


def _errors(when: str, content: dict[str, Any]) -> dict[str, Any]:
    errors = {key: content[f"{key}_{when}"] for key in ("error", "held_out", "alikeness")}
    return errors | ({"ball": content[f"ball_{when}"]} if f"ball_{when}" in content else {})
