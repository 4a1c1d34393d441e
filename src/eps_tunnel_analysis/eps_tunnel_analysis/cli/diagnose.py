# SPDX-License-Identifier: Apache-2.0
"""diagnose: which physical effect the model lacks."""

import argparse
import json
import sys
from pathlib import Path

from eps_tunnel_analysis.cli.diagnosing import (
    add_diagnosis_arguments,
    diagnosis_content,
    progress,
    write_diagnosis,
)
from eps_tunnel_analysis.cli.folder import new_folder, refuse_existing
from eps_tunnel_analysis.cli.plays import load_recorded
from eps_tunnel_analysis.cli.sides import add_bag_arguments, add_model_arguments
from eps_tunnel_analysis.cli.tables import console, table

NAME = "diagnose"
HELP = "Names the physical effect that the model lacks, and says how sure that is."
EPILOG = """\
examples:
  eps-tunnel diagnose --real bags/real_* --model labyrinth --out why
  eps-tunnel diagnose --real bags/real_* --model labyrinth --candidates backlash coulomb_friction --out why --json

Four verdicts: complete, effect (which), undecided (with the experiment that decides), unknown (no known effect
explains it). files in --out: diagnosis.json, report.html and, if undecided, next_experiment.yaml."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_bag_arguments(parser)
    add_model_arguments(parser)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="new folder for report and JSON")
    parser.add_argument("--candidates", nargs="+", metavar="EFFECT", help="effects to consider (default: all)")
    add_diagnosis_arguments(parser)
    parser.add_argument("--json", action="store_true", help="print diagnosis.json, and nothing else, to stdout")


def run(arguments: argparse.Namespace) -> None:
    from eps_tunnel_analysis.diagnose.diagnose import diagnose

    refuse_existing(arguments.out)
    recorded = load_recorded(arguments, efforts=True)
    with progress(arguments.progress) as told:
        found = diagnose(
            recorded.model,
            recorded.plays,
            arguments.seed,
            arguments.candidates,
            arguments.threads,
            told,
            held=recorded.held,
        )
    with new_folder(arguments.out) as folder:
        write_diagnosis(folder, found, recorded, arguments)
    if arguments.json:
        json.dump(diagnosis_content(found, recorded), sys.stdout, indent=1, allow_nan=False)
        print()
        return
    out, v = console(), found.verdict
    out.print(v.sentence, style="bold", soft_wrap=True, markup=False)
    rows = [(name, f"{p:.1%}", "*" if name in v.stated else "") for name, p in v.set.items() if p >= 0.001]
    table(out, "Hypotheses", ("hypothesis", "probability", "in the stated set"), rows)
    for note in v.notes:
        out.print(f"Note: {note}", soft_wrap=True, markup=False)
    if found.experiment:
        out.print(f"Next: play {arguments.out / 'next_experiment.yaml'}. {found.experiment.reason}", soft_wrap=True)
    out.print(f"Report: {(arguments.out / 'report.html').resolve()}", soft_wrap=True)
