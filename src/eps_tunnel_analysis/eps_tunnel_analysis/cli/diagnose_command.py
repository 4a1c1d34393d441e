# SPDX-License-Identifier: Apache-2.0
"""diagnose: which physical effect the model lacks."""

import argparse
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from eps_tunnel_analysis.cli.arguments import (
    add_bag_arguments,
    add_diagnosis_arguments,
    add_model_arguments,
    add_search_arguments,
    diagnosis_options,
)
from eps_tunnel_analysis.outputs import json_text
from eps_tunnel_analysis.terminal import console, print_next, print_verdict, rollout_progress

if TYPE_CHECKING:
    from eps_tunnel_analysis.check.check import Check

NAME = "diagnose"
HELP = "Names the physical effect that the model lacks, and says how sure that is."
EPILOG = """\
examples:
  eps-tunnel diagnose --real bags/real_* --model labyrinth --out why
  eps-tunnel diagnose --real bags/real_* --model labyrinth --candidates backlash coulomb_friction --out why --json

Four verdicts: complete, effect (which), undecided (with the experiment that decides), unknown (no known effect
explains it; then what it depends on, and a formula). Files in --out: diagnosis.json, report.html, model.yaml (with the
named effects and refitted values, ready to use); if undecided, next_experiment.yaml; if unknown, proposed_effect.py and
proposed_model.yaml where a law was found."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_bag_arguments(parser)
    add_model_arguments(parser)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="new folder for report and JSON")
    add_search_arguments(parser)
    add_diagnosis_arguments(parser)
    parser.add_argument(
        "--scheduler", metavar="tcp://HOST:PORT", help="Dask scheduler whose workers run the simulations"
    )
    parser.add_argument("--json", action="store_true", help="print diagnosis.json, and nothing else, to stdout")


def run(arguments: argparse.Namespace) -> None:
    from eps_tunnel_analysis.fit.cluster import cluster
    from eps_tunnel_analysis.loop.reason import DiagnosisRun, diagnose_bags
    from eps_tunnel_analysis.report.next_step import MODEL_FILE, next_step

    elsewhere = cluster(arguments.scheduler) if arguments.scheduler else nullcontext()
    with elsewhere as spread, rollout_progress(arguments.progress) as progress:
        reason = diagnose_bags(
            arguments.model, arguments.real, arguments.out, diagnosis_options(arguments),
            DiagnosisRun(progress, propose=True, spread=spread), _quiet if arguments.json else _show_check,
        )  # fmt: skip
    if arguments.json:
        print(json_text(reason.content), end="")
        return
    diagnosis = reason.diagnosis
    out, v = console(), diagnosis.verdict
    print_verdict(v, reason.recorded.notes, unit=reason.recorded.model.rig.position_unit)
    if (proposal := reason.proposal) is not None:
        out.print(proposal.sentence, soft_wrap=True, markup=False)
        if proposal.text:
            file = arguments.out / "proposed_effect.py"
            out.print(f"Its file: {file}, for --effects {arguments.out}", soft_wrap=True)
        if proposal.model:
            out.print(f"The model with it: {arguments.out / 'proposed_model.yaml'}", soft_wrap=True)
    if diagnosis.experiment:
        out.print(diagnosis.experiment.reason, soft_wrap=True, markup=False)
    out.print(f"Model: {arguments.out / MODEL_FILE}", soft_wrap=True)
    out.print(f"Report: {reason.report.resolve()}", soft_wrap=True)
    print_next(out, *next_step(diagnosis, reason.recorded, arguments.real, arguments.model, arguments.out, proposal))


def _show_check(checked: "Check") -> None:
    for line in checked.lines():
        console().print(line, soft_wrap=True, markup=False)


def _quiet(checked: "Check") -> None:
    """It is in the JSON."""
